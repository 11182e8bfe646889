"""What a mesh is by itself, wherever it stands: flat patches, hull, size. Found once per mesh."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.meshes.coarseness import depths_m
from twin.radar.propagation.meshes.kept import Kept
from twin.scene import SceneObject

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SMOOTH_RAD = np.radians(30)  # a sharper edge ends a surface, a blunter one bends it
_FLAT_RAD = 1e-4
_ROUNDED = 1e-6  # of a facet's size: by which rounding lifts a neighbour's middle off its plane
_WELDED = 1e-7  # of the mesh's size: corners closer than this are one
_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
_MIX_MESH = np.uint64(0xD6E8FEB86659FD93)
_MOST_HULL = 20_000  # vertices: finding the hull of more takes longer than it saves
_MOST_PATCHES = 64  # whose planes are compared: a mesh of more is not flat
_AT_ONCE = 2**18  # faces measured together: small meshes in one go, 200 MB
_shapes: "Kept[Shape]" = Kept()
_boxes: "Kept[Array]" = Kept()


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
    (`coarseness`), 0 where they stand for none. ``corners`` (m, 3): of every face, with one number
    for all at one place; None where the faces' own vertices are as few.
    """

    patch_of_face: Indices
    patch_area_m2: Array
    plane_of_face: Indices
    plane_area_m2: Array
    area_m2: float
    hull: Indices
    size_m: float
    bend_radius_m: float
    thickness_m: float | None
    outward: NDArray[np.int8]
    is_double: NDArray[np.bool_]
    is_convex: bool
    depth_m: float
    corners: NDArray[np.int32] | None

    @property
    def largest_patch_m2(self) -> float:
        """Area of the largest flat patch."""
        return float(self.patch_area_m2[0])

    def area_in_patches_m2(self, least_m2: float) -> float:
        """Area in flat patches that are at least so large."""
        count = int(np.searchsorted(-self.patch_area_m2, -least_m2, side="right"))
        return float(self.patch_area_m2[:count].sum())


def shape_of(item: SceneObject) -> Shape:
    """The shape of an object; the same for all that share its faces, which are rigid bodies."""
    return shapes_of([item])[0]


def shapes_of(items: Sequence[SceneObject]) -> list[Shape]:
    """Shapes of many objects, those not seen before measured together."""
    found = [_known(item) for item in items]
    new = [i for i, shape in enumerate(found) if shape is None]
    for some in _portions([items[i] for i in new]):
        for item, shape in zip(some, _measured(some), strict=True):
            _shapes.put(shape, [item.faces])
            _shapes.put(shape, [item.faces, item.vertices_m])
    return [shape or _known(items[i]) or shape_of(items[i]) for i, shape in enumerate(found)]


def boxes_of(items: Sequence[SceneObject]) -> Array:
    """Least and largest coordinates of what their faces use, in the world, (n, 2, 3)."""
    found = [_boxes.get([item]) for item in items]
    new = [i for i, box in enumerate(found) if box is None]
    for i, shape in zip(new, shapes_of([items[i] for i in new]), strict=True):
        corners = items[i].vertices_m[shape.hull]
        box = np.array([corners.min(axis=0), corners.max(axis=0)])
        found[i] = _boxes.put(box, [items[i]])
    return np.array(found, dtype=np.float64).reshape(-1, 2, 3)


def distances_m(boxes: Array, place_m: Array) -> Array:
    """Distances of boxes (n, 2, 3) from a point, 0 from within."""
    off = np.maximum(np.maximum(boxes[:, 0] - place_m, place_m - boxes[:, 1]), 0.0)
    distances: Array = np.linalg.norm(off, axis=1)
    return distances


def _known(item: SceneObject) -> Shape | None:
    shape = _shapes.get([item.faces, item.vertices_m])
    if shape is None:
        shape = _shapes.get([item.faces])
        if shape is not None and not _same_size(item, shape):
            return None
        if shape is not None:
            _shapes.put(shape, [item.faces, item.vertices_m])
    return shape


