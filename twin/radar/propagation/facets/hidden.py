"""Triangles that lie wholly in shadow, found by rays from their corners only.

The shadow of a convex occluder on a plane is convex. So if one convex part of a mesh hides all
three corners of a triangle, it hides the whole triangle. If it hides one corner, and another part
hides both others, then they hide the whole triangle if on both edges from that corner one shadow
begins where the other ends. For paths over mirrors the same holds of points beyond a mirror or
beside it. Without this test, walls behind other walls would be divided as finely as any possible
gap between these.
"""

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.borders import bisected, odd_one
from twin.radar.propagation.facets.currents import normal_of
from twin.radar.propagation.facets.triangles import Triangles, origin_of
from twin.radar.propagation.one_way.motion import NEAREST_M
from twin.radar.propagation.one_way.path import LEVEL, WINDOW, TracingContext, offset
from twin.transfer import aligned

_BEFORE = 1e-4  # of a path: a hit so near its end may be its end point itself
_BESIDE = 1e-6  # of the distance from the anchor, likewise
_INSET = 1e-3  # of the way to the centroid: corners are shared with other facets
_HALVINGS = (
    14  # of an edge, to find where another occluder begins: smaller gaps than 6e-5 are missed
)
_NEAR_M = 1e3  # from the anchor: radars of cross-sections stand farther away
#: Numbers of occluders: no path beyond a mirror, or beside it, come before the parts of meshes.
_BEYOND, _AT_SIDES, _PARTS = 1, 2, 6


def wholly_hidden(context: TracingContext, parts: Any, lit: Triangles) -> NDArray[np.bool_]:
    """Whether triangles are certainly hidden from their receiver, or from the source that lights
    them directly, (n,); by the convex ``parts`` of the world, on the device.
    """
    is_hidden = np.zeros(len(lit), dtype=bool)
    for end in ("receiver", "source") if lit.waves is None else ("receiver",):
        rest = np.flatnonzero(~is_hidden)
        if len(rest):
            is_hidden[rest] = _hidden_from(context, parts, lit.take(rest), end)
    return is_hidden


def _hidden_from(
    context: TracingContext, parts: Any, lit: Triangles, end: str
) -> NDArray[np.bool_]:
    mi, n = context.mi, len(lit)
    many = lit.repeat(3)
    number = dr.arange(mi.UInt32, 3 * n) % 3
    place = dr.select(number == 0, many.corners[0], many.corners[1])
    place = dr.select(number == 2, many.corners[2], place)
    by = np.array(_hidden_by(context, parts, many, end, place + _INSET * (many.center - place)))
    by = by.reshape(n, 3).T
    is_known = (by != 0).all(axis=0)
    alike = by == by[[1, 2, 0]]
    is_hidden: NDArray[np.bool_] = is_known & alike.all(axis=0)
    is_odd, odd = odd_one(alike)
    row = np.flatnonzero(is_known & is_odd)
    if len(row):
        is_hidden[row] = _are_joined(context, parts, lit.take(row), end, by[:, row], odd[row])
    return is_hidden


def _are_joined(
    context: TracingContext,
    parts: Any,
    lit: Triangles,
    end: str,
    by: NDArray[np.uint32],
    odd: NDArray[np.uint32],
) -> NDArray[np.bool_]:
    """Whether on both edges from corner ``odd``, which has another occluder than the other two, the
    shadow of one occluder begins where that of the other ends.
    """
    mi, n, column = context.mi, len(lit), np.arange(len(lit))
    many = lit.repeat(2)
    corners = [p + _INSET * (many.center - p) for p in many.corners]

    def corner(which: NDArray[np.uint32]) -> Any:
        index = mi.UInt32(aligned(which))
        return dr.select(index == 0, corners[0], dr.select(index == 1, corners[1], corners[2]))

    ends = np.stack([(odd + 1) % 3, (odd + 2) % 3], axis=1).ravel()
    tip, other = corner(np.repeat(odd, 2)), corner(ends)
    own = mi.UInt32(aligned(np.repeat(by[odd, column], 2)))
    dr.eval(tip, other)

    def same(place: Any) -> Any:
        return _hidden_by(context, parts, many, end, place) == own

    _, high = bisected(mi, tip, other, same, 2 * n, _HALVINGS)
    dr.eval(high)
    beyond = np.array(_hidden_by(context, parts, many, end, tip + high * (other - tip)))
    wanted = np.repeat(by[(odd + 1) % 3, column], 2)
    are_adjacent: NDArray[np.bool_] = (beyond == wanted).reshape(n, 2).all(axis=1)
    return are_adjacent


