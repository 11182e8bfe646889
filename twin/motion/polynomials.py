"""What moves smoothly between breaks, as polynomials of time: many times at the price of few."""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev

from twin.motion.kinematics import Array

#: Coefficients of an interval: of the degree that `Motion.breaks_s` promises.
_N = 16
#: Nodes on -1 to 1, and coefficients from values there.
_NODES = chebyshev.chebpts1(_N)
_FROM_VALUES = np.linalg.inv(chebyshev.chebvander(_NODES, _N - 1))


class Polynomials:
    """A function of time.

    Parameters
    ----------
    breaks_s : (k + 1,) array
        Ascending; between two of them a polynomial of degree 15 follows the function to rounding.
    function
        Values at times (n,), (n, ...). It is asked once. Where it stands still from one break to
        the next, its values are returned as they are.

    Attributes
    ----------
    last
        Largest of the last two coefficients: what a polynomial of less degree would be off by.
    """

    def __init__(self, breaks_s: Array, function: Callable[[Array], Array]) -> None:
        self._breaks = breaks_s
        middle, half = (breaks_s[1:] + breaks_s[:-1]) / 2, np.diff(breaks_s) / 2
        values = function((middle[:, None] + half[:, None] * _NODES).ravel())
        self._shape = values.shape[1:]
        values = values.reshape(len(half), _N, -1)
        self._first = values[:, 0]
        self._coefficients = _FROM_VALUES @ (values - values[:, :1])
        self.last = float(np.abs(self._coefficients[:, -2:]).max(initial=0.0))

    def at(self, times_s: Array) -> Array:
        """Values at times (n,) from the first break to the last, (n, ...)."""
        n_intervals = len(self._breaks) - 1
        own = np.searchsorted(self._breaks, times_s, side="right") - 1
        own = np.clip(own, 0, n_intervals - 1)
        start, end = self._breaks[own], self._breaks[own + 1]
        # Of breaks a rounding apart, no farther out than they are.
        share = np.clip((2 * times_s - start - end) / (end - start), -1, 1)
        powers = chebyshev.chebvander(share, _N - 1)
        found = self._first[own]
        for interval in np.unique(own):
            here = own == interval
            found[here] += powers[here] @ self._coefficients[interval]
        return found.reshape(len(times_s), *self._shape)

    @staticmethod
    def times(breaks_s: Array) -> int:
        """At how many times the function is asked."""
        return _N * (len(breaks_s) - 1)
