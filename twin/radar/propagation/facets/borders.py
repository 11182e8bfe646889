"""Where borders cut triangles: found by bisection on lines from the corner that they cut off."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

_INSET = 2e-4  # of the way to the centroid: lines along edges, which are shared with others
_HALVINGS = 10  # of a line until a border is found on it: 5e-4 of its length

Corners = tuple[Any, Any, Any]


@dataclass(frozen=True, eq=False)
class Border:
    """Triangles on both sides of a border, which is bent in its middle: two at the corner that it
    cuts off, three beyond; shares of the way from there to both others at which it lies, and how
    far it is from straight, over how far it is from that corner.
    """

    near: tuple[Corners, ...]
    far: tuple[Corners, ...]
    shares: tuple[Any, Any]
    bent: Any


def odd_one(alike: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.uint32]]:
    """Whether just two of three corners are alike, and which is the other one.

    ``alike`` (3, n): corners 0 and 1, 1 and 2, 2 and 0.
    """
    odd: NDArray[np.uint32] = ((np.argmax(alike, axis=0) + 2) % 3).astype(np.uint32)
    return alike.sum(axis=0) == 1, odd


def border(mi: Any, corners: Corners, odd: Any, same: Callable[[Any], Any]) -> Border:
    """Of triangles, of which corner ``odd`` is cut off: ``same`` tells of points whether they are
    on its side.
    """
    center = (corners[0] + corners[1] + corners[2]) / 3

    def ordered(points: Corners) -> Corners:
        """The odd corner first, the sense of rotation kept."""
        a, b, c = (
            dr.select(odd == 0, points[i], dr.select(odd == 1, points[i - 2], points[i - 1]))
            for i in range(3)
        )
        return a, b, c

    tip, left, right = ordered(tuple(p + _INSET * (center - p) for p in corners))
    dr.eval(tip, left, right)

    def share(end: Any) -> Any:
        """Of the way from the odd corner, at which the border lies."""
        count = dr.width(center)

        def halve(step: Any, low: Any, high: Any) -> tuple[Any, Any, Any]:
            middle = (low + high) / 2
            here = same(tip + middle * (end - tip))
            return step + 1, dr.select(here, middle, low), dr.select(here, high, middle)

        begin = dr.zeros(mi.UInt32, count), dr.zeros(mi.Float64, count), dr.ones(mi.Float64, count)
        _, low, high = dr.while_loop(
            begin, lambda step, low, high: step < _HALVINGS, halve, labels=("step", "low", "high")
        )
        midpoint = (low + high) / 2
        dr.eval(midpoint)  # one kernel for all lines
        return midpoint

    on_left, on_right = share(left), share(right)
    # A line through the middle of the straight border, on which that lies at one half.
    straight = on_left * (left - tip) + on_right * (right - tip)
    reach = dr.minimum(1, 1 / dr.maximum(on_left + on_right, 1e-9))
    through = tip + reach * straight
    dr.eval(through)
    on_middle = reach * share(through)
    tip, left, right = ordered(corners)
    bend = tip + on_middle * (on_left * (left - tip) + on_right * (right - tip))
    at_left, at_right = tip + on_left * (left - tip), tip + on_right * (right - tip)
    return Border(
        near=((tip, at_left, bend), (tip, bend, at_right)),
        far=((at_left, left, bend), (bend, left, right), (bend, right, at_right)),
        shares=(on_left, on_right),
        bent=dr.abs(2 * on_middle - 1),
    )
