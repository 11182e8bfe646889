"""Meshes from files, and tessellated from primitives."""

import logging
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.files import InputError
from twin.geometry import Geometry
from twin.scene.beside import ModelFiles, model_file
from twin.scene.gltf_validation import check_gltf
from twin.scene.mesh_validation import check_not_empty, check_stl

Array = NDArray[np.float64]

FORMATS = ("ply", "obj", "stl", "glb", "gltf")
_SEGMENTS = 64  # around a tessellated sphere, cylinder or disk: area within 0.16 %


def read_mesh(path: Path, place: str = "") -> Geometry:
    """A mesh file (PLY, OBJ, STL, glTF) as it stands, faces without area and all.

    Raises InputError where the file is missing, truncated or no mesh; of what is wrong within the
    mesh it begins with ``place``, default: the path.
    """
    import trimesh

    if path.is_dir():
        raise InputError(f"{path}: a folder, expected a mesh file")
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    loaded = load_quietly(path, trimesh.load)
    parts = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    meshes = [
        Geometry(part.vertices, part.faces, _texture_coordinates(part), place or str(path))
        for part in parts
        if len(getattr(part, "faces", ())) > 0
    ]
    if not meshes:
        raise InputError(f"{path}: has no faces")
    return Geometry.concatenate(
        meshes
    )  # trimesh would pack their pictures, and move the coordinates


def load_quietly(path: Path, loader: Callable[..., Any]) -> Any:
    """What one of trimesh's loaders makes of a file, unprocessed.

    Vertices come in any order: where it is kept, trimesh 5 loses the texture coordinates of an OBJ
    whose faces name them. Raises InputError whatever the reader stumbles over; its own warnings and
    log are dropped, since what matters is checked afterwards.
    """
    if path.suffix.lower().lstrip(".") not in FORMATS:
        raise InputError(f"{path}: {path.suffix!r} is none of {', '.join(FORMATS)}")
    check_not_empty(path)
    if check := _CHECKS.get(path.suffix.lower()):
        check(path)
    file, kind = model_file(path)
    logger = logging.getLogger("trimesh")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            files = ModelFiles(path)
            return loader(file, file_type=kind, resolver=files, process=False, maintain_order=False)
    except MemoryError:
        raise
    except Exception as error:  # readers fail in every way there is on broken files
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise InputError(f"{path}: can't be read as a mesh ({reason:.200})") from error


_CHECKS = {".stl": check_stl, ".gltf": check_gltf, ".glb": check_gltf}


def primitive(kind: str, properties: dict[str, Any]) -> Geometry | None:
    """Mitsuba's analytic shapes as triangles, in their own frame; None for other shapes."""
    make = _PRIMITIVES.get(kind)
    with np.errstate(all="ignore"):  # what comes of it is checked
        return make(properties) if make else None


def _texture_coordinates(loaded: Any) -> Array | None:
    uv = getattr(getattr(loaded, "visual", None), "uv", None)
    if uv is None:
        raw = loaded.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
        names = getattr(getattr(raw, "dtype", None), "names", None) or ()
        pair = next((p for p in (("u", "v"), ("s", "t")) if set(p) <= set(names)), None)
        uv = None if pair is None else np.column_stack([raw[pair[0]].ravel(), raw[pair[1]].ravel()])
    return None if uv is None or len(uv) != len(loaded.vertices) else np.array(uv, np.float64)


def _rectangle(_: dict[str, Any]) -> Geometry:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    return Geometry(corners, np.array([[0, 1, 2], [0, 2, 3]]), (corners[:, :2] + 1) / 2)


def _cube(_: dict[str, Any]) -> Geometry:
    import trimesh

    made = trimesh.creation.box(extents=(2, 2, 2))
    return Geometry(made.vertices, made.faces)


def _sphere(properties: dict[str, Any]) -> Geometry:
    import trimesh

    ball = trimesh.creation.icosphere(5)
    # As large from all sides in the mean (Cauchy), where corners on the sphere lose 3e-4 of it.
    radius = properties.get("radius", 1.0) * np.sqrt(4 * np.pi / ball.area)
    center = np.array(properties.get("center", (0, 0, 0)), dtype=np.float64).ravel()
    return Geometry(radius * np.asarray(ball.vertices) + center, ball.faces)


def _cylinder(properties: dict[str, Any]) -> Geometry:
    """Open tube from p0 to p1, as in Mitsuba."""
    p0 = np.array(properties.get("p0", (0, 0, 0)), dtype=np.float64).ravel()
    p1 = np.array(properties.get("p1", (0, 0, 1)), dtype=np.float64).ravel()
    angle = np.linspace(0, 2 * np.pi, _SEGMENTS, endpoint=False)
    axis = (p1 - p0) / np.linalg.norm(p1 - p0)
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    # As wide from all sides in the mean as the circle, by its circumference.
    half = np.pi / _SEGMENTS
    ring = (
        properties.get("radius", 1.0)
        * (half / np.sin(half))
        * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(axis, u))
    )
    i = np.arange(_SEGMENTS, dtype=np.int32)
    j = (i + 1) % _SEGMENTS
    faces = np.vstack(
        [np.column_stack([i, j, j + _SEGMENTS]), np.column_stack([i, j + _SEGMENTS, i + _SEGMENTS])]
    )
    return Geometry(np.vstack([p0 + ring, p1 + ring]), faces)


def _disk(_: dict[str, Any]) -> Geometry:
    """Of the circle's area."""
    angle = np.linspace(0, 2 * np.pi, _SEGMENTS, endpoint=False)
    radius = np.sqrt(angle[1] / np.sin(angle[1]))
    rim = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SEGMENTS)])
    i = np.arange(_SEGMENTS, dtype=np.int32)
    faces = np.column_stack([np.full(_SEGMENTS, _SEGMENTS), i, (i + 1) % _SEGMENTS])
    return Geometry(np.vstack([rim, np.zeros(3)]), faces)


_PRIMITIVES = {
    "rectangle": _rectangle,
    "cube": _cube,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "disk": _disk,
}
