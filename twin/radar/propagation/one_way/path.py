"""The one-way path between the radar and a point, direct or over large flat mirrors.

One kernel serves the forward and the return path, since both are the same path reversed.

Everything is an array on the device, one element per ray; ``source`` numbers the images of
`twin.radar.propagation.scene.images`.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.one_way.device_motion import Moving, MovingImages, gathered
from twin.radar.propagation.one_way.motion import NEAREST_M
from twin.radar.propagation.scene.mesh_scene import MeshScene
from twin.radar.propagation.scene.slabs import SlabTransmission, Walls, cross, no_slab
from twin.radar.scattering.arrays import ComplexVector3, Index, Mask, Real, Vector3
from twin.radar.scattering.kernel import coefficients_at, reflected, turned

Array = NDArray[np.float64]
#: The world's axes as an image shows them.
Axes = tuple[Vector3, Vector3, Vector3]

#: Rays start this far off a surface, over the distance from the anchor: 16 steps of float32. Twice
#: as much loses 0.4 dB of a corner reflector of 8 cm at 1 km.
OFF_SURFACE = 1e-6
#: Numbers per reflection in `TracingContext.levels`: image before it, a point of the plane, its
#: normal.
LEVEL = 9
#: Numbers per reflection in `TracingContext.windows`: twice a direction in its plane, and between
#: which coordinates along it the patch lies.
WINDOW = 10
#: Of the segment to a mirror: its last part, on which the mirror is looked for, ...
_JUST_BEFORE = 1e-3
_STEPS = 4  # ... and at least so often the distance from surfaces at which rays start
#: Cosine between a path and a surface's normal, below which rays begin beside the path.
_GRAZING = 0.1


@dataclass(frozen=True, eq=False)
class TracingContext:
    """Arrays that all paths share: world, antenna, images, reflection coefficients.

    ``order`` is the largest number of reflections; ``table`` the one of `scattering.surface`;
    ``positions`` (3 n) and ``motions`` are those of the images, ``axes`` (9 n) the world's axes
    mirrored for each image.
    """

    mi: Any
    world: MeshScene
    order: int
    n_sources: int
    place: Vector3
    boresight: Vector3
    vertical: Vector3
    patch_of_face: Index
    table: Real
    orders: Index
    positions: Real
    motions: MovingImages
    axes: Real
    levels: Real
    marks: Index
    windows: Real
    wavelength: Real
    walls: Walls | None

    def sent(self, source: Index, departure: Vector3) -> ComplexVector3:
        """The antenna's field, of amplitude 1, in a direction of departure."""
        field = turned(self.vertical, -self.boresight, departure)
        return ComplexVector3(field, self.mi.Vector3d(0))

    def both_ways(self, source: Index, receiver: Index) -> Mask:
        """Whether the same antenna also receives the echo along the reversed path."""
        return source != receiver


@dataclass(eq=False)
class OneWayPath:
    """Paths between the radar and points, one for each point.

    ``back`` and ``length``: unit vector and distance from the point to the image; ``departure``:
    unit vector from the radar; ``field``: incident field of a wave sent with amplitude 1, without
    spreading and phase; ``motion``: the image's; ``clear``: whether the path
    meets all its mirrors and no occluder; ``transmission``: of the walls that it crosses.
    """

    back: Vector3
    length: Real
    departure: Vector3
    field: ComplexVector3
    motion: Moving
    clear: Mask
    transmission: SlabTransmission


