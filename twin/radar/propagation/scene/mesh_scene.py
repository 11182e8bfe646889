"""The scene's triangles as the radar's rays meet them: float32 to hit, float64 planes to measure.

Coordinates are relative to an anchor near the radar, so that a scene far from its origin keeps its
shape. The mesh is built once per set of objects and updated in place when they move.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any
from weakref import WeakKeyDictionary

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba_of_radar
from twin.geometry import Geometry, divided, mitsuba_mesh, planes, scene_of_shapes
from twin.scene import SceneObject
from twin.scene.objects import IN_PLACE

Array = NDArray[np.float64]

#: Anchors lie on this grid: a track of poses within a cell shares one mesh.
_GRID_M = 64.0
_WORLDS = 20  # kept, the last one and others, such as single bodies
_MOST_KEPT = 2_000_000  # faces in those others: 300 MB for each million
_worlds: "OrderedDict[tuple[Geometry, ...], MeshScene]" = OrderedDict()
#: Of objects that are too large for float32 rays, around the last anchor.
_parts: "WeakKeyDictionary[SceneObject, tuple[bytes, SceneObject | None]]" = WeakKeyDictionary()


def anchor_of(place_m: Array) -> Array:
    """The anchor for a radar at a place."""
    anchor: Array = np.round(np.asarray(place_m) / _GRID_M) * _GRID_M
    return anchor


def mesher(objects: Sequence[SceneObject], anchor_m: Array) -> "MeshScene":
    """Objects as one mesh around an anchor, up to date."""
    items = tuple(_divided(item, anchor_m) for item in objects)
    key = tuple(item.geometry for item in items)
    held = _worlds.get(key)
    if held is None:
        _make_room()
        held = _worlds[key] = MeshScene(items)
    _worlds.move_to_end(key)
    held.place(items, anchor_m)
    return held


def _make_room() -> None:
    while len(_worlds) >= _WORLDS or sum(len(w.faces) for w in _worlds.values()) > _MOST_KEPT:
        _worlds.popitem(last=False)


def _divided(item: SceneObject, anchor_m: Array) -> SceneObject:
    """The object with no triangle that is too large for float32 rays."""
    held = _parts.get(item)
    if held is None or held[0] != anchor_m.tobytes():
        vertices, faces, _ = divided(item.vertices_m - anchor_m, item.geometry.faces)
        part = None
        if faces is not item.geometry.faces:
            part = replace(item, geometry=Geometry(vertices + anchor_m, faces), pose=IN_PLACE)
        held = _parts[item] = anchor_m.tobytes(), part
    return held[1] or item


class MeshScene:
    """One Mitsuba mesh of several objects, with a float64 plane and an object for each face."""

    def __init__(self, objects: Sequence[SceneObject]) -> None:
        self.items: list[SceneObject | None] = [None] * len(objects)
        self.is_empty = not objects
        self.anchor_m = np.full(3, np.nan)
        vertices = np.cumsum([0, *(len(item.vertices_m) for item in objects)])
        faces = np.cumsum([0, *(len(item.geometry.faces) for item in objects)])
        self.vertex_ranges = [slice(a, b) for a, b in pairwise(vertices)]
        self.face_ranges = [slice(a, b) for a, b in pairwise(faces)]
        self.vertices = np.zeros((int(vertices[-1]), 3))
        self.plane_table = np.zeros((int(faces[-1]), 6))
        self.object_of_face = np.repeat(np.arange(len(objects), dtype=np.uint32), np.diff(faces))
        self.faces = np.concatenate(
            [
                np.zeros((0, 3), dtype=np.uint32),
                *(
                    item.geometry.faces.astype(np.uint32) + first
                    for item, first in zip(objects, vertices, strict=False)
                ),
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
            self.plane_table[self.face_ranges[i]] = planes(here, item.geometry.faces)
        if changed or self.scene is None:
            self._upload()

    def _upload(self) -> None:
        mi = mitsuba_of_radar()
        if self.scene is None:
            mesh = mitsuba_mesh(mi, self.vertices, self.faces, name="world")
            self.scene = scene_of_shapes(mi, {"world": mesh})
            self.parameters = mi.traverse(self.scene)
            self.parameters.keep([r".*vertex_positions"])
            self.object_index = mi.UInt32(self.object_of_face)
        else:
            (name,) = self.parameters.keys()
            self.parameters[name] = mi.Float(self.vertices.astype(np.float32).ravel())
            self.parameters.update()
        self.planes = mi.Float64(self.plane_table.ravel())
        dr.eval(self.planes, self.object_index)


def _still(before: SceneObject, item: SceneObject) -> bool:
    """Whether an object of the same geometry stands where it stood."""
    same = before.pose is item.pose
    return same or np.array_equal(before.pose.as_matrix(), item.pose.as_matrix())


@dataclass(frozen=True, eq=False)
class Flat:
    """A large flat patch of a surface: a point and the unit normal, relative to the anchor."""

    object: int
    point: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class Flats:
    """Large flat patches of surfaces, relative to the anchor, one row each.

    ``object`` (n,); ``point`` and unit ``normal`` (n, 3) of their planes; ``box`` (n, 2, 3) around
    each; ``is_wall`` (n,) where the radar also sees through it. ``corners`` (m, 3, 3) are those of
    their triangles, patch by patch, which begin at ``first`` (n + 1,).
    """

    object: NDArray[np.int64]
    point: Array
    normal: Array
    box: Array
    is_wall: NDArray[np.bool_]
    corners: Array
    first: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.object)

    def __getitem__(self, number: int) -> Flat:
        return Flat(int(self.object[number]), self.point[number], self.normal[number])

    def and_walls(self, others: "Flats", first_object: int) -> "Flats":
        """These and those of walls, whose objects are numbered from ``first_object`` on."""
        return Flats(
            object=np.concatenate([self.object, others.object + first_object]),
            point=np.concatenate([self.point, others.point]),
            normal=np.concatenate([self.normal, others.normal]),
            box=np.concatenate([self.box, others.box]),
            is_wall=np.concatenate([self.is_wall, np.ones(len(others), dtype=bool)]),
            corners=np.concatenate([self.corners, others.corners]),
            first=np.concatenate([self.first, others.first[1:] + self.first[-1]]),
        )

    def extent(self, numbers: NDArray[np.int64], along: Array) -> Array:
        """Least and largest coordinate of some of the patches, each along its direction (n, 3)."""
        rows, begin = self._rows(numbers)
        at = np.einsum("nci,ni->nc", self.corners[rows], np.repeat(along, np.diff(begin), axis=0))
        low = np.minimum.reduceat(at.min(axis=1), begin[:-1])
        return np.stack([low, np.maximum.reduceat(at.max(axis=1), begin[:-1])], axis=1)

    def covers(self, number: int, place: Array) -> bool:
        """Whether a place in the plane of a patch is on one of its triangles."""
        corners = self.corners[self.first[number] : self.first[number + 1]] - place
        sides = np.cross(corners, np.roll(corners, -1, axis=1)) @ self.normal[number]
        return bool(((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)).any())

    def samples(self, numbers: NDArray[np.int64], which: NDArray[np.int64], count: int) -> Array:
        """Of ``count`` points spread over each of some patches those asked for, (n, m, 3)."""
        rows, begin = self._rows(numbers)
        a, b, c = (self.corners[rows, i] for i in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        total = np.add.reduceat(area, begin[:-1])
        below = np.cumsum(area)
        wanted = (below[begin[1:] - 1] - total)[:, None] + total[:, None] * ((which + 0.5) / count)
        row = np.searchsorted(below, wanted.ravel()).reshape(wanted.shape)
        row = np.clip(row, begin[:-1, None], begin[1:, None] - 1)
        # The additive recurrence of the plastic number fills the square evenly.
        u, v = (0.5 + which * 0.7548776662466927) % 1, (0.5 + which * 0.5698402909980532) % 1
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u)[:, None], np.where(flip, 1 - v, v)[:, None]
        points: Array = a[row] + u * (b - a)[row] + v * (c - a)[row]
        return points

    def _rows(self, numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Triangles of some of the patches, at least one, and where each patch's begin."""
        sizes = self.first[numbers + 1] - self.first[numbers]
        begin = np.cumsum(np.concatenate([[0], sizes]))
        return np.arange(begin[-1]) + np.repeat(self.first[numbers] - begin[:-1], sizes), begin


