"""From facet to facet: triangular tubes of rays that bodies reflect at each other.

A flat facet reflects the light of a point as if it came from the point's mirror image: so a tube is
an origin and a triangle, and where all of it meets one plane it lights a triangle there, with exact
phases. Where its corners and its centroid meet different planes it is divided.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.currents import normal_of, reflection
from twin.radar.propagation.images import Image
from twin.radar.propagation.legs import Station, leg, offset
from twin.radar.propagation.scatterers import Scatterers
from twin.radar.propagation.triangles import Incident, Triangles, quartered
from twin.transfer import aligned

Array = NDArray[np.float64]
Indices = NDArray[np.integer]

_INSET = 1e-3  # of the way to the centroid
_INSIDE = (0.38, 0.335, 0.285)  # near the centroid, which in what is symmetric meets a crease
_DOUBT = 1.5  # of what a ray that hits stands for: others of its tube miss


@dataclass(frozen=True, eq=False)
class Tubes:
    """Triangles that tubes light, with the ``root`` of each, the number of the facet's part that it
    began at, and its ``doubt``: share of what it may return that it may be off by.

    The triangles are of no receiver.
    """

    triangles: Triangles
    root: Indices
    doubt: Array

    def chosen(self, which: NDArray[np.bool_]) -> "Tubes":
        """Only some of them, by mask."""
        return Tubes(
            self.triangles.taken(np.flatnonzero(which)), self.root[which], self.doubt[which]
        )

    @staticmethod
    def joined(parts: "Sequence[Tubes]") -> "Tubes":
        """One after the other."""
        return Tubes(
            Triangles.joined([part.triangles for part in parts]),
            np.concatenate([part.root for part in parts]),
            np.concatenate([part.doubt for part in parts]),
        )

    @staticmethod
    def begin(triangles: Triangles) -> "Tubes":
        """Each a root."""
        return Tubes(triangles, np.arange(len(triangles)), np.zeros(len(triangles)))


def reflected_on(s: Station, scatterers: Scatterers, tubes: Tubes) -> Tubes | None:
    """Tubes where they land after the next reflection; None where they meet nothing.

    Where the rays of a tube part, each of its quarters goes on as a mere ray.
    """
    wide, rays = tubes.chosen(~tubes.triangles.is_ray), tubes.chosen(tubes.triangles.is_ray)
    landed = []
    if len(wide.root):
        plane, face = _met(s, scatterers, wide.triangles, 4)
        is_whole = (plane == plane[3]).all(axis=0)
        landed.append(_landed(s, scatterers, wide, is_whole & (plane[3] >= 0), face[3]))
        parting = wide.chosen(~is_whole)
        if len(parting.root):
            rays = Tubes.joined(
                [rays, _as_rays(s, parting)] if len(rays.root) else [_as_rays(s, parting)]
            )
    if len(rays.root):
        plane, face = _met(s, scatterers, rays.triangles, 1)
        landed.append(_landed(s, scatterers, rays, plane[0] >= 0, face[0]))
    found = [part for part in landed if len(part.root)]
    return Tubes.joined(found) if found else None


def _as_rays(s: Station, tubes: Tubes) -> Tubes:
    four = quartered(s, tubes.triangles)
    return Tubes(
        replace(four, is_ray=np.ones(len(four), dtype=bool)),
        np.repeat(tubes.root, 4),
        np.full(len(four), _DOUBT),
    )


def _met(
    s: Station, scatterers: Scatterers, tubes: Triangles, samples: int
) -> tuple[Indices, Indices]:
    """Planes and facets that reflected rays meet, (samples, n): those of corners and of a point
    inside, or of the latter alone; -1 where they meet none, or the source does not see the point.
    """
    mi, n = s.mi, len(tubes)
    many = tubes.repeated(samples) if samples > 1 else tubes
    place = many.spot
    if samples > 1:
        place = _samples(many, dr.arange(mi.UInt32, samples * n) & 3)
    normal = normal_of(s, many.face, many.center, many.incident.origin)
    direction = dr.normalize(place - many.incident.origin)
    direction = direction - 2 * dr.dot(direction, normal) * normal
    start = place + normal * offset(place)
    ray = mi.Ray3f(mi.Point3f(start), mi.Vector3f(direction))
    hit = s.world.scene.ray_intersect_preliminary(ray)
    planes, valid = mi.Int32(aligned(scatterers.plane)), hit.is_valid()
    plane = dr.gather(mi.Int32, planes, hit.prim_index, valid)
    active = valid & (plane >= 0)
    if s.walls is not None:  # between bodies no wall lets through
        ray.maxt = hit.t
        active &= ~s.walls.mesh.scene.ray_test(ray, active=active)
    if tubes.bounces == 0:
        active &= leg(s, many.source, place, normal * offset(place), active).clear
    plane, face = dr.select(active, plane, -1), hit.prim_index
    dr.eval(plane, face)
    return np.array(plane).reshape(n, samples).T, np.array(face).reshape(n, samples).T


def _samples(tubes: Triangles, which: Any) -> Any:
    """Points of tubes: near a corner, 0 to 2, or inside, 3."""
    place = sum(share * point for share, point in zip(_INSIDE, tubes.corners, strict=True))
    for number, point in enumerate(tubes.corners):
        place = dr.select(which == number, point + _INSET * (tubes.center - point), place)
    return place


def _landed(
    s: Station, scatterers: Scatterers, tubes: Tubes, which: NDArray[np.bool_], face: Indices
) -> Tubes:
    """Some of the tubes on the planes of facets that they meet."""
    rows = np.flatnonzero(which)
    if not len(rows):
        return tubes.chosen(which)
    lit = _lit_on(s, scatterers, tubes.triangles.taken(rows), face[rows])
    return Tubes(lit, tubes.root[rows], tubes.doubt[rows])


def _lit_on(s: Station, scatterers: Scatterers, some: Triangles, face: Indices) -> Triangles:
    """The triangles that tubes light on the planes of facets."""
    mi = s.mi
    wave = some.incident
    _, normal, _, out, out_im = reflection(s, scatterers, some)
    number = dr.gather(mi.UInt32, s.world.object_index, some.face)
    own = mi.Vector3d(
        *(dr.gather(mi.Float64, scatterers.velocity, 3 * number + i) for i in range(3))
    )
    origin = wave.origin - 2 * dr.dot(wave.origin - some.center, normal) * normal
    velocity = wave.velocity - 2 * dr.dot(wave.velocity - own, normal) * normal
    new = mi.UInt32(aligned(face.astype(np.uint32)))
    point, across = (
        mi.Vector3d(*(dr.gather(mi.Float64, s.world.planes, 6 * new + k + i) for i in range(3)))
        for k in (0, 3)
    )

    def onto(corner: Any) -> Any:
        way = corner - origin
        slope = dr.dot(across, way)
        return origin + way * (dr.dot(across, point - origin) / dr.select(slope != 0, slope, 1.0))

    axes = tuple(axis - 2 * dr.dot(axis, normal) * normal for axis in wave.axes)
    incident = Incident(origin, velocity, axes, out, out_im, wave.departure, wave.passage)
    return replace(
        some,
        corners=tuple(onto(corner) for corner in some.corners),
        face=new,
        spot=onto(
            dr.select(mi.Bool(aligned(some.is_ray)), some.spot, _samples(some, mi.UInt32(3)))
        ),
        incident=incident,
        body=scatterers.body[face],
        bounces=some.bounces + 1,
    ).evaluated()


def heard(
    s: Station, scatterers: Scatterers, landed: Triangles, images: Sequence[Image]
) -> tuple[Triangles, NDArray[np.intp]]:
    """Lit triangles with every image from their source on that sees their side as receiver, and the
    row of each.
    """
    face, source = np.array(landed.face).astype(np.intp), np.array(landed.source)
    origin = np.stack([np.array(axis) for axis in landed.incident.origin], axis=1)
    point, normal = s.world.plane_table[face, :3], s.world.plane_table[face, 3:]
    side = np.sum((origin - point) * normal, axis=1)
    rows, receivers = [], []
    for number, image in enumerate(images):
        same = np.sum((image.place - point) * normal, axis=1) * side > 0
        some = np.flatnonzero(same & (number >= source) & scatterers.heard[number, face])
        rows.append(some)
        receivers.append(np.full(len(some), number))
    row, receiver = np.concatenate(rows), np.concatenate(receivers)
    lit = landed.taken(row)
    return replace(lit, receiver=s.mi.UInt32(aligned(receiver.astype(np.uint32)))), row
