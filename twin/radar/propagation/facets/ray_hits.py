"""Hits of reflected rays: from the corners of ray tubes and a point inside, or from one point."""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.currents import normal_of, plane_of
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.triangles import Triangles, origin_of
from twin.radar.propagation.one_way.path import TracingContext, is_clear, offset, onto_path
from twin.transfer import aligned

Array = NDArray[np.float64]
Indices = NDArray[np.integer]

_INSET = 1e-2  # of the way to the centroid: rays start off the surface, beyond facets that touch it
#: A point near the centroid, by shares of the corners; the centroid itself may meet an edge if the
#: scene is symmetric.
INSIDE = (0.38, 0.335, 0.285)


@dataclass(frozen=True, eq=False)
class RayHits:
    """Hits of reflected rays, (samples, n).

    ``is_valid``: whether the ray's start is lit and the ray hits anything; ``face``: the facet;
    ``gap_m``: distance along the ray between that facet's plane and the plane that the last sample
    meets.
    """

    is_valid: NDArray[np.bool_]
    face: Indices
    gap_m: Array

    def take(self, row: Indices) -> "RayHits":
        """Of some tubes only."""
        return RayHits(self.is_valid[:, row], self.face[:, row], self.gap_m[:, row])


def reflected_ray_hits(
    context: TracingContext, scatterers: Scatterers, tubes: Triangles, samples: int
) -> RayHits:
    """Hits of rays from the corners and a point inside (4 samples), or from the lit point
    alone (1).
    """
    mi, n = context.mi, len(tubes)
    many = tubes.repeat(samples) if samples > 1 else tubes
    index = dr.arange(mi.UInt32, samples * n)
    place = samples_of(many, index & 3) if samples > 1 else many.lit_point
    active, face, direction = reflected_from(context, scatterers, many, place)
    dr.eval(active, face)
    gap = mi.Float64(0)
    if samples > 1:
        own = along(context, face, place, direction)
        last = along(context, dr.gather(mi.UInt32, face, index | 3), place, direction)
        both = active & dr.gather(mi.Bool, active, index | 3)
        gap = dr.select(both, dr.abs(own - last), np.inf)
    shape = (n, samples)
    return RayHits(
        np.array(active).reshape(shape).T,
        np.array(face).reshape(shape).T,
        np.broadcast_to(np.array(gap), n * samples).reshape(shape).T,
    )


def apart(context: TracingContext, tubes: Triangles, hits: RayHits) -> Array:
    """Distance along the ray of each sample between the plane that it meets and the plane that any
    other sample meets, (4 planes, 4 samples, n); infinite where either meets none.
    """
    mi, n = context.mi, len(tubes)
    many = tubes.repeat(4)
    index = dr.arange(mi.UInt32, 4 * n)
    place = samples_of(many, index & 3)
    direction, _ = _mirrored(context, many, place)
    faces = mi.UInt32(aligned(hits.face.T.ravel().astype(np.uint32)))
    own = along(context, faces, place, direction)
    distance_m = np.empty((4, 4, n))
    for k in range(4):
        gap = (
            along(context, dr.gather(mi.UInt32, faces, 4 * (index // 4) + k), place, direction)
            - own
        )
        valid = hits.is_valid & hits.is_valid[k]
        distance_m[k] = np.where(valid, np.abs(np.array(gap).reshape(n, 4).T), np.inf)
    return distance_m


def _mirrored(context: TracingContext, tubes: Triangles, place: Any) -> tuple[Any, Any]:
    """Direction of rays after their reflection at a place of a tube, and the normal there."""
    origin = origin_of(context, tubes)
    normal = normal_of(context, tubes.face, tubes.center, origin)
    direction = dr.normalize(place - origin)
    return direction - 2 * dr.dot(direction, normal) * normal, normal


def reflected_from(
    context: TracingContext, scatterers: Scatterers, tubes: Triangles, place: Any
) -> tuple[Any, Any, Any]:
    """Whether reflected rays from places meet a scatterer, its facet (else 0), and their
    direction.
    """
    mi = context.mi
    direction, normal = _mirrored(context, tubes, place)
    off = normal * (offset(place) + tubes.plane_deviation)
    active = mi.Bool(True)
    if tubes.waves is None:  # what lies in shadow reflects nothing
        active = is_clear(context, tubes.source, place, off, active)
    start = onto_path(place, place + off, direction)
    ray = mi.Ray3f(mi.Point3f(start), mi.Vector3f(direction))
    hit = context.world.scene.ray_intersect_preliminary(ray, active=active)
    active &= hit.is_valid()
    number = dr.gather(mi.UInt32, context.world.object_index, hit.prim_index, active)
    active &= dr.gather(mi.Bool, scatterers.answers, number, active)
    if context.walls is not None:  # between bodies no wall lets through
        ray.maxt = hit.t
        active &= ~context.walls.mesh.scene.ray_test(ray, active=active)
    return active, dr.select(active, hit.prim_index, 0), direction


def along(context: TracingContext, face: Any, place: Any, direction: Any) -> Any:
    """Distance from places to the planes of facets along directions."""
    point, normal = plane_of(context, face)
    slope = dr.dot(normal, direction)
    return dr.dot(normal, point - place) / dr.select(slope != 0, slope, 1.0)


def samples_of(tubes: Triangles, which: Any) -> Any:
    """Points of tubes: near a corner, 0 to 2, or inside, 3."""
    place = sum(share * point for share, point in zip(INSIDE, tubes.corners, strict=True))
    for number, point in enumerate(tubes.corners):
        place = dr.select(which == number, point + _INSET * (tubes.center - point), place)
    return place
