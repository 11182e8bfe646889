"""Flat sides of obstacles between two parallel edges, and the field behind them.

Paths over edges take obstacles as black screens: between the front and the rear edge of a box they
know air alone. A side that is nearly along the wave reflects almost all of it. The field behind is
then the double knife edge of both edges, and that of the radar's image in the side times the side's
coefficient, which is about -1 but for a conductor with the field across it: the image's wave passes
the front edge below the side and the rear one above it. Kirchhoff's integral over the planes of
both edges is this with the half-space's propagator between them, by the image.

Left out are the ends of edges, and points beside a side rather than behind it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.geometry.edges import EdgeTable, connected
from twin.radar.propagation.diffraction.knife_edge import double_knife_edge, knife_edge_factor
from twin.radar.propagation.diffraction.two_edges import ONE_EDGE
from twin.radar.propagation.meshes.silhouettes import Outline, edge_on_m
from twin.radar.rows import dots, lengths, matching_pairs, phasors

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_GRAZING = 0.2  # sine of the angle between the side and the wave, at most
_SHARP = 0.9  # cosine of the angle between faces of an edge, at most
_ACROSS = 0.7  # sine of the angle between an edge and the wave, at least
_SAME = 1 - 1e-8  # cosine between edges, or faces, one of which goes on from the other, at least
_FLAT_M = 3e-4  # by which corners of a side are off its plane


@dataclass(frozen=True, eq=False)
class Side:
    """A flat side between two parallel edges.

    ``edge`` (2, 3): ends of one of the edges, relative to the source; unit vectors ``along`` it,
    ``inwards`` along the wave from the front edge to the rear one, and the outer ``normal``;
    ``front_m`` and ``rear_m``: both edges along ``inwards``; ``item``: number of the object;
    ``edge_on_m``: up to this height over it places count as below.
    """

    edge: Array
    along: Array
    inwards: Array
    normal: Array
    front_m: float
    rear_m: float
    item: int
    edge_on_m: float

    @property
    def height_m(self) -> float:
        """Of the source over the side."""
        return -float(self.edge[0] @ self.normal)

    @property
    def is_source_over(self) -> bool:
        """Whether the source sees the side."""
        return self.height_m > self.edge_on_m

    def is_along(self, way: Array) -> bool:
        """Whether a way (3,) leads along it, at grazing incidence."""
        return bool(abs(self.normal @ way) < _GRAZING * np.linalg.norm(way))

    def over_m(self, places: Array) -> Array:
        """Heights over the side of places relative to the source."""
        over: Array = places @ self.normal + self.height_m
        return over

    def adds_edge_waves_alone(self, direct: Array, *, is_mirror: bool) -> Flags:
        """Whether points at the ends of vectors (n, 3) from the source are in the light, and out of
        that which the side reflects unless that is known already, as of `changed_by`.
        """
        u, v = direct @ self.inwards, self.over_m(direct)[:, None]
        share = np.array([self.front_m, self.rear_m]) / u[:, None]
        over = self.height_m + share * (v - self.height_m) > 0
        front, rear = (-self.height_m + share * (v + self.height_m) > 0).T
        return np.asarray(over.all(axis=1) & (is_mirror | ~rear | front))

    def has(self, ends: Array) -> Flags:
        """Whether edges (n, 2, 3) relative to the source are in its plane."""
        return np.asarray((np.abs(self.over_m(ends)) < _FLAT_M).all(axis=1))

    def has_plane(self, points: Array, normals: Array) -> Flags:
        """Whether planes by points (n, 3), relative to the source, are its own."""
        is_alike = np.abs(normals @ self.normal) > _SAME
        return np.asarray(is_alike & (np.abs(self.over_m(points)) < _FLAT_M))

    def has_edge(self, ends: Array) -> Flags:
        """Whether edges (n, 2, 3) relative to the source are parts of the one it was found by."""
        off_m = np.linalg.norm(np.cross(ends - self.edge[0], self.along), axis=2)
        return np.asarray((off_m < _FLAT_M).all(axis=1))


def sides_of(
    outline: Outline, table: EdgeTable, points: Array, item: int, wavelength_m: float
) -> list[Side]:
    """Of an object with this outline from the source, those that it looks along at grazing
    incidence, at edges as long as a Fresnel zone and more; ``points`` (n, 3) of its mesh, relative
    to the source.
    """
    rows = np.flatnonzero(table.count[outline.edge] == 2)
    first = table.first[outline.edge[rows]]
    faces = np.stack([table.half_edges[first], table.half_edges[first + 1]], axis=1) // 3
    normals = _unit_normals(points, table.faces[faces].astype(np.int64))  # (n, 2, 3)
    is_sharp = np.abs(dots(normals[:, 0], normals[:, 1])) < _SHARP
    rows, faces, normals = rows[is_sharp], faces[is_sharp], normals[is_sharp]
    ends, one = _joined(outline.ends[rows], outline.corner[rows], normals)
    rows, faces, normals = rows[one], faces[one], normals[one]
    nearest = _nearest(ends)
    distance_m = lengths(nearest)
    edge_m = ends[:, 1] - ends[:, 0]
    across_m = lengths(np.cross(edge_m, nearest)) / distance_m
    is_long = across_m > np.maximum(np.sqrt(wavelength_m * distance_m), _ACROSS * lengths(edge_m))
    sine = np.abs(np.einsum("nfi,ni->nf", normals, nearest)) / distance_m[:, None]
    found = []
    for row, which in np.argwhere(is_long[:, None] & (sine < _GRAZING)).tolist():
        lit, face, normal = outline.lit[rows[row]], int(faces[row, which]), normals[row, which]
        side = _side(points, table, face, normal * np.sign(normal @ lit), ends[row], item)
        if side is not None and _is_deep(side):
            found.append(side)
    return found


def _joined(ends: Array, corner: Indices, normals: Array) -> tuple[Array, Indices]:
    """Edges (n, 2, 3) between ``corner`` (n, 2) that go on from each other between the same planes
    as one each, (m, 2, 3), and the first of each.
    """
    along = ends[:, 1] - ends[:, 0]
    along /= lengths(along)[:, None]
    i, j = (rows // 2 for rows in matching_pairs(corner.ravel(), corner.ravel()))
    alike = np.max(
        [
            np.abs(np.einsum("nfi,nfi->nf", normals[i], other)).min(axis=1)
            for other in (normals[j], normals[j, ::-1])
        ],
        axis=0,
    )
    goes_on = (np.abs(dots(along[i], along[j])) > _SAME) & (alike > _SAME)
    part = connected(np.stack([i, j], axis=1)[goes_on], len(ends))
    one = np.unique(part, return_index=True)[1]
    at = np.einsum("nei,ni->ne", ends - ends[one[part], :1], along[one[part]])
    least, most = np.full(len(one), np.inf), np.full(len(one), -np.inf)
    np.minimum.at(least, part, at.min(axis=1))
    np.maximum.at(most, part, at.max(axis=1))
    reach = np.stack([least, most], axis=1)[..., None] * along[one, None]
    return ends[one, :1] + reach, one


def _nearest(ends: Array) -> Array:
    """The places of edges (n, 2, 3) that are nearest to the source, (n, 3)."""
    along = ends[:, 1] - ends[:, 0]
    share = -dots(ends[:, 0], along) / np.maximum(dots(along, along), 1e-300)
    nearest: Array = ends[:, 0] + np.clip(share, 0, 1)[:, None] * along
    return nearest


def _unit_normals(points: Array, faces: Indices) -> Array:
    a, b, c = np.moveaxis(points[faces], -2, 0)
    across = np.cross(b - a, c - a)
    normals: Array = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-300)
    return normals


def _side(
    points: Array, table: EdgeTable, face: int, normal: Array, ends: Array, item: int
) -> Side | None:
    """The side that a face is a part of, at an edge of the outline: behind the edge where the
    source is below it, before the edge where it is above; None on the other side.
    """
    middle = ends.mean(axis=0)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    inwards = np.cross(normal, along)
    inwards *= np.sign(inwards @ middle)
    depth_m = (points - middle) @ inwards
    is_seen = -float(normal @ middle) > edge_on_m(points)
    if is_seen == (depth_m[table.faces[face]].sum() > 0):
        return None
    off_m = np.abs((points - middle) @ normal)[table.faces].max(axis=1)
    flat = np.flatnonzero(off_m < _FLAT_M)
    place = np.full(len(table.faces), -1)
    place[flat] = np.arange(len(flat))
    pairs = place[table.neighbours]
    part = connected(pairs[(pairs >= 0).all(axis=1)], len(flat))
    corners = table.faces[flat[part == part[place[face]]]]
    reach_m, at_m = depth_m[corners], float(middle @ inwards)
    front_m, rear_m = (reach_m.min(), 0.0) if is_seen else (0.0, reach_m.max())
    return Side(
        ends, along, inwards, normal, at_m + front_m, at_m + rear_m, item, edge_on_m(points)
    )


def _is_deep(side: Side) -> bool:
    """Whether its edges are not one for points far behind."""
    return 0 < side.front_m < (1 - ONE_EDGE) * side.rear_m


def changed_by(
    side: Side, direct: Array, wavenumber: float, coefficient: complex, is_mirror: bool
) -> Complex:
    """What a side adds to the square of the field over the straight wave, (n,), at points at the
    ends of vectors (n, 3) from the source; ``is_mirror``: apart from the specular path by it, which
    is known already to where the side ends.
    """
    change = np.zeros(len(direct), dtype=np.complex128)
    u, v, along = direct @ side.inwards, side.over_m(direct), direct @ side.along
    height = side.height_m
    behind = np.flatnonzero(u > side.rear_m)
    at_m = along[behind] * side.rear_m / u[behind]
    first, last = np.sort(side.edge @ side.along)
    some = behind[(at_m > first) & (at_m < last)]
    u, v, along = u[some], v[some], along[some]
    edges_m = np.array([side.front_m, side.rear_m])
    straight = np.sqrt(u**2 + (v - height) ** 2 + along**2)
    mirrored = np.sqrt(u**2 + (v + height) ** 2 + along**2)
    before = np.hypot(edges_m, height)
    after = np.hypot(u[:, None] - edges_m, v[:, None])
    gap = side.rear_m - side.front_m
    once = np.hypot(before + after, along[:, None])
    twice = np.hypot(before[0] + gap + after[:, 1], along)
    a, c = before[0], after[:, 1]
    correlation = np.sqrt(a * c / ((a + gap) * (gap + c)))
    share = edges_m / u[:, None]
    is_over = height + share * (v[:, None] - height) > 0
    is_reflected = -height + share * (v[:, None] + height) > 0
    is_reflected[:, 0] = ~is_reflected[:, 0]
    turn = coefficient * phasors(-(wavenumber * (mirrored - straight)))
    black = _field(wavenumber, straight, once, twice, is_over, correlation)
    image = turn * _field(wavenumber, mirrored, once, twice, is_reflected, -correlation)
    specular = np.where(is_mirror & is_reflected.all(axis=1), turn, 0)
    known = specular * (specular + 2 * is_over.all(axis=1))
    change[some] = image * (image + 2 * black) - known
    return change


def _field(
    wavenumber: float, straight: Array, once: Array, twice: Array, is_lit: Flags, correlation: Array
) -> Complex:
    """Behind two edges, over the straight wave, given path lengths (n,), over each edge (n, 2) and
    over both (n,).
    """
    q = np.maximum(wavenumber * (once - straight[:, None]), 0)
    both, alone = double_knife_edge(q, is_lit, correlation)
    single = np.where(is_lit, -1, 1) * knife_edge_factor(q) * phasors(-q)
    field: Complex = is_lit.all(axis=1) + np.sum(np.where(alone, single, 0), axis=1)
    return field + both * phasors(-(wavenumber * (twice - straight)))
