"""Ray tubes: triangular bundles of rays that the facets of bodies reflect at each other.

A flat facet reflects the wave of a point source as if it came from the point's mirror image. So a
ray tube is an origin and a triangle. Where all of it meets one plane it lights a triangle there,
its footprint, with exact phases. Where its corners and its centroid meet different planes it is
divided.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.borders import odd_one, split_at_border
from twin.radar.propagation.facets.currents import plane_of, reflection
from twin.radar.propagation.facets.ray_hits import (
    INSIDE,
    RayHits,
    along,
    apart,
    reflected_from,
    reflected_ray_hits,
    samples_of,
)
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.triangles import (
    Incident,
    Triangles,
    Waves,
    incident_on,
    origin_of,
)
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.scene.images import Image
from twin.radar.propagation.scene.slabs import SlabTransmission
from twin.radar.scattering.arrays import ComplexVector3, Vector3
from twin.transfer import aligned, host

Array = NDArray[np.float64]
Indices = NDArray[np.integer]

#: Phase, as mean over a ray tube, by which the facets that it meets may deviate from one plane; and
#: from which on they are not one curved surface.
_SMOOTH_RAD = 0.7
_STEP_RAD = 3.0
_DOUBT = 1.0  # relative error of a tube that is represented by one ray: others of its rays may miss
#: Of the distance from the anchor: by which float32 shifts borders, as measured on hollow bodies.
_ROUNDED = 5e-7
_CURVED = 1.0  # relative error of a tube cut at a border, over that border's curvature
_MOST_CURVATURE = 0.4
_ALIKE = 0.9  # cosine between facets of one curved surface
#: Sine of the angle at which planes are met: from less on, a ray's triangle is no larger than the
#: flat patch that it lies on.
_LEAST_SLOPE = 0.05


@dataclass(frozen=True, eq=False)
class Tubes:
    """Ray tubes, each as the triangle that it lights, still without a receiver.

    ``root``: number of the part of a facet at which the tube begins; ``doubt``: relative error of
    its echo; ``rounding``: likewise, by the float32 positions of borders that cut it, which no
    division lessens; ``is_lit``: whether its triangle is lit, or only near one that is.
    """

    triangles: Triangles
    root: Indices
    doubt: Array
    rounding: Array
    is_lit: NDArray[np.bool_]

    def take(self, which: NDArray[Any]) -> "Tubes":
        """Only some of them, by index or mask."""
        if which.dtype == bool and which.all():
            return self
        index = np.flatnonzero(which) if which.dtype == bool else which
        return Tubes(
            self.triangles.take(index),
            self.root[index],
            self.doubt[index],
            self.rounding[index],
            self.is_lit[index],
        )

    @staticmethod
    def concatenate(parts: "Sequence[Tubes]") -> "Tubes":
        """One after the other."""
        return Tubes(
            Triangles.concatenate([part.triangles for part in parts]),
            np.concatenate([part.root for part in parts]),
            np.concatenate([part.doubt for part in parts]),
            np.concatenate([part.rounding for part in parts]),
            np.concatenate([part.is_lit for part in parts]),
        )

    @staticmethod
    def from_roots(triangles: Triangles) -> "Tubes":
        """Tubes that begin at these triangles, each a root."""
        count = len(triangles)
        no_error, is_lit = np.zeros(count), np.ones(count, dtype=bool)
        return Tubes(triangles, np.arange(count), no_error, no_error, is_lit)


@dataclass(frozen=True, eq=False)
class _Intersections:
    """Ray tubes and the ``face`` that each meets; ``deviation_m``: distance of what it meets from
    the plane of that facet, at most; ``goes_on_as_ray``: whether it is represented by one ray from
    here on.
    """

    tubes: Tubes
    face: Indices
    deviation_m: Array
    goes_on_as_ray: NDArray[np.bool_]

    @staticmethod
    def of_rays(tubes: Tubes, face: Indices) -> "_Intersections":
        """Of tubes that are represented by one ray each."""
        return _Intersections(tubes, face, np.zeros(len(face)), np.ones(len(face), dtype=bool))


def reflected_on(context: TracingContext, scatterers: Scatterers, tubes: Tubes) -> Tubes | None:
    """Ray tubes after the next reflection, on the facets that they meet; None if they meet none.

    A tube whose rays meet facets so nearly in one plane that phases hardly differ stays whole. One
    that a single border cuts goes on in parts. Any other goes on as four quarters, each represented
    by one ray.
    """
    tubes = tubes.take(tubes.is_lit)
    wide, rays = tubes.take(~tubes.triangles.is_ray), tubes.take(tubes.triangles.is_ray)
    intersections = _onto_planes(context, scatterers, wide)
    if len(rays.root):
        hits = reflected_ray_hits(context, scatterers, rays.triangles, 1)
        hit = hits.is_valid[0]
        further = replace(rays, doubt=np.maximum(rays.doubt, _DOUBT)).take(hit)
        intersections.append(_Intersections.of_rays(further, hits.face[0, hit]))
    intersections = [part for part in intersections if len(part.face)]
    return _on_planes_met(context, scatterers, intersections) if intersections else None


def _onto_planes(
    context: TracingContext, scatterers: Scatterers, tubes: Tubes, may_clip: bool = True
) -> list[_Intersections]:
    """The facets that ray tubes, or parts of them, meet."""
    if not len(tubes.root):
        return []
    hits = reflected_ray_hits(context, scatterers, tubes.triangles, 4)
    gap_m = hits.gap_m[:3].max(axis=0)
    off = _phase_rad(context, gap_m)
    is_whole = off < _SMOOTH_RAD
    whole = tubes.take(is_whole)
    whole = replace(whole, doubt=whole.doubt + off[is_whole])
    no_ray = np.zeros(len(whole.root), dtype=bool)
    intersections = [_Intersections(whole, hits.face[3, is_whole], gap_m[is_whole], no_ray)]
    rest = np.flatnonzero(~is_whole & hits.is_valid.any(axis=0))
    if may_clip and len(rest):
        parts, is_clipped = _clip(context, scatterers, tubes.take(rest), hits.take(rest))
        if parts is not None:
            intersections += _onto_planes(context, scatterers, parts, may_clip=False)
        rest = rest[~is_clipped]
    if len(rest):
        # A quarter as large, curved surfaces part a fourth as much.
        doubt = np.minimum(off[rest] / 4, _DOUBT)
        intersections += _by_quarters(context, scatterers, tubes.take(rest), hits.take(rest), doubt)
    return intersections


def _phase_rad(context: TracingContext, gap_m: Array) -> Array:
    """Mean phase error of an echo for a distance between planes: on both ways, a third of that at
    the corners.
    """
    return 2 / 3 * 2 * np.pi / float(context.wavelength[0]) * gap_m


def _clip(
    context: TracingContext, scatterers: Scatterers, tubes: Tubes, hits: RayHits
) -> tuple[Tubes | None, NDArray[np.bool_]]:
    """Parts of ray tubes that one border cuts, and which tubes these are: one corner meets another
    surface than both others, the border is nearly straight, and the sample inside is on the side of
    it that this predicts.
    """
    off, nothing = _phase_rad(context, apart(context, tubes.triangles, hits)), ~hits.is_valid
    off = np.maximum(off, off.swapaxes(0, 1))
    alike = (off < _SMOOTH_RAD) | nothing[:, None] & nothing
    is_clipped, odd = odd_one(np.stack([alike[0, 1], alike[1, 2], alike[2, 0]]))
    rows = np.arange(len(odd))
    one, two = (odd + 1) % 3, (odd + 2) % 3
    is_clipped &= alike[3, odd, rows] | alike[3, one, rows]
    is_clipped &= np.minimum(off[odd, one, rows], off[odd, two, rows]) > _STEP_RAD
    rows = np.flatnonzero(is_clipped)
    if not len(rows):
        return None, is_clipped
    odd, one = odd[rows], one[rows]
    wanted = hits.is_valid[odd, rows]
    faces = np.where(wanted, hits.face[odd, rows], hits.face[one, rows])
    some = tubes.take(rows)
    at = split_at_border(
        context.mi,
        some.triangles.corners,
        context.mi.UInt32(aligned(odd)),
        _like(context, scatterers, some.triangles, faces, wanted),
    )
    curvature = np.array(at.curvature)
    inner = sum(INSIDE[1] / np.maximum(np.array(share), 1e-9) for share in at.shares)
    is_clear = (curvature < _MOST_CURVATURE) & ((inner < 1) == alike[3, odd, rows])
    is_clipped[rows] = is_clear
    some = replace(
        some,
        doubt=some.doubt + _CURVED * curvature,
        rounding=np.hypot(some.rounding, _rounding(scatterers, some.triangles)),
    )
    row = np.flatnonzero(is_clear)
    if not len(row):
        return None, is_clipped
    # Parts that meet nothing, too: there may be more than this border.
    parts = [_part(context, some, corners, row) for corners in (*at.near, *at.far)]
    return Tubes.concatenate(parts), is_clipped


def _rounding(scatterers: Scatterers, tubes: Triangles) -> Array:
    """Relative errors of the echoes of ray tubes that a border cuts, by its rounded position.

    A border is off by as much all along a flat patch. Errors of tubes add up as independent ones,
    so each counts more by the square root of how many of its size there are along the patch.
    """
    a, b, c = tubes.corners
    distance_m, area_m2 = host([dr.norm(a), dr.norm(dr.cross(b - a, c - a)) / 2], len(tubes))
    size_m = np.sqrt(np.maximum(area_m2, 1e-300))
    patch_m = np.sqrt(scatterers.patch_area_m2[np.array(tubes.face)])
    along_border = np.sqrt(np.maximum(patch_m / size_m, 1))
    return np.minimum(_ROUNDED * distance_m / size_m * along_border, 1)


def _like(
    context: TracingContext,
    scatterers: Scatterers,
    tubes: Triangles,
    face: Indices,
    wanted: NDArray[np.bool_],
) -> Callable[[Any], Any]:
    """Function of points of ray tubes: whether the ray from there meets the plane of a facet to
    within the smoothness limit or, where not ``wanted``, does not.
    """
    faces, expected = (
        context.mi.UInt32(aligned(face.astype(np.uint32))),
        context.mi.Bool(aligned(wanted)),
    )
    limit = _SMOOTH_RAD / float(_phase_rad(context, np.ones(1))[0])

    def same(place: Any) -> Any:
        active, hits, direction = reflected_from(context, scatterers, tubes, place)
        gap = along(context, hits, place, direction) - along(context, faces, place, direction)
        return (active & (dr.abs(gap) < limit)) == expected

    return same


def _part(
    context: TracingContext, tubes: Tubes, corners: tuple[Any, Any, Any], row: Indices
) -> Tubes:
    """The parts with these corners, of some of the tubes."""
    some, index = tubes.take(row), context.mi.UInt32(aligned(row.astype(np.uint32)))
    a, b, c = (dr.gather(context.mi.Vector3d, corner, index) for corner in corners)
    return replace(some, triangles=replace(some.triangles, corners=(a, b, c)).evaluate())


def _by_quarters(
    context: TracingContext, scatterers: Scatterers, tubes: Tubes, hits: RayHits, doubt: Array
) -> list[_Intersections]:
    """Quarters of ray tubes, each represented by the ray at its own centroid.

    Where that ray meets nothing, or a surface that faces elsewhere than what the tube's corner
    there meets, a quarter on the corner's surface is added that is not lit: only near something
    lit.
    """
    pieces = _quarters(context, tubes.triangles)
    own = reflected_ray_hits(context, scatterers, pieces, 1)
    is_lit, face = own.is_valid[0], own.face[0]
    at_corner, is_hit = hits.face.T.ravel(), hits.is_valid.T.ravel()
    normal = context.world.plane_table[:, 3:]
    is_other = np.abs(np.einsum("ij,ij->i", normal[face], normal[at_corner])) < _ALIKE
    also = is_hit & (~is_lit | is_other)
    root, rounding = np.repeat(tubes.root, 4), np.repeat(tubes.rounding, 4)
    quarters = Tubes(pieces, root, np.repeat(tubes.doubt + doubt, 4), rounding, is_lit)
    near = replace(quarters, is_lit=np.zeros_like(is_lit))
    return [
        _Intersections.of_rays(part.take(which), on[which])
        for part, which, on in ((quarters, is_lit, face), (near, also, at_corner))
    ]


def _quarters(context: TracingContext, tubes: Triangles) -> Triangles:
    """Quarters at the three corners and in the middle."""
    four = tubes.repeat(4)
    number = dr.arange(context.mi.UInt32, len(four)) & 3
    a, b, c = four.corners
    middles = (b + c) / 2, (c + a) / 2, (a + b) / 2
    # Of the quarter at a corner the other two corners are the middles of the edges there.
    p, q, r = (
        dr.select(number == i, corner, dr.select(number == 3, middles[i], other))
        for i, corner, other in (
            (0, a, dr.select(number == 1, middles[2], middles[1])),
            (1, b, dr.select(number == 2, middles[0], middles[2])),
            (2, c, dr.select(number == 0, middles[1], middles[0])),
        )
    )
    return replace(four, corners=(p, q, r)).evaluate()


def _on_planes_met(
    context: TracingContext, scatterers: Scatterers, intersections: Sequence[_Intersections]
) -> Tubes:
    """Ray tubes with their footprints on the planes of the facets that they meet."""
    tubes = Tubes.concatenate([part.tubes for part in intersections])
    face, deviation_m, is_ray = (
        np.concatenate(column)
        for column in zip(
            *((p.face, p.deviation_m, p.goes_on_as_ray) for p in intersections), strict=True
        )
    )
    return replace(
        tubes, triangles=_lit_on(context, scatterers, tubes.triangles, face, deviation_m, is_ray)
    )


def _lit_on(
    context: TracingContext,
    scatterers: Scatterers,
    some: Triangles,
    face: Indices,
    deviation_m: Array,
    becomes_ray: NDArray[np.bool_],
) -> Triangles:
    """Footprints of ray tubes on the planes of facets, with the waves that light them."""
    mi, wide = context.mi, dr.zeros(context.mi.Float64, len(face))
    wave = incident_on(context, some)
    _, normal, _, reflected_field = reflection(context, scatterers, some, wave)
    number = dr.gather(mi.UInt32, context.world.object_index, some.face)
    origin = wave.origin - 2 * dr.dot(wave.origin - some.center, normal) * normal
    image = wave.origin, wave.motion
    motion = scatterers.motions.mirrored(mi, number, image, some.center, normal)
    new = mi.UInt32(aligned(face.astype(np.uint32)))
    point, across = plane_of(context, new)

    def onto(place: Vector3) -> Vector3:
        ray = place - origin
        slope = dr.dot(across, ray)
        return origin + ray * (dr.dot(across, point - origin) / dr.select(slope != 0, slope, 1.0))

    is_ray, begin = mi.Bool(aligned(becomes_ray)), some.lit_point
    lit_point = onto(dr.select(is_ray, begin, samples_of(some, mi.UInt32(3))))
    direction, wider = dr.normalize(lit_point - origin), dr.norm(lit_point - origin)
    wider /= dr.norm(begin - origin)
    a, b, c = some.corners
    section = dr.abs(dr.dot(dr.cross(b - a, c - a), direction)) / 2 * dr.square(wider)
    patch_area = mi.Float64(aligned(scatterers.patch_area_m2[face]))
    least = dr.minimum(_LEAST_SLOPE, section / dr.maximum(patch_area, 1e-300))
    slope = dr.dot(across, direction)
    slope = dr.select(slope < 0, -1.0, 1.0) * dr.maximum(dr.abs(slope), least)

    def around(place: Vector3) -> Vector3:
        """Corners for parallel rays: the tube's own rays there may miss the plane."""
        aside = (place - begin) * wider
        aside -= direction * (dr.dot(across, aside) / slope)
        return lit_point + aside - across * dr.dot(across, aside)

    x, y, z = (axis - 2 * dr.dot(axis, normal) * normal for axis in wave.axes)
    transmission = SlabTransmission(*(value + wide for value in vars(wave.transmission).values()))
    field = ComplexVector3(reflected_field.re, reflected_field.im + wide)
    incident = Incident(origin, motion, (x, y, z), field, wave.departure, transmission)
    waves = Waves(incident, lit_point, mi.Float64(aligned(deviation_m)))
    a, b, c = (dr.select(is_ray, around(corner), onto(corner)) for corner in some.corners)
    triangles = replace(
        some,
        corners=(a, b, c),
        face=new,
        wave=dr.arange(mi.UInt32, len(face)),
        waves=waves,
        body=scatterers.body[face],
        is_ray=becomes_ray,
        bounces=some.bounces + np.uint8(1),
    )
    dr.eval(waves.columns(), *triangles.corners, triangles.wave)
    return triangles


def receivers_of(
    context: TracingContext, scatterers: Scatterers, lit: Triangles, images: Sequence[Image]
) -> tuple[NDArray[np.intp], NDArray[np.uint32]]:
    """Every pair of a lit triangle and an image on its lit side as receiver: the row of the
    triangle, and the number of the image.

    An echo between two different images is a separate path in each direction, with different last
    facets.
    """
    face = np.array(lit.face).astype(np.intp)
    (origin,) = host([origin_of(context, lit)], len(lit))
    point, normal = context.world.plane_table[face, :3], context.world.plane_table[face, 3:]
    plane = np.einsum("ij,ij->i", point, normal)
    side = np.einsum("ij,ij->i", origin, normal) - plane
    rows, receivers = [], []
    for number, image in enumerate(images):
        some = np.flatnonzero(scatterers.reachable[number][face])
        some = some[(normal[some] @ image.place - plane[some]) * side[some] > 0]
        rows.append(some)
        receivers.append(np.full(len(some), number, dtype=np.uint32))
    return np.concatenate(rows), np.concatenate(receivers)
