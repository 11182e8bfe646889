"""Whether the two arms of a complementary set are equally sensitive, as they are taken to be.

A pattern's exposure and that to its complement add up to the same light, so that their sums tell
nothing of the image. Arms of sensitivities a and b make the sum follow the difference linearly, by
r = (a - b) / (a + b), and add r times the sum of a half-lit pattern to every measurement.

r is found by least squares from the steps between successive pairs, which slow drift does not
reach, without the first pair, which a slow amplifier makes too small. It is told beyond 5 standard
errors (Student's, by the number of pairs) and what noise of unlike arms can make of r at most: of
fewer than one image in 1.7 million where arms are equal and noise is normal. Counts are left as
they are: the error of r would be one of all measurements.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number, with_error
from hardware.reconstruction.measurements import pairs
from hardware.reconstruction.noise import errors_of_few, freedom_of_successive, noise_of_sums
from hardware.reconstruction.sensing import Sensing
from hardware.records import SpiRecord

Array = NDArray[np.float64]


def unequal_arms(record: SpiRecord, sensing: Sensing) -> Iterator[str]:
    """A warning where arms differ, with their ratio and what it adds to measurements and cells."""
    if record.patterns.mode != "complementary":
        return
    lit, complement = pairs(record.electrons[_clear_pairs(record)], record.patterns)
    if len(lit) < 3:
        return
    sums, differences = lit + complement, lit - complement
    slope, error, least = _slope(sums, differences, 2 * record.electrons_per_count**2 / 12)
    if not (unequal := np.abs(slope) > least).any():
        return
    # Of a half-lit pattern, whose difference is the slope times its sum.
    sum_half_lit = (sums - slope * differences).mean(axis=0) / np.maximum(1 - slope**2, 1e-3)
    added = slope * sum_half_lit
    worst = int(np.argmax(np.where(unequal, np.abs(added), -1.0)))
    strength = min(abs(float(slope[worst])), 1.0)
    ratio, scatter = (1 - strength) / (1 + strength), 2 * error[worst] / (1 + strength) ** 2
    weak, strong = ("second", "first") if slope[worst] > 0 else ("first", "second")
    yield (
        f"{np.count_nonzero(unequal)} of {len(slope)} images have arms that are not equally "
        f"sensitive, the {weak} {with_error(ratio, scatter)} times as much as the {strong}: taken "
        f"as equal they add {number(added[worst])} electrons to every measurement"
        f"{_in_cells(float(added[worst]), sensing)}, and make the noise too large"
    )


def _clear_pairs(record: SpiRecord) -> NDArray[np.bool_]:
    """Pairs (count,) but the first that are neither flagged nor at a converter's rail."""
    at_rail = (record.counts == 2**record.adc_bits - 1) | (record.counts == 0)
    bad = at_rail.any(axis=1) | (record.flags != 0)
    clear = ~bad.reshape(record.patterns.count, -1).any(axis=1)
    clear[0] = False
    return np.asarray(clear)


def _slope(sums: Array, differences: Array, least_variance: float) -> tuple[Array, Array, Array]:
    """Slope of sums over differences (n_pairs, n_images), its standard error, and the size beyond
    which it is not by chance, all (n_images,).

    The noises of sum and difference correlate where one arm has more of it, by no more than the
    variance of the sums: their squared steps are the most that noise alone adds. An arm that is
    dead looks the same and is not told.
    """
    of_sums, steps = np.diff(sums, axis=0), np.diff(differences, axis=0)
    squares = (steps**2).sum(axis=0)
    some = np.where(squares > 0, squares, np.inf)
    slope = (steps * of_sums).sum(axis=0) / some
    rest = noise_of_sums(sums - slope * differences, in_turn=False)
    variance = np.maximum(rest, least_variance)
    weight = np.diff(steps, axis=0, prepend=0.0, append=0.0)  # of each sum in the slope
    error = np.sqrt(variance * (weight**2).sum(axis=0)) / some
    far = errors_of_few(freedom_of_successive(len(sums)) - 1)
    least = far * error + (of_sums**2).sum(axis=0) / some
    told = squares > 0  # where all differences are alike, no slope is
    return slope, np.where(told, error, np.inf), np.where(told, least, np.inf)


def _in_cells(added: float, sensing: Sensing) -> str:
    """What a constant in all measurements does to cells, through the plain inverse of rows of the
    Hadamard matrix.
    """
    if sensing.is_dense:
        return ""
    moved = sensing.adjoint(np.full(sensing.count, added)) / sensing.n_cells
    cell = int(np.argmax(np.abs(moved)))
    row, column = divmod(cell, sensing.shape[1])
    return f", most of it in cell ({row}, {column}), {number(moved[cell])} electrons"
