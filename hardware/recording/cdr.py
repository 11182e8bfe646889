"""Common data representation, the bytes of ROS 2 messages (OMG DDSI-RTPS 2.5, section 10; XCDR1).

Not from a library, because the installable ones take a microsecond per number, seconds for one
radar record; here arrays are copied as a whole.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError

_HEADER = b"\0\1\0\0"  # plain CDR, little-endian
_FORMS = {
    "bool": "?",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float32": "f",
    "float64": "d",
}
_NUMBERS = {kind: struct.Struct(f"<{form}") for kind, form in _FORMS.items()}


class Writer:
    """Fields one after another."""

    def __init__(self) -> None:
        self._data = bytearray()

    @property
    def message(self) -> bytes:
        """The whole message."""
        return _HEADER + bytes(self._data)

    def number(self, kind: str, value: float) -> None:
        """One number of a ROS type."""
        form = _NUMBERS[kind]
        self._align(form.size)
        self._data += form.pack(value)

    def text(self, value: str) -> None:
        """A string."""
        data = value.encode() + b"\0"
        self.number("uint32", len(data))
        self._data += data

    def array(self, values: NDArray[np.generic]) -> None:
        """A sequence of numbers, row by row."""
        self.number("uint32", values.size)
        if values.size:
            self._align(values.itemsize)
        little = values.astype(values.dtype.newbyteorder("<"), copy=False)
        self._data += little.tobytes()

    def _align(self, size: int) -> None:
        self._data += bytes(-len(self._data) % size)


class Reader:
    """The same the other way. Raises InputError where the message ends too early."""

    def __init__(self, message: bytes) -> None:
        if message[:4] != _HEADER:
            raise InputError(f"message: begins with {message[:4].hex()}, expected 00010000")
        self._data, self._at = memoryview(message)[4:], 0

    def number(self, kind: str) -> int | float:
        """One number of a ROS type."""
        form = _NUMBERS[kind]
        self._align(form.size)
        value: int | float = form.unpack(self._take(form.size))[0]
        return value

    def text(self) -> str:
        """A string."""
        return bytes(self._take(int(self.number("uint32")))).rstrip(b"\0").decode()

    def array(self, kind: str) -> NDArray[np.generic]:
        """A sequence of numbers."""
        size = int(self.number("uint32"))
        dtype = np.dtype(kind).newbyteorder("<")
        if size:
            self._align(dtype.itemsize)
        data = self._take(size * dtype.itemsize)
        return np.frombuffer(data, dtype).astype(np.dtype(kind))

    def _align(self, size: int) -> None:
        self._at += -self._at % size

    def _take(self, size: int) -> memoryview:
        if self._at + size > len(self._data):
            raise InputError(f"message: ends after {len(self._data)} bytes, too early")
        self._at += size
        return self._data[self._at - size : self._at]
