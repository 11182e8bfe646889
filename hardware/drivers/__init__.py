"""Drivers: what sits on a line, and how its bytes become records. The protocol: PROTOCOL.md."""

from hardware.drivers.clock import ClockModel
from hardware.drivers.link import LinkError
from hardware.drivers.spi import DeviceError, Patience, SpiCamera, SpiSettings

__all__ = ["ClockModel", "DeviceError", "LinkError", "Patience", "SpiCamera", "SpiSettings"]
