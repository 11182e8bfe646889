"""Injected faults of virtual devices, with their probabilities."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

from twin.files import InputError


@dataclass(frozen=True)
class RadioFaults:
    """Probabilities per burst, by the names of `hardware.drivers.radio.Fault`.

    ``stall``: the radio does not answer for ``stall_s``. ``drop``: it drops its client silently.
    """

    overflow: float = 0.0
    late: float = 0.0
    out_of_sequence: float = 0.0
    underflow: float = 0.0
    stall: float = 0.0
    stall_s: float = 1.0
    drop: float = 0.0

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True)
class CameraFaults:
    """Probabilities per frame sent, and the drift of the camera's clock.

    ``drop``, ``duplicate``, ``reorder`` (with the next frame), ``flip`` (one bit), ``split`` (sent
    in pieces), ``stall`` (the line is silent for ``stall_s``), ``reset`` (the camera restarts),
    ``overrun`` (the ADC misses the frame's exposures), ``hang_up`` (a TCP connection is closed).
    """

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    flip: float = 0.0
    split: float = 0.0
    stall: float = 0.0
    stall_s: float = 0.1
    reset: float = 0.0
    overrun: float = 0.0
    hang_up: float = 0.0
    drift: float = 0.0

    def __post_init__(self) -> None:
        _check(self)


def _check(faults: "RadioFaults | CameraFaults") -> None:
    for name in (field.name for field in fields(faults)):
        value, most = getattr(faults, name), 3600.0 if name == "stall_s" else 1.0
        if not (math.isfinite(value) and 0 <= value <= most):
            raise InputError(f"fault {name}: {value}, expected 0 to {most:g}")


_Faults = TypeVar("_Faults", RadioFaults, CameraFaults)


def parse_faults(texts: Sequence[str], kind: type[_Faults]) -> _Faults:
    """Faults from texts ``NAME=CHANCE``. Raises InputError for invalid ones."""
    known = {field.name for field in fields(kind)}
    chances: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if name not in known:
            raise InputError(f"fault {name!r}: expected {', '.join(sorted(known))}")
        try:
            chances[name] = float(value)
        except ValueError as error:
            raise InputError(f"fault {name}: {value!r}, expected a number") from error
    return kind(**chances)
