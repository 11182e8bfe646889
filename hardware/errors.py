"""Errors of the vehicle's software, by kind; each is also the built-in error of its kind.

`HardwareError` is the root: what a command answers with one line. Anything else, a ValueError out
of a library among them, is a fault of the software itself.
"""

import math
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


def check_count(name: str, value: Any, least: int = 1) -> None:
    """Raise InputError unless an argument is a whole number from ``least`` on."""
    if not is_whole(value) or value < least:
        raise InputError(f"{name}: {value!r:.60}, expected a whole number from {least} on")


def check_finite(name: str, value: object) -> None:
    """Raise InputError unless an argument is a finite number."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise InputError(f"{name}: {value!r:.60}, expected a finite number")


class DeviceError(HardwareError, ValueError):
    """A device refused a request, or does not do what its protocol says."""


class LinkError(HardwareError, ConnectionError):
    """The line to a device is gone: unplugged, closed by the other side, or it takes no bytes."""


class NoAnswerError(LinkError, TimeoutError):
    """The line is there, but nobody answers on it."""
