"""Clocks of the devices of a drive, against the reference: that of the world's motion."""

from dataclasses import dataclass, field

from hardware.drivers.clock import MOST_DRIFT, ClockModel
from twin.errors import InputError

_MOST_DRIFT_PPM = 1e6 * MOST_DRIFT
_MOST_OFFSET_S = 1e9


@dataclass(frozen=True)
class DeviceClock:
    """A device's clock, which its exposures or slots follow: at reference time t it shows
    ``offset_s`` + t (1 + ``drift_ppm`` / 1e6).

    Times are whole ns, drift alone is multiplied: 100 ppm over an hour, 0.36 s, to 1e-7 ns. The
    reference starts at 0 with the drive. Raises InputError for values that no clock has.
    """

    offset_s: float = 0.0
    drift_ppm: float = 0.0
    model: ClockModel = field(init=False)

    def __post_init__(self) -> None:
        for name, most in (("offset_s", _MOST_OFFSET_S), ("drift_ppm", _MOST_DRIFT_PPM)):
            value = getattr(self, name)
            if not -most <= value <= most:
                raise InputError(f"{name}: {value:g}: expected a number from {-most:g} to {most:g}")
        model = ClockModel(0, round(1e9 * self.offset_s), 1e-6 * self.drift_ppm, 0.0)
        object.__setattr__(self, "model", model)

    def after_start(self, elapsed_ns: int) -> int:
        """What it shows when it has counted so many ns of its own since the start."""
        return self.model.offset_ns + elapsed_ns

    def reference_ns(self, elapsed_ns: int) -> int:
        """The reference when it has counted so many ns of its own since the start."""
        return self.model.host_ns(self.after_start(elapsed_ns))
