"""Read a scene folder or a bare Mitsuba XML file into a validated `Scene`."""

from collections import Counter
from collections.abc import Hashable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from twin.errors import check_kind
from twin.files import InputError, scenes_folder
from twin.geometry import Geometry
from twin.scene import xml
from twin.scene.coplanar import coplanar
from twin.scene.defaults import default_pose, default_sun
from twin.scene.enclosure import encloses
from twin.scene.limits import FARTHEST_M, FARTHEST_ORIGIN_M
from twin.scene.materials import GENERIC, Material, materials_of, row_of
from twin.scene.meshes import primitive, read_mesh
from twin.scene.model import Scene
from twin.scene.motion_tree import MotionTree
from twin.scene.objects import IN_PLACE, Array, SceneObject
from twin.scene.rig import Pose, Rig
from twin.scene.settings import SceneSettings, load_settings
from twin.scene.sun import Sun
from twin.scene.texture import Reflectance, Texture

_MESH_PLUGINS = ("ply", "obj", "stl")

#: Of files that `twin import` reads.
MODEL_SUFFIXES = frozenset({".glb", ".gltf", ".obj", ".ply", ".stl"})

_TROPIC_DEG = 23.5  # with half a tenth for rounded angles

_COARSE_M = 1e-3  # step of a mesh file's float32 coordinates that is warned of


def load_scene(scene: str | Path | Scene, pose: Pose | None = None) -> Scene:
    """Read, validate and complete a scene.

    Parameters
    ----------
    scene
        Name of a bundled scene, a folder with ``scene.xml``, or a Mitsuba XML file. A scene is
        returned as it is, at the pose if one is given.
    pose
        Of the rig; default: that of ``scene.toml``, else the XML's camera, else one chosen from
        the geometry, with a warning that says so.

    Raises InputError, one line that names file, place, value and what was expected.

    >>> scene = load_scene("yard")
    >>> scene.name, scene.objects[0].name, scene.at_rest
    ('yard', 'ground', False)
    """
    if pose is not None:
        check_kind("pose", pose, Pose, "twin.Pose")
    if not isinstance(scene, str | Path | Scene):
        raise InputError(f"scene = {scene!r:.60}: expected a name, a path or a twin.Scene")
    if isinstance(scene, Scene):
        return scene if pose is None else scene.at(pose)
    path = scene_file(scene)
    document = xml.read_xml(path)
    names = [shape.name for shape in document.shapes]
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"{path}: two shapes have the id {name!r}")
    toml = path.parent / "scene.toml"
    settings = load_settings(toml, set(names)) if toml.is_file() else None
    table, notes = materials_of(path.parent)
    materials = _Materials(path, table)

    meshes = _MeshFiles(path)
    objects = tuple(_object(path, shape, meshes, materials, settings) for shape in document.shapes)
    tree = MotionTree(toml, objects, settings) if settings else None
    if tree:
        objects = tree.objects()
    rig, warnings = _rig(settings, document, objects, pose)
    if tree:
        rig = rig if pose else tree.rig(rig)
        warnings += tree.warnings
    if not np.abs(rig.position_m).max() <= FARTHEST_ORIGIN_M:
        raise InputError(
            f"{toml if settings and not pose else path}: rig: position_m = "
            f"{rig.position_m.tolist()}, expected at most {FARTHEST_ORIGIN_M:g} m from the origin"
        )
    for shape, item in zip(document.shapes, objects, strict=True):
        _check_extent(path, shape, item, rig)
    sun, on_sun = _sun(settings, document, rig)
    warnings += [*_on_objects(document, objects, rig), *on_sun]
    return Scene(
        name=path.parent.resolve().name if path.name == "scene.xml" else path.stem,
        path=path,
        description=settings.description if settings else "",
        objects=objects,
        rig=rig,
        sun=sun,
        targets=tree.targets(tree.settings.make_targets()) if tree else (),
        track=settings.make_track() if settings else None,
        materials={o.material: materials.table[o.material] for o in objects},
        unknown_materials=materials.unknown,
        assumptions=tuple(materials.assumptions()),
        notes=notes,
        warnings=(*warnings, *materials.warnings()),
    )


