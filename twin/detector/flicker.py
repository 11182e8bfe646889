"""1/f noise of an amplifier in the image of a set of patterns.

The difference of two exposures in turn takes out what is slower than a pair. Where patterns are
shown once, noise that drifts over the whole frame stays: cells whose patterns change as slowly as
it does have more of it than others.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import Patterns
from twin.detector.inverse import inverse_image
from twin.detector.noise import NoiseBudget

Array = NDArray[np.float64]

#: Among the contributions of a `NoiseBudget`.
FLICKER = "1/f noise of the amplifier"
#: 2 x 4 x the integral of sin(u)^2 / u from 0 to pi/2: what the difference of two exposures in turn
#: keeps of 1/f noise, per white variance and corner frequency times period.
OF_A_PAIR = 6.593
_AT_ONCE = 128  # frequencies: 16 MB for 4096 exposures


def in_image(budget: NoiseBudget, patterns: Patterns) -> NoiseBudget:
    """A budget whose 1/f noise is counted as it survives pairs, with what survives these patterns:
    root mean square over the cells that are measured, as noise of one exposure.
    """
    slow_e = budget.noise_e.get(FLICKER, 0.0)
    if not slow_e or patterns.mode == "differential":
        return budget
    of_pixel = budget.pixel_noise_e(patterns) / budget.total_noise_e
    more = np.sqrt(_of_measured(patterns) / (OF_A_PAIR / 2)) / of_pixel
    return replace(budget, noise_e={**budget.noise_e, FLICKER: slow_e * float(more)})


def by_cell(budget: NoiseBudget, patterns: Patterns) -> Array:
    """Noise of every cell, (n_cells,), of such a budget: as `NoiseBudget.cells_noise_e`, with the
    1/f noise of each.
    """
    noise, slow_e = budget.cells_noise_e(patterns), budget.noise_e.get(FLICKER, 0.0)
    if not slow_e or patterns.mode == "differential":
        return noise
    share = (slow_e / budget.total_noise_e) ** 2
    slow = flicker_of_cells(patterns) / _of_measured(patterns) * budget.pixel_noise_e(patterns) ** 2
    return np.asarray(np.sqrt((1 - share) * noise**2 + share * slow))


def _of_measured(patterns: Patterns) -> float:
    """Mean of `flicker_of_cells` over the cells that the set measures; 0 where there are none."""
    measured = ~patterns.unmeasured_cells
    return float(np.mean(flicker_of_cells(patterns)[measured])) if measured.any() else 0.0


@lru_cache(maxsize=8)
def flicker_of_cells(patterns: Patterns) -> Array:
    """Variance of 1/f noise in each cell of the image, (n_cells,), per white variance of an
    exposure and corner frequency times period.

    The noise of a frame's exposures as `FrontEnd.expose` draws it, frequency by frequency from one
    cycle per frame on; several shutters of a pattern as one.
    """
    n, total = patterns.n_exposures, np.zeros(patterns.n_cells)
    cycles = np.arange(1, n // 2 + 1)
    for some in np.array_split(cycles, max(1, len(cycles) // _AT_ONCE)):
        turns = 2 * np.pi * (np.outer(np.arange(n), some) % n) / n
        both = np.where(2 * some == n, 1, 2) / some
        for wave in (np.cos(turns), np.sin(turns)):
            total += inverse_image(wave, patterns) ** 2 @ both
    return total
