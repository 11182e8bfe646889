"""Schedule and front end of a radio as a JSON file, which a driver needs."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from hardware.drivers.radio.schedule import Schedule
from hardware.errors import InputError
from hardware.files import read_json, whole_file
from hardware.records.state import RadarFrontEnd
from hardware.waveform import OfdmWaveform

FORMAT, VERSION = "ugv-radio-setup", 1

_NESTED = ("waveform", "carriers_hz")
_PLACES = ("transmitters_m", "receivers_m")


def write_setup(schedule: Schedule, front_end: RadarFrontEnd, path: str | Path) -> None:
    """Write both to one file, whole or not at all; what is unknown (NaN) is null in it."""
    sent = asdict(replace(schedule, waveform=replace(schedule.waveform, symbols="flat")))
    del sent["waveform"]["own"]
    pairs = schedule.waveform.own_symbols
    sent["waveform"]["symbols"] = schedule.waveform.symbols if pairs is None else pairs.tolist()
    known: dict[str, Any] = {"level": schedule.level}
    del sent["level"]  # stands beside the power that belongs to it
    for name, value in vars(front_end).items():
        known[name] = value.tolist() if name in _PLACES else None if math.isnan(value) else value
    content = {"format": FORMAT, "version": VERSION, "schedule": sent}
    with whole_file(path) as partial:
        partial.write_text(json.dumps({**content, "front_end": known}, indent=1) + "\n")


def read_setup(path: str | Path) -> tuple[Schedule, RadarFrontEnd]:
    """Read what `write_setup` wrote.

    Raises FileNotFoundError; InputError for a file that is none, of another version, or with a
    field that is missing, unknown or wrong.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such setup")
    content = read_json(path)
    try:
        header = (content.get("format"), content.get("version"))
        if header != (FORMAT, VERSION):
            raise InputError(f"format and version {header}, expected {(FORMAT, VERSION)}")
        schedule, front_end = content["schedule"], content["front_end"]
        schedule = {k: v if k in _NESTED else _number(k, v) for k, v in schedule.items()}
        schedule["waveform"] = OfdmWaveform(**schedule["waveform"])
        schedule["carriers_hz"] = tuple(float(hz) for hz in schedule["carriers_hz"])
        front_end = {
            k: np.array(v, np.float64) if k in _PLACES else _number(k, v)
            for k, v in front_end.items()
        }
        if "level" in front_end:
            schedule["level"] = front_end.pop("level")
        return Schedule(**schedule), RadarFrontEnd(**front_end)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        text = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: {text}") from error


def _number(name: str, value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name}: {value!r} is not a number")
    return float(value)
