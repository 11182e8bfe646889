"""The messages of PROTOCOL.md in both directions: data classes that pack into frames and back.

Virtual devices use the same classes as the driver.
"""

import struct
from dataclasses import astuple, dataclass
from enum import IntEnum
from typing import Any, ClassVar, Self, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.framing import MAX_PAYLOAD, ProtocolFrame
from hardware.errors import InputError
from hardware.patterns import Mode, Order
from hardware.records.state import ALWAYS_OPEN, Shutter

PROTOCOL_VERSION = 1

#: Codes on the wire are indices of these tuples; a table sent as bits has the code UPLOADED.
ORDER_CODES: tuple[Order, ...] = tuple(name for name in get_args(Order) if name != "custom")
MODE_CODES: tuple[Mode, ...] = get_args(Mode)
UPLOADED = 255

MAX_SHUTTERS = 64


class State(IntEnum):
    """State of a device."""

    IDLE = 0
    CONFIGURED = 1
    ARMED = 2
    RUNNING = 3


class Refusal(IntEnum):
    """Reason of a refusal."""

    UNKNOWN = 1
    MALFORMED = 2
    STATE = 3
    UNSUPPORTED = 4
    TABLE = 5
    BUSY = 6


class _Fixed:
    """A message whose fields all have a fixed size, packed in their order."""

    TYPE: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<")

    def pack(self) -> bytes:
        """Payload."""
        return self.LAYOUT.pack(*astuple(self))  # type: ignore[call-overload]

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Message in a payload. Raises InputError unless it fits to the byte."""
        _expect(cls, payload, cls.LAYOUT.size)
        return cls(*cls.LAYOUT.unpack(payload))


@dataclass(frozen=True)
class Identify(_Fixed):
    """Host requests the device's identity."""

    TYPE = 0x01


@dataclass(frozen=True)
class Configure:
    """Host configures the pattern set and its measurement.

    ``order`` and ``mode`` are codes; a ``pattern_period_s`` of 0 requests the shortest, with an
    ``exposures_per_frame`` of 0 the device chooses. ``shutters`` as in `SpiRecord`.
    """

    TYPE: ClassVar[int] = 0x02
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<HHIBBBBHdd")

    rows: int
    columns: int
    count: int
    order: int
    mode: int
    gain: int
    exposures_per_frame: int
    integration_time_s: float
    pattern_period_s: float
    shutters: tuple[Shutter, ...] = (ALWAYS_OPEN,)

    def pack(self) -> bytes:
        """Payload."""
        head = self.LAYOUT.pack(
            self.rows,
            self.columns,
            self.count,
            self.order,
            self.mode,
            self.gain,
            len(self.shutters),
            self.exposures_per_frame,
            self.integration_time_s,
            self.pattern_period_s,
        )
        return head + np.array(self.shutters, "<f8").tobytes()

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Message in a payload. Raises InputError unless it fits to the byte."""
        head, rest = _split(cls, payload, cls.LAYOUT)
        rows, columns, count, order, mode, gain, n, per_frame, integration, period = head
        if not 1 <= n <= MAX_SHUTTERS:
            raise InputError(f"Configure: {n} shutters, expected 1 to {MAX_SHUTTERS}")
        _expect(cls, rest, 32 * n)
        shutters = tuple(Shutter(*row) for row in np.frombuffer(rest, "<f8").reshape(n, 4).tolist())
        return cls(
            rows, columns, count, order, mode, gain, per_frame, integration, period, shutters
        )


@dataclass(frozen=True)
class Upload:
    """Host sends bytes of the pattern table: one bit per cell, see PROTOCOL.md."""

    TYPE: ClassVar[int] = 0x03
    MOST: ClassVar[int] = MAX_PAYLOAD - 4

    offset: int
    data: bytes

    def pack(self) -> bytes:
        """Payload."""
        return struct.pack("<I", self.offset) + self.data

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Message in a payload. Raises InputError where it is too short."""
        (offset,), data = _split(cls, payload, struct.Struct("<I"))
        return cls(offset, data)


