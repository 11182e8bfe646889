"""What a mesh is by itself, wherever it stands: flat patches, hull, size. Found once per mesh."""

from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin.scene import SceneObject

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SMOOTH_RAD = np.radians(30)  # a sharper edge ends a surface, a blunter one bends it
_FLAT_RAD = 1e-4
_WELDED = 1e-7  # of the mesh's size: corners closer than this are one
_NEAR = 0.02  # of a body's size: bodies closer than this are one
_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
_MOST_HULL = 20_000  # vertices: finding the hull of more takes longer than it saves
_KEPT = 512  # meshes; each costs its indices
_known: "OrderedDict[int, tuple[NDArray[np.integer], Shape]]" = OrderedDict()


@dataclass(frozen=True, eq=False)
class Shape:
    """A rigid mesh in numbers that motion doesn't change.

    ``patch_of_face`` (m,) numbers flat patches, the largest first; ``patch_area_m2`` (p,) is their
    area. ``hull`` are the vertices on the convex hull. ``bend_radius_m`` is the radius with which
    the largest patch smoothly goes on into its neighbours: inf for a wall, small for a ball.
    """

    patch_of_face: Indices
    patch_area_m2: Array
    hull: Indices
    size_m: float
    bend_radius_m: float

    @property
    def largest_patch_m2(self) -> float:
        """Area of the largest flat patch."""
        return float(self.patch_area_m2[0])


def shape_of(item: SceneObject) -> Shape:
    """The shape of an object; the same for all that share its faces, which are rigid bodies."""
    key = id(item.faces)
    held = _known.get(key)
    if held is not None and held[0] is item.faces and _same_size(item, held[1]):
        _known.move_to_end(key)
        return held[1]
    shape = _measure(item)
    _known[key] = (item.faces, shape)
    if len(_known) > _KEPT:
        _known.popitem(last=False)
    return shape


def together(a: SceneObject, b: SceneObject) -> bool:
    """Whether objects touch, by their boxes, and move alike: parts of one body."""
    if a.velocity_m_per_s != b.velocity_m_per_s:
        return False
    (low_a, high_a), (low_b, high_b) = _box(a), _box(b)
    gap = np.maximum(low_a - high_b, low_b - high_a)
    size = max(float((high_a - low_a).max()), float((high_b - low_b).max()))
    return bool((gap <= _NEAR * size).all())


@lru_cache(maxsize=_KEPT)
def _box(item: SceneObject) -> tuple[Array, Array]:
    corners = item.vertices_m[shape_of(item).hull]
    return corners.min(axis=0), corners.max(axis=0)


def _same_size(item: SceneObject, shape: Shape) -> bool:
    size = _size(item.vertices_m[shape.hull])
    return abs(size - shape.size_m) <= 1e-6 * shape.size_m


def _size(points: Array) -> float:
    """Twice the farthest from the middle: motion leaves it as it is."""
    return 2 * float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def _measure(item: SceneObject) -> Shape:
    is_used = np.zeros(len(item.vertices_m), dtype=bool)
    is_used[item.faces] = True
    used = np.flatnonzero(is_used)
    points = item.vertices_m - item.vertices_m[used].mean(axis=0)
    faces = welded(points, item.faces)
    a, b, c = (points[item.faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    double = np.linalg.norm(across, axis=1)
    normals = across / np.maximum(double, 1e-300)[:, None]
    pairs = _neighbours(faces[double > 0])
    pairs = np.flatnonzero(double > 0)[pairs]
    turn = _turn(normals[pairs[:, 0]], normals[pairs[:, 1]])
    label = _connected(pairs[turn < _FLAT_RAD], len(faces))
    area: Array = np.bincount(label, weights=double / 2).astype(np.float64)
    order = np.argsort(-area, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    patch = rank[label]
    hull = _hull(points, used)
    return Shape(
        patch_of_face=patch,
        patch_area_m2=area[order],
        hull=hull,
        size_m=_size(item.vertices_m[hull]),
        bend_radius_m=_bend(patch[pairs], turn, float(area[order[0]])),
    )


def welded(points: Array, faces: NDArray[np.integer]) -> Indices:
    """Faces with corners at the same place made one."""
    size = max(float(np.abs(points[faces]).max()), 1e-300)
    cells = np.round(points / (_WELDED * size)).astype(np.int64)
    # One number per cell: sorting rows takes twenty times as long. 1e6 cells share one by chance
    # once in 4e7 meshes.
    keys = cells.astype(np.uint64) @ _MIX
    _, index = np.unique(keys, return_inverse=True)
    welded: Indices = index.reshape(-1)[faces]
    return welded


def _neighbours(faces: Indices) -> Indices:
    """Pairs of faces on either side of an edge, (n, 2); edges of one or more than two have none."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (int(faces.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    _, start, count = np.unique(keys[order], return_index=True, return_counts=True)
    start = start[count == 2]
    pairs: Indices = np.stack([order[start], order[start + 1]], axis=1) // 3
    return pairs


def _turn(a: Array, b: Array) -> Array:
    """Angle between planes, whichever way their normals point; precise for small ones."""
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    turn: Array = np.arctan2(sine, np.abs(np.sum(a * b, axis=1)))
    return turn


def _connected(pairs: Indices, count: int) -> Indices:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels: Indices = connected_components(links, directed=False)[1]
    return labels


def _hull(points: Array, used: Indices) -> Indices:
    from scipy.spatial import ConvexHull, QhullError

    if not 32 <= len(used) <= _MOST_HULL:
        return used
    try:
        return used[ConvexHull(points[used]).vertices]
    except QhullError:  # flat
        return used


def _bend(patches: Indices, turn: Array, area_m2: float) -> float:
    """Side of the largest patch over the angle by which it turns into a smooth neighbour."""
    border = (patches == 0).any(axis=1) & (turn > _FLAT_RAD) & (turn < _SMOOTH_RAD)
    return float(np.sqrt(area_m2) / turn[border].max()) if border.any() else float("inf")
