"""Turn a model file of any kind into a scene folder of ours."""

import functools
import json
import re
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from hardware.formatting import number
from twin.files import InputError, whole_folder
from twin.geometry import Geometry
from twin.scene.beside import missing_files
from twin.scene.imported_materials import ImportedBsdfs, imported_material, texture_coordinates
from twin.scene.limits import FARTHEST_M, FARTHEST_ORIGIN_M
from twin.scene.materials import materials_of
from twin.scene.meshes import load_quietly
from twin.scene.objects import Array
from twin.scene.rig import Rig

_LIKELY_M = 100.0  # what is larger is drawn in millimetres, more often than not
_HALF_FIELD_RAD = np.radians(10)  # of the devices that the model is to fit in
#: Of the detector beside the emitter, and of the radar below both.
_DETECTOR_M, _RADAR_M = -Rig.detector.position_m[1], -Rig.radar.position_m[2]
#: glTF fixes its up axis; other formats leave it open.
_UP = {".glb": "y", ".gltf": "y"}
_Z_UP_FROM_Y = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)


def import_model(
    model: Path,
    folder: Path,
    *,
    scale: float = 1.0,
    up: str | None = None,
    material: str = "generic",
    texture_as_reflectance: bool = False,
) -> list[str]:
    """Write ``scene.xml``, ``scene.toml``, ``meshes/*.ply`` and ``textures/*.png`` for a model.

    A material whose name is a row of the materials table (``Concrete.001`` is ``concrete``) is that
    row. Texture coordinates and pictures are kept.

    Parameters
    ----------
    model
        glTF, OBJ, STL, PLY, or whatever else trimesh reads.
    folder
        The scene folder; it must not hold a scene yet.
    scale
        Metres per unit of the model.
    up
        The model's up axis, ``y`` or ``z``; default y for glTF, z else. With y up, the model's +z
        becomes x forward.
    material
        Row of the materials table for parts whose own material is none of its rows.
    texture_as_reflectance
        Take pictures of visible light as the reflectance at 1550 nm, about which they say nothing.

    Returns
    -------
    One line per thing that was assumed or left out.

    Raises InputError on a file that can't be read or a part no renderer may see.
    """
    import trimesh

    _check(model, folder, scale, up, material)
    apart = {"split_objects": True} if model.suffix.lower() == ".obj" else {}
    loaded = load_quietly(model, functools.partial(trimesh.load_scene, **apart))
    axis, turn = upright(model, up)
    place = np.diag([scale, scale, scale, 1.0]) @ turn
    table, _ = materials_of(folder)
    materials = ImportedBsdfs(table, material, texture_as_reflectance)
    parts, notes = _parts(loaded, model, place, materials)
    corners = np.concatenate([part.corners_m.reshape(-1, 3) for part, _ in parts.values()])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (high - low).max() > FARTHEST_M:
        raise InputError(
            f"{model}: measures {(high - low).max():.3g} m, expected at most {FARTHEST_M:g} m"
        )
    rig_m = _rig_m(low, high)
    if (far_m := np.abs(rig_m).max()) > FARTHEST_ORIGIN_M:
        raise InputError(
            f"{model}: a rig before it is {far_m:.3g} m from the origin, expected at most "
            f"{FARTHEST_ORIGIN_M:g} m: --scale, or move the model"
        )
    # PLY files hold float32: meshes stay near the origin, the XML moves them in float64.
    origin = np.round((low + high) / 2) if np.abs([low, high]).max() > 1e3 else np.zeros(3)
    with whole_folder(folder) as partial:
        (partial / "meshes").mkdir()
        for name, (part, _) in parts.items():
            drawn = None if part.uv is None else trimesh.visual.TextureVisuals(uv=part.uv)
            mesh = trimesh.Trimesh(
                part.vertices_m - origin, part.faces, process=False, visual=drawn
            )
            mesh.export(partial / "meshes" / f"{name}.ply")
        materials.write_pictures(partial)
        bsdf_of = {name: bsdf for name, (_, bsdf) in parts.items()}
        (partial / "scene.xml").write_text(_xml(bsdf_of, materials.xml(), origin))
        (partial / "scene.toml").write_text(_toml(model, rig_m))
    size = " x ".join(number(s) for s in high - low)
    notes.append(f"{axis} is up, {scale:g} m per unit: the scene measures {size} m")
    if scale == 1 and (high - low).max() > _LIKELY_M:
        notes.append("a model in millimetres needs --scale 0.001")
    notes += [*materials.notes(), *missing_files(model)]
    notes.append("the rig was placed in front of the model, looking at it: see scene.toml")
    if (reach_m := np.abs([low - rig_m, high - rig_m]).max()) > FARTHEST_M:
        notes.append(
            f"the rig is {reach_m:.3g} m from the model's far end, and a scene is read up to "
            f"{FARTHEST_M:g} m: place it nearer in scene.toml"
        )
    off_axis = float(np.arctan2(_RADAR_M, _distance(low, high) + (high - low)[0] / 2))
    if off_axis > _HALF_FIELD_RAD:
        degrees = number(np.degrees(off_axis), 2)
        notes.append(
            f"the radar, {_RADAR_M:g} m below the camera, sees the model {degrees} degrees above "
            "its axis: [rig.radar] of scene.toml places it"
        )
    return notes


