"""A figure with what it may be off by."""

import math
from dataclasses import dataclass

#: Standard deviations within which 95 of 100 draws of a normal distribution lie.
_TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class Interval:
    """A figure with its errors, statistical and systematic apart, in the figure's own unit.

    Parameters
    ----------
    value
        What was computed.
    standard_error
        Standard deviation of ``value`` over other random draws of the same model.
    systematic
        What the model may be off by, the same way at every draw: a bound, not a deviation.

    >>> psnr_db = Interval(27.31, standard_error=0.05, systematic=0.02)
    >>> print(f"{psnr_db.low:.2f} to {psnr_db.high:.2f}")
    27.19 to 27.43
    """

    value: float
    standard_error: float = 0.0
    systematic: float = 0.0

    @property
    def half_width(self) -> float:
        """Of the interval that holds the true value in 95 of 100 cases."""
        return _TWO_SIDED_95 * self.standard_error + self.systematic

    @property
    def low(self) -> float:
        """Lower end of that interval."""
        return self.value - self.half_width

    @property
    def high(self) -> float:
        """Upper end of that interval."""
        return self.value + self.half_width

    def holds(self, truth: float) -> bool:
        """Whether a true value lies within the interval; two NaN agree."""
        if math.isnan(self.value) or math.isnan(truth):
            return math.isnan(self.value) and math.isnan(truth)
        return self.low <= truth <= self.high
