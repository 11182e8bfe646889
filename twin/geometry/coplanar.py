"""Faces that lie in one plane and share part of it: which, and how far apart.

What shares a plane is one surface to a sensor, however often a scene lists it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.geometry.faces import dots, lengths
from twin.geometry.geometry import Geometry
from twin.geometry.near_boxes import near_pairs

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

_PARALLEL = 1 - 1e-6  # cosine between normals: what is tilted by more is in one plane nowhere
#: Of the smaller face's size: faces that overlap by less only touch.
TOUCHING = 1e-4
_ROUNDING = 1e-12  # of coordinates
#: Of normals, and of distances over the size: faces in one plane share such a cell.
_CELL = 1e-4
_COARSE_CELL = 0.01  # of two meshes, whose planes are closer than a tolerance alone
#: Which of two opposite normals stands for a plane: a direction that no usual one is across.
_ASKEW = np.array([0.3713, 0.5477, 0.7499])
_MOST_IN_PLANE = 256  # patches whose boxes are compared
_MIX = np.array([1, 0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
_SHIFTS = 0.0, 0.5  # of cells: rounding parts patches in both once in 1e8
_AT_ONCE = 2**18  # pairs, 300 MB


@dataclass(frozen=True, eq=False)
class Facets:
    """Some faces: ``corners_m`` (n, 3, 3), unit ``normal`` (n, 3), ``outward`` (n,) as of `Shape`,
    0 where that is not known, and the ``face`` (n,) of its mesh that each is.
    """

    corners_m: Array
    normal: Array
    outward: NDArray[np.int8]
    face: Indices

    @staticmethod
    def of(geometry: Geometry, vertices_m: Array, face: Indices) -> "Facets":
        """Some faces of a geometry whose vertices stand elsewhere, of unknown outside."""
        corners = vertices_m[geometry.faces[face]]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = across / np.maximum(lengths(across), 1e-300)[:, None]
        return Facets(corners, normal, np.zeros(len(face), dtype=np.int8), face)

    @staticmethod
    def inside(geometry: Geometry, vertices_m: Array, box_m: Array) -> "Facets":
        """Those with an area whose boxes meet another box (2, 3)."""
        meets = np.ones(len(geometry), dtype=bool)
        for axis in range(3):
            a, b, c = (vertices_m[geometry.faces[:, k], axis] for k in range(3))
            meets &= np.maximum(np.maximum(a, b), c) >= box_m[0, axis]
            meets &= np.minimum(np.minimum(a, b), c) <= box_m[1, axis]
        facets = Facets.of(geometry, vertices_m, np.flatnonzero(meets))
        return facets.with_area()

    def with_area(self) -> "Facets":
        """Those that have one."""
        return self.take(np.flatnonzero(self.normal.any(axis=1)))

    def known(self, geometry: Geometry) -> "Facets":
        """The same with their outside, without those that are doubles of others."""
        shape = geometry.shape
        facets = replace(self, outward=shape.outward[self.face])
        return facets.take(~shape.is_double[self.face])

    def seen_from(self, place_m: Array) -> "Facets":
        """Those that do not turn the inside of a closed body to a place."""
        height = dots(place_m - self.corners_m[:, 0], self.normal)
        return self.take(height * self.outward >= 0)

    def __len__(self) -> int:
        return len(self.face)

    def take(self, rows: Indices | Flags) -> "Facets":
        """Only some of them."""
        return Facets(self.corners_m[rows], self.normal[rows], self.outward[rows], self.face[rows])

    @property
    def boxes(self) -> Array:
        """Around each, (n, 2, 3)."""
        return np.stack([self.corners_m.min(axis=1), self.corners_m.max(axis=1)], axis=1)


@dataclass(frozen=True, eq=False)
class Shared:
    """Pairs of facets that share part of a plane: rows of the ``one`` and the ``other``, (n,), and
    the ``height_m`` of the first over the second along the second's normal, (n,).
    """

    one: Indices
    other: Indices
    height_m: Array


def shared_by_two(one: Facets, other: Facets, tolerance_m: float) -> Shared:
    """Pairs of a facet of each that share part of a plane to within a distance."""
    rows, others = _in_common_planes(one, other, tolerance_m)
    if not len(rows):
        return Shared(rows, others, np.zeros(0))
    found = _of_near_boxes(one.take(rows), other.take(others), tolerance_m)
    return Shared(rows[found.one], others[found.other], found.height_m)


def _in_common_planes(one: Facets, other: Facets, tolerance_m: float) -> tuple[Indices, Indices]:
    """Rows of facets of each that may have some of the other in their plane."""
    if not len(one) or not len(other):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    points = np.concatenate([one.corners_m, other.corners_m]).reshape(-1, 3)
    center, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    size = max(size, 10 * tolerance_m / _COARSE_CELL)
    common = np.zeros(len(one), dtype=bool), np.zeros(len(other), dtype=bool)
    for shift in _SHIFTS:
        keys = [
            _plane_keys(f.normal, (f.corners_m[:, 0] - center) / size, _COARSE_CELL, shift)
            for f in (one, other)
        ]
        for flags, own, others in zip(common, keys, keys[::-1], strict=True):
            flags |= np.isin(own, others)
    return np.flatnonzero(common[0]), np.flatnonzero(common[1])


def _plane_keys(normal: Array, point: Array, cell: float, shift: float) -> NDArray[np.uint64]:
    """A number for each plane by its cell, whichever way its normal points."""
    normal = normal * np.sign(normal @ _ASKEW)[:, None]
    place = np.column_stack([normal, dots(point, normal)]) / cell
    cells = np.floor(place + shift + 0.25).astype(np.int64).view(np.uint64) * _MIX
    keys: NDArray[np.uint64] = cells.sum(axis=1, dtype=np.uint64)
    return keys


def _of_near_boxes(one: Facets, other: Facets, tolerance_m: float) -> Shared:
    boxes = np.concatenate([one.boxes, other.boxes])
    boxes[:, 0] -= tolerance_m
    boxes[:, 1] += tolerance_m
    pairs = near_pairs(boxes)[0]
    pairs = pairs[(pairs[:, 0] < len(one)) & (pairs[:, 1] >= len(one))]
    return _shared(one, other, pairs[:, 0], pairs[:, 1] - len(one), tolerance_m)


def shared_within(geometry: Geometry, tolerance_m: float) -> tuple[Facets, Shared]:
    """Pairs of a mesh's own faces that share part of a plane, the earlier one first: what is looked
    at are faces folded onto a neighbour, and flat patches of which another is in the same plane.
    """
    doubtful = np.zeros(len(geometry), dtype=bool)
    if not geometry.shape.is_convex:
        doubtful = _folded(geometry) | _of_planes_with_others(geometry)
    facets = Facets.of(geometry, geometry.vertices_m, np.flatnonzero(doubtful)).known(geometry)
    facets = facets.with_area()
    pairs = near_pairs(facets.boxes)[0] if len(facets) else np.zeros((0, 2), dtype=np.int64)
    return facets, _shared(facets, facets, pairs[:, 0], pairs[:, 1], tolerance_m)


def stands_before(one: Facets, other: Facets, shared: Shared, place_m: Array | None) -> Flags:
    """Whether the first facet of pairs is what is seen, and not the second; of two in the very same
    plane that is the second. Of open meshes it depends on the side from which a place sees them.
    """
    a, b = shared.one, shared.other
    cosine = dots(one.normal[a], other.normal[b])
    side = other.outward[b].astype(np.float64)
    side = np.where(side == 0, np.sign(cosine) * one.outward[a], side)
    if place_m is not None:
        towards = dots(place_m - other.corners_m[b][:, 0], other.normal[b])
        side = np.where(side == 0, np.sign(towards), side)
    reach = np.abs(other.corners_m[b]).max(axis=(1, 2))
    before: Flags = shared.height_m * side > _ROUNDING * reach
    return before


def _shared(one: Facets, other: Facets, i: Indices, j: Indices, tolerance_m: float) -> Shared:
    found = [Shared(i[:0], j[:0], np.zeros(0))]
    for first in range(0, len(i), _AT_ONCE):
        a, b = i[first : first + _AT_ONCE], j[first : first + _AT_ONCE]
        cosine = dots(one.normal[a], other.normal[b])
        # What closed bodies show of such faces are opposite sides: they touch, and neither is seen.
        seen = np.sign(cosine) * one.outward[a] * other.outward[b] >= 0
        rows = np.flatnonzero((np.abs(cosine) > _PARALLEL) & seen)
        a, b = a[rows], b[rows]
        own, others = _heights(one, a, other, b), _heights(other, b, one, a)
        off, back = np.abs(own).max(axis=1), np.abs(others).max(axis=1)
        near = np.minimum(off, back) <= tolerance_m
        near &= _overlap(one.corners_m[a], other.corners_m[b], other.normal[b])
        height = np.where(off <= back, own.mean(axis=1), -np.sign(cosine[rows]) * others.mean(1))
        found.append(Shared(a[near], b[near], height[near]))
    return Shared(*(np.concatenate(column) for column in zip(*map(_columns, found), strict=True)))


def _columns(shared: Shared) -> tuple[Indices, Indices, Array]:
    return shared.one, shared.other, shared.height_m


def _heights(one: Facets, a: Indices, other: Facets, b: Indices) -> Array:
    """Of the corners of facets over the planes of others, (n, 3)."""
    off = one.corners_m[a] - other.corners_m[b][:, :1]
    heights: Array = np.einsum("nci,ni->nc", off, other.normal[b])
    return heights


def _overlap(one: Array, other: Array, normal: Array) -> Flags:
    """Whether triangles (n, 3, 3) in one plane overlap: no line along an edge of either parts
    them.
    """
    size = np.minimum(*(np.ptp(corners, axis=1).max(axis=1) for corners in (one, other)))
    overlap = np.ones(len(one), dtype=bool)
    for corners in (one, other):
        for k in range(3):
            across = np.cross(normal, corners[:, (k + 1) % 3] - corners[:, k])
            across /= np.maximum(lengths(across), 1e-300)[:, None]
            at, others = (
                np.einsum("nci,ni->nc", points - corners[:, :1], across) for points in (one, other)
            )
            depth = np.minimum(at.max(axis=1), others.max(axis=1))
            depth -= np.maximum(at.min(axis=1), others.min(axis=1))
            overlap &= depth > TOUCHING * size
    return overlap


def _folded(geometry: Geometry) -> Flags:
    """Faces of flat patches in which a face lies on the same side of an edge as its neighbour: if
    both normals agree, both run along the edge in the same sense.
    """
    table, patch = geometry.edges, geometry.shape.patch_of_face
    start = table.first[table.count == 2]
    pairs = [np.stack([table.half_edges[start], table.half_edges[start + 1]], axis=1)]
    for edge in np.flatnonzero(table.count > 2).tolist():
        several = table.half_edges[table.first[edge] :][: table.count[edge]]
        pairs.append(several[np.stack(np.triu_indices(len(several), 1), axis=1)])
    halves = np.concatenate(pairs)
    solid = _with_area(geometry, len(table.faces))
    flat = patch[solid[halves[:, 0] // 3]] == patch[solid[halves[:, 1] // 3]]
    halves = halves[flat | (np.arange(len(halves)) >= len(start))]
    one, other = (geometry.normals[solid[half // 3]] for half in halves.T)
    along = table.along[halves[:, 0]] * table.along[halves[:, 1]]
    folded = np.zeros(int(patch.max()) + 1, dtype=bool)
    folded[patch[solid[halves[dots(one, other) * along > _PARALLEL] // 3]]] = True
    return folded[patch]


def _with_area(geometry: Geometry, count: int) -> Indices:
    """The ``count`` faces that `Geometry.edges` is made of."""
    if count == len(geometry):
        return np.arange(count)
    a, b, c = (geometry.vertices_m[geometry.welded_faces[:, i]] for i in range(3))
    return np.flatnonzero((np.cross(b - a, c - a) != 0).any(axis=1))


def _of_planes_with_others(geometry: Geometry) -> Flags:
    """Faces of flat patches that meet the box of another of the mesh in their plane."""
    patch = geometry.shape.patch_of_face
    order = np.argsort(patch, kind="stable")
    first = np.searchsorted(patch[order], np.arange(int(patch.max()) + 2))
    face = geometry.faces[order[first[:-1]]]
    center, radius = geometry.sphere
    normal = geometry.normals[order[first[:-1]]]
    point = (geometry.vertices_m[face[:, 0]] - center) / radius
    meets = np.zeros(len(face), dtype=bool)
    for shift in _SHIFTS:
        key = _plane_keys(normal, point, _CELL, shift)
        ordered = np.sort(key)
        rows = np.flatnonzero(np.isin(key, ordered[1:][ordered[1:] == ordered[:-1]]))
        if not len(rows):
            continue
        is_wanted = np.zeros(len(face), dtype=bool)
        is_wanted[rows] = True
        among = is_wanted[patch[order]]
        corners = geometry.vertices_m[geometry.faces[order[among]]]
        begin = np.searchsorted(patch[order[among]], rows)
        low = np.minimum.reduceat(corners.min(axis=1), begin)
        boxes = np.stack([low, np.maximum.reduceat(corners.max(axis=1), begin)], axis=1)
        meets[rows] |= _meet(boxes, key[rows])
    return meets[patch]


def _meet(boxes: Array, key: NDArray[np.uint64]) -> Flags:
    """Boxes (n, 2, 3) that meet another one of the same key; of very many with one, all of them."""
    order = np.argsort(key, kind="stable")
    boxes, key = boxes[order], key[order]
    found = np.zeros(len(key), dtype=bool)
    for step in range(1, len(key)):
        same = np.flatnonzero(key[step:] == key[:-step])
        if not len(same) or step > _MOST_IN_PLANE:
            found[same] = found[same + step] = True
            break
        one, other = boxes[same], boxes[same + step]
        meet = same[((one[:, 0] <= other[:, 1]) & (other[:, 0] <= one[:, 1])).all(axis=1)]
        found[meet] = found[meet + step] = True
    is_meeting = np.zeros(len(key), dtype=bool)
    is_meeting[order] = found
    return is_meeting
