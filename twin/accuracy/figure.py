"""A named figure of a result, with unit and interval: what ``summary.json`` holds."""

import math
from dataclasses import dataclass
from typing import Any

from twin.accuracy.interval import Interval


@dataclass(frozen=True)
class Figure:
    """A figure as it is printed.

    Parameters
    ----------
    of
        System or radar that it is of, and the object or method where it is of one.
    name
        Of the quantity.
    unit
        In SI or dB; empty for a ratio.
    interval
        Its value and error. A figure that was asked for, and not computed, has no error.

    >>> print(Figure(("workable",), "SNR per pixel, median", "", Interval(4.31, 0.02)))
    workable: SNR per pixel, median: 4.310 ± 0.039
    """

    of: tuple[str, ...]
    name: str
    unit: str
    interval: Interval

    def entry(self) -> dict[str, Any]:
        """Ready for JSON: null where there is no number, no end or no bound; ``systematic_above``
        only where the interval has an upper end alone.
        """
        above = self.interval.systematic_above
        return {
            "of": list(self.of),
            "name": self.name,
            "unit": self.unit,
            "value": _number(self.interval.value),
            "standard_error": _number(self.interval.standard_error),
            "systematic": _number(self.interval.systematic),
            "noise": _number(self.interval.noise),
            **({} if above is None else {"systematic_above": _number(above)}),
        }

    def __str__(self) -> str:
        return f"{': '.join((*self.of, self.name))}: {self.interval.text(self.unit)}"


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
