"""Settings of a camera's measurement, also from a TOML file."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hardware.drivers.messages import MAX_SHUTTERS
from hardware.errors import InputError
from hardware.files import read_toml
from hardware.patterns import OwnPatterns, Patterns, PatternSet, own_patterns
from hardware.records.state import ALWAYS_OPEN, AT_ORIGIN, QuaternionPose, Shutter
from hardware.units import quantity, unit_of


@dataclass(frozen=True, eq=False)
class SpiSettings:
    """What to measure.

    Parameters
    ----------
    patterns
        Shown over and over. By name where the device knows the order, else sent bit by bit; a
        user's own must be binary for that.
    integration_time_s, pattern_period_s
        Of one exposure, and from one to the next; period 0: the shortest.
    gain
        Step of the device's amplifier, from 0.
    exposures_per_frame
        0: the device chooses.
    shutters
        As in `SpiRecord`.
    pulse_width_s
        Length of the emitter's pulse where the shutters are gates, for the records.
    pose
        Of the rig, for the records.
    upload
        Send the patterns even where the device knows their order.
    """

    patterns: Patterns
    integration_time_s: float
    pattern_period_s: float = 0.0
    gain: int = 0
    exposures_per_frame: int = 0
    shutters: tuple[Shutter, ...] = (ALWAYS_OPEN,)
    pulse_width_s: float = 0.0
    pose: QuaternionPose = AT_ORIGIN
    upload: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.patterns, OwnPatterns):
            self.patterns.check_binary("a camera takes one bit per cell")
        if not 0 < self.integration_time_s < math.inf:
            raise InputError(f"integration_time_s: {self.integration_time_s} is not positive")
        if not 0 <= self.pattern_period_s < math.inf:
            raise InputError(
                f"pattern_period_s: {self.pattern_period_s} is not 0 or a positive number"
            )
        if not 0 <= self.pulse_width_s < math.inf:
            raise InputError(f"pulse_width_s: {self.pulse_width_s} is not 0 or a positive number")
        for name, most in (("gain", 0xFF), ("exposures_per_frame", 0xFFFF)):
            value = getattr(self, name)
            if not isinstance(value, int) or not 0 <= value <= most:
                raise InputError(f"{name}: {value} is no whole number between 0 and {most}")
        if not 1 <= len(self.shutters) <= MAX_SHUTTERS:
            raise InputError(f"shutters: {len(self.shutters)}, expected 1 to {MAX_SHUTTERS}")
        for name, make, values in (
            ("shutters", Shutter.from_numbers, self.shutters),
            ("pose", QuaternionPose.from_numbers, (self.pose,)),
        ):
            for value in values:
                try:
                    make(value)
                except InputError as error:
                    raise InputError(f"{name}: {error}") from error


def read_settings(path: str | Path) -> SpiSettings:
    """Read a file: the fields of `SpiSettings`, and those of `PatternSet` in a table ``patterns``;
    or of a user's own patterns ``file``, beside it, and ``mode``. Times may say their unit:
    ``integration_time_s = "315 us"``.

    Raises FileNotFoundError; InputError naming the file and the field.
    """
    fields = read_toml(path)
    table = fields.pop("patterns", {})
    if not isinstance(table, dict):
        raise InputError(
            f"{path}: patterns = {table!r:.60}: expected a table of rows, columns, count"
        )
    try:
        patterns = _patterns(_tuples(table), Path(path).parent)
        return SpiSettings(patterns, **_state({n: _in_unit(n, v) for n, v in fields.items()}))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: {str(error).replace('__init__()', 'it')}") from error


def _patterns(table: dict[str, Any], folder: Path) -> Patterns:
    if "file" not in table:
        return PatternSet(**table)
    if unknown := sorted(set(table) - {"file", "mode"}):
        raise InputError(f"patterns.{unknown[0]}: patterns of a file have `file` and `mode` alone")
    return own_patterns(folder / table["file"], table.get("mode", "differential"))


def _state(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields with pose and shutters as their types."""
    made = dict(fields)
    if "pose" in made:
        made["pose"] = QuaternionPose.from_numbers(made["pose"])
    if "shutters" in made:
        made["shutters"] = tuple(map(Shutter.from_numbers, made["shutters"]))
    return made


def _in_unit(name: str, value: Any) -> Any:
    unit = unit_of(name)
    if not isinstance(value, str) or unit is None:
        return value
    try:
        return quantity(value, unit)
    except InputError as error:
        raise InputError(f"{name} = {value!r:.60}: {error}") from None


def _tuples(fields: dict[str, Any]) -> dict[str, Any]:
    def frozen(value: Any) -> Any:
        return tuple(map(frozen, value)) if isinstance(value, list) else value

    return {name: frozen(value) for name, value in fields.items()}
