"""The scene's triangles as the radar's rays meet them: float32 to hit, float64 planes to measure.

Coordinates are relative to an anchor near the radar, so that a scene far from its origin keeps its
shape. The mesh is built once per set of objects and updated in place when they move.
"""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.radar.propagation.shape import shape_of
from twin.scene import SceneObject
from twin.scene.meshes import Mesh, divided

Array = NDArray[np.float64]

#: Anchors lie on this grid: a track of poses within a cell shares one mesh.
_GRID_M = 64.0
_WORLDS = 4  # kept; 1e6 triangles take some 300 MB each
_worlds: "OrderedDict[tuple[Any, ...], Mesher]" = OrderedDict()


def anchor_of(place_m: Array) -> Array:
    """The anchor for a radar at a place."""
    anchor: Array = np.round(np.asarray(place_m) / _GRID_M) * _GRID_M
    return anchor


def mesher(objects: Sequence[SceneObject], anchor_m: Array) -> "Mesher":
    """Objects as one mesh around an anchor, up to date."""
    items = tuple(_divided(item, tuple(anchor_m.tolist())) for item in objects)
    key = tuple(id(item.faces) for item in items)
    held = _worlds.get(key)
    if held is None:
        held = _worlds[key] = Mesher(items)
        if len(_worlds) > _WORLDS:
            _worlds.popitem(last=False)
    _worlds.move_to_end(key)
    held.place(items, anchor_m)
    return held


@lru_cache(maxsize=1024)
def _divided(item: SceneObject, anchor_m: tuple[float, float, float]) -> SceneObject:
    """The object with no triangle that is too large for float32 rays."""
    around = Mesh(item.vertices_m - np.array(anchor_m), item.faces)
    mesh = divided(around)
    if mesh.faces is around.faces:
        return item
    return replace(item, vertices_m=mesh.vertices + anchor_m, faces=mesh.faces)


class Mesher:
    """One Mitsuba mesh of several objects, with a float64 plane and an object for each face."""

    def __init__(self, objects: Sequence[SceneObject]) -> None:
        self.items: list[SceneObject | None] = [None] * len(objects)
        self.is_empty = not objects
        self.kept = tuple(item.faces for item in objects)  # their ids are the key
        self.anchor_m = np.full(3, np.nan)
        vertices = np.cumsum([0, *(len(item.vertices_m) for item in objects)])
        faces = np.cumsum([0, *(len(item.faces) for item in objects)])
        self.vertex_ranges = [slice(a, b) for a, b in pairwise(vertices)]
        self.face_ranges = [slice(a, b) for a, b in pairwise(faces)]
        self.vertices = np.zeros((int(vertices[-1]), 3))
        self.plane_table = np.zeros((int(faces[-1]), 6))
        self.object_of_face = np.repeat(np.arange(len(objects), dtype=np.uint32), np.diff(faces))
        self.faces = np.concatenate(
            [
                np.zeros((0, 3), dtype=np.uint32),
                *(o.faces.astype(np.uint32) + a for o, a in zip(objects, vertices, strict=False)),
            ]
        )
        if self.is_empty:  # a point, which no ray hits: there is always something to trace
            self.vertices, self.faces = np.zeros((1, 3)), np.zeros((1, 3), dtype=np.uint32)
            self.plane_table = np.zeros((1, 6))
            self.object_of_face = np.zeros(1, dtype=np.uint32)
        self.scene: Any = None
        self.planes: Any = None

    def place(self, objects: Sequence[SceneObject], anchor_m: Array) -> None:
        """Bring vertices and planes to where the objects are."""
        moved_anchor = not np.array_equal(anchor_m, self.anchor_m)
        self.anchor_m = np.asarray(anchor_m, dtype=np.float64)
        changed = False
        for i, item in enumerate(objects):
            before = self.items[i]
            self.items[i] = item
            if not moved_anchor and before is not None and _still(before, item):
                continue
            changed = True
            here = item.vertices_m - self.anchor_m
            self.vertices[self.vertex_ranges[i]] = here
            self.plane_table[self.face_ranges[i]] = _planes(here[item.faces])
        if changed or self.scene is None:
            self._upload()

    def _upload(self) -> None:
        mi = mitsuba()
        narrow = self.vertices.astype(np.float32).ravel()
        if self.scene is None:
            mesh = mi.Mesh("world", len(self.vertices), len(self.faces))
            parameters = mi.traverse(mesh)
            parameters["vertex_positions"] = narrow
            parameters["faces"] = self.faces.ravel()
            parameters.update()
            self.scene = mi.load_dict({"type": "scene", "world": mesh})
            self.parameters = mi.traverse(self.scene)
            self.parameters.keep([r".*vertex_positions"])
            self.object_index = mi.UInt32(self.object_of_face)
        else:
            (name,) = self.parameters.keys()
            self.parameters[name] = mi.Float(narrow)
            self.parameters.update()
        self.planes = mi.Float64(self.plane_table.ravel())
        dr.eval(self.planes, self.object_index)