@dataclass(frozen=True)
class Arm(_Fixed):
    """Host accepts the pattern table, by its CRC-32."""

    TYPE = 0x04
    LAYOUT = struct.Struct("<I")

    table_crc: int


@dataclass(frozen=True)
class Start(_Fixed):
    """Host starts a run with a number of its choice, of ``sets`` pattern sets, 0: until stopped."""

    TYPE = 0x05
    LAYOUT = struct.Struct("<IQ")

    run: int
    sets: int


@dataclass(frozen=True)
class Stop(_Fixed):
    """Host ends the run."""

    TYPE = 0x06


@dataclass(frozen=True)
class Query(_Fixed):
    """Host requests the status."""

    TYPE = 0x07


@dataclass(frozen=True)
class Time(_Fixed):
    """Host requests the device's time, and sends its own."""

    TYPE = 0x08
    LAYOUT = struct.Struct("<q")

    host_ns: int


@dataclass(frozen=True)
class Identity:
    """Identity and capabilities of a device. ``orders``, ``modes``: bit masks of the codes."""

    TYPE: ClassVar[int] = 0x81
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<HBBIIHHBxdd")

    version: int
    adc_bits: int
    detectors: int
    max_cells: int
    max_table_bytes: int
    orders: int
    modes: int
    gains: int
    min_integration_time_s: float
    max_integration_time_s: float
    device: str

    @property
    def in_words(self) -> str:
        """Name, converter and detectors."""
        return f"{self.device!r} of {self.adc_bits} bits and {self.detectors} detectors"

    def pack(self) -> bytes:
        """Payload."""
        *head, device = astuple(self)
        return self.LAYOUT.pack(*head) + device.encode()

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Message in a payload. Raises InputError where it does not fit."""
        head, name = _split(cls, payload, cls.LAYOUT)
        return cls(*(*head, _text(name)))


@dataclass(frozen=True)
class Configured(_Fixed):
    """Configuration of the device after a request; these values are the valid ones."""

    TYPE = 0x82
    LAYOUT = struct.Struct("<IHBxIIdddd")

    exposures: int
    exposures_per_frame: int
    detectors: int
    table_bytes: int
    table_crc: int
    integration_time_s: float
    pattern_period_s: float
    electrons_per_count: float
    offset_counts: float


@dataclass(frozen=True)
class Status(_Fixed):
    """State of the device: the reply to Upload, Arm, Start, Stop and Query; sent with tag 0 at
    start-up and when a run ends by itself.

    ``frames`` is the number of frames of the run so far, of which ``dropped`` were never sent.
    ``booted`` is 1 from start-up until the first run starts.
    """

    TYPE = 0x87
    LAYOUT = struct.Struct("<BBxxIQQqII")

    state: int
    booted: int
    run: int
    frames: int
    dropped: int
    time_ns: int
    table_bytes: int
    table_crc: int


@dataclass(frozen=True)
class TimeReply(_Fixed):
    """Host's time as received, and device time of the receipt and of this reply."""

    TYPE = 0x88
    LAYOUT = struct.Struct("<qqq")

    host_ns: int
    received_ns: int
    sent_ns: int