def _on_objects(document: xml.Document, objects: tuple[SceneObject, ...], rig: Rig) -> list[str]:
    """Warnings of what the rig sees of them, or where it stands."""
    placed = zip(document.shapes, objects, strict=True)
    warnings = [told for shape, item in placed if (told := _coarse(shape, item, rig))]
    if not document.shapes:
        warnings.append("the scene has no shapes")
    inside = tuple(item.name for item in objects if encloses(item, rig.position_m))
    if inside:
        warnings.append(f"the rig stands inside {_list(inside)}")
    return [*warnings, *coplanar(objects, rig.position_m)]


def _sun(settings: SceneSettings | None, document: xml.Document, rig: Rig) -> tuple[Sun, list[str]]:
    """Of the settings, else a default; and warnings of it, and of other light sources."""
    sun, warnings = settings.make_sun() if settings else None, []
    standing_for_sun = () if sun is None else ("directional",)  # in stock Mitsuba
    if sun is None:
        sun = default_sun(rig.pose)
        warnings.append(
            f"{_without(settings, 'a sun')}: sun defaulted to azimuth {sun.azimuth_deg:.0f} deg, "
            f"elevation {sun.elevation_deg:.0f} deg, {sun.illuminance_lx:.0f} lx"
        )
    elif sun.elevation_deg < 0 < sun.illuminance_lx:
        warnings.append(
            f"the sun is {-sun.elevation_deg:g} deg below the horizon, and lights the scene from "
            "there: a scene without light of the sun has illuminance_lx = 0"
        )
    if unused := tuple(e for e in document.emitters if e not in standing_for_sun):
        warnings.append(f"light sources of the XML are not used: {_list(unused)}")
    if abs(sun.declination_deg or 0.0) > _TROPIC_DEG:
        warnings.append(
            f"the sun never stands there at latitude {sun.latitude_deg:g} deg, north at azimuth "
            f"{sun.north_azimuth_deg:g} deg: its declination would be {sun.declination_deg:.1f} "
            "deg, and is between -23.4 and 23.4"
        )
    return sun, warnings


def scene_file(scene: str | Path) -> Path:
    """The XML file of a scene by name, folder or file, unread. Raises InputError for none."""
    bundled = scenes_folder() / str(scene) / "scene.xml"
    path = Path(scene)
    if path.is_dir():
        if not (path / "scene.xml").is_file():
            raise InputError(f"{path}: this folder has no scene.xml")
        return path / "scene.xml"
    if path.is_file():
        if path.suffix.lower() in MODEL_SUFFIXES:
            raise InputError(
                f"{path}: is a model, expected a scene: `twin import {path} scenes/{path.stem}` "
                f"makes one, `twin run scenes/{path.stem}` runs it"
            )
        if path.name == "scene.toml":
            raise InputError(
                f"{path}: holds the settings of a scene, expected its folder: "
                f"`twin run {path.parent}` runs it"
            )
        return path
    if bundled.is_file():
        return bundled
    known = ", ".join(sorted(p.parent.name for p in scenes_folder().glob("*/scene.xml")))
    raise InputError(f"{scene}: no such scene; bundled ones: {known}")