def _still(before: SceneObject, item: SceneObject) -> bool:
    same = before.vertices_m is item.vertices_m
    return same or np.array_equal(before.vertices_m, item.vertices_m)


def _planes(corners: Array) -> Array:
    """A point of each face's plane and its normal, (m, 6); zeros for a face without area."""
    a = corners[:, 0]
    first, second = corners[:, 1] - a, corners[:, 2] - a
    # Scaled first: the squares of tiny edges would underflow.
    size = np.maximum(np.abs(first), np.abs(second)).max(axis=1, keepdims=True)
    size = np.where(size > 0, size, 1.0)
    across = np.cross(first / size, second / size)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    normal = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    return np.hstack([a, normal])


@dataclass(frozen=True, eq=False)
class Flat:
    """A large flat patch of a surface: a point and the unit normal, relative to the anchor, and a
    few points all over it; ``is_wall`` where the radar also sees through it.
    """

    object: int
    point: Array
    normal: Array
    samples: Array
    is_wall: bool = False


def flats(world: Mesher, large_m: Mapping[int, float]) -> tuple[list[Flat], NDArray[np.uint32]]:
    """Flat patches wider than the size asked for, per object, and the patch of every face.

    Patches of an object in one plane count as one. Faces in none of them have the number
    ``len(flats)``.
    """
    found: list[Flat] = []
    of_face = np.full(len(world.faces), -1, dtype=np.int64)
    for number, side in large_m.items():
        item = world.items[number]
        assert item is not None
        shape, rows = shape_of(item), world.face_ranges[number]
        planes = world.plane_table[rows]
        for patch in _coplanar(shape.patch_of_face, planes, shape.patch_area_m2, side):
            of_face[rows][patch] = len(found)
            x = planes[patch[0]]
            corners = world.vertices[world.faces[rows][patch]]
            found.append(Flat(number, x[:3], x[3:], _samples(corners)))
    return found, np.where(of_face < 0, len(found), of_face).astype(np.uint32)


_MOST_PATCHES = 64  # of an object: beyond, it is not flat


def _coplanar(
    patch_of_face: NDArray[np.int64], planes: Array, area: Array, side: float
) -> list[NDArray[np.int64]]:
    """Faces of every patch that is large enough by itself or with others in its plane."""
    groups: list[tuple[Array, list[NDArray[np.int64]], float]] = []
    for patch in range(min(len(area), _MOST_PATCHES)):
        faces = np.flatnonzero(patch_of_face == patch)
        plane = planes[faces[0]]
        for known, members, _ in groups:
            if abs(abs(known[3:] @ plane[3:]) - 1) < 1e-10 and (
                abs((plane[:3] - known[:3]) @ known[3:]) < 1e-6
            ):
                members.append(faces)
                break
        else:
            groups.append((plane, [faces], float(area[patch])))
    return [
        np.concatenate(members)
        for _, members, _ in groups
        if sum(float(area[patch_of_face[m[0]]]) for m in members) >= side**2
    ]


def _samples(corners: Array, count: int = 256) -> Array:
    """Points spread over triangles (m, 3, 3), always the same."""
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    n = np.arange(count)
    which = np.searchsorted(np.cumsum(area) / area.sum(), (n + 0.5) / count)
    # The additive recurrence of the plastic number fills the square evenly.
    u, v = (0.5 + n * 0.7548776662466927) % 1, (0.5 + n * 0.5698402909980532) % 1
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    a, b, c = (corners[np.minimum(which, len(corners) - 1), i] for i in range(3))
    points: Array = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    return points
