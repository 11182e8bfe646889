"""Errors of the simulator: the vehicle's own, by the same names, and that of the engine.

What is wrong with an input is one error on both sides, so that ``except twin.InputError`` also
catches what the vehicle's software, which the twin calls, finds wrong. `TwinError` is the root of
all of them: what a command answers with one line.
"""

from numbers import Integral

from hardware.errors import HardwareError as TwinError
from hardware.errors import InputError, check_kind

__all__ = ["EngineError", "InputError", "TwinError", "check_kind", "check_seed"]


def check_seed(seed: object) -> None:
    """Raise InputError for what is no whole number from 0."""
    if not isinstance(seed, Integral) or seed < 0:
        raise InputError(f"seed: {seed!r:.60}: expected a whole number from 0")


class EngineError(TwinError, RuntimeError):
    """The renderer can't be started on this machine, or what computes with it fails."""
