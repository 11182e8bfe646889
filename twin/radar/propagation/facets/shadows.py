"""Visibility of triangles: rays to the receiver, and to a source that lights them directly.

Rays start at the corners and the centroid. Where a border of a shadow cuts off one corner, it is
searched for on three lines from that corner, and the part cut off becomes two triangles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.borders import bisected, corner_first
from twin.radar.propagation.facets.currents import normal_of
from twin.radar.propagation.facets.triangles import Triangles, origin_of
from twin.radar.propagation.one_way.path import TracingContext, is_clear, offset
from twin.transfer import aligned

_INSET = 1e-3  # of the way to the centroid: corners are shared with other facets
#: Further points that are tested, in barycentric coordinates: in the middles of edges and towards
#: corners; inside, for parts whose edges are shadow borders; all over the triangle.
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
_LINE_INSET = 3 * _INSET  # of the lines on which borders are searched for, likewise
_HALVINGS = 12  # of a line in the search for a border: 2.4e-4 of its length


def is_visible(context: TracingContext, lit: Triangles, place: Any) -> Any:
    """Whether points of triangles are visible from source and receiver."""
    mi = context.mi
    normal = normal_of(context, lit.face, place, origin_of(context, lit))
    off = normal * (offset(place) + lit.plane_deviation)
    clear = is_clear(context, lit.receiver, place, off, mi.Bool(True))
    if lit.waves is None:
        apart = clear & (lit.source != lit.receiver)
        clear &= is_clear(context, lit.source, place, off, apart) | ~apart
    return clear


def visible_samples(
    context: TracingContext, lit: Triangles, thoroughly: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Whether corners and a point inside are visible, (4, n); unless ``thoroughly``, only the point
    inside is tested and its result is that of all.
    """
    n, often = len(lit), np.flatnonzero(thoroughly & ~lit.is_ray)
    if not len(often):
        return np.tile(np.array(is_visible(context, lit, lit.lit_point)), (4, 1))
    index = np.concatenate([np.arange(n), np.tile(often, 3)])
    corner = np.concatenate([np.full(n, 3), np.repeat(np.arange(3), len(often))])
    some = lit.gather(index)
    which = context.mi.UInt32(aligned(corner.astype(np.uint32)))
    place = some.lit_point
    for number, point in enumerate(some.corners):
        place = dr.select(which == number, point + _INSET * (some.center - point), place)
    clear = np.array(is_visible(context, some, place))
    is_clear = np.tile(clear[:n], (4, 1))
    is_clear[:3, often] = clear[n:].reshape(3, -1)
    return is_clear


def agree_at(
    context: TracingContext,
    lit: Triangles,
    wanted: NDArray[np.bool_],
    points: Sequence[tuple[float, float, float]],
) -> NDArray[np.bool_]:
    """Whether triangles are visible, or hidden, as ``wanted`` says, (n,), at all further points,
    given in barycentric coordinates.
    """
    n, share = len(lit), np.array(points).T
    some, number = lit.repeat(len(points)), np.tile(np.arange(len(points)), n)
    weights = [context.mi.Float64(aligned(column[number])) for column in share]
    place = sum(w * corner for w, corner in zip(weights, some.corners, strict=True))
    clear = np.array(is_visible(context, some, place)).reshape(n, -1)
    is_alike: NDArray[np.bool_] = (clear == wanted[:, None]).all(axis=1)
    return is_alike


@dataclass(frozen=True, eq=False)
class ShadowClipping:
    """Triangles divided by the border of a shadow, which cuts off one corner.

    parts
        The two triangles at that corner, with the border as two straight pieces, 2 n.
    whole
        The one triangle at that corner, with the border as one straight line, n.
    others
        The three triangles on the other side, 3 n.
    is_seen
        Whether the corner that is cut off is visible, (n,).
    is_known
        Whether test points on either side of the border are all visible or hidden as the corners
        there are, (n,): then there is no second border.
    """

    parts: Triangles
    whole: Triangles
    others: Triangles
    is_seen: NDArray[np.bool_]
    is_known: NDArray[np.bool_]


def clip_at_shadow(
    context: TracingContext, lit: Triangles, corners: NDArray[np.bool_]
) -> ShadowClipping:
    """Divide triangles of which one corner is visible and both others are not, or the reverse;
    ``corners``: which are visible, (3, n).
    """
    odd = np.where(corners[0] == corners[1], 2, np.where(corners[0] == corners[2], 1, 0))
    is_seen = corners[odd, np.arange(len(lit))]
    number, wanted = (
        context.mi.UInt32(aligned(odd.astype(np.uint32))),
        context.mi.Bool(aligned(is_seen)),
    )

    inset = [point + _LINE_INSET * (lit.center - point) for point in lit.corners]
    tip, left, right = corner_first(inset, number)

    def lit_share(end: Any) -> Any:
        """Share of the line from the odd corner at which the border cuts it."""

        def same(place: Any) -> Any:
            return is_visible(context, lit, place) == wanted

        low, high = bisected(context.mi, tip, end, same, len(lit), _HALVINGS)
        share = (low + high) / 2
        dr.eval(share)  # all that follows would search again
        return share

    share_left, share_right = lit_share(left), lit_share(right)
    across = 2 / dr.maximum(share_left + share_right, 1e-9)

    def through(begin: Any, one: Any, other: Any) -> Any:
        """End, on the far side, of the line through the middle of the straight border."""
        middle = (share_left * (one - begin) + share_right * (other - begin)) / 2
        return begin + across * middle

    inner = through(tip, left, right)
    share = lit_share(inner)
    middle_at = tip + share * (inner - tip)
    # From the lines of the search, which lie a little inside, on to the triangle's own edges.
    near = _LINE_INSET / 3
    left_at, right_at = tip + share_left * (left - tip), tip + share_right * (right - tip)
    middle_left, middle_right = (share * across * half / 2 for half in (share_left, share_right))
    left_at += (left_at - middle_at) * _onwards(near, (1 - 3 * near) * middle_right)
    right_at += (right_at - middle_at) * _onwards(near, (1 - 3 * near) * middle_left)
    tip, left, right = corner_first(lit.corners, number)
    near_by: list[tuple[Any, Any, Any]] = [(tip, left_at, middle_at), (tip, middle_at, right_at)]
    others = [(left_at, left, middle_at), (middle_at, left, right), (middle_at, right, right_at)]
    beyond: list[tuple[Any, ...]] = [*others, (left, right), (left_at, left), (right_at, right)]
    is_known = context.mi.Bool(True)
    for part, expected in (*((p, wanted) for p in near_by), *((p, ~wanted) for p in beyond)):
        middle = sum(part) / len(part)
        is_known &= is_visible(context, lit, middle + _INSET * (lit.center - middle)) == expected
    parts = Triangles.concatenate([replace(lit, corners=part) for part in near_by])
    whole = replace(lit, corners=(tip, left_at, right_at))
    rest = Triangles.concatenate([replace(lit, corners=part) for part in others])
    return ShadowClipping(
        parts.evaluate(), whole.evaluate(), rest.evaluate(), is_seen, np.array(is_known)
    )


def _onwards(margin: float, away: Any) -> Any:
    """By what share of its length a border is extended to cross the margin along an edge; its other
    end is ``away`` from the margin.
    """
    return dr.minimum(margin / dr.maximum(away, 1e-9), 1)
