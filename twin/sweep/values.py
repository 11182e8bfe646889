"""Values of a study that no point may have, whatever stands beside them: told before any point."""

import math
from collections.abc import Iterator

import numpy as np

from twin.fidelity import Tolerance
from twin.files import InputError
from twin.own_parts import own_part
from twin.radar.device.design import RadarDesign
from twin.sweep.accuracy_names import TOLERANCE
from twin.sweep.inputs import ChangedError, Inputs
from twin.sweep.names import needs_radar
from twin.sweep.parameters import check_bounds, check_value, full_name
from twin.sweep.setup import fidelity_of, part_section, seed_of
from twin.sweep.study import Study, Value
from twin.system import System
from twin.toml import Entry

_ENTRIES: dict[str, type[Entry]] = {"system": System, "radar": RadarDesign}
#: Of a longer list the least and the most alone: what a field may be is a range.
_MOST_EACH = 1000


def check_values(study: Study, inputs: Inputs) -> None:
    """Raise InputError, naming parameter and value, for what no point may have. What depends on
    other values as well is left to the points.
    """
    has_radar = needs_radar(study.metrics)
    for name, value in _given(study):
        root, _, rest = full_name(name).partition(".")
        if root == "radar" and not has_radar:
            continue
        try:
            _check(name, root, rest, value, inputs)
            if name == TOLERANCE and not has_radar:
                _check_without_radar(Tolerance.of(str(value)))
        except ChangedError:
            raise
        except InputError as error:
            said = "" if str(error).startswith(name) else f"{name} = {value!r:.60}: "
            raise InputError(f"{said}{error}") from error


def _check_without_radar(tolerance: Tolerance) -> None:
    try:
        tolerance.check_sensors(camera=True, radar=False)
    except InputError as error:
        raise InputError(f"no metric of this study looks at the radar: {error}") from None


def _given(study: Study) -> Iterator[tuple[str, Value]]:
    """Each value that a parameter is given somewhere, in its unit."""
    for name, value in study.set.items():
        yield name, check_value(name, value)
    for axis in study.axes:
        for name, column in axis.columns.items():
            values = np.unique(column).tolist()  # in their order, NaN as the last
            if len(values) > _MOST_EACH and not isinstance(values[0], str):
                values = [values[0], values[-1]]
            for value in values:
                yield name, value


def _check(name: str, root: str, rest: str, value: Value, inputs: Inputs) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError("expected a finite number")
    section, _, field = rest.partition(".")
    if root in ("scene", "system", "radar") and not rest:
        inputs.get(root, str(value))
    elif field == "part":
        part_section(section, str(value), inputs)
    elif field == "function":
        own_part(rest, inputs.get("function", str(value)))
    elif root in _ENTRIES:
        try:
            _ENTRIES[root].sections()[section].check_alone(field, value)
        except InputError as error:
            raise InputError(f"{name.rpartition('.')[0]}.{error}") from error
    elif root == "scene" and rest.endswith(".reflectance"):
        check_bounds(name, value, True, 1.0)
    elif root == "fidelity" and rest != "tolerance":
        fidelity_of({rest: value}, None, inputs)
    elif root == "seed":
        seed_of(value)
    elif rest == "detection" and value:
        inputs.get("detection", str(value))
