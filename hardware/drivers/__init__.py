"""Drivers: what sits on a line, and how its bytes become records. The protocol: PROTOCOL.md.

The camera's is imported when it is asked for: the radio's needs neither its framing nor its line.
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
