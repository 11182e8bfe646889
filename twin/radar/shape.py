"""What a mesh is by itself, wherever it stands: flat patches, hull, size. Found once per mesh."""

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.scene import SceneObject

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SMOOTH_RAD = np.radians(30)  # a sharper edge ends a surface, a blunter one bends it
_FLAT_RAD = 1e-4
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


def _same_size(item: SceneObject, shape: Shape) -> bool:
    size = _size(item.vertices_m[shape.hull])
    return abs(size - shape.size_m) <= 1e-6 * shape.size_m


def _size(points: Array) -> float:
    """Twice the farthest from the middle: motion leaves it as it is."""
    return 2 * float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def _measure(item: SceneObject) -> Shape:
    import trimesh

    used = np.unique(item.faces)
    middle = item.vertices_m[used].mean(axis=0)
    mesh = trimesh.Trimesh(item.vertices_m - middle, item.faces, process=False)
    mesh.merge_vertices()
    n = len(item.faces)
    label = np.arange(n)
    for facet in mesh.facets:
        label[facet] = facet.min()
    area: Array = np.bincount(label, weights=mesh.area_faces, minlength=n).astype(np.float64)
    order = np.argsort(-area, kind="stable")
    order = order[area[order] > 0]
    rank = np.full(n, -1)
    rank[order] = np.arange(len(order))
    hull = _hull(item.vertices_m - middle, used)
    return Shape(
        patch_of_face=rank[label],
        patch_area_m2=area[order] if len(order) else np.zeros(1),
        hull=hull,
        size_m=_size(item.vertices_m[hull]),
        bend_radius_m=_bend(mesh, rank[label], area[order]),
    )


def _hull(points: Array, used: Indices) -> Indices:
    from scipy.spatial import ConvexHull, QhullError

    if len(used) < 32:
        return used
    try:
        return used[ConvexHull(points[used]).vertices]
    except QhullError:  # flat
        return used


def _bend(mesh: object, patch: Indices, area: Array) -> float:
    """Side of the largest patch over the angle by which it turns into a smooth neighbour."""
    pairs, angles = np.asarray(mesh.face_adjacency), np.asarray(mesh.face_adjacency_angles)  # type: ignore[attr-defined]
    border = (patch[pairs] == 0).any(axis=1) & (angles > _FLAT_RAD) & (angles < _SMOOTH_RAD)
    if not border.any():
        return float("inf")
    return float(np.sqrt(area[0]) / angles[border].max())
