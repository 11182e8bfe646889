"""What a mesh is by itself, wherever it stands: flat patches, hull, size, sense of its normals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.read_only import read_only
from twin.errors import InputError
from twin.geometry.coarseness import depths_m
from twin.geometry.edges import EdgeTable, connected, doubles, edge_table, welded
from twin.geometry.faces import areas, dots, lengths, normals

if TYPE_CHECKING:
    from twin.geometry.geometry import Geometry

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Faces = NDArray[np.int32]
Flags = NDArray[np.bool_]

_SMOOTH_RAD = np.radians(30)  # a sharper edge ends a surface, a blunter one bends it
_FLAT_RAD = 1e-4
_ROUNDED = 1e-6  # of a facet's size: by which rounding lifts a neighbour's middle off its plane
_MOST_HULL = 20_000  # vertices: finding the hull of more takes longer than it saves
_MOST_PATCHES = 64  # whose planes are compared: a mesh of more is not flat
_AT_ONCE = 2**18  # faces measured together: small meshes in one go, 200 MB


@dataclass(frozen=True, eq=False)
class Shape:
    """A rigid mesh in numbers that motion doesn't change.

    ``patch_of_face`` (m,) numbers flat patches, the largest first; ``patch_area_m2`` (p,) is their
    area. ``plane_of_face`` (m,) numbers the planes of the largest patches, -1 for faces in none;
    ``plane_area_m2`` (q,) is the area in each. ``hull`` are the vertices on the convex hull.
    ``bend_radius_m`` is the radius with which the largest patch smoothly goes on into its
    neighbours: inf for a wall, small for a ball. ``thickness_m`` is the distance of the two largest
    patches where they are parallel and about as large, else None. ``outward`` (m,): 1 or -1 where
    the normal of a face, by the sense of its corners, looks out of a closed part of the mesh or
    into it; 0 where that part is open. ``is_double`` (m,): faces that another one lies upon.
    ``depth_m``: by which the facets' depth below the smooth surface that they stand for scatters
    (`coarseness`), 0 where they stand for none.
    """

    patch_of_face: NDArray[np.int32]
    patch_area_m2: Array
    plane_of_face: NDArray[np.int32]
    plane_area_m2: Array
    area_m2: float
    hull: Indices
    size_m: float
    bend_radius_m: float
    thickness_m: float | None
    outward: NDArray[np.int8]
    is_double: Flags
    is_convex: bool
    depth_m: float

    @property
    def largest_patch_m2(self) -> float:
        """Area of the largest flat patch."""
        return float(self.patch_area_m2[0])

    def area_in_patches_m2(self, least_m2: float) -> float:
        """Area in flat patches that are at least so large."""
        count = int(np.searchsorted(-self.patch_area_m2, -least_m2, side="right"))
        return float(self.patch_area_m2[:count].sum())


def shapes_of(geometries: "Sequence[Geometry]") -> list[Shape]:
    """Shapes of many meshes; those not asked for before are measured together, each once."""
    for some in _portions([g for g in dict.fromkeys(geometries) if "shape" not in vars(g)]):
        if any(not len(geometry.faces) for geometry in some):
            raise InputError("mesh: has no faces")
        for geometry, (shape, welded_faces) in zip(some, read_only(_measured(some)), strict=True):
            # What the properties of these names answer from now on.
            vars(geometry).update(shape=shape, welded_faces=welded_faces)
    return [vars(geometry)["shape"] for geometry in geometries]


def _portions(geometries: "Sequence[Geometry]") -> "Iterator[list[Geometry]]":
    """Meshes in portions of a bounded number of faces, or one mesh each."""
    portion: list[Geometry] = []
    faces = 0
    for geometry in geometries:
        if portion and faces + len(geometry.faces) > _AT_ONCE:
            yield portion
            portion, faces = [], 0
        portion.append(geometry)
        faces += len(geometry.faces)
    if portion:
        yield portion


@dataclass(frozen=True, eq=False)
class _Meshes:
    """Some meshes one after the other: their vertices, each mesh's about its own middle, faces,
    and where each mesh's vertices and faces begin, (n_meshes + 1,).
    """

    points: Array
    faces: Faces
    first_vertex: Indices
    first_face: Indices

    def __len__(self) -> int:
        return len(self.first_face) - 1

    @property
    def mesh_of_face(self) -> Indices:
        return np.repeat(np.arange(len(self)), np.diff(self.first_face))


def _together(geometries: "Sequence[Geometry]") -> tuple[_Meshes, list[Indices]]:
    """Some meshes as one, and the vertices that each one's faces use."""
    first_vertex = np.cumsum([0, *(len(g.vertices_m) for g in geometries)])
    first_face = np.cumsum([0, *(len(g.faces) for g in geometries)])
    faces = np.concatenate(
        [g.faces + np.int32(n) for g, n in zip(geometries, first_vertex, strict=False)]
    )
    is_used = np.zeros(first_vertex[-1], dtype=bool)
    is_used[faces] = True
    used = [np.flatnonzero(is_used[a:b]) for a, b in pairwise(first_vertex)]
    points = np.concatenate(
        [
            g.vertices_m - (g.vertices_m[rows].mean(axis=0) if len(rows) else 0.0)
            for g, rows in zip(geometries, used, strict=True)
        ]
    )
    return _Meshes(points, faces, first_vertex, first_face), used