@dataclass(frozen=True, eq=False)
class Measurement:
    """Consecutive exposures of a set.

    Parameters
    ----------
    run, sequence
        Which run, and the frame's number in it, from 0.
    time_ns
        Device clock at the start of the first exposure.
    first
        Place of the first exposure in the set: pattern index times shutters, plus the shutter's.
    counts : (n_exposures, n_detectors) int32
    flags : (n_exposures,) uint8
        Bits of `Flag`.
    """

    TYPE: ClassVar[int] = 0xC1
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IQqIHBB")
    WIDE: ClassVar[int] = 1  # counts of four bytes instead of two
    FLAGGED: ClassVar[int] = 2  # flags follow; else all are 0

    run: int
    sequence: int
    time_ns: int
    first: int
    counts: NDArray[np.int32]
    flags: NDArray[np.uint8]

    @staticmethod
    def most_exposures(detectors: int) -> int:
        """Exposures that fit into one frame, whatever their counts and flags."""
        return (MAX_PAYLOAD - Measurement.LAYOUT.size) // (4 * detectors + 1)

    def pack(self) -> bytes:
        """Payload."""
        n, detectors = self.counts.shape
        wide = self.WIDE if self.counts.max(initial=0) > 0xFFFF else 0
        form = wide | (self.FLAGGED if self.flags.any() else 0)
        head = self.LAYOUT.pack(
            self.run, self.sequence, self.time_ns, self.first, n, detectors, form
        )
        counts = self.counts.astype("<i4" if wide else "<u2").tobytes()
        return head + counts + (self.flags.astype(np.uint8).tobytes() if self.flags.any() else b"")

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Message in a payload. Raises InputError unless it fits to the byte."""
        head, rest = _split(cls, payload, cls.LAYOUT)
        run, sequence, time_ns, first, n, detectors, form = head
        if n < 1 or detectors < 1 or form > cls.WIDE | cls.FLAGGED:
            raise InputError(f"Measurement: {n} exposures, {detectors} detectors, form {form}")
        size = n * detectors * (4 if form & cls.WIDE else 2)
        _expect(cls, rest, size + (n if form & cls.FLAGGED else 0))
        counts = np.frombuffer(rest, "<i4" if form & cls.WIDE else "<u2", n * detectors)
        flags = np.frombuffer(rest, np.uint8, n, size) if form & cls.FLAGGED else np.zeros(n, "u1")
        return cls(
            run, sequence, time_ns, first, counts.astype(np.int32).reshape(n, detectors), flags
        )


@dataclass(frozen=True)
class Refused:
    """Device refuses a request: a code of `Refusal`, and a text."""

    TYPE: ClassVar[int] = 0xFF

    code: int
    text: str

    def pack(self) -> bytes:
        """Payload."""
        return bytes([self.code]) + self.text.encode()

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Message in a payload. Raises InputError where it does not fit."""
        (code,), text = _split(cls, payload, struct.Struct("<B"))
        return cls(code, _text(text))


Request: TypeAlias = Identify | Configure | Upload | Arm | Start | Stop | Query | Time
Reply: TypeAlias = Identity | Configured | Status | TimeReply | Measurement | Refused
Message: TypeAlias = Request | Reply

_BY_TYPE: dict[int, type[Message]] = {
    kind.TYPE: kind for kind in (*get_args(Request), *get_args(Reply))
}


def to_frame(message: Message, tag: int = 0) -> ProtocolFrame:
    """Frame of a message."""
    return ProtocolFrame(message.TYPE, tag, message.pack())


def from_frame(frame: ProtocolFrame) -> Message:
    """Message of a frame. Raises InputError for an unknown type or a payload that does not fit."""
    kind = _BY_TYPE.get(frame.type)
    if kind is None:
        raise InputError(f"type {frame.type:#04x}: no message of the protocol")
    return kind.unpack(frame.payload)


def _split(kind: type, payload: bytes, layout: struct.Struct) -> tuple[tuple[Any, ...], bytes]:
    if len(payload) < layout.size:
        raise InputError(f"{kind.__name__}: {len(payload)} bytes, expected {layout.size} or more")
    return layout.unpack_from(payload), payload[layout.size :]


def _text(data: bytes) -> str:
    """Text of a device, as one may print it."""
    text = data.decode(errors="replace")
    return "".join(one if one.isprintable() else "\N{REPLACEMENT CHARACTER}" for one in text)


def _expect(kind: type, payload: bytes, size: int) -> None:
    if len(payload) != size:
        raise InputError(f"{kind.__name__}: {len(payload)} bytes, expected {size}")
