"""Errors of the simulator, by kind.

`TwinError` is the root: what a command answers with one line. What is wrong with an input is also
the vehicle's own error for that, so that ``ugv capture twin:SCENE`` answers it in the same way.
"""

from hardware.errors import InputError as VehicleInputError


class TwinError(Exception):
    """What this package raises when something other than its own code is wrong."""


class InputError(TwinError, VehicleInputError):
    """What the user gave is wrong; the message names the file, the field and what was expected."""


class EngineError(TwinError, RuntimeError):
    """The renderer can't be started on this machine, or what computes with it fails."""
