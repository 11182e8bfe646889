"""Byte stream to a device at any pyserial URL, with timeouts."""

import select
import time
from typing import Any

from hardware.errors import InputError, LinkError

#: Largest number of bytes of one read.
_CHUNK = 65536
#: Polling interval of a port without select (rfc2217://).
_POLL_S = 1e-3


class Link:
    """A connection to a device.

    Parameters
    ----------
    url
        As in pyserial: ``/dev/ttyACM0``, ``COM3``, ``socket://host:port``,
        ``rfc2217://host:port``.
    baud
        Baud rate of a serial line.
    write_timeout_s
        Timeout of writing; not for ``rfc2217://``.

    Raises LinkError where the URL cannot be opened, InputError for an invalid URL.
    """

    def __init__(self, url: str, *, baud: int = 115_200, write_timeout_s: float = 1.0) -> None:
        import serial

        self.url = url
        try:
            # pyserial has no write timeout there; a broken line is detected by its silence.
            limit = None if url.lower().startswith("rfc2217:") else write_timeout_s
            self._port: Any = serial.serial_for_url(
                url, baudrate=baud, timeout=0, write_timeout=limit
            )
        except OSError as error:
            raise LinkError(f"{url}: {error}") from error
        except ValueError as error:  # pyserial's own, for what is no URL
            raise InputError(f"{url}: {error}") from error
        try:
            self._handle: int | None = self._port.fileno()
        except (AttributeError, OSError):  # UnsupportedOperation is an OSError
            self._handle = None

    def read(self, timeout_s: float) -> bytes:
        """Bytes that have arrived, or arrive within the timeout; empty where none do.

        Raises LinkError.
        """
        try:
            if self._handle is not None:
                select.select([self._handle], [], [], timeout_s)
                return self._port.read(_CHUNK)
            return self._poll(timeout_s)
        except (OSError, ValueError, TypeError) as error:  # pyserial's own is an OSError
            raise LinkError(f"{self.url}: {error}") from error

    def write(self, data: bytes) -> None:
        """Send everything. Raises LinkError."""
        try:
            self._port.write(data)
        except OSError as error:
            raise LinkError(f"{self.url}: {error}") from error

    def close(self) -> None:
        """Close; any number of times."""
        inner = getattr(self._port, "_socket", None)
        self._port.close()
        if inner is not None:  # pyserial leaves it open where the other side closed first
            inner.close()

    def _poll(self, timeout_s: float) -> bytes:
        deadline = time.monotonic() + timeout_s
        while not (data := self._port.read(_CHUNK)) and time.monotonic() < deadline:
            time.sleep(_POLL_S)
        while len(data) < _CHUNK and (more := self._port.read(_CHUNK)):
            data += more  # rfc2217:// gives a byte at a time
        return data
