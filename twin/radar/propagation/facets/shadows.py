"""What of a triangle is seen: rays to its receiver, and to a source that lights it directly.

Rays start at the corners and the centroid. Where a border of a shadow cuts off one corner, it is
searched for on three lines from that corner, and the part cut off becomes two triangles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.currents import normal_of
from twin.radar.propagation.facets.triangles import Triangles, origin_of
from twin.radar.propagation.one_way.path import TracingContext, offset, one_way_path
from twin.transfer import aligned

_INSET = 1e-3  # of the way to the centroid: corners are shared with other facets
#: Points where more is looked at, by shares of the corners: in the middles of edges and towards
#: corners; inside, where all edges are the borders of others; all over.
BETWEEN = (
    (0.499, 0.499, 0.002),
    (0.002, 0.499, 0.499),
    (0.499, 0.002, 0.499),
    (0.68, 0.16, 0.16),
    (0.16, 0.68, 0.16),
    (0.16, 0.16, 0.68),
)
INSIDE = (
    (0.44, 0.44, 0.12),
    (0.12, 0.44, 0.44),
    (0.44, 0.12, 0.44),
    (0.76, 0.12, 0.12),
    (0.12, 0.76, 0.12),
    (0.12, 0.12, 0.76),
)
_ROWS = 7
ALL_OVER = tuple(
    ((i + 1 / 3) / _ROWS, (j + 1 / 3) / _ROWS, (_ROWS - 1 - i - j + 1 / 3) / _ROWS)
    for i in range(_ROWS)
    for j in range(_ROWS - i)
)
_DRAWN_IN = 3 * _INSET  # lines on which borders are searched for, likewise
_HALVINGS = 12  # of a line until a border is found on it: 2.4e-4 of its length


def seen(context: TracingContext, lit: Triangles, place: Any) -> Any:
    """Whether points of triangles are seen by source and receiver."""
    mi = context.mi
    normal = normal_of(context, lit.face, place, origin_of(context, lit))
    off = normal * (offset(place) + lit.lift)
    clear = one_way_path(context, lit.receiver, place, off, mi.Bool(True)).clear
    if lit.waves is None:
        apart = clear & (lit.source != lit.receiver)
        clear &= one_way_path(context, lit.source, place, off, apart).clear | ~apart
    return clear


def sampled(
    context: TracingContext, lit: Triangles, thoroughly: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Whether corners and a point inside are seen, (4, n); where not ``thoroughly`` the latter
    stands for all.
    """
    n, often = len(lit), np.flatnonzero(thoroughly & ~lit.is_ray)
    index = np.concatenate([np.arange(n), np.tile(often, 3)])
    corner = np.concatenate([np.full(n, 3), np.repeat(np.arange(3), len(often))])
    some = lit.gather(index)
    which = context.mi.UInt32(aligned(corner.astype(np.uint32)))
    place = some.spot
    for number, point in enumerate(some.corners):
        place = dr.select(which == number, point + _INSET * (some.center - point), place)
    clear = np.array(seen(context, some, place))
    is_clear = np.tile(clear[:n], (4, 1))
    is_clear[:3, often] = clear[n:].reshape(3, -1)
    return is_clear


def alike(
    context: TracingContext,
    lit: Triangles,
    wanted: NDArray[np.bool_],
    points: Sequence[tuple[float, float, float]],
) -> NDArray[np.bool_]:
    """Whether triangles are seen, or not, as ``wanted``, (n,), at more points, by shares of the
    corners.
    """
    n, share = len(lit), np.array(points).T
    some, number = lit.repeat(len(points)), np.tile(np.arange(len(points)), n)
    weights = [context.mi.Float64(aligned(column[number])) for column in share]
    place = sum(w * corner for w, corner in zip(weights, some.corners, strict=True))
    clear = np.array(seen(context, some, place)).reshape(n, -1)
    is_alike: NDArray[np.bool_] = (clear == wanted[:, None]).all(axis=1)
    return is_alike


