"""A scene with some of its values changed, by dotted names; the names of a study say the same."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.units import quantity, unit_of
from twin.files import InputError
from twin.scene.limits import FARTHEST_M, FARTHEST_ORIGIN_M
from twin.toml import changed_name, check_changes, no_such_field

if TYPE_CHECKING:
    from twin.scene.model import Scene
    from twin.scene.objects import SceneObject, Target
    from twin.scene.rig import Pose, Rig
    from twin.scene.sun import Sun

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
    *(
        f"sun.{field}"
        for field in (
            "azimuth_deg",
            "elevation_deg",
            "illuminance_lx",
            "latitude_deg",
            "north_azimuth_deg",
        )
    ),
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
    of_sun: dict[str, Any] = {}
    for name, value in changes.items():
        check_scene_name(name)
        if name.startswith("sun."):
            of_sun[name.removeprefix("sun.")] = _in_unit(name, value)
        else:
            scene = _with(scene, name, _in_unit(name, value))
    if of_sun:
        scene = replace(scene, sun=_other_sun(scene.sun, of_sun))
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
        return replace(scene, rig=_placed(scene.rig, _moved(scene.rig.pose, rest, value)))
    which, _, what = rest.rpartition(".")
    items: tuple[Any, ...] = getattr(scene, group)
    if which != "*" and which not in {item.name for item in items}:
        known = ", ".join(item.name for item in items) or "none at all"
        raise InputError(f"scene.{group}: no {which!r}; there are {known}")
    if what.startswith("shift_"):
        return _shifted(scene, which, "xyz".index(what[len("shift_")]), value)
    if what == "velocity_m_per_s":
        return _at_velocity(scene, which, value)
    items = tuple(replace(i, **{what: value}) if which in ("*", i.name) else i for i in items)
    held: dict[str, Any] = {group: items}
    return replace(scene, **held)


def _other_sun(sun: "Sun", changes: Mapping[str, Any]) -> "Sun":
    """A sun with other values; what changes neither its height nor its brightness leaves the sky as
    clear as it is.
    """
    stops = changes.get("latitude_deg", 0) is None
    if not stops and changes.keys().isdisjoint(("elevation_deg", "illuminance_lx")):
        return replace(sun, **changes)
    if sun.has_set and not stops and "illuminance_lx" not in changes:
        raise InputError(
            "scene.sun.elevation_deg: the sun has set, and has no illuminance: expected "
            "sun.illuminance_lx beside it"
        )
    return replace(sun, **changes, clear_sky_share=None)


def _placed(rig: "Rig", pose: "Pose") -> "Rig":
    """The rig at another pose now, and on the way that leads from there."""
    if rig.motion is None:
        return replace(rig, pose=pose)
    return rig.following(rig.motion.displaced(pose.transform * rig.pose.transform.inv()))


def _at_velocity(scene: "Scene", which: str, velocity: Any) -> "Scene":
    """The scene with an object at another velocity, and what it carries; ``*``: with all that no
    other carries.
    """
    meant = [o for o in scene.objects if o.name == which or (which == "*" and not o.parent)]
    for item in meant:
        if item.motion is not None:
            how = f"its parent {item.parent!r}" if item.parent else "its own motion"
            raise InputError(
                f"scene.objects.{item.name}.velocity_m_per_s: it moves by {how}, expected an "
                "object without a motion"
            )
    changed = {o.name: replace(o, velocity_m_per_s=velocity) for o in meant}
    return _with_objects(scene, changed, lambda target: replace(target, velocity_m_per_s=velocity))


def _with_objects(
    scene: "Scene", changed: Mapping[str, "SceneObject"], target: Callable[["Target"], "Target"]
) -> "Scene":
    """A scene with some of its objects changed, and all that these carry moved along.

    ``target`` changes those on objects that have no motion, as their object was changed.
    """
    then = {item.name: item for item in scene.objects}
    now = {**then, **changed}

    def follow(name: str) -> None:
        for child in [item for item in now.values() if item.parent == name]:
            assert child.motion is not None  # as all have that have a parent
            now[child.name] = child.following(
                child.motion.with_parent(name, now[name].course), name
            )
            follow(child.name)

    for name in changed:
        follow(name)

    def carried(item: "Target") -> "Target":
        if item.object is None or now[item.object] is then[item.object]:
            return item
        if now[item.object].motion is None:
            return target(item)
        return item.carried(then[item.object], now[item.object])

    targets = tuple(carried(item) for item in scene.targets)
    return replace(scene, objects=tuple(now.values()), targets=targets)


def _shifted(scene: "Scene", name: str, axis: int, by_m: float) -> "Scene":
    """The scene with an object elsewhere, and all that it carries."""
    if isinstance(by_m, bool) or not isinstance(by_m, int | float) or not np.isfinite(by_m):
        raise InputError(
            f"scene.objects.{name}.shift_{'xyz'[axis]}_m = {by_m!r}: expected a number"
        )
    shift = np.eye(3)[axis] * by_m
    meant = [o for o in scene.objects if o.name == name or (name == "*" and not o.parent)]

    def target(item: "Target") -> "Target":
        x, y, z = (np.asarray(item.position_m) + shift).tolist()
        return replace(item, position_m=(x, y, z))

    return _with_objects(scene, {o.name: o.moved(shift) for o in meant}, target)


def _moved(pose: "Pose", what: str, value: Any) -> "Pose":
    if not isinstance(value, Real):
        raise InputError(f"scene.rig.{what} = {value!r:.60}: expected a number")
    if what in _ANGLES:
        angle: dict[str, Any] = {what: float(value)}
        return replace(pose, **angle)
    place = list(pose.position_m)
    place["xyz".index(what[0])] = float(value)
    return replace(pose, position_m=(place[0], place[1], place[2]))
