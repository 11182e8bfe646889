"""Parameters of a study: dotted names, checked against what there is, and their values with units.

``system.SECTION.FIELD``, ``system.SECTION.part``, ``system``; ``weather.FIELD`` for
``system.weather.FIELD``; ``scene``, ``scene.rig.x_m`` (y, z; yaw, pitch, roll in deg),
``scene.sun.FIELD``, ``scene.objects.NAME.reflectance`` and ``.shift_x_m`` (y, z; NAME may be
``*``), ``scene.targets.NAME.rcs_m2``; ``fidelity.tolerance``
(as `Tolerance.of` reads it), ``fidelity.preset``, ``fidelity.KNOB``;
``radar.SECTION.FIELD``; ``seed``; ``processing.method``, ``processing.detection`` (empty: the
vehicle's own); ``link.distance_m`` and ``link.reflectance`` of the closed form.
"""

import difflib
import math
import re
from dataclasses import fields
from functools import lru_cache

from hardware.units import quantity, unit_of
from twin.errors import InputError
from twin.fidelity import REPLACED, Fidelity, Tolerance
from twin.radar.device.design import RadarDesign
from twin.scene.changes import SCENE_NAMES, check_scene_name
from twin.system import System
from twin.toml import Entry

Value = bool | int | float | str

#: The closed form's own: whether each may be 0, and the most it may be.
LINK = {"link.distance_m": (False, 1e12), "link.reflectance": (True, 1.0)}
#: What a new render is not needed for.
_LATER = re.compile(
    r"(system|weather|scene)?\.?(system\.)?("
    r"detector\.(?!shape|pixels|part)|readout\.|acquisition\.|sky\.|filter\.|detector\.part|"
    r"emitter\.(radiant|peak|line|spectrum|contrast|intensity|switching|kind|source)|"
    r"optics\.(f_number|transmission))|processing\.|fidelity\.noise|radar\.|link\.|scene\.targets|"
    r"scene\.sun\.illuminance|scene\.objects\..*\.reflectance"
)


def is_optical(name: str) -> bool:
    """Whether a parameter may change what is rendered; it only decides the order of the work."""
    return _LATER.match(name) is None


def full_name(name: str) -> str:
    """A parameter's name from its root on: ``weather.FIELD`` is one of the system."""
    return f"system.{name}" if name.partition(".")[0] == "weather" else name


def check_name(name: str) -> None:
    """Raise InputError, with the nearest name, for a parameter that does not exist."""
    if name in _plain_names():
        return
    if name.startswith("scene."):
        check_scene_name(name.removeprefix("scene."))
        return
    section, _, knob = name.rpartition(".")
    if section == "fidelity" and knob in REPLACED:
        raise InputError(f"{name}: is no parameter any more; it {REPLACED[knob]}")
    raise InputError(f"{name}: is no parameter; {_hint(name)}")


def _hint(name: str) -> str:
    """The nearest name; where none is near, those of the same section, or the roots."""
    if near := difflib.get_close_matches(name, _plain_names(), n=1):
        return f"did you mean {near[0]}?"
    section, _, _ = name.rpartition(".")
    beside = [known for known in _plain_names() if section and known.startswith(f"{section}.")]
    roots = dict.fromkeys(known.partition(".")[0] for known in _plain_names())
    return f"there are {', '.join(beside or (f'{root}…' for root in roots))}"


def check_value(name: str, value: Value) -> Value:
    """A value in the unit of the parameter; text with a unit ("315 us", "85 %") is converted.

    Raises InputError for an unknown parameter, for a unit of another kind, and for a distance or
    reflectance of the closed form that can't be.
    """
    check_name(name)
    if name == "fidelity.tolerance":
        Tolerance.of(str(value)).knobs()  # refuses what depends on a scene
        return value
    if isinstance(value, str) and (unit_of(name) or value.rstrip().endswith("%")):
        try:
            value = quantity(value, unit_of(name))
        except InputError as error:
            raise InputError(f"{name} = {value!r:.60}: {error}") from None
    if name in LINK:
        check_bounds(name, value, *LINK[name])
    return value


def check_bounds(name: str, value: Value, may_be_zero: bool, most: float) -> None:
    """Raise InputError for what is no finite number above 0, or from 0, up to ``most``."""
    if isinstance(value, bool | str):
        raise InputError(f"{name} = {value!r}: expected a number")
    within = math.isfinite(value) and 0 <= value <= most
    if not within or (value == 0 and not may_be_zero):
        wanted = "0 to 1" if most == 1 else "a positive number"
        wanted += f" up to {most:g}" if 1 < most < math.inf else ""
        raise InputError(f"{name} = {value}: expected {wanted}")


@lru_cache(maxsize=1)
def _plain_names() -> tuple[str, ...]:
    names = ["scene", "system", "radar", "seed", "fidelity.preset", "fidelity.tolerance"]
    names += ["processing.method", "processing.detection"]
    names += [f"scene.{name}" for name in SCENE_NAMES]
    names += [f"fidelity.{field.name}" for field in fields(Fidelity)]
    names += LINK
    models: tuple[tuple[str, type[Entry]], ...] = (("system", System), ("radar", RadarDesign))
    for root, model in models:
        for section, part in model.sections().items():
            names += [f"{root}.{section}.{field}" for field in part.model_fields]
            if root == "system":
                names.append(f"system.{section}.part")
    weather = [name.removeprefix("system.") for name in names if ".weather." in name]
    return tuple(names + weather)
