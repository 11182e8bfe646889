"""What both sensors' calibrations have: the reference target, the device, and warnings."""

from collections.abc import Iterable
from dataclasses import dataclass

from hardware.errors import InputError
from hardware.records import container

#: Warnings that a calibration keeps, so that they fit into one setting of its file.
_MOST_WARNINGS = 20


@dataclass(frozen=True)
class CalibrationTarget:
    """Reference: ``size`` is a Lambertian reflectance for the camera, a radar cross section in
    square metres for the radar.
    """

    distance_m: float
    size: float

    def __post_init__(self) -> None:
        container.check_positive(self, "distance_m", "size")


class Warned:
    """A calibration whose file holds warnings, one a line."""

    warnings: tuple[str, ...]

    @property
    def warning_lines(self) -> str:
        """As they stand in the file."""
        return "\n".join(self.warnings)


def distinct(warnings: Iterable[str]) -> tuple[str, ...]:
    """Each warning once; of very many the first, and how many more there were."""
    every = tuple(dict.fromkeys(warnings))
    more = len(every) - _MOST_WARNINGS
    return (*every[:_MOST_WARNINGS], f"{more} more warnings") if more > 0 else every


def check_device(calibrated: str, measured: str) -> None:
    """Raise InputError for the record of another device."""
    if calibrated != measured:
        raise InputError(f"device: calibrated {calibrated!r}, measured {measured!r}")