def _same_size(item: SceneObject, shape: Shape) -> bool:
    size = _size(item.vertices_m[shape.hull])
    return abs(size - shape.size_m) <= 1e-6 * shape.size_m


def _size(points: Array) -> float:
    """Twice the farthest from the middle: motion leaves it as it is."""
    off = points - points.mean(axis=0)
    return 2 * float(np.sqrt(np.einsum("ij,ij->i", off, off).max()))


def _portions(items: Sequence[SceneObject]) -> Iterator[list[SceneObject]]:
    """Different meshes in portions of a bounded number of faces, or one mesh each."""
    portion: list[SceneObject] = []
    faces = 0
    for item in {id(item.faces): item for item in items}.values():
        if portion and faces + len(item.faces) > _AT_ONCE:
            yield portion
            portion, faces = [], 0
        portion.append(item)
        faces += len(item.faces)
    if portion:
        yield portion


def _measured(items: Sequence[SceneObject]) -> list[Shape]:
    """All of them in one go: numpy's calls cost more than a small mesh's arithmetic."""
    first_vertex = np.cumsum([0, *(len(item.vertices_m) for item in items)])
    first_face = np.cumsum([0, *(len(item.faces) for item in items)])
    faces = np.concatenate(
        [item.faces.astype(np.int64) + n for item, n in zip(items, first_vertex, strict=False)]
    )
    mesh_of_face = np.repeat(np.arange(len(items)), np.diff(first_face))
    is_used = np.zeros(first_vertex[-1], dtype=bool)
    is_used[faces] = True
    used = [np.flatnonzero(is_used[a:b]) for a, b in pairwise(first_vertex)]
    points = np.concatenate(
        [
            i.vertices_m - i.vertices_m[rows].mean(axis=0)
            for i, rows in zip(items, used, strict=True)
        ]
    )
    normals, area = _normals(points, faces)
    joined = welded(points, faces, mesh_of_face)
    solid = np.flatnonzero(area > 0)
    pairs = solid[_neighbours(joined[solid])]
    turn = _turn(normals[pairs[:, 0]], normals[pairs[:, 1]])
    patch, area_of_patch, first_patch = _patches(pairs[turn < _FLAT_RAD], area, mesh_of_face)
    is_double = _doubles(joined)
    once = np.where(is_double, 0.0, area)
    outward = _outward(points[faces], joined, once)
    bend = _bends(patch[pairs], turn, mesh_of_face[pairs[:, 0]], len(items))
    hollow = _hollow(points[faces], normals, outward, pairs)
    smooth = (turn > _FLAT_RAD) & (turn < _SMOOTH_RAD)
    depth = depths_m(
        points[faces],
        normals,
        area,
        pairs[smooth],
        turn[smooth],
        patch + first_patch[mesh_of_face],
        mesh_of_face,
        len(items),
    )
    found = []
    for n, item in enumerate(items):
        rows = slice(first_face[n], first_face[n + 1])
        areas = area_of_patch[first_patch[n] : first_patch[n + 1]]
        count = min(len(areas), _MOST_PATCHES)
        some = np.flatnonzero(patch[rows] < count)
        face = first_face[n] + some[np.unique(patch[rows][some], return_index=True)[1]]
        at, along = points[faces[face, 0]], normals[face]
        plane, plane_areas = _planes(at, along, areas[:count])
        plane_of_patch = np.append(plane, np.full(len(areas) - count, -1))
        within = (pairs[:, 0] >= first_face[n]) & (pairs[:, 0] < first_face[n + 1])
        hull = _hull(points[first_vertex[n] : first_vertex[n + 1]], used[n])
        found.append(
            Shape(
                patch_of_face=patch[rows].copy(),
                patch_area_m2=areas.copy(),
                plane_of_face=plane_of_patch[patch[rows]],
                plane_area_m2=plane_areas,
                area_m2=float(areas.sum()),
                hull=hull,
                size_m=_size(item.vertices_m[hull]),
                bend_radius_m=float(np.sqrt(areas[0]) / bend[n]) if bend[n] else float("inf"),
                outward=outward[rows].copy(),
                is_double=is_double[rows].copy(),
                is_convex=_is_convex(outward[rows], pairs[within] - first_face[n], hollow[within]),
                depth_m=float(depth[n]),
                corners=_fewer(joined[rows], len(used[n])),
                thickness_m=_thickness(at, along, areas),
            )
        )
    return found


