"""Lit triangles on the scene's facets, which are divided until their echo is accurate enough.

A triangle is lit from a point, its origin: the radar, an image of it in a large surface, or, after
reflections between bodies, that image's image in the facets on the path. It has one image of the
radar as receiver.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.one_way.device_motion import Moving
from twin.radar.propagation.one_way.path import (
    Axes,
    TracingContext,
    image_place,
    mirrored_axes,
    one_way_path,
)
from twin.radar.propagation.scene.slabs import SlabTransmission
from twin.radar.scattering.arrays import ComplexVector3, Index, Real, Vector3
from twin.transfer import aligned, concatenated

Array = NDArray[np.float64]
Indices = NDArray[np.integer]

_ON_HOST = "body", "is_ray", "first", "bounces"  # what triangles have there


@dataclass(frozen=True, eq=False)
class Incident:
    """Incident waves at points, on the device; see `path.OneWayPath`.

    ``origin`` is the point from which each spreads, ``motion`` that point's, ``axes`` the world's
    axes mirrored in all mirrors and facets on the path.
    """

    origin: Vector3
    motion: Moving
    axes: Axes
    field: ComplexVector3
    departure: Vector3
    transmission: SlabTransmission


@dataclass(frozen=True, eq=False)
class Waves:
    """Waves that light the footprints of ray tubes, each at the centroid.

    ``lit_point``: a point of the footprint that is lit; ``plane_deviation``: distance of the
    surface from the footprint's plane, at most, m: a ray tube on a curved surface has one plane
    footprint.
    """

    incident: Incident
    lit_point: Vector3
    plane_deviation: Real

    def columns(self) -> list[Any]:
        """All arrays, in order."""
        w = self.incident
        vectors = (
            w.origin,
            *w.axes,
            w.field.re,
            w.field.im,
            w.departure,
            self.lit_point,
        )
        return [
            *(axis for v in vectors for axis in v),
            *vars(w.transmission).values(),
            self.plane_deviation,
            *w.motion.columns(),
        ]

    @staticmethod
    def of(columns: Sequence[Any], vector: Any) -> "Waves":
        """From these arrays."""
        origin, x, y, z, re, im, departure, lit_point = (
            vector(*columns[i : i + 3]) for i in range(0, 24, 3)
        )
        transmission = SlabTransmission(*columns[24:28])
        field, motion = ComplexVector3(re, im), Moving.of_columns(columns[29:], vector)
        incident = Incident(origin, motion, (x, y, z), field, departure, transmission)
        return Waves(incident, lit_point, columns[28])

    def at(self, index: Index) -> "Waves":
        """The waves with these indices."""
        columns = [dr.gather(type(value), value, index) for value in self.columns()]
        return Waves.of(columns, type(self.lit_point))


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles on the device, one element each, relative to the anchor.

    ``corners``: three vectors; ``face``: the facet on which they lie; ``source`` and ``receiver``:
    images of the radar; ``wave``: which of the ``waves`` lights each; without these the source
    lights them directly. On the host (n,): ``body``; ``is_ray``: the triangle is represented by one
    ray at the wave's lit point, and its corners may be dark; ``first``: the first facet of the
    path; ``bounces``: reflections at bodies on it, this one included.
    """

    corners: tuple[Vector3, Vector3, Vector3]
    face: Index
    source: Index
    receiver: Index
    wave: Index
    waves: Waves | None
    body: NDArray[np.intp]
    is_ray: NDArray[np.bool_]
    first: NDArray[np.uint32]
    bounces: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.body)

    @property
    def center(self) -> Vector3:
        """Centroids."""
        a, b, c = self.corners
        return (a + b + c) / 3

    @property
    def plane_deviation(self) -> Real | float:
        """Distance of the surface from the triangle's plane, at most, in m."""
        return (
            0.0
            if self.waves is None
            else dr.gather(_number(self), self.waves.plane_deviation, self.wave)
        )

    @property
    def lit_point(self) -> Vector3:
        """A point of each that is lit if any point is."""
        if self.waves is None:
            return self.center
        is_ray = dr.mask_t(self.face)(aligned(self.is_ray))
        own = dr.gather(type(self.corners[0]), self.waves.lit_point, self.wave)
        return dr.select(is_ray, own, self.center)

    def gather(self, which: Indices) -> "Triangles":
        """Only some of them, by index; not evaluated yet."""
        index = type(self.face)(aligned(which.astype(np.uint32)))
        columns = [dr.gather(type(value), value, index) for value in self._columns()]
        own: dict[str, Any] = {name: getattr(self, name)[which] for name in _ON_HOST}
        return replace(self._of(columns), **own)

    def take(self, which: Indices) -> "Triangles":
        """Only some of them, by index."""
        return self.gather(which).evaluate()

    def towards(self, row: Indices, receiver: NDArray[np.uint32]) -> "Triangles":
        """Some of them, by index, each with an image as receiver."""
        receivers = type(self.face)(aligned(receiver))
        return replace(self.gather(row), receiver=receivers).evaluate()

    def with_own_waves(self) -> "Triangles":
        """The same with the waves that light them alone, where most of the waves light others."""
        if self.waves is None:
            return self
        used, number = np.unique(np.array(self.wave), return_inverse=True)
        if 2 * len(used) > dr.width(self.waves.plane_deviation):
            return self
        index = type(self.face)
        waves = self.waves.at(index(aligned(used)))
        dr.eval(waves.columns())
        wave = index(aligned(number.reshape(-1).astype(np.uint32)))
        return replace(self, wave=wave, waves=waves)

    def repeat(self, times: int) -> "Triangles":
        """Each of them several times in a row."""
        index = dr.arange(type(self.face), times * len(self)) // times
        columns = [dr.gather(type(value), value, index) for value in self._columns()]
        own: dict[str, Any] = {name: np.repeat(getattr(self, name), times) for name in _ON_HOST}
        return replace(self._of(columns), **own)

    def evaluate(self) -> "Triangles":
        """The same, computed."""
        dr.eval(self._columns())
        return self

    @staticmethod
    def concatenate(parts: Sequence["Triangles"]) -> "Triangles":
        """One after the other; all lit directly, or none."""
        parts = [part for part in parts if len(part)] or list(parts[:1])
        if len(parts) == 1:
            return parts[0]
        first, waves = parts[0], parts[0].waves
        others = {id(part.waves): part.waves for part in parts}
        if len(others) > 1 and waves is not None:
            waves, begin = _all_waves(list(others.values()))
            number = dict(zip(others, begin, strict=True))
            parts = [replace(p, wave=p.wave + number[id(p.waves)]) for p in parts]
        columns = list(zip(*(part._columns() for part in parts), strict=True))
        whole = first._of(concatenated(columns, [len(part) for part in parts]))
        own: dict[str, Any] = {
            name: np.concatenate([getattr(p, name) for p in parts]) for name in _ON_HOST
        }
        return replace(whole, waves=waves, **own)

    def _columns(self) -> list[Any]:
        """All numbers, in order."""
        corners = [axis for corner in self.corners for axis in corner]
        wave = [] if self.waves is None else [self.wave]
        return [*corners, self.face, self.source, self.receiver, *wave]

    def _of(self, columns: Sequence[Any]) -> "Triangles":
        """The same with other numbers."""
        vector = type(self.corners[0])
        a, b, c = (vector(*columns[i : i + 3]) for i in (0, 3, 6))
        face, source, receiver, *rest = columns[9:]
        wave = rest[0] if rest else self.wave
        return replace(
            self, corners=(a, b, c), face=face, source=source, receiver=receiver, wave=wave
        )


