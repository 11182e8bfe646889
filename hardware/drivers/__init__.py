"""Drivers: devices on a line, and records from their bytes. The protocol: PROTOCOL.md.

The camera's driver is imported on first use: the radio's needs neither its framing nor its line.
"""

from typing import TYPE_CHECKING, Any

from hardware.drivers.clock import ClockModel
from hardware.errors import DeviceError, LinkError

if TYPE_CHECKING:
    from hardware.drivers.spi import Patience, SpiCamera, SpiSettings

__all__ = ["ClockModel", "DeviceError", "LinkError", "Patience", "SpiCamera", "SpiSettings"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from hardware.drivers import spi

    return getattr(spi, name)