def _fewer(joined: Indices, count: int) -> NDArray[np.int32] | None:
    """Corners of faces numbered from 0 on; None where they are no fewer than ``count``."""
    numbers, corners = np.unique(joined, return_inverse=True)
    return corners.reshape(-1, 3).astype(np.int32) if len(numbers) < count else None


def _normals(points: Array, faces: Indices) -> tuple[Array, Array]:
    """Unit normals (m, 3) and areas (m,)."""
    a = points[faces[:, 0]]
    across = np.cross(points[faces[:, 1]] - a, points[faces[:, 2]] - a)
    double = np.linalg.norm(across, axis=1)
    across /= np.maximum(double, 1e-300)[:, None]
    return across, double / 2


def welded(
    points: Array, faces: NDArray[np.integer], mesh_of_face: Indices | None = None
) -> Indices:
    """Faces with corners at the same place made one; ``mesh_of_face`` (m,), in order, tells meshes
    apart.
    """
    if mesh_of_face is None:
        mesh_of_face = np.zeros(len(faces), dtype=np.int64)
    starts = np.flatnonzero(np.diff(mesh_of_face, prepend=-1))
    reach = np.abs(points).max(axis=1)[faces].max(axis=1)
    size = np.maximum(np.maximum.reduceat(reach, starts), 1e-300)
    mesh_of_point = np.zeros(len(points), dtype=np.int64)
    mesh_of_point[faces] = mesh_of_face[:, None]
    cells = np.round(points / (_WELDED * size[mesh_of_point, None])).astype(np.int64)
    # One number per cell: sorting rows takes twenty times as long. 1e6 cells share one by chance
    # once in 4e7 meshes.
    keys = cells.astype(np.uint64) @ _MIX + mesh_of_point.astype(np.uint64) * _MIX_MESH
    _, index = np.unique(keys, return_inverse=True)
    corners: Indices = index.reshape(-1)[faces]
    return corners


def _neighbours(faces: Indices) -> Indices:
    """Pairs of faces on either side of an edge, (n, 2); edges of one or more than two have none."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (int(faces.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    _, start, count = np.unique(keys[order], return_index=True, return_counts=True)
    start = start[count == 2]
    pairs: Indices = np.stack([order[start], order[start + 1]], axis=1) // 3
    return pairs


def _doubles(faces: Indices) -> NDArray[np.bool_]:
    """Faces with the same corners as one before them."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)  # stable: of equal ones the first comes first
    same = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
    found = np.zeros(len(faces), dtype=bool)
    found[order[1:]] = same
    return found


