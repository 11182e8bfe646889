"""A triangle mesh that never changes, with what is found out about it kept on it."""

from collections.abc import Sequence
from dataclasses import InitVar, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from hardware.read_only import cached_read_only
from twin.errors import InputError
from twin.geometry.edges import EdgeTable, connected, edge_table, first_alike, welded
from twin.geometry.faces import areas, normals
from twin.geometry.shape import Shape, shapes_of

Array = NDArray[np.float64]
Faces = NDArray[np.int32]


@dataclass(frozen=True, eq=False, repr=False)
class Geometry(Described):
    """Vertices (n, 3) in metres, faces (m, 3) by their corners' indices, texture coordinates (n, 2)
    or None.

    The arrays are read-only; those that a caller could still change are copied. What is computed of
    a geometry is kept as long as it lives, and once for all objects that share it; it is not
    pickled. Two geometries are equal only if they are one.

    Raises InputError, beginning with ``place``, on an index outside the vertices or a coordinate
    that is no finite number. Faces without area are allowed: see `without_empty_faces`.

    >>> square = Geometry([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    >>> square.areas_m2.tolist(), square.normals[0].tolist()
    ([0.5, 0.5], [0.0, 0.0, 1.0])
    """

    vertices_m: Array
    faces: Faces
    uv: Array | None = None
    place: InitVar[str] = "mesh"

    def __post_init__(self, place: str) -> None:
        vertices, faces = _as_rows(self.vertices_m, "vertices", place), self.faces
        faces = _as_rows(faces, "faces", place)
        _check_indices(faces, len(vertices), place)
        lost = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if len(lost):
            vertex = vertices[lost[0]].tolist()
            raise InputError(f"{place}: vertex {lost[0]} is {vertex}, expected finite numbers")
        object.__setattr__(self, "vertices_m", _read_only(vertices, np.float64))
        object.__setattr__(self, "faces", _read_only(faces, np.int32))
        if self.uv is not None:
            if np.shape(self.uv) != (len(vertices), 2):
                raise InputError(
                    f"{place}: texture coordinates of shape {np.shape(self.uv)}, expected two "
                    f"numbers for each of {len(vertices)} vertices"
                )
            if not np.isfinite(self.uv).all():
                raise InputError(f"{place}: a texture coordinate is no number")
            object.__setattr__(self, "uv", _read_only(self.uv, np.float64))

    def __reduce__(self) -> tuple[Any, ...]:
        return Geometry, (self.vertices_m, self.faces, self.uv)

    def __len__(self) -> int:
        return len(self.faces)

    @staticmethod
    def concatenate(parts: "Sequence[Geometry]") -> "Geometry":
        """Several as one; with texture coordinates where all of them have some."""
        if len(parts) == 1:
            return parts[0]
        starts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
        uvs = [part.uv for part in parts if part.uv is not None]
        return Geometry(
            np.concatenate([np.zeros((0, 3)), *(part.vertices_m for part in parts)]),
            np.concatenate(
                [np.zeros((0, 3), np.int32)]
                + [part.faces + start for part, start in zip(parts, starts, strict=False)]
            ),
            np.concatenate(uvs) if uvs and len(uvs) == len(parts) else None,
        )

    def transformed(self, matrix: Array, place: str = "mesh") -> "Geometry":
        """Moved, turned and scaled by a 4x4 matrix; faces turned over where it mirrors."""
        with np.errstate(all="ignore"):  # what comes of it is checked
            vertices = self.vertices_m @ matrix[:3, :3].T + matrix[:3, 3]
        mirrored = np.linalg.det(matrix[:3, :3]) < 0
        faces = self.faces[:, ::-1] if mirrored else self.faces
        return Geometry(vertices, faces, self.uv, place)

    def without_empty_faces(self, place: str = "mesh") -> "Geometry":
        """The same without the faces that have no area, ready for a renderer.

        Raises InputError where no face has an area.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            solid = areas(self.vertices_m, self.faces) > 0
        if not solid.any():
            raise InputError(f"{place}: no face has an area")
        return self if solid.all() else Geometry(self.vertices_m, self.faces[solid], self.uv)

    @property
    def corners_m(self) -> Array:
        """Corners of every face, (m, 3, 3); made anew each time."""
        corners: Array = self.vertices_m[self.faces]
        return corners

    @cached_read_only
    def normals(self) -> Array:
        """Unit normals of the faces by the sense of their corners, (m, 3); 0 without an area."""
        return normals(self.vertices_m, self.faces)

    @cached_read_only
    def areas_m2(self) -> Array:
        """Of the faces, (m,)."""
        return areas(self.vertices_m, self.faces)

    @cached_read_only
    def used_m(self) -> Array:
        """Vertices that a face refers to, (k, 3)."""
        is_used = np.zeros(len(self.vertices_m), dtype=bool)
        is_used[self.faces] = True
        used: Array = self.vertices_m[is_used]
        return used

    @cached_read_only
    def sphere(self) -> tuple[Array, float]:
        """A sphere around the faces: centre (3,) and radius."""
        center = (self.used_m.min(axis=0) + self.used_m.max(axis=0)) / 2
        return center, float(np.linalg.norm(self.used_m - center, axis=1).max())

    @cached_read_only
    def shape(self) -> Shape:
        """Flat patches, planes, hull, sense of the normals and more; see `Shape`."""
        return shapes_of([self])[0]

    @cached_read_only
    def welded_faces(self) -> Faces:
        """Faces (m, 3) with one vertex for all that stand at the same place."""
        middle = self.used_m.mean(axis=0)
        return welded(self.vertices_m - middle, self.faces, np.array([0, len(self.vertices_m)]))

    @cached_read_only
    def _solid(self) -> NDArray[np.int64]:
        """Welded faces that have an area, by number."""
        a, b, c = (self.vertices_m[self.welded_faces[:, i]] for i in range(3))
        return np.flatnonzero((np.cross(b - a, c - a) != 0).any(axis=1))

    @cached_read_only
    def edges(self) -> EdgeTable:
        """Edges of the welded faces that have an area."""
        return edge_table(self.welded_faces[self._solid])

    @cached_read_only
    def parts(self) -> NDArray[np.int64]:
        """Number of the part that each face belongs to, (m,), -1 of one without an area: what hangs
        together by edges of two faces. What stands on a surface meets it in edges of more.
        """
        table, first = self.edges, np.arange(len(self._solid))
        if (table.count > 2).any():
            first = first_alike(table.faces)
            table = edge_table(table.faces[np.unique(first)])
        part = np.full(len(self.faces), -1, dtype=np.int64)
        of_first = connected(table.neighbours, len(table.faces))
        part[self._solid] = of_first[np.unique(first, return_inverse=True)[1]]
        return part

    @cached_property
    def merged(self) -> Any:
        """A trimesh of the same faces with equal vertices made one, for what trimesh knows of it:
        whether it is closed, its volume, the sense of its faces.
        """
        import trimesh

        return trimesh.Trimesh(self.vertices_m, self.faces, process=True)


def _as_rows(values: Any, name: str, place: str) -> NDArray[Any]:
    """An array of three numbers each; an empty list is none of them."""
    array = np.asarray(values)
    if array.shape == (0,):
        array = array.reshape(0, 3)
    if array.shape[1:] != (3,):
        raise InputError(f"{place}: {name} of shape {array.shape}, expected three numbers each")
    return array


def _check_indices(faces: NDArray[Any], count: int, place: str) -> None:
    if not len(faces):
        return
    if faces.dtype.kind not in "iu":
        raise InputError(f"{place}: faces of type {faces.dtype}, expected indices")
    if faces.min() < 0 or faces.max() >= count:
        face, corner = np.argwhere((faces < 0) | (faces >= count))[0]
        raise InputError(f"{place}: face {face} refers to vertex {faces[face, corner]} of {count}")


def _read_only(values: Any, kind: Any) -> NDArray[Any]:
    """An array that nobody can write to: the same one where that is so already."""
    array = np.ascontiguousarray(values, dtype=kind)
    if np.shares_memory(array, values) if isinstance(values, np.ndarray) else False:
        base = array
        while isinstance(base, np.ndarray) and not base.flags.writeable and base.base is not None:
            base = base.base
        if not isinstance(base, np.ndarray) or base.flags.writeable:
            array = array.copy()
    array = np.asarray(array)
    array.setflags(write=False)
    return array