def flats(world: MeshScene, large_m: Array) -> tuple[Flats, NDArray[np.uint32]]:
    """Flat patches wider than the size asked for, (n_objects,), and the patch of every face.

    Patches of an object in one plane count as one. Faces in none of them have the number
    ``len(flats)``.
    """
    of_face = np.full(len(world.faces), -1, dtype=np.int64)
    objects: list[int] = []
    for number in np.flatnonzero(np.isfinite(large_m)).tolist():
        item = world.items[number]
        assert item is not None
        shape = item.geometry.shape
        planes = np.flatnonzero(shape.plane_area_m2 >= large_m[number] ** 2)
        if not len(planes):
            continue
        number_of = np.full(len(shape.plane_area_m2) + 1, -1, dtype=np.int64)  # of plane -1, too
        number_of[planes] = len(objects) + np.arange(len(planes))
        of_face[world.face_ranges[number]] = number_of[shape.plane_of_face]
        objects += [number] * len(planes)
    rows = np.flatnonzero(of_face >= 0)
    rows = rows[np.argsort(of_face[rows], kind="stable")]
    first = np.searchsorted(of_face[rows], np.arange(len(objects) + 1))
    corners = world.vertices[world.faces[rows]]
    plane = world.plane_table[rows[first[:-1]]]
    low, high = (
        reduce.reduceat(end, first[:-1]) if len(rows) else np.zeros((0, 3))
        for reduce, end in ((np.minimum, corners.min(axis=1)), (np.maximum, corners.max(axis=1)))
    )
    patches = Flats(
        object=np.array(objects, dtype=np.int64),
        point=plane[:, :3],
        normal=plane[:, 3:],
        box=np.stack([low, high], axis=1),
        is_wall=np.zeros(len(objects), dtype=bool),
        corners=corners,
        first=first,
    )
    return patches, np.where(of_face < 0, len(objects), of_face).astype(np.uint32)