def upright(model: Path, up: str | None) -> tuple[str, Array]:
    """The up axis of a model, ``y`` or ``z``, by default that of its format, and the 4x4 matrix
    that turns it to z, and with y up the model's +z to x. Raises InputError on another axis.
    """
    if up not in (None, "y", "z"):
        raise InputError(f"up: {up!r}: expected y or z")
    axis = up or _UP.get(model.suffix.lower(), "z")
    return axis, _Z_UP_FROM_Y if axis == "y" else np.eye(4)


def _check(model: Path, folder: Path, scale: float, up: str | None, material: str) -> None:
    if model.is_dir():
        raise InputError(f"{model}: a folder, expected a mesh file")
    if not model.is_file():
        raise InputError(f"{model}: no such file")
    for name in ("scene.xml", "scene.toml", "meshes"):
        if (folder / name).exists():
            raise InputError(f"{folder / name}: exists already, expected a new scene folder")
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"scale: {scale}: expected metres per unit, above 0")
    upright(model, up)
    table, _ = materials_of(folder)
    if material not in table:
        raise InputError(
            f"material: {material!r} is not in the table of materials; known: {', '.join(table)}"
        )


def _parts(
    loaded: Any, model: Path, place: Array, materials: ImportedBsdfs
) -> tuple[dict[str, tuple[Geometry, str]], list[str]]:
    """Every mesh of the model in scene coordinates with the id of its BSDF, by a name that is good
    for a file and is no id of a BSDF: ids are unique in a file.
    """
    parts: dict[str, tuple[Geometry, str]] = {}
    skipped = flat = 0
    for node in loaded.graph.nodes_geometry:
        with np.errstate(all="ignore"):  # what comes of it is validated
            matrix, geometry = loaded.graph[node]
            matrix = place @ matrix
        mesh = loaded.geometry[geometry]
        if len(getattr(mesh, "faces", ())) == 0:
            skipped += 1
            continue
        # What is read from content alone has no name of its own.
        known = model.name if node == "geometry_0" else str(node)
        plain = re.sub(r"[^\w-]+", "_", known).strip("_")[:60] or "part"
        free = (f"{plain}-{number}" for number in count(2))
        name = plain
        while name in parts or name in materials.table:
            name = next(free)
        uv = texture_coordinates(mesh.visual, len(mesh.vertices))
        where = f"{model}: part {node!r}"
        raw = Geometry(mesh.vertices, mesh.faces, uv, where).without_empty_faces(where)
        placed = raw.transformed(matrix, where).without_empty_faces(where)
        flat += len(mesh.faces) - len(placed.faces)
        parts[name] = placed, materials.bsdf(imported_material(mesh.visual), name, uv is not None)
    if not parts:
        raise InputError(f"{model}: has no faces")
    left_out = {"parts without faces": skipped, "faces without an area": flat}
    return parts, [f"{n} {what} left out" for what, n in left_out.items() if n]


def _xml(bsdf_of: dict[str, str], bsdfs: str, origin: Array) -> str:
    """``bsdf_of``: id of each shape's BSDF; ``bsdfs``: the elements of all."""
    x, y, z = (repr(float(v)) for v in origin)
    moved = f'        <transform name="to_world"><translate value="{x}, {y}, {z}"/></transform>\n'
    shapes = "\n".join(
        f'    <shape type="ply" id="{name}">\n'
        f'        <string name="filename" value="meshes/{name}.ply"/>\n'
        f'        <boolean name="face_normals" value="true"/>\n'
        f"{moved if origin.any() else ''}"
        f'        <ref id="{bsdf}"/>\n'
        f"    </shape>"
        for name, bsdf in bsdf_of.items()
    )
    return f'<scene version="3.0.0">\n    <integrator type="path"/>\n{bsdfs}{shapes}\n</scene>\n'


def _distance(low: Array, high: Array) -> float:
    """Metres before the model from which it fits into the fields of emitter and detector, of which
    the one stands beside the other.
    """
    size = float((high - low)[1:].max())
    return float(max(1.3 * size / 2, size / 2 + 1.1 * _DETECTOR_M) / np.tan(_HALF_FIELD_RAD))


def _rig_m(low: Array, high: Array) -> tuple[float, float, float]:
    """Place of the rig: before the model, towards +x of it."""
    distance = _distance(low, high)
    y, z = (low[1:] + high[1:]) / 2
    digits = max(0, 2 - int(np.floor(np.log10(distance))))
    x, y, z = (round(float(v), digits) for v in (high[0] + distance, y, z))
    return x, y, z


def _toml(model: Path, rig_m: tuple[float, float, float]) -> str:
    """Rig in front of the model, looking back."""
    x, y, z = rig_m
    return (
        f"description = {json.dumps(f'imported from {model.name}')}\n\n"
        "[rig]\n"
        f"position_m = [{x:.12g}, {y:.12g}, {z:.12g}]\n"
        "yaw_deg = 180.0\n"
        "[rig.emitter]\n"
        "offset_m = [0.0, 0.0, 0.0]\n"
        "[rig.detector]\n"
        f"offset_m = [0.0, {-_DETECTOR_M}, 0.0]\n\n"
        "[sun]\n"
        "azimuth_deg = 40.0\n"
        "elevation_deg = 40.0\n"
        "illuminance_lx = 100e3\n"
    )