def _outward(corners: Array, faces: Indices, area: Array) -> NDArray[np.int8]:
    """Which way out of closed parts normals point: by the sign of the volume that a part encloses.

    Closed is what has two faces at each edge, which run along it in opposite senses.
    """
    real = np.flatnonzero(area > 0)
    found = np.zeros(len(faces), dtype=np.int8)
    if not len(real):
        return found
    ends = faces[real][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    keys = ends.min(axis=1) * (int(faces.max()) + 1) + ends.max(axis=1)
    _, edge, count = np.unique(keys, return_inverse=True, return_counts=True)
    sense = np.bincount(edge, np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0))
    is_open = (count != 2) | (sense != 0)
    label = _connected(_neighbours(faces[real]), len(real))
    parts = int(label.max()) + 1
    leaks = np.bincount(label[np.arange(len(edge)) // 3], is_open[edge], parts) > 0
    a, b, c = (corners[real, i] for i in range(3))
    volume = np.bincount(label, np.sum(a * np.cross(b, c), axis=1), parts) / 6
    is_thick = np.abs(volume) > 1e-9 * np.bincount(label, area[real], parts) ** 1.5
    found[real] = np.where(leaks | ~is_thick, 0, np.sign(volume))[label]
    return found


def _hollow(
    corners: Array, normals: Array, outward: NDArray[np.int8], pairs: Indices
) -> NDArray[np.bool_]:
    """Which pairs of neighbours of closed surfaces bend inwards, (n,)."""
    one, other = pairs.T
    middle = corners.mean(axis=1)
    size = np.abs(corners - middle[:, None]).max(axis=(1, 2))
    height = np.sum((middle[other] - middle[one]) * normals[one], axis=1) * outward[one]
    hollow: NDArray[np.bool_] = height > _ROUNDED * np.maximum(size[one], size[other])
    return hollow


def _is_convex(outward: NDArray[np.int8], pairs: Indices, hollow: NDArray[np.bool_]) -> bool:
    """A surface without a border that is convex at every edge is so all over (Tietze, Nakajima)."""
    if not outward.all() or hollow.any() or 2 * len(pairs) != 3 * len(outward):
        return False
    return not _connected(pairs, len(outward)).any()


def _turn(a: Array, b: Array) -> Array:
    """Angle between planes, whichever way their normals point; precise for small ones."""
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    turn: Array = np.arctan2(sine, np.abs(np.sum(a * b, axis=1)))
    return turn


def _patches(flat: Indices, area: Array, mesh_of_face: Indices) -> tuple[Indices, Array, Indices]:
    """Patch of every face by its rank in its mesh, areas of all patches mesh by mesh, the largest
    first, and where each mesh's begin; ``flat`` are pairs of faces that go on in one plane.
    """
    label = _connected(flat, len(area))
    total = np.bincount(label, weights=area).astype(np.float64)
    mesh = np.zeros(len(total), dtype=np.int64)
    mesh[label] = mesh_of_face
    order = np.lexsort((-total, mesh))
    first = np.searchsorted(mesh[order], np.arange(int(mesh_of_face[-1]) + 2))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - first[mesh[order]]
    return rank[label], total[order], first


def _connected(pairs: Indices, count: int) -> Indices:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels: Indices = connected_components(links, directed=False)[1]
    return labels


def _planes(at: Array, along: Array, area: Array) -> tuple[Indices, Array]:
    """Number of the plane of each patch, by a point and the normal (n, 3), and the area in each."""
    same = np.abs(np.abs(along @ along.T) - 1) < 1e-10
    same &= np.abs(np.einsum("ijk,ik->ij", at[None] - at[:, None], along)) < 1e-6
    np.fill_diagonal(same, val=True)
    leader = same.argmax(axis=0)  # the largest patch in this plane
    leaders, plane = np.unique(leader[leader], return_inverse=True)
    areas = np.bincount(plane, weights=area, minlength=len(leaders)).astype(np.float64)
    return plane.astype(np.int64), areas


def _thickness(at: Array, along: Array, area: Array) -> float | None:
    """Distance of the two largest patches, where they are parallel and about as large."""
    if len(area) < 2 or area[1] < 0.5 * area[0] or abs(abs(along[0] @ along[1]) - 1) > 1e-6:
        return None
    return float(abs((at[1] - at[0]) @ along[0])) or None


def _bends(patches: Indices, turn: Array, mesh: Indices, count: int) -> Array:
    """The largest angle by which each mesh's largest patch turns into a smooth neighbour, or 0."""
    border = (patches == 0).any(axis=1) & (turn > _FLAT_RAD) & (turn < _SMOOTH_RAD)
    widest = np.zeros(count)
    np.maximum.at(widest, mesh[border], turn[border])
    return widest


def _hull(points: Array, used: Indices) -> Indices:
    from scipy.spatial import ConvexHull, QhullError

    if not 32 <= len(used) <= _MOST_HULL:
        return used
    try:
        return used[ConvexHull(points[used]).vertices]
    except QhullError:  # flat
        return used