def _number(lit: Triangles) -> Any:
    return dr.value_t(lit.corners[0])


def _all_waves(waves: Sequence[Any]) -> tuple[Waves, list[Any]]:
    """One table of several, and the first row of each in it."""
    columns = list(zip(*(part.columns() for part in waves), strict=True))
    sizes = [dr.width(part.plane_deviation) for part in waves]
    index = dr.uint32_array_t(type(waves[0].plane_deviation))
    begin = [dr.opaque(index, int(n)) for n in np.cumsum([0, *sizes[:-1]])]
    return Waves.of(concatenated(columns, sizes), type(waves[0].lit_point)), begin


def origin_of(context: TracingContext, lit: Triangles) -> Vector3:
    """The point from which each triangle's incident wave spreads."""
    if lit.waves is None:
        return image_place(context, lit.source)
    return dr.gather(context.mi.Vector3d, lit.waves.incident.origin, lit.wave)


def incident_on(context: TracingContext, lit: Triangles) -> Incident:
    """The incident wave at each triangle's centroid; of a directly lit one without any test for
    occluders.
    """
    if lit.waves is not None:
        return lit.waves.at(lit.wave).incident
    mi = context.mi
    path = one_way_path(
        context, lit.source, lit.center, mi.Vector3d(0), mi.Bool(True), tested=False
    )
    return Incident(
        origin=image_place(context, lit.source),
        motion=path.motion,
        axes=mirrored_axes(context, lit.source),
        field=path.field,
        departure=path.departure,
        transmission=path.transmission,
    )


def split_in_four(context: TracingContext, triangles: Triangles) -> Triangles:
    """Each triangle divided into four, by bisecting the longest edge twice."""
    corners = triangles.corners
    four = triangles.repeat(4)
    number = dr.arange(context.mi.UInt32, len(four))
    for half in (2, 1):
        a, b, c = four.corners if half == 2 else corners
        ab, bc, ca = (dr.squared_norm(q - p) for p, q in ((a, b), (b, c), (c, a)))
        first, second = (ab >= bc) & (ab >= ca), bc >= ca
        p = dr.select(first, a, dr.select(second, b, c))
        q = dr.select(first, b, dr.select(second, c, a))
        r = dr.select(first, c, dr.select(second, a, b))
        is_later, middle = (number & half) > 0, (p + q) / 2
        corners = (dr.select(is_later, middle, p), dr.select(is_later, q, middle), r)
    return replace(four, corners=corners).evaluate()
