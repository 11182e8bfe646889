"""Settings of a camera's measurement, and the TOML file that holds them."""

import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from hardware.drivers.messages import MAX_SHUTTERS
from hardware.errors import InputError
from hardware.files import read_toml, whole_file
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
    integration_time_s
        Time for which one exposure collects light.
    pattern_period_s
        From the beginning of one exposure to the next; 0: the shortest that the device can.
    gain
        Step of the device's amplifier, from 0.
    exposures_per_frame
        Exposures that the device sends together; 0: it chooses.
    shutters
        For time of flight, each pattern is shown once behind each: modulation frequency (Hz), phase
        (rad), delay of a gate (s), its width (s). All 0: always open.
    pulse_width_s
        Length of the emitter's pulse where the shutters are gates, for the records.
    pose
        Of the rig, for the records: x, y, z (m) and the quaternion, real part first.
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


_PATTERN_FIELDS = tuple(field.name for field in fields(PatternSet))
_FILE_FIELDS = ("file", "mode")


def read_settings(path: str | Path) -> SpiSettings:
    """Read a file: the fields of `SpiSettings`, and those of `PatternSet` in a table ``patterns``;
    or of a user's own patterns ``file``, beside it, and ``mode``. Times may say their unit:
    ``integration_time_s = "315 us"``.

    Raises FileNotFoundError; InputError naming the file and the field.
    """
    try:
        content = read_toml(path)
    except InputError as error:
        raise InputError(
            f"{error}; expected a camera's settings, patterns and times in TOML"
        ) from error
    try:
        table = content.pop("patterns", None)
        known = [field.name for field in fields(SpiSettings)]
        _check_names("", content, known, ())
        if not isinstance(table, dict):
            shown = "patterns: missing" if table is None else f"patterns = {table!r:.60}"
            raise InputError(f"{shown}: expected a table of rows, columns, count")
        _check_names("", content, known, ("integration_time_s",))
        patterns = _patterns(_tuples(table), Path(path).parent)
        return SpiSettings(patterns, **_state({n: _in_unit(n, v) for n, v in content.items()}))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error


def write_settings(settings: SpiSettings, path: str | Path) -> None:
    """Write a file that `read_settings` reads back, whole or not at all; a user's own patterns go
    to ``NAME-patterns.npy`` beside it.
    """
    path, shown = Path(path), settings.patterns
    if isinstance(shown, OwnPatterns):
        beside = path.with_name(f"{path.stem}-patterns.npy")
        table_file = io.BytesIO()  # written to a full disk, NumPy's error has no number
        np.save(table_file, np.uint8(shown.levels > 0))
        with whole_file(beside) as partial:
            partial.write_bytes(table_file.getvalue())
        table: dict[str, Any] = {"file": beside.name, "mode": shown.mode}
    else:
        table = {name: getattr(shown, name) for name in _PATTERN_FIELDS}
    state = {f.name: getattr(settings, f.name) for f in fields(settings) if f.name != "patterns"}
    text = "\n".join([*_lines(state), "", "[patterns]", *_lines(table)])
    with whole_file(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")


def _lines(values: Mapping[str, Any]) -> list[str]:
    """``name = value``: finite numbers, text and lists of them are the same in JSON and TOML."""
    return [
        f"{name} = {json.dumps(value, allow_nan=False, ensure_ascii=False)}"
        for name, value in values.items()
        if value is not None
    ]


def _check_names(
    table: str, given: Iterable[str], known: Iterable[str], needed: Iterable[str]
) -> None:
    """Raise InputError for a field that is unknown or missing."""
    known, given = list(known), list(given)
    for name in given:
        if name not in known:
            raise InputError(f"{table}{name}: no such field, expected {', '.join(known)}")
    for name in needed:
        if name not in given:
            raise InputError(f"{table}{name}: missing")


def _patterns(table: dict[str, Any], folder: Path) -> Patterns:
    if "file" in table:
        if unknown := sorted(set(table) - set(_FILE_FIELDS)):
            raise InputError(
                f"patterns.{unknown[0]}: patterns of a file have `file` and `mode` alone"
            )
        if not isinstance(table["file"], str):
            raise InputError(f"patterns.file: {table['file']!r:.60}, expected the name of a file")
        return own_patterns(folder / table["file"], table.get("mode", "differential"))
    needed = ("rows", "columns", "count")
    _check_names("patterns.", table, (*_PATTERN_FIELDS, "file"), needed)
    for name in needed:
        _check_whole(f"patterns.{name}", table[name])
    subset = table.get("subset")
    if subset is not None and not isinstance(subset, tuple):
        raise InputError(f"patterns.subset: {subset!r:.60}, expected a list of rows")
    for row in subset or ():
        _check_whole("patterns.subset", row)
    try:
        return PatternSet(**table)
    except InputError as error:
        raise InputError(f"patterns.{error}") from error


def _check_whole(name: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(f"{name}: {value!r:.60}, expected a whole number")


def _state(given: dict[str, Any]) -> dict[str, Any]:
    """Fields with pose and shutters as their types."""
    made = dict(given)
    if "pose" in made:
        with _naming("pose", made["pose"], "a list of 7 numbers"):
            made["pose"] = QuaternionPose.from_numbers(made["pose"])
    if "shutters" in made:
        with _naming("shutters", made["shutters"], "a list of lists of 4 numbers"):
            made["shutters"] = tuple(map(Shutter.from_numbers, made["shutters"]))
    for name in ("integration_time_s", "pattern_period_s", "pulse_width_s"):
        value = made.get(name, 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{name}: {value!r:.60}, expected a number of seconds")
    if not isinstance(made.get("upload", False), bool):
        raise InputError(f"upload: {made['upload']!r:.60}, expected true or false")
    return made


@contextmanager
def _naming(name: str, value: Any, expected: str) -> Iterator[None]:
    """Errors say which field a value was given for."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: {value!r:.60}, expected {expected}") from error


def _in_unit(name: str, value: Any) -> Any:
    unit = unit_of(name)
    if not isinstance(value, str) or unit is None:
        return value
    try:
        return quantity(value, unit)
    except InputError as error:
        raise InputError(f"{name} = {value!r:.60}: {error}") from None


def _tuples(given: dict[str, Any]) -> dict[str, Any]:
    def frozen(value: Any) -> Any:
        return tuple(map(frozen, value)) if isinstance(value, list) else value

    return {name: frozen(value) for name, value in given.items()}
