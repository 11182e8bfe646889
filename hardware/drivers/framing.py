"""Frames on a byte stream: COBS between zero bytes, CRC-32 at the end; broken frames are rejected.

Consistent overhead byte stuffing: Cheshire and Baker, IEEE/ACM Trans. Networking 7, 1999. CRC-32 is
that of IEEE 802.3, as in zlib.
"""

import zlib
from typing import NamedTuple

from cobs import cobs

from hardware.errors import InputError

#: Bytes of a frame before stuffing, its checksum among them, and after it.
MAX_FRAME = 4096
MAX_ENCODED = MAX_FRAME + (MAX_FRAME + 253) // 254
_HEADER, _CHECKSUM = 2, 4
MAX_PAYLOAD = MAX_FRAME - _HEADER - _CHECKSUM


class ProtocolFrame(NamedTuple):
    """One frame: type of the message, tag that links a reply to its request, payload."""

    type: int
    tag: int
    payload: bytes


def encode(frame: ProtocolFrame) -> bytes:
    """Bytes on the wire, with the closing zero.

    Raises InputError for a payload longer than `MAX_PAYLOAD`, or a type or tag that is no byte.
    """
    if len(frame.payload) > MAX_PAYLOAD:
        raise InputError(f"payload: {len(frame.payload)} bytes, at most {MAX_PAYLOAD}")
    body = bytes((frame.type, frame.tag)) + frame.payload
    return cobs.encode(body + zlib.crc32(body).to_bytes(_CHECKSUM, "little")) + b"\0"


def decode(stuffed: bytes) -> ProtocolFrame | None:
    """Frame between two zero bytes, or None where it is invalid."""
    if len(stuffed) > MAX_ENCODED:
        return None
    try:
        body = cobs.decode(stuffed)
    except cobs.DecodeError:
        return None
    if not _HEADER + _CHECKSUM <= len(body) <= MAX_FRAME:
        return None
    if zlib.crc32(body[:-_CHECKSUM]) != int.from_bytes(body[-_CHECKSUM:], "little"):
        return None
    return ProtocolFrame(body[0], body[1], body[_HEADER:-_CHECKSUM])


class Deframer:
    """Extracts frames from bytes that arrive in any portions.

    Holds at most the bytes of one frame; ``rejected`` counts invalid frames.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self._rest = b""
        self._skipping = False  # inside something too long to be a frame

    def feed(self, data: bytes) -> list[ProtocolFrame]:
        """Add bytes; returns the frames that they complete."""
        *closed, self._rest = (self._rest + data).split(b"\0")
        if closed and self._skipping:
            closed[0], self._skipping = b"", False
        if len(self._rest) > MAX_ENCODED:
            self.rejected += not self._skipping
            self._rest, self._skipping = b"", True
        frames = []
        for stuffed in filter(None, closed):
            if frame := decode(stuffed):
                frames.append(frame)
            else:
                self.rejected += 1
        return frames
