"""Meshes in float64: read from files, tessellated from primitives, validated."""

import logging
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.files import InputError
from twin.scene.beside import ModelFiles, model_file
from twin.scene.gltf import check_gltf

Array = NDArray[np.float64]

FORMATS = ("ply", "obj", "stl", "glb", "gltf")
_SEGMENTS = 64  # around a tessellated sphere, cylinder or disk: area within 0.16 %


#: Float32 has 1.7e7 steps: a triangle this much longer than it is far is found to 1.5e-5 of its
#: distance, well below the renderer's own offset of shadow rays.
_EDGE_OVER_DISTANCE = 256.0


@dataclass(frozen=True, eq=False)
class Mesh:
    """Vertices (n, 3) in metres, faces (m, 3), texture coordinates (n, 2) or None."""

    vertices: Array
    faces: NDArray[np.integer]
    uv: Array | None = None

    def transformed(self, matrix: Array) -> "Mesh":
        """Moved by a 4x4 matrix; faces turned over where it mirrors."""
        with np.errstate(all="ignore"):  # what comes of it is validated
            vertices = self.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        mirrored = np.linalg.det(matrix[:3, :3]) < 0
        return Mesh(vertices, self.faces[:, ::-1] if mirrored else self.faces, self.uv)


def read_mesh(path: Path) -> Mesh:
    """A mesh file (PLY, OBJ, STL, glTF) as it stands, unvalidated indices and all.

    Raises InputError where the file is missing, truncated or no mesh.
    """
    import trimesh

    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    loaded = load_quietly(path, trimesh.load)
    parts = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    meshes = [
        Mesh(
            np.array(part.vertices, dtype=np.float64),
            np.array(part.faces, dtype=np.int64),
            _texture_coordinates(part),
        )
        for part in parts
        if len(getattr(part, "faces", ())) > 0
    ]
    if not meshes:
        raise InputError(f"{path}: has no faces")
    return _joined(meshes)


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several as one; trimesh would pack their pictures, and move the texture coordinates."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    uvs = [mesh.uv for mesh in meshes if mesh.uv is not None]
    return Mesh(
        np.vstack([mesh.vertices for mesh in meshes]),
        np.vstack([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
        np.vstack(uvs) if len(uvs) == len(meshes) else None,
    )


def load_quietly(path: Path, loader: Callable[..., Any]) -> Any:
    """What one of trimesh's loaders makes of a file, unprocessed.

    Vertices come in any order: where it is kept, trimesh 5 loses the texture coordinates of an OBJ
    whose faces name them. Raises InputError whatever the reader stumbles over; its own warnings and
    log are dropped, since what matters is checked afterwards.
    """
    if path.suffix.lower().lstrip(".") not in FORMATS:
        raise InputError(f"{path}: {path.suffix!r} is none of {', '.join(FORMATS)}")
    if check := _CHECKS.get(path.suffix.lower()):
        check(path)
    logger = logging.getLogger("trimesh")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            file, kind = model_file(path)
            files = ModelFiles(path)
            return loader(file, file_type=kind, resolver=files, process=False, maintain_order=False)
    except MemoryError:
        raise
    except Exception as error:  # readers fail in every way there is on broken files
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise InputError(f"{path}: can't be read as a mesh ({reason:.200})") from error


def _check_obj(path: Path) -> None:
    """What readers bend into shape: too few numbers in a line, which they take from the next one;
    vertex 0, for which they take the last (OBJ counts from 1, or from the end, negative).
    """
    zero = re.compile(rb"^f\s+(?:\S+\s+)*0(?:[/\s]|$)")
    before = b""
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            line = before + line.rstrip()
            before = b""
            if line.endswith(b"\\"):  # goes on in the next one
                before = line[:-1] + b" "
                continue
            if line[:2] in (b"v ", b"v\t", b"f ", b"f\t") and len(line.split(None, 3)) < 4:
                raise InputError(f"{path}: line {number}: {line[:40]!r}, expected three or more")
            if zero.match(line):
                raise InputError(f"{path}: line {number}: vertex 0, but OBJ counts from 1")


_CHECKS = {".obj": _check_obj, ".gltf": check_gltf, ".glb": check_gltf}


def validate(mesh: Mesh, place: str) -> Mesh:
    """The mesh without its zero-area faces, ready for a renderer.

    Raises InputError, beginning with ``place``, on an index outside the vertices, a coordinate
    that is no number, or when no face has an area.
    """
    for name in ("vertices", "faces"):
        if (shape := getattr(mesh, name).shape)[1:] != (3,):
            raise InputError(f"{place}: {name} of shape {shape}, expected three numbers each")
    bad = np.argwhere((mesh.faces < 0) | (mesh.faces >= len(mesh.vertices)))
    if len(bad):
        face, corner = bad[0]
        raise InputError(
            f"{place}: face {face} refers to vertex {mesh.faces[face, corner]} "
            f"of {len(mesh.vertices)}"
        )
    lost = np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1))
    if len(lost):
        raise InputError(f"{place}: vertex {lost[0]} is {mesh.vertices[lost[0]].tolist()}")
    if mesh.uv is not None and not np.isfinite(mesh.uv).all():
        raise InputError(f"{place}: a texture coordinate is no number")
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    with np.errstate(over="ignore", invalid="ignore"):
        solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0
    if not solid.any():
        raise InputError(f"{place}: no face has an area")
    return Mesh(mesh.vertices, mesh.faces[solid].astype(np.int32), mesh.uv)