def _measured(geometries: "Sequence[Geometry]") -> list[tuple[Shape, Faces]]:
    """Shape and welded faces of each, all in one go: numpy's calls cost more than a small mesh's
    arithmetic.
    """
    meshes, used = _together(geometries)
    points, faces, mesh_of_face = meshes.points, meshes.faces, meshes.mesh_of_face
    normal, area = normals(points, faces), areas(points, faces)
    joined = welded(points, faces, meshes.first_vertex)
    is_double = doubles(joined)
    pairs, outward, is_whole = _sides(meshes, joined, area, is_double)
    turn = _turns(normal, pairs)
    patch, area_of_patch, first_patch = _patches(pairs[turn < _FLAT_RAD], area, mesh_of_face)
    smooth = (turn > _FLAT_RAD) & (turn < _SMOOTH_RAD)
    bend = _bends(patch, pairs[smooth], turn[smooth], mesh_of_face, len(meshes))
    is_hollow = _hollow(meshes, normal, outward, pairs)
    depth = depths_m(
        points,
        faces,
        normal,
        area,
        bends=pairs[smooth],
        turn=turn[smooth],
        patch=patch + first_patch[mesh_of_face],
        mesh_of_face=mesh_of_face,
        count=len(meshes),
    )
    borders = np.bincount(mesh_of_face[pairs[:, 0]], minlength=len(meshes))
    found = []
    for n, geometry in enumerate(geometries):
        rows = slice(meshes.first_face[n], meshes.first_face[n + 1])
        areas_m2 = area_of_patch[first_patch[n] : first_patch[n + 1]]
        count = min(len(areas_m2), _MOST_PATCHES)
        some = np.flatnonzero(patch[rows] < count)
        face = rows.start + some[np.unique(patch[rows][some], return_index=True)[1]]
        at, along = points[faces[face, 0]], normal[face]
        plane, plane_areas = _planes(at, along, areas_m2[:count])
        plane_of_patch = np.append(plane, np.full(len(areas_m2) - count, -1)).astype(np.int32)
        own = points[meshes.first_vertex[n] : meshes.first_vertex[n + 1]]
        hull = _hull(own, used[n])
        # A surface without a border that is convex at every edge is so all over (Tietze, Nakajima).
        closed = is_whole[n] and 2 * borders[n] == 3 * len(geometry.faces)
        one = joined[rows] - np.int32(meshes.first_vertex[n])
        shape = Shape(
            patch_of_face=patch[rows].astype(np.int32),
            patch_area_m2=areas_m2.copy(),
            plane_of_face=plane_of_patch[patch[rows]],
            plane_area_m2=plane_areas,
            area_m2=float(areas_m2.sum()),
            hull=hull,
            size_m=_size(geometry.vertices_m[hull]),
            bend_radius_m=float(np.sqrt(areas_m2[0]) / bend[n]) if bend[n] else float("inf"),
            outward=outward[rows].copy(),
            is_double=is_double[rows].copy(),
            is_convex=bool(closed and not is_hollow[n]),
            depth_m=float(depth[n]),
            thickness_m=_thickness(at, along, areas_m2),
        )
        found.append((shape, geometry.faces if np.array_equal(one, geometry.faces) else one))
    return found


def _size(points: Array) -> float:
    """Twice the farthest from the middle: motion leaves it as it is."""
    if not len(points):
        return 0.0
    off = points - points.mean(axis=0)
    return 2 * float(np.sqrt(np.einsum("ij,ij->i", off, off).max()))


def _sides(
    meshes: _Meshes, joined: Faces, area: Array, is_double: Flags
) -> tuple[NDArray[np.int32], NDArray[np.int8], Flags]:
    """Pairs of faces on either side of an edge, (n, 2); whether each face's normal looks out of a
    closed part, 1, or into it, -1, else 0; and which meshes are one closed part.
    """
    solid = np.flatnonzero(area > 0)
    table = edge_table(joined[solid])
    pairs = solid.astype(np.int32)[table.neighbours]
    once = np.flatnonzero((area > 0) & ~is_double)
    if len(once) < len(solid):
        table = edge_table(joined[once])
    outward = np.zeros(len(joined), dtype=np.int8)
    label = np.zeros(len(joined), dtype=np.int32)
    label[once] = connected(table.neighbours, len(once))
    outward[once] = _outward(meshes, table, label[once], once, area)
    is_whole = np.array(
        [
            bool(outward[a:b].all()) and bool((label[a:b] == label[a]).all()) if b > a else False
            for a, b in pairwise(meshes.first_face)
        ]
    )
    return pairs, outward, is_whole


