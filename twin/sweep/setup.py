"""From a point's values to what is simulated: scene, system, radar, fidelity, method."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from twin.fidelity import Fidelity, preset
from twin.files import InputError
from twin.radar.device.design import RadarDesign, load_radar
from twin.scene import Pose, Scene, SceneObject, load_scene
from twin.sweep.names import RENDERED
from twin.sweep.study import Study, Value
from twin.system import System, load_part, load_system
from twin.toml import Entry, describe

E = TypeVar("E", bound=Entry)
Values = dict[str, Value]


@dataclass(frozen=True, eq=False)
class Setup:
    """What is simulated in one point."""

    scene: Scene
    system: System
    radar: RadarDesign | None
    fidelity: Fidelity
    method: str
    scene_values: tuple[tuple[str, Value], ...]

    def scene_key(self, *, painted: bool = True) -> tuple[tuple[str, Value], ...]:
        """Tells scenes of one study apart; without paint, those that differ by more than that."""
        if painted:
            return self.scene_values
        return tuple(
            (name, "any" if name.endswith(".reflectance") else value)
            for name, value in self.scene_values
            if name != "sun.illuminance_lx"
        )


def setup(study: Study, values: Values) -> Setup:
    """Setup of a point. Raises InputError or ValueError naming the parameter."""
    groups: dict[str, Values] = {}
    for name, value in values.items():
        root, _, rest = name.partition(".")
        if root == "weather":
            root, rest = "system", name
        groups.setdefault(root, {})[rest] = value
    radar = None
    if needs_radar(study):
        radar = _entry("radar", study.radar, study.folder, groups.get("radar", {}))
    scene_values = tuple(sorted(groups.get("scene", {}).items()))
    name = str(groups.get("scene", {}).get("", study.scene))
    return Setup(
        scene=_kept_scene(name, study.folder, scene_values),
        scene_values=scene_values,
        system=_entry("system", study.system, study.folder, groups.get("system", {})),
        radar=radar,
        fidelity=_fidelity(groups.get("fidelity", {})),
        method=str(groups.get("processing", {}).get("method", "lmmse")),
    )


def needs_radar(study: Study) -> bool:
    """Whether a metric looks at the radar."""
    return any(name in RENDERED and RENDERED[name].of_radar for name in study.metrics)


def _fidelity(values: Values) -> Fidelity:
    base = preset(str(values.get("preset", "standard")))
    return base.with_(**{name: v for name, v in values.items() if name != "preset"})


def _entry(root: str, name: str, folder: Path, values: Values) -> Any:
    """A system or radar with values in place of its own; kept, for most points share it."""
    return _kept_entry(root, str(values.get("", name)), folder, tuple(sorted(values.items())))


@lru_cache(maxsize=256)
def _kept_entry(
    root: str, name: str, folder: Path, values: tuple[tuple[str, Value], ...]
) -> System | RadarDesign:
    beside = folder / name
    source = beside if beside.is_file() else name
    if root == "radar":
        return changed(load_radar(source), values)
    return changed(load_system(source), values)


def changed(entry: E, values: tuple[tuple[str, Value], ...]) -> E:
    """An entry with values, by ``SECTION.FIELD``, in place of its own. Raises InputError."""
    if not any(name for name, _ in values):
        return entry
    content = entry.model_dump()
    for name, value in sorted(values, key=lambda item: not item[0].endswith(".part")):
        section, _, field = name.partition(".")
        if not field:
            continue
        if field == "part":
            part = getattr(load_part(str(value)), section, None)
            if part is None:
                raise InputError(f"{section}.part = {value!r}: this part has no {section}")
            content[section] = part.model_dump()
        else:
            content[section] = (content.get(section) or {}) | {
                field: {"value": value, "assumed": "swept"}
            }
    _drop_rivals(content, values)
    try:
        return type(entry).model_validate(content)
    except ValidationError as error:
        raise InputError(f"{type(entry).__name__.lower()}: {describe(error)}") from error


#: Of two fields that exclude each other, the one that is set replaces the other.
_RIVALS = {
    "sky.illuminance_lx": "sun_elevation_deg",
    "sky.sun_elevation_deg": "illuminance_lx",
    "readout.transimpedance_ohm": "feedback_capacitance_f",
    "readout.feedback_capacitance_f": "transimpedance_ohm",
}


def _drop_rivals(content: dict[str, Any], values: tuple[tuple[str, Value], ...]) -> None:
    for name, _ in values:
        if name in _RIVALS:
            content[name.partition(".")[0]].pop(_RIVALS[name], None)


@lru_cache(maxsize=8)
def _loaded_scene(name: str, folder: Path) -> Scene:
    beside = folder / name
    return load_scene(beside if beside.exists() else name)


@lru_cache(maxsize=64)
def _kept_scene(name: str, folder: Path, values: tuple[tuple[str, Value], ...]) -> Scene:
    scene = _loaded_scene(name, folder)
    for field, value in values:
        if field:
            scene = _with(scene, field, float(value))
    return scene


def _with(scene: Scene, field: str, value: float) -> Scene:
    group, _, rest = field.partition(".")
    if group == "rig":
        return scene.at(_moved(scene.rig.pose, rest, value))
    if group == "sun":
        return replace(scene, sun=replace(scene.sun, **{rest: value}))
    name, _, what = rest.rpartition(".")
    items: tuple[Any, ...] = getattr(scene, group)
    if name != "*" and name not in {item.name for item in items}:
        known = ", ".join(item.name for item in items) or "none at all"
        raise InputError(f"scene.{group}: no {name!r}; there are {known}")
    change = _repainted if group == "objects" else _resized
    changed = tuple(
        change(item, what, value) if name in ("*", item.name) else item for item in items
    )
    return replace(scene, **{group: changed})  # type: ignore[arg-type]


def _moved(pose: Pose, what: str, value: float) -> Pose:
    if what in ("yaw_deg", "pitch_deg", "roll_deg"):
        return replace(pose, **{what: value})  # type: ignore[arg-type]
    place = list(pose.position_m)
    place["xyz".index(what[0])] = value
    return replace(pose, position_m=(place[0], place[1], place[2]))


def _repainted(item: SceneObject, what: str, value: float) -> SceneObject:
    if what == "reflectance":
        if not 0 <= value <= 1:
            raise InputError(f"scene.objects.{item.name}.reflectance = {value:g}: expected 0 to 1")
        return replace(item, reflectance=value)
    shift = np.zeros(3)
    shift["xyz".index(what[len("shift_")])] = value
    return replace(item, vertices_m=item.vertices_m + shift)


def _resized(item: Any, what: str, value: float) -> Any:
    return replace(item, **{what: value})