def one_way_path(
    context: TracingContext,
    source: Index,
    place: Vector3,
    off: Vector3,
    active: Mask,
    unshadowed: bool = False,
    tested: bool = True,
) -> OneWayPath:
    """The path to a point from which rays start at a distance ``off`` (vector) from the surface.

    ``unshadowed``: occluders are ignored, only the mirrors are tested; ``tested``: whether rays are
    sent at all.
    """
    mi = context.mi
    path = _to_image(context, source, place, off, active, unshadowed, tested)
    field = context.sent(source, path.departure)
    travel = path.departure
    transmission = no_slab(mi)

    def cross_walls(begin: Vector3, along: Vector3, segment: Real, where: Mask) -> None:
        nonlocal field
        if context.walls is not None:
            arguments = begin, along, segment, path.length, context.wavelength, where
            field = cross(mi, context.walls, transmission, field, *arguments)

    begin = path.radar + dr.zeros(mi.Vector3d, dr.width(path.departure))
    cross_walls(begin, path.departure, path.distance, path.clear)
    for mirror in path.mirrors[::-1]:
        has, away = mirror.has, -mirror.direction
        cosine = -dr.dot(mirror.normal, travel)
        coefficients = coefficients_at(mi, context.table, mirror.surface, cosine, has)
        field = reflected(field, travel, mirror.normal, coefficients).where(has, field)
        travel = dr.select(has, away, travel)
        cross_walls(mirror.place, away, mirror.distance, has & path.clear)
    motion = context.motions.at(mi, source, active)
    return OneWayPath(
        path.back, path.length, path.departure, field, motion, path.clear, transmission
    )


def is_clear(
    context: TracingContext, source: Index, place: Vector3, off: Vector3, active: Mask
) -> Mask:
    """Whether the path to a point meets all its mirrors and no occluder: as of `one_way_path`,
    whose field takes longer to set up than the rays to send.
    """
    return _to_image(context, source, place, off, active, in_parts=True).clear


@dataclass(eq=False)
class _Mirror:
    """Reflection of paths on their way from points to the radar: whether a path ``has`` it, its
    ``place``, the ``direction`` and ``distance`` to there, the ``normal`` on the path's side and
    the ``surface``.
    """

    has: Mask
    place: Vector3
    direction: Vector3
    distance: Real
    normal: Vector3
    surface: Index


@dataclass(eq=False)
class _PathToImage:
    """Lines from points to the radar, by way of ``mirrors`` from the point on.

    ``back``, ``length``, ``departure`` and ``clear`` as of `OneWayPath`; the place of the
    ``radar``, and its ``distance`` from the last mirror.
    """

    back: Vector3
    length: Real
    departure: Vector3
    clear: Mask
    mirrors: list[_Mirror]
    radar: Vector3
    distance: Real


def _to_image(
    context: TracingContext,
    source: Index,
    place: Vector3,
    off: Vector3,
    active: Mask,
    unshadowed: bool = False,
    tested: bool = True,
    in_parts: bool = False,
) -> _PathToImage:
    """``in_parts``: the first hit is looked for on the last part of a segment to a mirror, and any
    hit before, which is found in half the time of the first hit on all of it.
    """
    mi = context.mi
    order = dr.gather(mi.UInt32, context.orders, source, active)
    image = gathered(mi, context.positions, 3 * source, active)
    towards = image - place
    length = dr.norm(towards)
    back = towards / dr.maximum(length, NEAREST_M)
    clear = mi.Bool(active)

    at, aim, start = place, image, place + off
    mirrors = []
    for level in reversed(range(context.order)):
        has = active & (order > level)
        row = source * context.order + level
        before, point, normal = (
            gathered(mi, context.levels, LEVEL * row + 3 * i, has) for i in range(3)
        )
        segment_vector = aim - at
        distance = dr.norm(segment_vector)
        direction = segment_vector / dr.maximum(distance, NEAREST_M)
        slope = dr.dot(normal, direction)
        t = dr.dot(normal, point - at) / dr.select(slope != 0, slope, 1.0)
        mirror = at + t * direction
        number, surface, of_wall = (
            dr.gather(mi.UInt32, context.marks, 3 * row + i, has) for i in range(3)
        )
        clear &= ~has | ((t > 0) & (t < distance))
        if tested:
            begin, reach_m = onto_path(at, start, direction), t
            last = begin
            if unshadowed or in_parts:
                near = dr.minimum(dr.maximum(_JUST_BEFORE * t, _STEPS * offset(mirror)), t)
                last, reach_m = dr.select(near < t, at + (t - near) * direction, begin), near
            on_patch = _first_meets(
                context, last, direction, reach_m, number, of_wall > 0, has & clear
            )
            if in_parts:
                on_patch &= ~_is_met(context, begin, direction, t - reach_m, has & on_patch)
            clear &= ~has | on_patch
        facing = normal * dr.select(slope < 0, 1.0, -1.0)
        at = dr.select(has, mirror, at)
        aim = dr.select(has, before, aim)
        start = dr.select(has, mirror + facing * offset(mirror), start)
        mirrors.append(_Mirror(has, mirror, direction, t, facing, surface))

    segment_vector = aim - at
    distance = dr.norm(segment_vector)
    towards_radar = segment_vector / dr.maximum(distance, NEAREST_M)
    if tested and not unshadowed:
        reach = mi.Float(distance * (1 - 1e-5)) - mi.Float(offset(at))
        begin = onto_path(at, start, towards_radar)
        clear &= ~_is_met(context, begin, towards_radar, reach, clear)
    return _PathToImage(back, length, -towards_radar, clear, mirrors, aim, distance)


