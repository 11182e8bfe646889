"""The radar's radio: a common interface over UHD or ZeroMQ, and the stepped-carrier schedule."""

from hardware.drivers.radio.calibration import Calibration, calibrate
from hardware.drivers.radio.interface import Fault, RadioDriver, RadioError, Reception, Tuned
from hardware.drivers.radio.opening import open_radio
from hardware.drivers.radio.schedule import Schedule, acquire, carriers

__all__ = [
    "Calibration",
    "Fault",
    "RadioDriver",
    "RadioError",
    "Reception",
    "Schedule",
    "Tuned",
    "acquire",
    "calibrate",
    "carriers",
    "open_radio",
]