@dataclass(frozen=True, eq=False)
class Clipping:
    """Triangles cut by a shadow's border: the parts at the corner that differs from the others,
    bordered by two straight lines (``parts``, 2 n) and by one (``whole``, n), and what is left of
    the triangle (``others``, 3 n); whether that corner
    ``is_seen``, and whether all of the border ``is_known``: points in the middle of what lies on
    either side of it are seen or not like the corners there.
    """

    parts: Triangles
    whole: Triangles
    others: Triangles
    is_seen: NDArray[np.bool_]
    is_known: NDArray[np.bool_]


def clip(context: TracingContext, lit: Triangles, corners: NDArray[np.bool_]) -> Clipping:
    """Cut triangles one corner of which differs from both others in what is seen, (3, n)."""
    odd = np.where(corners[0] == corners[1], 2, np.where(corners[0] == corners[2], 1, 0))
    is_seen = corners[odd, np.arange(len(lit))]
    number, wanted = (
        context.mi.UInt32(aligned(odd.astype(np.uint32))),
        context.mi.Bool(aligned(is_seen)),
    )

    def ordered(points: Any) -> Any:
        """The odd corner first, the sense of rotation kept."""
        return [
            dr.select(number == 0, points[i], dr.select(number == 1, points[i - 2], points[i - 1]))
            for i in range(3)
        ]

    inset = [point + _DRAWN_IN * (lit.center - point) for point in lit.corners]
    tip, left, right = ordered(inset)

    def lit_share(end: Any) -> Any:
        """Share of the way from the odd corner at which the border lies."""

        def halve(step: Any, low: Any, high: Any) -> tuple[Any, Any, Any]:
            middle = (low + high) / 2
            same = seen(context, lit, tip + middle * (end - tip)) == wanted
            return step + 1, dr.select(same, middle, low), dr.select(same, high, middle)

        begin = (
            dr.zeros(context.mi.UInt32, len(lit)),
            dr.zeros(context.mi.Float64, len(lit)),
            dr.ones(context.mi.Float64, len(lit)),
        )
        _, low, high = dr.while_loop(
            begin, lambda step, low, high: step < _HALVINGS, halve, labels=("step", "low", "high")
        )
        share = (low + high) / 2
        dr.eval(share)  # all that follows would search again
        return share

    share_left, share_right = lit_share(left), lit_share(right)
    across = 2 / dr.maximum(share_left + share_right, 1e-9)

    def through(begin: Any, one: Any, other: Any) -> Any:
        """End on the far side of the line through the middle of the border."""
        middle = (share_left * (one - begin) + share_right * (other - begin)) / 2
        return begin + across * middle

    inner = through(tip, left, right)
    share = lit_share(inner)
    bend = tip + share * (inner - tip)
    # From the lines searched, which run a little inside, on to the triangle's own edges.
    near = _DRAWN_IN / 3
    left_at, right_at = tip + share_left * (left - tip), tip + share_right * (right - tip)
    bent_left, bent_right = (share * across * half / 2 for half in (share_left, share_right))
    left_at += (left_at - bend) * _onwards(near, (1 - 3 * near) * bent_right)
    right_at += (right_at - bend) * _onwards(near, (1 - 3 * near) * bent_left)
    tip, left, right = ordered(lit.corners)
    near_by: list[tuple[Any, Any, Any]] = [(tip, left_at, bend), (tip, bend, right_at)]
    others = [(left_at, left, bend), (bend, left, right), (bend, right, right_at)]
    beyond: list[tuple[Any, ...]] = [*others, (left, right), (left_at, left), (right_at, right)]
    is_known = context.mi.Bool(True)
    for part, expected in (*((p, wanted) for p in near_by), *((p, ~wanted) for p in beyond)):
        middle = sum(part) / len(part)
        is_known &= seen(context, lit, middle + _INSET * (lit.center - middle)) == expected
    parts = Triangles.concatenate([replace(lit, corners=part) for part in near_by])
    whole = replace(lit, corners=(tip, left_at, right_at))
    rest = Triangles.concatenate([replace(lit, corners=part) for part in others])
    return Clipping(
        parts.evaluate(), whole.evaluate(), rest.evaluate(), is_seen, np.array(is_known)
    )


def _onwards(margin: float, away: Any) -> Any:
    """How far a border has to go on, over its length, to pass a margin beside an edge, where its
    other end is ``away`` from the margin.
    """
    return dr.minimum(margin / dr.maximum(away, 1e-9), 1)
