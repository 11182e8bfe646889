"""The noise of one exposure by its causes, and of each pixel of the image."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import Patterns, PatternSet, RasterScan, fwht_in_place
from hardware.reconstruction.sensing import Sensing
from twin.errors import InputError

Array = NDArray[np.float64]

_HARMONICS = np.arange(1, 9)


@dataclass(frozen=True)
class NoiseBudget:
    """Mean signal and root-mean-square noise of one average exposure, in electrons.

    ``noise_e``: contributions by any name; of them "quantisation", the converter's step over
    sqrt(12), is compared with the others. Raises InputError for a number that is negative or not
    finite, and for a signal without any noise.
    """

    signal_e: float
    background_e: float
    dark_e: float
    noise_e: dict[str, float]

    def __post_init__(self) -> None:
        parts = {name: getattr(self, name) for name in ("signal_e", "background_e", "dark_e")}
        for name, value in (parts | self.noise_e).items():
            if not 0 <= value < np.inf:
                raise InputError(f"noise budget: {name} = {value:g} e: expected a number from 0 up")
        total = self.total_noise_e
        if not total < np.inf or (total == 0 < self.signal_e):
            raise InputError(
                f"noise budget: {total:g} e in all, with a signal of {self.signal_e:g} e: "
                "expected a finite number above 0"
            )

    @property
    def total_noise_e(self) -> float:
        """All contributions together."""
        return math.hypot(*self.noise_e.values())

    def pixel_noise_e(self, patterns: Patterns) -> float:
        """Noise of one pixel after the inverse transform of the patterns shown; of a user's own
        patterns after least squares, root mean square of all cells.

        One measurement is the difference of two exposures, or twice one exposure less a constant.
        """
        per_value = np.sqrt(2.0) if patterns.mode == "differential" else 2.0
        if isinstance(patterns, RasterScan):  # each cell has its own exposure
            return float(self.total_noise_e * (per_value if patterns.mode != "plain" else 1.0))
        if not isinstance(patterns, PatternSet):
            return float(np.sqrt(np.mean(self._least_squares_noise_e(patterns) ** 2)))
        return float(per_value * self.total_noise_e * np.sqrt(patterns.count) / patterns.n_cells)

    def cells_noise_e(self, patterns: Patterns) -> Array:
        """The same of every cell, (n_cells,).

        The two reference exposures are in every measurement alike, each once beside twice an
        exposure: a cell whose entries in the patterns shown add up to t has 4 count + 2 t^2
        variances in place of 4 count.
        """
        pixel = self.pixel_noise_e(patterns)
        if isinstance(patterns, RasterScan):
            return np.full(patterns.n_cells, pixel)
        if not isinstance(patterns, PatternSet):
            return self._least_squares_noise_e(patterns)
        added = np.zeros(patterns.n_cells)
        if patterns.mode == "reference":
            added[patterns.indices] = 1.0
            added = fwht_in_place(added)
        return np.asarray(pixel * np.sqrt(1 + added**2 / (2 * patterns.count)))

    def _least_squares_noise_e(self, patterns: Patterns) -> Array:
        """Noise of every cell by least squares, of the references as well."""
        inverse = Sensing(patterns).pseudo_inverse
        per_value = 2.0 if patterns.mode == "differential" else 4.0
        gain = per_value * np.sum(inverse**2, axis=1)
        if patterns.mode == "reference":
            gain += 2 * inverse.sum(axis=1) ** 2
        return np.asarray(self.total_noise_e * np.sqrt(gain))


def settled_share(noise_over_rounding: float) -> float:
    """Share of the variance of a converter's rounding that follows from where a signal lies between
    two steps, 0 to 1; the rest differs from one draw of the noise to the next.

    ``noise_over_rounding``: other noise, normal, over the step over sqrt(12). The mean error at one
    place is a Fourier series over the step, each harmonic k smaller by exp(-2 (pi k s)^2) with a
    noise of s steps (Widrow, Statistical theory of quantization, 1996).
    """
    steps = noise_over_rounding / math.sqrt(12)
    harmonics = np.exp(-((2 * np.pi * _HARMONICS * steps) ** 2)) / (np.pi * _HARMONICS) ** 2
    return min(6 * float(harmonics.sum()), 1.0)
