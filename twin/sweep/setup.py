"""From a point's values to what is simulated: scene, system, radar, fidelity, method."""

from dataclasses import dataclass
from typing import Any, TypeVar

from hardware.own_functions import is_file_function
from hardware.radar.own_detection import Detect, OwnDetection
from hardware.reconstruction import Method
from hardware.reconstruction.registry import Solve
from twin.fidelity import Accuracy, Fidelity, Tolerance, knobs_of
from twin.fidelity.knobs import NONE
from twin.files import InputError
from twin.radar.device.design import RadarDesign
from twin.scene import Scene
from twin.sweep.inputs import Held, Inputs
from twin.sweep.names import needs_radar
from twin.sweep.parameters import full_name
from twin.sweep.study import Study, Value
from twin.system import System
from twin.toml import Entry, names_file, placed

E = TypeVar("E", bound=Entry)
Values = dict[str, Value]


@dataclass(frozen=True, eq=False)
class Setup:
    """What is simulated in one point."""

    scene: Scene
    system: System
    radar: RadarDesign | None
    fidelity: Fidelity
    method: str | Method | Solve
    detection: OwnDetection | Detect | None
    seed: int
    scene_values: tuple[tuple[str, Value], ...]

    def scene_key(self, *, reflectances: bool = True) -> tuple[tuple[str, Value], ...]:
        """Tells scenes of one study apart, whatever the sun's illuminance, to which light is
        relative; without reflectances, those that differ by more.
        """
        return tuple(
            (name, "any" if name.endswith(".reflectance") and not reflectances else value)
            for name, value in self.scene_values
            if name != "sun.illuminance_lx"
        )


def setup(study: Study, values: Values, inputs: Inputs) -> Setup:
    """Setup of a point. Raises InputError naming the parameter."""
    groups = groups_of(values)
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
        fidelity=fidelity_of(groups.get("fidelity", {}), radar, inputs),
        method=_method(groups.get("processing", {}), inputs),
        detection=_detection(groups.get("processing", {}), inputs),
        seed=seed_of(groups.get("seed", {}).get("", study.seed)),
    )


def system_of(study: Study, values: Values, inputs: Inputs) -> System:
    """System of a point. Raises InputError naming the parameter."""
    found: System = _entry("system", study.system, groups_of(values).get("system", {}), inputs)
    return found


def groups_of(values: Values) -> dict[str, Values]:
    """Values by the root of their names, each with the rest of its name."""
    groups: dict[str, Values] = {}
    for name, value in values.items():
        root, _, rest = full_name(name).partition(".")
        groups.setdefault(root, {})[rest] = value
    return groups


def _method(values: Values, inputs: Inputs) -> str | Method | Solve:
    name = str(values.get("method", "lmmse"))
    if ":" in name or f"method {name}" in inputs.objects:
        own: Method | Solve = inputs.get("method", name)
        return own
    return name


def _detection(values: Values, inputs: Inputs) -> OwnDetection | Detect | None:
    name = str(values.get("detection", ""))
    return inputs.get("detection", name) if name else None


def seed_of(value: Value) -> int:
    """A seed. Raises InputError."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, int) or value < 0:
        raise InputError(f"seed = {value!r}: expected a whole number from 0")
    return value


def fidelity_of(values: Values, radar: RadarDesign | None, inputs: Inputs) -> Fidelity:
    """Knobs over the preset or tolerance that is named; without one over `standard`, as those of
    `Fidelity`; where no knob is named either, those of the default tolerance. Motion during a frame
    is followed where it is named alone: points would share no light, each being of its own times.
    """
    key = (inputs.stamp, tuple(sorted(values.items())), radar)
    return _fidelities.get(key, lambda: _new_fidelity(values, radar, inputs))


def _new_fidelity(values: Values, radar: RadarDesign | None, inputs: Inputs) -> Fidelity:
    given = {name: v for name, v in values.items() if name not in ("preset", "tolerance")}
    accuracy: Accuracy | None = "standard" if given else None
    knobs: Values = {"motion_tolerance": NONE, **given}
    if "preset" in values:
        name = str(values["preset"])
        accuracy = inputs.objects.get(f"fidelity {name}", name)
    elif "tolerance" in values:
        accuracy = Tolerance.of(str(values["tolerance"]))
    base = knobs_of(accuracy, radar.total_bandwidth_hz if radar else None)
    if is_file_function(str(knobs.get("radar", ""))):
        knobs["radar"] = placed("function", str(knobs["radar"]), inputs.folder)
    return base.with_(knobs)


_entries, _scenes, _fidelities = Held(256), Held(64), Held(64)  # most points share theirs


def _entry(root: str, name: str, values: Values, inputs: Inputs) -> Any:
    """A system or radar with values in place of its own."""
    name, changes = str(values.get("", name)), tuple(sorted(values.items()))

    def make() -> System | RadarDesign:
        base: System | RadarDesign = inputs.get(root, name)
        return changed(base, changes, inputs)

    return _entries.get((inputs.stamp, root, name, changes), make)


def changed(entry: E, values: tuple[tuple[str, Value], ...], inputs: Inputs) -> E:
    """An entry with values, by ``SECTION.FIELD``, in place of its own. Raises InputError."""
    changes: dict[str, Any] = {}
    for name, value in values:
        section, _, field = name.partition(".")
        if field == "part":
            changes[section] = part_section(section, str(value), inputs)
        elif field:
            if names_file(field) and isinstance(value, str):
                value = placed(field, value, inputs.folder)
            changes[name] = {"value": value, "assumed": "swept"}
    return entry.with_({"name": entry.name, **changes}) if changes else entry


def part_section(section: str, name: str, inputs: Inputs) -> Any:
    """What a part says of a section. Raises InputError where it has none."""
    found = getattr(inputs.get("part", name), section, None)
    if found is None:
        raise InputError(f"{section}.part = {name!r}: this part has no {section}")
    return found


def _scene(name: str, values: tuple[tuple[str, Value], ...], inputs: Inputs) -> Scene:
    def make() -> Scene:
        scene: Scene = inputs.get("scene", name)
        return scene.with_({field: value for field, value in values if field})

    return _scenes.get((inputs.stamp, name, values), make)
