"""Errors of the vehicle's software, by kind; each is also the built-in error of its kind.

`HardwareError` is the root: what a command answers with one line. Anything else, a ValueError out
of a library among them, is a fault of the software itself.
"""

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any


class HardwareError(Exception):
    """What this package raises when something other than its own code is wrong."""


class InputError(HardwareError, ValueError):
    """A file, an argument or a record is wrong; the message names it and what was expected."""


def check_kind(name: str, value: object, kind: type, given_by: str) -> None:
    """Raise InputError unless an argument is of its kind, with what gives one."""
    if not isinstance(value, kind):
        raise InputError(
            f"{name} = {value!r:.60}: expected a {kind.__name__}, as {given_by} gives it"
        )


def is_whole(value: object) -> bool:
    """Whether a value is a whole number by its kind, Python's or NumPy's."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_count(name: str, value: Any, least: int = 1, most: int | None = None) -> None:
    """Raise InputError unless an argument is a whole number from ``least`` on, up to ``most``."""
    if not is_whole(value) or value < least or (most is not None and value > most):
        limit = "" if most is None else f", at most {most}"
        raise InputError(f"{name}: {value!r:.60}, expected a whole number from {least} on{limit}")


def check_index(name: str, value: Any, size: int) -> None:
    """Raise InputError unless an argument is the place of one of ``size`` things of a record."""
    if not is_whole(value) or not 0 <= value < size:
        raise InputError(
            f"{name}: {value!s:.60}, the record holds {size}, expected a whole number from 0 on "
            "below that"
        )


def check_finite(name: str, value: object, within: float = math.inf) -> None:
    """Raise InputError unless an argument is a finite number, at most ``within`` either way."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number or not _is_finite(value) or abs(value) > within:  # type: ignore[arg-type]
        limit = "" if math.isinf(within) else f" within +/- {within:.9g}"
        raise InputError(f"{name}: {value!r:.60}, expected a finite number{limit}")


def _is_finite(value: Real) -> bool:
    """Whether a number is finite as a double, which whole numbers from 1.8e308 on are not."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def check_positive(name: str, value: Any) -> None:
    """Raise InputError unless an argument is a finite number above 0."""
    check_finite(name, value)
    if value <= 0:
        raise InputError(f"{name}: {value!r:.60} is not a positive number")


def check_between(name: str, value: Any, least: float, most: float) -> None:
    """Raise InputError unless an argument is a positive number from ``least`` to ``most``."""
    check_positive(name, value)
    if not least <= value <= most:
        raise InputError(f"{name}: {value!r:.60}, expected a number from {least:g} to {most:g}")


def check_switch(name: str, value: object) -> None:
    """Raise InputError unless an argument is True or False."""
    if not isinstance(value, bool):
        raise InputError(f"{name}: {value!r:.60}, expected True or False")


def check_choice(name: str, value: object, choices: Sequence[str]) -> None:
    """Raise InputError unless an argument is one of some words."""
    if not isinstance(value, str) or value not in choices:
        raise InputError(f"{name}: {value!r:.60} is none of {', '.join(choices)}")


class DeviceError(HardwareError, ValueError):
    """A device refused a request, or does not do what its protocol says."""


class LinkError(HardwareError, ConnectionError):
    """The line to a device is gone: unplugged, closed by the other side, or it takes no bytes."""


class NoAnswerError(LinkError, TimeoutError):
    """The line is there, but nobody answers on it."""