def divided(mesh: Mesh) -> Mesh:
    """The same surface about the origin with no triangle that is large where it is near.

    A renderer in float32 finds a point of a triangle only to the step of its corners' coordinates,
    8 mm at 1e5 m: light is lost to the surface's own shadow. So edges are halved, in float64,
    until none is longer than `_EDGE_OVER_DISTANCE` times the triangle's distance (or 1 m).
    """
    vertices, faces, uv = mesh.vertices, mesh.faces, mesh.uv
    if np.linalg.norm(np.ptp(vertices, axis=0)) <= _EDGE_OVER_DISTANCE:  # of 1 m: nothing is longer
        return mesh
    while True:
        corners = vertices[faces]
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        longest = edges.max(axis=1)
        nearest = np.linalg.norm(corners.mean(axis=1), axis=1) - longest
        split = longest > _EDGE_OVER_DISTANCE * np.maximum(nearest, 1.0)
        if not split.any():
            return Mesh(vertices, faces, uv)
        first = edges[split].argmax(axis=1)[:, None]
        turn = (first + np.arange(3)) % 3
        a, b, c = np.take_along_axis(faces[split], turn, axis=1).T
        middle = len(vertices) + np.arange(len(a))
        halves = np.concatenate(
            [np.column_stack([a, middle, c]), np.column_stack([middle, b, c])]
        ).astype(faces.dtype)
        vertices = np.concatenate([vertices, (vertices[a] + vertices[b]) / 2])
        uv = None if uv is None else np.concatenate([uv, (uv[a] + uv[b]) / 2])
        faces = np.concatenate([faces[~split], halves])


def primitive(kind: str, properties: dict[str, Any]) -> Mesh | None:
    """Mitsuba's analytic shapes as triangles, in their own frame; None for other shapes."""
    make = _PRIMITIVES.get(kind)
    with np.errstate(all="ignore"):  # what comes of it is validated
        return make(properties) if make else None


def _texture_coordinates(loaded: Any) -> Array | None:
    uv = getattr(getattr(loaded, "visual", None), "uv", None)
    if uv is None:
        raw = loaded.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
        names = getattr(getattr(raw, "dtype", None), "names", None) or ()
        pair = next((p for p in (("u", "v"), ("s", "t")) if set(p) <= set(names)), None)
        uv = None if pair is None else np.column_stack([raw[pair[0]].ravel(), raw[pair[1]].ravel()])
    return None if uv is None or len(uv) != len(loaded.vertices) else np.array(uv, np.float64)


def _rectangle(_: dict[str, Any]) -> Mesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), (corners[:, :2] + 1) / 2)


def _from_trimesh(made: Any) -> Mesh:
    return Mesh(np.array(made.vertices, np.float64), np.array(made.faces, np.int64))


def _cube(_: dict[str, Any]) -> Mesh:
    import trimesh

    return _from_trimesh(trimesh.creation.box(extents=(2, 2, 2)))


def _sphere(properties: dict[str, Any]) -> Mesh:
    import trimesh

    ball = _from_trimesh(trimesh.creation.icosphere(5, radius=properties.get("radius", 1.0)))
    center = np.array(properties.get("center", (0, 0, 0)), dtype=np.float64).ravel()
    return Mesh(ball.vertices + center, ball.faces)


def _cylinder(properties: dict[str, Any]) -> Mesh:
    """Open tube from p0 to p1, as in Mitsuba."""
    p0 = np.array(properties.get("p0", (0, 0, 0)), dtype=np.float64).ravel()
    p1 = np.array(properties.get("p1", (0, 0, 1)), dtype=np.float64).ravel()
    angle = np.linspace(0, 2 * np.pi, _SEGMENTS, endpoint=False)
    axis = (p1 - p0) / np.linalg.norm(p1 - p0)
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    ring = properties.get("radius", 1.0) * (
        np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(axis, u)
    )
    i = np.arange(_SEGMENTS)
    j = (i + 1) % _SEGMENTS
    faces = np.vstack(
        [np.column_stack([i, j, j + _SEGMENTS]), np.column_stack([i, j + _SEGMENTS, i + _SEGMENTS])]
    )
    return Mesh(np.vstack([p0 + ring, p1 + ring]), faces)


def _disk(_: dict[str, Any]) -> Mesh:
    angle = np.linspace(0, 2 * np.pi, _SEGMENTS, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SEGMENTS)])
    i = np.arange(_SEGMENTS)
    faces = np.column_stack([np.full(_SEGMENTS, _SEGMENTS), i, (i + 1) % _SEGMENTS])
    return Mesh(np.vstack([rim, np.zeros(3)]), faces)


_PRIMITIVES = {
    "rectangle": _rectangle,
    "cube": _cube,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "disk": _disk,
}