class _MeshFiles:
    """Geometries of a scene's shapes: those of equal shapes are one, read once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.held: dict[Hashable, Geometry] = {}

    def placed(self, shape: xml.XmlShape) -> tuple[Geometry, RigidTransform]:
        """A shape's geometry, and the pose of its frame in the world.

        What ``to_world`` does beyond turning and moving is done to the vertices.
        """
        place = _place(self.path, shape)
        matrix = shape.to_world
        if not np.isfinite(matrix).all():
            raise InputError(f"{place}: to_world is not finite")
        to_uv = shape.surface.to_uv
        properties = tuple(sorted((key, str(value)) for key, value in shape.properties.items()))
        key = (shape.plugin, properties, None if to_uv is None else to_uv.tobytes())
        if key not in self.held:
            self.held[key] = self._read(shape, place)
        geometry = self.held[key]
        if _is_rigid(matrix):
            return geometry, RigidTransform.from_matrix(matrix)
        return geometry.transformed(matrix, place).without_empty_faces(place), IN_PLACE

    def _read(self, shape: xml.XmlShape, place: str) -> Geometry:
        if shape.plugin in _MESH_PLUGINS:
            if "filename" not in shape.properties:
                raise InputError(f"{place}: {shape.plugin!r} needs a filename")
            geometry = read_mesh(shape.properties["filename"], place)
        else:
            try:
                made = primitive(shape.plugin, shape.properties)
            except (TypeError, ValueError) as error:
                raise InputError(f"{place}: {shape.plugin!r}: {error}") from error
            if made is None:
                raise InputError(
                    f"{place}: {shape.plugin!r} is not supported; "
                    "expected ply, obj, stl, rectangle, cube, sphere, cylinder or disk"
                )
            geometry = made
        geometry = geometry.without_empty_faces(place)
        if geometry.uv is None:
            return geometry
        flips = shape.plugin in _MESH_PLUGINS and shape.flips_texture
        uv = geometry.uv * [1, -1] + [0, 1] if flips else geometry.uv
        return Geometry(geometry.vertices_m, geometry.faces, shape.surface.placed(uv), place)


def _is_rigid(matrix: Array) -> bool:
    """Whether a 4x4 matrix only turns and moves."""
    turn = matrix[:3, :3]
    return bool(np.abs(turn @ turn.T - np.eye(3)).max() < 1e-12 and np.linalg.det(turn) > 0)


def _place(path: Path, shape: xml.XmlShape) -> str:
    return f"{shape.properties.get('filename', path)}: shape {shape.name!r}"


def _check_extent(path: Path, shape: xml.XmlShape, item: SceneObject, rig: Rig) -> None:
    distance = np.abs(item.vertices_m - rig.position_m).max(axis=1)
    far = int(distance.argmax())
    if distance[far] > FARTHEST_M:
        raise InputError(
            f"{_place(path, shape)}: vertex {far} is {distance[far]:.3g} m from the rig, "
            f"expected at most {FARTHEST_M:g} m"
        )


def _coarse(shape: xml.XmlShape, item: SceneObject, rig: Rig) -> str | None:
    """Warning for a mesh file with float32 coordinates far from the origin."""
    if shape.plugin not in _MESH_PLUGINS or not np.array_equal(shape.to_world, np.eye(4)):
        return None
    narrow = item.vertices_m.astype(np.float32)
    step = float(np.spacing(np.abs(narrow).max()))
    if step < _COARSE_M or not np.array_equal(narrow, item.vertices_m):
        return None
    from trimesh.triangles import closest_point

    corners = item.vertices_m[item.geometry.faces] - rig.position_m
    near = np.linalg.norm(closest_point(corners, np.zeros((len(corners), 3))), axis=1).min()
    # A corner is off by sqrt(3) / 2 steps; light falls with the square of the distance.
    error = float(np.sqrt(3) * step / max(near, step))
    return (
        f"{shape.name}: its float32 coordinates have steps of {step:.2g} m: light is off by up to "
        f"{100 * error:.2g} % at its nearest point; place it by to_world, or write doubles"
    )


def _object(
    path: Path,
    shape: xml.XmlShape,
    meshes: "_MeshFiles",
    materials: "_Materials",
    settings: SceneSettings | None,
) -> SceneObject:
    geometry, pose = meshes.placed(shape)
    row, reflectance = materials.of(shape)
    if isinstance(reflectance, Texture) and geometry.uv is None:
        raise InputError(f"{_place(path, shape)}: textured, but has no u, v coordinates")
    return SceneObject(
        name=shape.name,
        geometry=geometry,
        material=row,
        reflectance=reflectance,
        velocity_m_per_s=settings.velocity(shape.name) if settings else (0.0, 0.0, 0.0),
        radar=settings.radar_role(shape.name) if settings else None,
        thickness_m=settings.thickness_m(shape.name) if settings else None,
        pose=pose,
    )


def _rig(
    settings: SceneSettings | None,
    document: xml.Document,
    objects: Sequence[SceneObject],
    pose: Pose | None,
) -> tuple[Rig, list[str]]:
    given = settings or SceneSettings()
    offsets = "" if given.rig else "sensor offsets defaulted"
    if at := pose or given.rig_pose():
        told = [f"{_without(settings, 'a rig')}: {offsets}"] if offsets else []
        return given.make_rig(at), told
    chosen, why = default_pose(document.camera, objects)
    place = ", ".join(f"{p:.4g}" for p in chosen.position_m)
    told = [
        f"{_without(settings, 'a place of the rig')}: rig placed at ({place}) m, "
        f"yaw {chosen.yaw_deg:.1f}, pitch {chosen.pitch_deg:.1f}, "
        f"roll {chosen.roll_deg:.1f} deg ({why}){f'; {offsets}' if offsets else ''}"
    ]
    return given.make_rig(chosen), told


def _without(settings: SceneSettings | None, what: str) -> str:
    return "no scene.toml" if settings is None else f"scene.toml without {what}"


class _Materials:
    """Finds each shape's row and reflectance; collects what had to be defaulted."""

    def __init__(self, path: Path, table: dict[str, Material]) -> None:
        self.path = path
        self.table = table
        self.used: dict[str, None] = {}
        self.unknown: dict[str, str] = {}
        self.own: dict[str, list[str]] = {}
        self.left_out: dict[str, list[str]] = {}
        self.defaulted: dict[str, list[str]] = {}
        self.overruled: dict[str, None] = {}

    def of(self, shape: xml.XmlShape) -> tuple[str, Reflectance]:
        surface = shape.surface
        given = self._checked(shape)
        for what in surface.left_out:
            self.left_out.setdefault(what, []).append(shape.name)
        row = row_of(surface.radio_type or surface.id, self.table)
        if row is not None:
            self.used[row] = None
            if isinstance(given, Texture):
                return row, given
            value = self.table[row].optical.reflectance.value
            if given is not None and abs(given - value) > 1e-3:
                self.overruled[f"{row}: {given:g} in the XML, {value:g} in the table"] = None
            return row, value
        name = surface.radio_type or surface.id or shape.name
        if surface.radio_type:
            raise InputError(
                f"{self.path}: shape {shape.name!r}: material {name!r} is not in the table of "
                f"materials; known: {', '.join(self.table)}"
            )
        self.unknown[shape.name] = name
        if given is not None:
            told = "an image" if isinstance(given, Texture) else f"{given:g}"
            self.own.setdefault(f"{name}, {told}", []).append(shape.name)
            return GENERIC, given
        self.defaulted.setdefault(f"{name}, {surface.plugin}", []).append(shape.name)
        return GENERIC, self.table[GENERIC].optical.reflectance.value

    def _checked(self, shape: xml.XmlShape) -> Reflectance | None:
        value = shape.surface.reflectance
        if value is None:
            return None
        numbers = value.image if isinstance(value, Texture) else value
        low, high = float(np.min(numbers)), float(np.max(numbers))
        if not (low >= 0 and high <= 1):
            wrong = low if not low >= 0 else high
            raise InputError(
                f"{self.path}: shape {shape.name!r}: material {shape.surface.id!r}: "
                f"reflectance {wrong:g}, expected 0 to 1"
            )
        return value

    def assumptions(self) -> tuple[str, ...]:
        """Reflectances that are assumed, not cited."""
        return tuple(
            f"reflectance of {row} = {value.value:g}: {value.assumed}"
            for row in self.used
            if (value := self.table[row].optical.reflectance).assumed
        )

    def warnings(self) -> list[str]:
        """What the table of materials does not know."""
        found = []
        if self.own:
            found.append(
                "materials not in the table, reflectance taken from the XML: "
                f"{_by_object(self.own)}"
            )
        if self.overruled:
            found.append(f"the table of materials holds: {_list(self.overruled)}")
        if self.defaulted:
            value = self.table[GENERIC].optical.reflectance.value
            found.append(
                f"materials without a reflectance, defaulted to {value:g}: "
                f"{_by_object(self.defaulted)}"
            )
        if self.left_out:
            found.append(f"surfaces simplified: {_by_object(self.left_out)}")
        return found


def _by_object(found: dict[str, list[str]]) -> str:
    """What was found, each with the objects it holds for."""
    return "; ".join(f"{what} ({', '.join(names)})" for what, names in found.items())


def _list(names: "dict[str, None] | tuple[str, ...]") -> str:
    return ", ".join(names)
