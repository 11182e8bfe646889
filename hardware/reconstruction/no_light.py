"""Whether a record shows any light: counts that are all the same, images that are noise alone.

Light of many cells shows in the sum of all, in the values of patterns that count no cell
negatively; light of few in those cells of the plain inverse, which noise meets with the mean of all
patterns. An image in which neither stands out, to either side, holds no light that could be told.
Of images without light one in 1000 stands out by chance, where noise is normal. As the noise is
found in the record itself, Student's distribution takes the normal one's place. Of a user's own
patterns, and without a pattern that tells all light, counts that are all the same are told alone.
"""

from collections.abc import Iterator

import numpy as np

from hardware.formatting import number
from hardware.patterns import OwnPatterns
from hardware.reconstruction.measurements import Measurements
from hardware.reconstruction.negative_light import error_of_a_sum, sums_of_light
from hardware.reconstruction.noise import freedom
from hardware.reconstruction.sensing import Sensing
from hardware.records import SpiRecord

#: Chance that a sum, or any cell, of an image without light stands out: together one in 1000.
_CHANCE = 5e-4


def without_light(record: SpiRecord, sensing: Sensing, measured: Measurements) -> Iterator[str]:
    """Warnings of a record that shows no light."""
    if record.flags.all():  # saturated, which is told
        return
    alike = np.ptp(record.counts, axis=0) == 0
    if n_alike := int(np.count_nonzero(alike)):
        yield (
            f"{n_alike} of {len(alike)} detectors gave the same count in every exposure: no light "
            "is told from the rounding of counts"
        )
    elif not any(shutter.modulated for shutter in record.shutters):
        yield from _noise_alone(record, sensing, measured)


def _noise_alone(record: SpiRecord, sensing: Sensing, measured: Measurements) -> Iterator[str]:
    """A warning of images that are no more than noise."""
    sums = sums_of_light(record.patterns)
    degrees = freedom(record.patterns)
    own = isinstance(record.patterns, OwnPatterns) or sensing.mixing is not None
    if own or not (degrees > 0 and sums.any()):
        return
    light, error = measured.values[sums].mean(axis=0), error_of_a_sum(record.patterns, measured)
    shown = sensing.measured & ~record.patterns.common_cells  # the constant's noise is there
    of_cells = np.sqrt(sensing.count * measured.most_noise_variance)
    largest = np.abs(sensing.adjoint(measured.values)[shown]).max(axis=0, initial=0.0)
    dark = largest <= _errors(degrees, int(np.count_nonzero(shown))) * of_cells
    dark &= np.abs(light) <= _errors(degrees) * error
    if not dark.any():
        return
    at = int(np.argmax(dark))
    together = f"{number(light[at])} electrons, with a standard error of {number(error[at])}"
    yield (
        f"{np.count_nonzero(dark)} of {len(dark)} images hold no light above their noise: all "
        f"cells together {together}, and no cell stands out"
    )


def _errors(degrees: float, n: int = 1) -> float:
    """Standard errors beyond which, to either side, any of n values of noise is by `_CHANCE`."""
    from scipy.special import stdtrit  # takes 0.1 s to import

    return -float(stdtrit(degrees, _CHANCE / (2 * max(n, 1))))