def _hidden_by(context: TracingContext, parts: Any, lit: Triangles, end: str, place: Any) -> Any:
    """Number of the occluder that hides points of triangles; 0 for none, or one that is not convex.

    The shadow of every numbered occluder on a plane is convex.
    """
    mi, scene, source = context.mi, context.world.scene, getattr(lit, end)
    off = normal_of(context, lit.face, place, origin_of(context, lit)) * (
        offset(place) + lit.plane_deviation
    )
    order = dr.gather(mi.UInt32, context.orders, source)
    at, aim, start = place, _gathered(mi, context.positions, 3 * source), place + off
    occluder, exists = dr.zeros(mi.UInt32, dr.width(place)), mi.Bool(True)

    def note(kind: Any, where: Any, level: int) -> None:
        nonlocal occluder
        number = kind * (context.order + 1) + level
        occluder = dr.select((occluder == 0) & where & (kind > 0), number, occluder)

    def first_hit(begin: Any, direction: Any, reach: Any, where: Any, mirror: Any = None) -> Any:
        """Number of the convex part that a ray meets; 0 for none, or for the mirror itself."""
        ray = mi.Ray3f(mi.Point3f(begin), mi.Vector3f(direction), mi.Float(reach), 0.0, [])
        hit = scene.ray_intersect_preliminary(ray, active=where)
        is_met = where & hit.is_valid()
        number = dr.gather(mi.UInt32, parts, hit.prim_index, is_met) + _PARTS
        if mirror is not None:
            is_met &= dr.gather(mi.UInt32, context.patch_of_face, hit.prim_index, is_met) != mirror
        return dr.select(is_met, number, 0)

    for level in reversed(range(context.order)):
        has = exists & (order > level)
        row = source * context.order + level
        before, point, normal = (
            _gathered(mi, context.levels, LEVEL * row + 3 * i) for i in range(3)
        )
        segment = aim - at
        distance = dr.norm(segment)
        direction = segment / dr.maximum(distance, NEAREST_M)
        slope = dr.dot(normal, direction)
        t = dr.dot(normal, point - at) / dr.select(slope != 0, slope, 1.0)
        mirror = at + t * direction
        is_beyond = has & ((t <= 0) | (t >= distance))
        note(mi.UInt32(_BEYOND), is_beyond, level)
        exists &= ~is_beyond
        has &= exists
        note(_side(context, row, mirror), has, level)
        patch = dr.gather(mi.UInt32, context.marks, 3 * row, has)
        rays = start, direction, t * (1 - _BEFORE), has & (occluder == 0)
        note(first_hit(*rays, patch), has, level)
        facing = normal * dr.select(slope < 0, 1.0, -1.0)
        at, aim = dr.select(has, mirror, at), dr.select(has, before, aim)
        start = dr.select(has, mirror + facing * offset(mirror), start)
    # From the radar, since occluders near it hide most, where float32 resolves its place.
    is_near = dr.norm(aim) < _NEAR_M
    begin, back = dr.select(is_near, aim, start), dr.select(is_near, start, aim)
    segment = back - begin
    last = first_hit(
        begin, dr.normalize(segment), dr.norm(segment) * (1 - _BEFORE), exists & (occluder == 0)
    )
    note(last, mi.Bool(True), context.order)
    return occluder


def _side(context: TracingContext, row: Any, place: Any) -> Any:
    """The side of a mirror's window beyond which a place in its plane lies; 0 for none."""
    mi = context.mi
    slack, side = _BESIDE * dr.norm(place), mi.UInt32(0)
    for k in range(2):
        axis = _gathered(mi, context.windows, WINDOW * row + 5 * k)
        low, high = (
            dr.gather(mi.Float64, context.windows, WINDOW * row + 5 * k + i) for i in (3, 4)
        )
        along = dr.dot(axis, place)
        side = dr.select(along < low - slack, mi.UInt32(_AT_SIDES + 2 * k), side)
        side = dr.select(along > high + slack, mi.UInt32(_AT_SIDES + 2 * k + 1), side)
    return side


def _gathered(mi: Any, values: Any, index: Any) -> Any:
    return mi.Vector3d(*(dr.gather(mi.Float64, values, index + i) for i in range(3)))
