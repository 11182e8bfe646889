"""Faults on request: what a virtual device does wrong, and how often."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from twin.files import InputError


@dataclass(frozen=True)
class RadioFaults:
    """Chances per burst, 0 to 1, by the names of `hardware.drivers.radio.Fault`.

    ``stall``: the radio is silent for ``stall_s``. ``drop``: it forgets its client without a word.
    """

    overflow: float = 0.0
    late: float = 0.0
    out_of_sequence: float = 0.0
    underflow: float = 0.0
    stall: float = 0.0
    stall_s: float = 1.0
    drop: float = 0.0

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            value, most = getattr(self, name), 3600.0 if name == "stall_s" else 1.0
            if not (math.isfinite(value) and 0 <= value <= most):
                raise InputError(f"fault {name}: {value}, expected 0 to {most:g}")


def parse_faults(texts: Sequence[str]) -> RadioFaults:
    """Faults from ``NAME=CHANCE`` each. Raises InputError for what is none."""
    known = {field.name for field in fields(RadioFaults)}
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if name not in known:
            raise InputError(f"fault {name!r}: expected {', '.join(sorted(known))}")
        try:
            found[name] = float(value)
        except ValueError as error:
            raise InputError(f"fault {name}: {value!r}, expected a number") from error
    return RadioFaults(**found)
