"""Division of triangles by a border that separates one corner from the other two.

The border is found by bisection on lines from that corner. `tubes` divides ray tubes so, `shadows`
triangles at the border of a shadow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

_INSET = 2e-4  # of the way to the centroid: lines along edges, which are shared with others
_HALVINGS = 18  # of a line in the search for a border: 4e-6 of its length

Corners = tuple[Any, Any, Any]


@dataclass(frozen=True, eq=False)
class Border:
    """Triangles on both sides of a border, which is taken as two straight pieces.

    ``near``: two triangles at the corner that is cut off; ``far``: three on the other side;
    ``shares``: where the border cuts both edges from that corner, as shares of these;
    ``curvature``: deviation of the border's middle from the straight line, over its distance from
    the corner.
    """

    near: tuple[Corners, ...]
    far: tuple[Corners, ...]
    shares: tuple[Any, Any]
    curvature: Any


def odd_one(alike: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.uint32]]:
    """Whether exactly two of three corners are alike, and the index of the third.

    ``alike`` (3, n): corners 0 and 1, 1 and 2, 2 and 0.
    """
    odd: NDArray[np.uint32] = ((np.argmax(alike, axis=0) + 2) % 3).astype(np.uint32)
    return alike.sum(axis=0) == 1, odd


def corner_first(corners: Sequence[Any], odd: Any) -> Corners:
    """The corners, that of index ``odd`` first, in the same sense of rotation."""
    a, b, c = (
        dr.select(odd == 0, corners[i], dr.select(odd == 1, corners[i - 2], corners[i - 1]))
        for i in range(3)
    )
    return a, b, c


def bisected(
    mi: Any, begin: Any, end: Any, same: Callable[[Any], Any], count: int, halvings: int
) -> tuple[Any, Any]:
    """Shares of ``count`` lines between which a border cuts these: the last one on the side of
    ``begin`` and the first one beyond, by a number of halvings; ``same``: whether points are on the
    side of ``begin``.
    """

    def halve(step: Any, low: Any, high: Any) -> tuple[Any, Any, Any]:
        middle = (low + high) / 2
        here = same(begin + middle * (end - begin))
        return step + 1, dr.select(here, middle, low), dr.select(here, high, middle)

    whole = dr.zeros(mi.UInt32, count), dr.zeros(mi.Float64, count), dr.ones(mi.Float64, count)
    _, low, high = dr.while_loop(
        whole, lambda step, low, high: step < halvings, halve, labels=("step", "low", "high")
    )
    return low, high


def split_at_border(mi: Any, corners: Corners, odd: Any, same: Callable[[Any], Any]) -> Border:
    """Border of triangles whose corner ``odd`` it cuts off; ``same``: function of points, whether
    they are on that corner's side.
    """
    center = (corners[0] + corners[1] + corners[2]) / 3
    inset = [p + _INSET * (center - p) for p in corners]
    tip, left, right = corner_first(inset, odd)
    dr.eval(tip, left, right)

    def share(end: Any) -> Any:
        """Share of the line from the odd corner to ``end`` at which the border cuts it."""
        low, high = bisected(mi, tip, end, same, dr.width(center), _HALVINGS)
        midpoint = (low + high) / 2
        dr.eval(midpoint)  # one kernel for all lines
        return midpoint

    on_left, on_right = share(left), share(right)
    # A third line, through the middle of the straight border; there this border is at one half.
    straight = on_left * (left - tip) + on_right * (right - tip)
    reach = dr.minimum(1, 1 / dr.maximum(on_left + on_right, 1e-9))
    through = tip + reach * straight
    dr.eval(through)
    on_middle = reach * share(through)
    tip, left, right = corner_first(corners, odd)
    middle = tip + on_middle * (on_left * (left - tip) + on_right * (right - tip))
    at_left, at_right = tip + on_left * (left - tip), tip + on_right * (right - tip)
    return Border(
        near=((tip, at_left, middle), (tip, middle, at_right)),
        far=((at_left, left, middle), (middle, left, right), (middle, right, at_right)),
        shares=(on_left, on_right),
        curvature=dr.abs(2 * on_middle - 1),
    )
