"""What of an image is neither scene nor noise: light of exposures before, and what is cut off."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import Patterns, PatternSet, fwht_in_place
from hardware.reconstruction.measurements import measured_values
from hardware.reconstruction.sensing import Sensing
from twin.camera.chain import Chain, Powers
from twin.camera.illumination import prompt

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Distortion:
    """An image's error in the mean, noise aside, in electrons of the cells.

    ``kept`` (n_detectors,): factor between the image and the true one, by least squares.
    ``error_e`` (n_detectors,): root mean square of what no factor explains. ``contrast_e``:
    standard deviation of the true image of all detectors.
    """

    kept: Array
    error_e: Array
    contrast_e: float

    def hides(self, noise_e: Array) -> Bools:
        """Detectors whose image is gone: what is left of its contrast is no more than the error,
        which noise (n_detectors,) does not cover.
        """
        kept = np.maximum(self.kept, 0)
        return np.asarray((self.error_e > noise_e) & (self.error_e >= kept * self.contrast_e))

    def over(self, noise_e: Array) -> float:
        """Error over noise, both as root mean square over the detectors."""
        return float(np.sqrt(np.mean(self.error_e**2) / np.mean(noise_e**2)))


@dataclass(frozen=True, eq=False)
class Distortions:
    """By what is left of the exposure before, by what rails and well cut off, and by both."""

    lag: Distortion
    clipping: Distortion
    total: Distortion


def distortions(chain: Chain, power: Powers) -> Distortions:
    """Of the mean counts of a camera against one that switches and settles at once and whose
    converter has no rails; images by inverse transform, of own
    patterns by least squares.
    """
    patterns, detector, n_shutters = chain.patterns, chain.front_end, len(chain.shutters)

    def image(exposed_w: Array, *, cut: bool) -> Array:
        linear = exposed_w * detector.electrons_per_watt + detector.dark_e
        electrons = detector.mean_e(exposed_w) if cut else linear
        summed = electrons.reshape(-1, n_shutters, electrons.shape[-1]).sum(axis=1)
        return _image(summed, patterns)

    ideal_w = chain.exposed(prompt(chain.system, power.cells_w), power.sun_w)
    slow_w = chain.settled(chain.exposed(chain.steady(power), power.sun_w), power.sun_w)
    true = image(ideal_w, cut=False)
    return Distortions(
        lag=_against(true, image(slow_w, cut=False)),
        clipping=_against(true, image(ideal_w, cut=True)),
        total=_against(true, image(slow_w, cut=True)),
    )


def _image(electrons: Array, patterns: Patterns) -> Array:
    """Measured cells (n_cells, n_detectors) of exposures (n_exposures, n_detectors)."""
    values = measured_values(electrons, patterns)
    if not isinstance(patterns, PatternSet):
        return (Sensing(patterns).pseudo_inverse @ values)[~patterns.unmeasured_cells]
    coefficients = np.zeros((patterns.n_cells, electrons.shape[-1]))
    coefficients[patterns.indices] = values
    return fwht_in_place(coefficients)[~patterns.unmeasured_cells] / patterns.n_cells


def _against(true: Array, image: Array) -> Distortion:
    power = np.sum(true**2, axis=0)
    kept = np.ones_like(power)
    np.divide(np.sum(true * image, axis=0), power, out=kept, where=power > 0)
    error = np.sqrt(np.mean((image - kept * true) ** 2, axis=0))
    return Distortion(kept, error, float(true.std()))
