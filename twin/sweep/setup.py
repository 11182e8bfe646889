"""From a point's values to what is simulated: scene, system, radar, fidelity, method."""

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from twin.fidelity import Fidelity, preset
from twin.files import InputError
from twin.radar.device.design import RadarDesign
from twin.scene import Pose, Scene, SceneObject, Target
from twin.sweep.inputs import Held, Inputs, beside
from twin.sweep.names import needs_radar
from twin.sweep.study import Study, Value
from twin.system import System
from twin.toml import Entry, describe, without_rivals

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
    seed: int
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


def setup(study: Study, values: Values, inputs: Inputs) -> Setup:
    """Setup of a point. Raises InputError or ValueError naming the parameter."""
    groups = _groups(values)
    radar = None
    if needs_radar(study.metrics):
        radar = _entry("radar", study.radar, groups.get("radar", {}), inputs)
    scene_values = tuple(sorted(groups.get("scene", {}).items()))
    name = str(groups.get("scene", {}).get("", study.scene))
    return Setup(
        scene=_scene(name, scene_values, inputs),
        scene_values=scene_values,
        system=system_of(study, values, inputs),
        radar=radar,
        fidelity=_fidelity(groups.get("fidelity", {})),
        method=str(groups.get("processing", {}).get("method", "lmmse")),
        seed=_seed(groups.get("seed", {}).get("", study.seed)),
    )


def system_of(study: Study, values: Values, inputs: Inputs) -> System:
    """System of a point. Raises InputError or ValueError naming the parameter."""
    found: System = _entry("system", study.system, _groups(values).get("system", {}), inputs)
    return found


def _groups(values: Values) -> dict[str, Values]:
    """Values by the root of their names, each with the rest of its name."""
    groups: dict[str, Values] = {}
    for name, value in values.items():
        root, _, rest = name.partition(".")
        if root == "weather":
            root, rest = "system", name
        groups.setdefault(root, {})[rest] = value
    return groups


def _seed(value: Value) -> int:
    if not isinstance(value, int) or value < 0:
        raise InputError(f"seed = {value!r}: expected a whole number from 0")
    return value


def _fidelity(values: Values) -> Fidelity:
    base = preset(str(values.get("preset", "standard")))
    return base.with_(**{name: v for name, v in values.items() if name != "preset"})


_entries, _scenes = Held(256), Held(64)  # most points share theirs


def _entry(root: str, name: str, values: Values, inputs: Inputs) -> Any:
    """A system or radar with values in place of its own."""
    name, changes = str(values.get("", name)), tuple(sorted(values.items()))

    def make() -> System | RadarDesign:
        base: System | RadarDesign = inputs.get(root, name)
        return changed(base, changes, inputs)

    return _entries.get((inputs.stamp, root, name, changes), make)


def changed(entry: E, values: tuple[tuple[str, Value], ...], inputs: Inputs) -> E:
    """An entry with values, by ``SECTION.FIELD``, in place of its own. Raises InputError."""
    if not any(name for name, _ in values):
        return entry
    content = entry.model_dump()
    given: dict[str, set[str]] = {}
    for name, value in sorted(values, key=lambda item: not item[0].endswith(".part")):
        section, _, field = name.partition(".")
        if not field:
            continue
        if field == "part":
            part = getattr(inputs.get("part", str(value)), section, None)
            if part is None:
                raise InputError(f"{section}.part = {value!r}: this part has no {section}")
            content[section] = part.model_dump()
        else:
            if field.endswith(("_csv", "_file")):
                value = str(beside(str(value), inputs.folder))
            content[section] = (content.get(section) or {}) | {
                field: {"value": value, "assumed": "swept"}
            }
            given.setdefault(section, set()).add(field)
    for section, fields in given.items():
        content[section] = without_rivals(type(entry), section, content[section], fields)
    try:
        return type(entry).model_validate(content)
    except ValidationError as error:
        raise InputError(f"{type(entry).__name__.lower()}: {describe(error)}") from error


def _scene(name: str, values: tuple[tuple[str, Value], ...], inputs: Inputs) -> Scene:
    def make() -> Scene:
        scene: Scene = inputs.get("scene", name)
        for field, value in values:
            if field:
                scene = _with(scene, field, float(value))
        return scene

    return _scenes.get((inputs.stamp, name, values), make)


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
    if group == "targets":
        sized = (replace(t, rcs_m2=value) if name in ("*", t.name) else t for t in scene.targets)
        return replace(scene, targets=tuple(sized))
    if what != "reflectance":
        return _shifted(scene, name, "xyz".index(what[len("shift_")]), value)
    painted = (_repainted(o, value) if name in ("*", o.name) else o for o in scene.objects)
    return replace(scene, objects=tuple(painted))


def _shifted(scene: Scene, name: str, axis: int, by_m: float) -> Scene:
    """The scene with an object elsewhere, and the targets that it carries."""
    shift = np.eye(3)[axis] * by_m

    def target(item: Target) -> Target:
        x, y, z = (np.asarray(item.position_m) + shift).tolist()
        return replace(item, position_m=(x, y, z))

    return replace(
        scene,
        objects=tuple(
            replace(o, vertices_m=o.vertices_m + shift) if name in ("*", o.name) else o
            for o in scene.objects
        ),
        targets=tuple(
            target(t) if t.object is not None and name in ("*", t.object) else t
            for t in scene.targets
        ),
    )


def _moved(pose: Pose, what: str, value: float) -> Pose:
    if what in ("yaw_deg", "pitch_deg", "roll_deg"):
        return replace(pose, **{what: value})  # type: ignore[arg-type]
    place = list(pose.position_m)
    place["xyz".index(what[0])] = value
    return replace(pose, position_m=(place[0], place[1], place[2]))


def _repainted(item: SceneObject, reflectance: float) -> SceneObject:
    if not 0 <= reflectance <= 1:
        raise InputError(
            f"scene.objects.{item.name}.reflectance = {reflectance:g}: expected 0 to 1"
        )
    return replace(item, reflectance=reflectance)
