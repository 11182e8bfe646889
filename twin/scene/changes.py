"""A scene with some of its values changed, by dotted names; the names of a study say the same."""

import re
from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.units import quantity, unit_of
from twin.files import InputError
from twin.scene.model import FARTHEST_M, FARTHEST_ORIGIN_M
from twin.toml import changed_name, check_changes, no_such_field

if TYPE_CHECKING:
    from twin.scene.model import Pose, Scene, SceneObject, Target

_ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
_OBJECT = (
    "reflectance",
    "shift_x_m",
    "shift_y_m",
    "shift_z_m",
    "velocity_m_per_s",
    "radar",
    "thickness_m",
)
_TARGET = ("rcs_m2",)
_NAMED = re.compile(r"(objects|targets)\.(.+)\.(\w+)")
#: Names that every scene has.
SCENE_NAMES = (
    *(f"rig.{field}" for field in ("x_m", "y_m", "z_m", *_ANGLES)),
    *(f"sun.{field}" for field in ("azimuth_deg", "elevation_deg", "illuminance_lx")),
)


def check_scene_name(name: str) -> None:
    """Raise InputError, with the nearest name, for what no scene has."""
    match = _NAMED.fullmatch(name)
    if match:
        known = _OBJECT if match[1] == "objects" else _TARGET
        if match[3] not in known:
            raise InputError(f"scene.{name}: {match[3]!r} is none of {', '.join(known)}")
    elif name not in SCENE_NAMES:
        raise InputError(f"scene.{name}: {no_such_field(name, SCENE_NAMES)}")


def changed(scene: "Scene", changes: Mapping[str, Any]) -> "Scene":
    """See `Scene.with_`."""
    check_changes(changes)
    if not changes:
        return scene
    for name, value in changes.items():
        check_scene_name(name)
        scene = _with(scene, name, _in_unit(name, value))
    _check_extent(scene, changes)
    return replace(scene, name=changed_name(scene.name))


def _check_extent(scene: "Scene", changes: Mapping[str, Any]) -> None:
    """Raise InputError for a rig or an object that changes have moved farther than files may."""
    place = scene.rig.position_m
    for axis, name in enumerate(("rig.x_m", "rig.y_m", "rig.z_m")):
        if name in changes and abs(place[axis]) > FARTHEST_ORIGIN_M:
            raise InputError(
                f"scene.{name} = {place[axis]:g}: expected at most {FARTHEST_ORIGIN_M:g} m from "
                "the origin"
            )
    if not any(name.startswith("rig.") or ".shift_" in name for name in changes):
        return
    for item in scene.objects:
        distance = float(np.abs(item.box_m - place).max())
        if distance > FARTHEST_M:
            raise InputError(
                f"scene.{', '.join(changes)}: objects.{item.name} is then up to {distance:.3g} m "
                f"from the rig, expected at most {FARTHEST_M:g} m"
            )


def _in_unit(name: str, value: Any) -> Any:
    """Text with a unit as a number in that of the name; a vector's parts alike."""
    unit = unit_of(name)
    if isinstance(value, tuple | list):
        return tuple(_in_unit(name, part) for part in value)
    if not isinstance(value, str) or not (unit or name.endswith(".reflectance")):
        return value
    try:
        return quantity(value, unit)
    except InputError as error:
        raise InputError(f"scene.{name} = {value!r:.60}: {error}") from None


def _with(scene: "Scene", name: str, value: Any) -> "Scene":
    group, _, rest = name.partition(".")
    if group == "rig":
        return scene.at(_moved(scene.rig.pose, rest, value))
    if group == "sun":
        return replace(scene, sun=replace(scene.sun, **{rest: value}))
    which, _, what = rest.rpartition(".")
    items: tuple[Any, ...] = getattr(scene, group)
    if which != "*" and which not in {item.name for item in items}:
        known = ", ".join(item.name for item in items) or "none at all"
        raise InputError(f"scene.{group}: no {which!r}; there are {known}")
    if what.startswith("shift_"):
        return _shifted(scene, which, "xyz".index(what[len("shift_")]), value)
    items = tuple(replace(i, **{what: value}) if which in ("*", i.name) else i for i in items)
    held: dict[str, Any] = {group: items}
    scene = replace(scene, **held)
    return _carried(scene, which) if what == "velocity_m_per_s" else scene


def _carried(scene: "Scene", which: str) -> "Scene":
    """Targets that move as their objects do."""
    moving = {item.name: item.velocity_m_per_s for item in scene.objects}
    return replace(
        scene,
        targets=tuple(
            replace(t, velocity_m_per_s=moving[t.object])
            if t.object is not None and which in ("*", t.object)
            else t
            for t in scene.targets
        ),
    )


def _shifted(scene: "Scene", name: str, axis: int, by_m: float) -> "Scene":
    """The scene with an object elsewhere, and the targets that it carries."""
    if isinstance(by_m, bool) or not isinstance(by_m, int | float) or not np.isfinite(by_m):
        raise InputError(
            f"scene.objects.{name}.shift_{'xyz'[axis]}_m = {by_m!r}: expected a number"
        )
    shift = np.eye(3)[axis] * by_m

    def target(item: "Target") -> "Target":
        x, y, z = (np.asarray(item.position_m) + shift).tolist()
        return replace(item, position_m=(x, y, z))

    def moved(item: "SceneObject") -> "SceneObject":
        return item.moved(shift)

    return replace(
        scene,
        objects=tuple(moved(o) if name in ("*", o.name) else o for o in scene.objects),
        targets=tuple(
            target(t) if t.object is not None and name in ("*", t.object) else t
            for t in scene.targets
        ),
    )


def _moved(pose: "Pose", what: str, value: Any) -> "Pose":
    if not isinstance(value, Real):
        raise InputError(f"scene.rig.{what} = {value!r:.60}: expected a number")
    if what in _ANGLES:
        angle: dict[str, Any] = {what: float(value)}
        return replace(pose, **angle)
    place = list(pose.position_m)
    place["xyz".index(what[0])] = float(value)
    return replace(pose, position_m=(place[0], place[1], place[2]))