def _outward(
    meshes: _Meshes, table: EdgeTable, label: NDArray[np.int32], rows: Indices, area: Array
) -> NDArray[np.int8]:
    """Which way out of closed parts normals point: by the sign of the volume that a part encloses.

    Closed is what has two faces at each edge, which run along it in opposite senses. ``label`` of
    the part of each of some faces, by their ``rows``.
    """
    parts = int(label.max(initial=-1)) + 1
    leaks = np.zeros(parts, dtype=bool)
    leaks[label[table.half_edges[np.repeat(table.is_open(), table.count)] // 3]] = True
    found = np.zeros(len(rows), dtype=np.int8)
    if leaks.all():
        return found
    inner = np.flatnonzero(~leaks[label])
    number, rows = label[inner], rows[inner]
    a, b, c = (meshes.points[meshes.faces[rows, i]] for i in range(3))
    volume = np.bincount(number, dots(a, np.cross(b, c)), parts) / 6
    is_thick = np.abs(volume) > 1e-9 * np.bincount(number, area[rows], parts) ** 1.5
    found[inner] = np.where(is_thick, np.sign(volume), 0)[number]
    return found


def _hollow(meshes: _Meshes, normal: Array, outward: NDArray[np.int8], pairs: Faces) -> Flags:
    """Which meshes bend inwards somewhere in their closed parts, (n_meshes,)."""
    found = np.zeros(len(meshes), dtype=bool)
    pairs = pairs[outward[pairs[:, 0]] != 0]
    for some in np.array_split(pairs, len(pairs) // _AT_ONCE + 1):
        one, other = (meshes.points[meshes.faces[face]] for face in some.T)
        middle, beyond = one.mean(axis=1), other.mean(axis=1)
        size = np.maximum(
            np.abs(one - middle[:, None]).max(axis=(1, 2)),
            np.abs(other - beyond[:, None]).max(axis=(1, 2)),
        )
        face = some[:, 0]
        height = dots(beyond - middle, normal[face]) * outward[face]
        hollow = face[height > _ROUNDED * size]
        found[np.searchsorted(meshes.first_face, hollow, side="right") - 1] = True
    return found


def _turns(normal: Array, pairs: Faces) -> Array:
    """Angle between the planes of pairs of faces, whichever way their normals point; precise for
    small ones.
    """
    found = np.empty(len(pairs))
    for first in range(0, len(pairs), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        a, b = normal[pairs[some, 0]], normal[pairs[some, 1]]
        found[some] = np.arctan2(lengths(np.cross(a, b)), np.abs(dots(a, b)))
    return found


def _patches(flat: Faces, area: Array, mesh_of_face: Indices) -> tuple[Indices, Array, Indices]:
    """Patch of every face by its rank in its mesh, areas of all patches mesh by mesh, the largest
    first, and where each mesh's begin; ``flat`` are pairs of faces that go on in one plane.
    """
    label = connected(flat, len(area))
    total = np.bincount(label, weights=area).astype(np.float64)
    mesh = np.zeros(len(total), dtype=np.int64)
    mesh[label] = mesh_of_face
    order = np.argsort(-total, kind="stable")
    order = order[np.argsort(mesh[order], kind="stable")]  # faster than by both at once
    first = np.searchsorted(mesh[order], np.arange(int(mesh_of_face[-1]) + 2))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - first[mesh[order]]
    return rank[label], total[order], first


def _planes(at: Array, along: Array, area: Array) -> tuple[Indices, Array]:
    """Number of the plane of each patch, by a point and the normal (n, 3), and the area in each."""
    same = np.abs(np.abs(along @ along.T) - 1) < 1e-10
    same &= np.abs(np.einsum("ijk,ik->ij", at[None] - at[:, None], along)) < 1e-6
    np.fill_diagonal(same, val=True)
    leader = same.argmax(axis=0)  # the largest patch in this plane
    leaders, plane = np.unique(leader[leader], return_inverse=True)
    areas_m2 = np.bincount(plane, weights=area, minlength=len(leaders)).astype(np.float64)
    return plane.astype(np.int64), areas_m2


def _thickness(at: Array, along: Array, area: Array) -> float | None:
    """Distance of the two largest patches, where they are parallel and about as large."""
    if len(area) < 2 or area[1] < 0.5 * area[0] or abs(abs(along[0] @ along[1]) - 1) > 1e-6:
        return None
    return float(abs((at[1] - at[0]) @ along[0])) or None


def _bends(patch: Indices, smooth: Faces, turn: Array, mesh_of_face: Indices, count: int) -> Array:
    """The largest angle by which each mesh's largest patch turns into a smooth neighbour, or 0."""
    border = (patch[smooth[:, 0]] == 0) | (patch[smooth[:, 1]] == 0)
    widest = np.zeros(count)
    np.maximum.at(widest, mesh_of_face[smooth[border, 0]], turn[border])
    return widest


def _hull(points: Array, used: Indices) -> Indices:
    from scipy.spatial import ConvexHull, QhullError

    if not 32 <= len(used) <= _MOST_HULL:
        return used
    try:
        return used[ConvexHull(points[used]).vertices]
    except QhullError:  # flat
        return used
