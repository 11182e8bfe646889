"""What numbers of a scene may be: checked wherever one is set."""

import math
from typing import Any

import numpy as np

from twin.files import InputError

#: Delays are computed to first order in v / c.
FASTEST_M_PER_S = 1e5
#: Above the atmosphere the sun gives some 1.3e5 lx.
BRIGHTEST_LX = 1e7
#: A vertex farther from the rig is taken for a fault of the file: float32 rays lose 0.3 % of the
#: light on a wall of half-size 1e4 m and 27 % on one of 1e6 m.
FARTHEST_M = 1e5

#: A rig farther from the origin is taken for a fault: float64 has steps of 0.1 um there.
FARTHEST_ORIGIN_M = 1e9
#: An angle beyond it is taken for a fault: float64 has steps of 1e-7 deg there.
MOST_TURN_DEG = 1e9
#: Thirty years: a time beyond it is taken for a fault.
LATEST_S = 1e9


def check(name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> None:
    """Raise InputError for what is no finite number between both ends."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and math.isfinite(value) and low <= value <= high):
        wanted = "a finite number" if high == math.inf else f"{low:g} to {high:g}"
        raise InputError(f"scene.{name} = {value!r:.60}: expected {wanted}")


def check_above_zero(name: str, value: Any) -> None:
    """Raise InputError for what is no finite number above 0."""
    check(name, value)
    if value <= 0:
        raise InputError(f"scene.{name} = {value!r}: expected a number above 0")


def check_vector(name: str, value: Any, most: float = math.inf) -> None:
    """Raise InputError for what is not three finite numbers of at most ``most``."""
    if isinstance(value, str) or np.shape(value) != (3,):
        raise InputError(f"scene.{name} = {value!r:.60}: expected three numbers")
    for part in value:
        check(name, part, -most, most)
