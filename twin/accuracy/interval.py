"""A figure with what it may be off by."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from hardware.formatting import at_most, with_error

#: Standard deviations within which 95 of 100 draws of a normal distribution lie.
TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class Interval:
    """A figure with its errors, statistical and systematic apart, in the figure's own unit.

    The interval holds, in 95 of 100 cases, the figure that the sensor itself would give in a
    measurement of its own: with exact light or echoes, and another draw of its noise. So it holds
    what the model may be off by once, and the noise of two measurements, which differ by sqrt(2) of
    what each of them scatters by.

    Parameters
    ----------
    value
        What was computed.
    standard_error
        Standard deviation of ``value`` over other draws of the model's random numbers: its paths.
    systematic
        What the model may be off by, the same way at every draw: a bound, not a deviation. Infinite
        where nothing bounds it.
    noise
        Standard deviation of ``value`` over other draws of the sensor's noise.
    systematic_above
        Of an interval that has an upper end alone, ``systematic`` being infinite: what the model
        may be off by upward. None: as far as downward.

    >>> psnr_db = Interval(27.31, standard_error=0.05, systematic=0.02, noise=0.08)
    >>> print(f"{psnr_db.low:.2f} to {psnr_db.high:.2f}")
    27.05 to 27.57
    >>> print(psnr_db, "of it", psnr_db.of_model)
    27.31 ± 0.26 of it 27.31 ± 0.12
    >>> level_dbm = Interval(-98.2, 0.5, math.inf, systematic_above=2.0)
    >>> print(level_dbm, level_dbm.holds(-120.0), level_dbm.holds(-95.0))
    -98.2, at most -95.2 True False
    """

    value: float
    standard_error: float = 0.0
    systematic: float = 0.0
    noise: float = 0.0
    systematic_above: float | None = None

    @property
    def half_width(self) -> float:
        """Of the interval; infinite where it has no lower end."""
        return float(half_width(self.standard_error, self.systematic, self.noise))

    @property
    def of_model(self) -> "Interval":
        """The same for the same noise, in the mean over its draws: what the model alone may be off
        by. Light a little other has other counts rounded, which moves one frame as noise does.
        """
        return replace(self, noise=0.0)

    @property
    def low(self) -> float:
        """Lower end of that interval."""
        return self.value - self.half_width

    @property
    def high(self) -> float:
        """Upper end of that interval."""
        above = self.systematic if self.systematic_above is None else self.systematic_above
        return self.value + float(half_width(self.standard_error, above, self.noise))

    def holds(self, truth: float) -> bool:
        """Whether a true value lies within the interval; two NaN agree, and so do two that are
        infinite alike.
        """
        if math.isnan(self.value) or math.isnan(truth):
            return math.isnan(self.value) and math.isnan(truth)
        return self.value == truth or self.low <= truth <= self.high

    def agrees(self, other: "Interval") -> bool:
        """Whether the errors of both explain their difference: their paths and their noise are
        independent, systematic errors may be opposite.

        >>> Interval(1.0, 0.1).agrees(Interval(1.2, 0.1)), Interval(1.0, 0.1).agrees(Interval(1.3))
        (True, False)
        """
        statistical = TWO_SIDED_95 * math.hypot(
            self.standard_error, other.standard_error, self.noise, other.noise
        )
        bounds = [replace(each, standard_error=0.0, noise=0.0) for each in (self, other)]
        if math.isnan(self.value) or math.isnan(other.value):
            return math.isnan(self.value) and math.isnan(other.value)
        return self.value == other.value or all(
            one.low <= another.high + statistical for one, another in (bounds, bounds[::-1])
        )

    def __str__(self) -> str:
        return self.text()

    def text(self, unit: str = "", *, sign: bool = False) -> str:
        """In words, to two digits of the half-width, see `hardware.formatting.with_error`; where
        there is no lower end, with the upper one.

        >>> Interval(-3.21, 0.2).text("dB"), Interval(-3.21, 0.0, math.inf).text("dB")
        ('-3.21 ± 0.39 dB', '-3.21 dB, error not bounded')
        """
        above = self.high - self.value
        if math.isfinite(above) and not math.isfinite(self.half_width):
            return at_most(self.value, above, unit, sign=sign)
        return with_error(self.value, self.half_width, unit, sign=sign)


def half_width(standard_error: Any, systematic: Any, noise: Any) -> Any:
    """Half the width of intervals with these errors, numbers or arrays."""
    return TWO_SIDED_95 * (standard_error**2 + 2 * noise**2) ** 0.5 + systematic


def propagated(function: Callable[..., float], *of: Interval) -> Interval:
    """A smooth function of figures whose errors are independent, by the delta method.

    Standard errors and noise add as squares, systematic errors as they are; each from the
    difference of the function over its own error, both ways.

    >>> level_db = propagated(lambda ratio: 20 * math.log10(ratio), Interval(10.0, 0.1))
    >>> print(level_db)
    20.00 ± 0.17
    """
    values = [figure.value for figure in of]

    def change(i: int, by: float) -> float:
        """Half of what the function changes over a figure's error, both ways."""
        if not by:
            return 0.0
        ends = ([*values[:i], values[i] + step, *values[i + 1 :]] for step in (by, -by))
        above, below = (function(*end) for end in ends)
        return abs(above - below) / 2

    return Interval(
        function(*values),
        math.hypot(*(change(i, figure.standard_error) for i, figure in enumerate(of))),
        math.fsum(change(i, figure.systematic) for i, figure in enumerate(of)),
        math.hypot(*(change(i, figure.noise) for i, figure in enumerate(of))),
    )