def image_place(context: TracingContext, source: Index) -> Vector3:
    """Places of images."""
    return gathered(context.mi, context.positions, 3 * source, True)


def mirrored_axes(context: TracingContext, source: Index) -> Axes:
    """The world's axes mirrored for an image."""
    x, y, z = (gathered(context.mi, context.axes, 9 * source + 3 * i, True) for i in range(3))
    return x, y, z


def along(vector: Vector3, axes: Axes) -> Vector3:
    """Components of a vector along axes; along an image's axes: the vector mirrored back to
    the radar.
    """
    return type(vector)(*(dr.dot(vector, axis) for axis in axes))


def _is_met(
    context: TracingContext, start: Vector3, direction: Vector3, reach: Real, active: Mask
) -> Mask:
    """Whether anything is on segments from a start."""
    mi = context.mi
    segment = mi.Ray3f(mi.Point3f(start), mi.Vector3f(direction), mi.Float(reach), 0.0, [])
    return context.world.scene.ray_test(segment, active=mi.Bool(active))


def _first_meets(
    context: TracingContext,
    start: Vector3,
    direction: Vector3,
    distance: Real,
    number: Index,
    of_wall: Mask,
    active: Mask,
) -> Mask:
    """Whether the first hit of rays is on the given patch, of an opaque object or of a wall."""
    mi = context.mi
    ray = mi.Ray3f(mi.Point3f(start), mi.Vector3f(direction))
    hit = context.world.scene.ray_intersect_preliminary(ray, active=active)
    patch = dr.gather(mi.UInt32, context.patch_of_face, hit.prim_index, active & hit.is_valid())
    solid = hit.is_valid() & (patch == number)
    if context.walls is None:
        return solid
    free = ~hit.is_valid() | (mi.Float64(hit.t) > distance * (1 - 1e-5))
    hit = context.walls.mesh.scene.ray_intersect_preliminary(ray, active=active & of_wall)
    patch = dr.gather(
        mi.UInt32, context.walls.patch_of_face, hit.prim_index, active & hit.is_valid()
    )
    return dr.select(of_wall, free & hit.is_valid() & (patch == number), solid)


def onto_path(place: Any, start: Any, direction: Any) -> Any:
    """Where a ray begins, as far from the surface as ``start``, but on the path itself.

    From beside it the same ray would shift the borders of all shadows by as much, alike: of a body
    that sends most of its wave elsewhere that is no small part of its echo.
    """
    off = start - place
    height = dr.norm(off)
    normal = off / dr.maximum(height, 1e-300)
    cosine = dr.maximum(dr.dot(normal, direction), 0)
    # Within the last degrees of grazing only in part: what touches the surface is to cast a shadow.
    onwards = dr.minimum(1 / dr.maximum(cosine, _GRAZING), cosine / _GRAZING**2)
    return start + offset(place) * onwards * (direction - cosine * normal)


def offset(place: Vector3) -> Real:
    """Distance from a surface at which rays start, at a place."""
    return OFF_SURFACE * (dr.norm(place) + 1e-3)


def offset_m(place: Array) -> Array:
    """As `offset`, on the host: of places (n, 3), (n, 1)."""
    return OFF_SURFACE * (np.linalg.norm(place, axis=1, keepdims=True) + 1e-3)
