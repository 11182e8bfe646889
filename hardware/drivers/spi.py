"""The single-pixel camera behind PROTOCOL.md: configures it, and turns its frames into records."""

import itertools
import logging
import math
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Self, TypeVar

import numpy as np

from hardware.drivers.assembly import Assembly, ExposureSet
from hardware.drivers.clock import ClockFilter, ClockModel
from hardware.drivers.framing import Deframer, encode
from hardware.drivers.link import Link, LinkError
from hardware.drivers.messages import (
    MAX_SHUTTERS,
    MODE_CODES,
    ORDER_CODES,
    PROTOCOL_VERSION,
    UPLOADED,
    Arm,
    Configure,
    Configured,
    Identify,
    Identity,
    Measurement,
    Message,
    Query,
    Refused,
    Request,
    Start,
    State,
    Status,
    Stop,
    Time,
    TimeReply,
    Upload,
    from_frame,
    to_frame,
)
from hardware.drivers.table import table_bytes
from hardware.patterns import PatternSet
from hardware.records import SpiRecord

_log = logging.getLogger(__name__)
_Expected = TypeVar("_Expected", Identity, Configured, Status, TimeReply)

#: Between exchanges of time while measuring.
_SYNC_PERIOD_S = 1.0
#: Exchanges of time before the first measurement.
_FIRST_SYNCS = 8


class DeviceError(ValueError):
    """The device refused a request, or does not do what the protocol says."""


@dataclass(frozen=True, eq=False)
class SpiSettings:
    """What to measure.

    Parameters
    ----------
    patterns
        Shown over and over. By name where the device knows the order, else sent bit by bit.
    integration_time_s, pattern_period_s
        Of one exposure, and from one to the next; period 0: the shortest.
    gain
        Step of the device's amplifier, from 0.
    exposures_per_frame
        0: the device chooses.
    shutters : (n_shutters, 4)
        As in `SpiRecord`.
    pose : (7,)
        Of the rig, for the records.
    upload
        Send the patterns even where the device knows their order.
    """

    patterns: PatternSet
    integration_time_s: float
    pattern_period_s: float = 0.0
    gain: int = 0
    exposures_per_frame: int = 0
    shutters: tuple[tuple[float, float, float, float], ...] = ((0.0, 0.0, 0.0, 0.0),)
    pose: tuple[float, ...] = (0, 0, 0, 1, 0, 0, 0)
    upload: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.integration_time_s < math.inf:
            raise ValueError(f"integration_time_s: {self.integration_time_s} is not positive")
        if not 0 <= self.pattern_period_s < math.inf:
            raise ValueError(f"pattern_period_s: {self.pattern_period_s} is no time")
        for name, most in (("gain", 0xFF), ("exposures_per_frame", 0xFFFF)):
            if not 0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: {getattr(self, name)} is not between 0 and {most}")
        if not 1 <= len(self.shutters) <= MAX_SHUTTERS:
            raise ValueError(f"shutters: {len(self.shutters)}, expected 1 to {MAX_SHUTTERS}")


@dataclass
class Tally:
    """What became of the frames, since the camera was opened."""

    frames: int = 0
    lost: int = 0
    rejected: int = 0
    refused: int = 0
    reconnects: int = 0
    restarts: int = 0


@dataclass(eq=False)
class _Run:
    number: int
    assembly: Assembly
    configured: Configured
    #: Device's count of frames at the last silence; None since a frame came.
    frames_at_silence: int | None = None


@dataclass(frozen=True)
class Patience:
    """How long to wait: for a reply, how often to ask again, and for a lost line to come back."""

    reply_s: float = 0.5
    attempts: int = 4
    reconnect_s: float = 10.0
    between_attempts_s: float = 0.1


class SpiCamera:
    """A camera on a line.

    Parameters
    ----------
    url
        As pyserial takes it.
    settings
        Sent at the start, and again after the device was reset.
    on_loss
        Called with the sequence numbers of frames that were lost.

    A line that breaks is opened again. If the device still measures, it goes on and what was lost
    in between is marked; if it was reset, it is set up and started anew. Bytes are read only when a
    record is asked for: a slow consumer fills the system's buffers, then the device's, which drops
    whole frames and says so; nothing here grows.

    Raises LinkError where there is no line within ``patience``, TimeoutError where nobody answers,
    DeviceError for a refusal.
    """

    def __init__(
        self,
        url: str,
        settings: SpiSettings,
        *,
        on_loss: Callable[[range], None] = lambda lost: None,
        patience: Patience | None = None,
        baud: int = 115_200,
    ) -> None:
        self.url, self.settings, self.tally = url, settings, Tally()
        self._patience = patience or Patience()
        self._baud = baud
        self._on_loss = on_loss
        self._tags = itertools.cycle(range(1, 256))
        self._inbox: deque[Measurement | Status] = deque(maxlen=4096)
        self._clock, self._next_sync_s = ClockFilter(), 0.0
        self._run: _Run | None = None
        self._link, self._deframer = self._open(), Deframer()
        try:
            self.identity = self._identify()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def clock(self) -> ClockModel | None:
        """Device clock against ``time.time_ns``; None before the first exchange."""
        return self._clock.model

    def acquire(self) -> SpiRecord:
        """One record: one round of the patterns. Raises LinkError where nothing of it arrived."""
        for record in self.records(sets=1):
            return record
        raise LinkError(f"{self.url}: every frame of the set was lost")

    def records(self, sets: int = 0) -> Iterator[SpiRecord]:
        """Records of rounds of the patterns, 0: without end.

        A round of which nothing arrived gives no record. Ends early where rounds were lost.
        """
        try:
            self._start(sets)
            while self._run:
                yield from map(self._record, self._step())
        finally:
            if self._run:
                self._stop()

    def status(self) -> Status:
        """State of the device."""
        return self._ask(Query(), Status)

    def close(self) -> None:
        """End a run, close the line; any number of times."""
        if self._run:
            self._stop()
        self._link.close()

    # A run, step by step.

    def _start(self, sets: int) -> None:
        """Set up the device and let it measure."""
        number = self._free_run_number()
        made = self._configure()
        assembly = Assembly(number, made, self.identity.adc_bits, self._lost)
        self._inbox.clear()
        self._sync(_FIRST_SYNCS)
        self._sets = sets
        self._run = _Run(number, assembly, made)
        self._ask(Start(number, sets), Status)

    def _step(self) -> list[ExposureSet]:
        """What the next message brings; mends what is broken."""
        run = self._run
        assert run is not None
        try:
            message = self._next(self._silence_s(run.configured))
            if isinstance(message, Measurement):
                self.tally.frames += 1
                run.frames_at_silence = None
                before = run.assembly.refused
                sets = list(run.assembly.take(message))
                self.tally.refused += run.assembly.refused - before
                return sets
            return self._judge(message or self.status())
        except (LinkError, TimeoutError) as error:
            _log.warning("%s: %s; opening it again", self.url, error)
            self._reconnect()
            return self._judge(self.status())

    def _judge(self, status: Status) -> list[ExposureSet]:
        """Go on, end or begin anew, by what the device says of itself."""
        run = self._run
        assert run is not None
        waiting = any(isinstance(message, Measurement) for message in self._inbox)
        if status.run == run.number and status.state == State.RUNNING:
            if status.frames != run.frames_at_silence or waiting:
                run.frames_at_silence = status.frames
                return []
            _log.warning("%s: the device measures nothing; starting anew", self.url)
        elif status.run == run.number and not status.booted:
            if waiting:  # what it sent before it ended
                self._inbox.append(status)
                return []
            self._run = None
            return list(run.assembly.finish(status.frames))
        else:
            _log.warning("%s: the device was reset; starting anew", self.url)
        self.tally.restarts += 1
        sets = list(run.assembly.finish(run.assembly.next_sequence))
        left = self._sets and max(self._sets - self._sets_done(run), 1)
        self._start_anew(left)
        return sets

    def _start_anew(self, sets: int) -> None:
        """Start, though the device may be down again at any moment."""
        deadline = time.monotonic() + self._patience.reconnect_s
        while True:
            try:
                return self._start(sets)
            except (LinkError, TimeoutError, DeviceError):
                if time.monotonic() > deadline:
                    raise
                self._reconnect()

    def _sets_done(self, run: _Run) -> int:
        per_set = -(-run.configured.exposures // run.configured.exposures_per_frame)
        return run.assembly.next_sequence // per_set

    def _stop(self) -> None:
        """End the run; a line that is down needs no end."""
        run, self._run = self._run, None
        assert run is not None
        try:
            self._ask(Stop(), Status)
        except (LinkError, TimeoutError, DeviceError) as error:
            _log.warning("%s: not stopped: %s", self.url, error)

    def _record(self, found: ExposureSet) -> SpiRecord:
        settings, made = self.settings, self._configured
        return SpiRecord(
            counts=found.counts,
            device_time_ns=found.device_time_ns,
            sequence=found.sequence,
            flags=found.flags,
            patterns=settings.patterns,
            integration_time_s=made.integration_time_s,
            electrons_per_count=made.electrons_per_count,
            offset_counts=made.offset_counts,
            adc_bits=self.identity.adc_bits,
            device=self.identity.device,
            pose=np.array(settings.pose, np.float64),
            shutters=np.array(settings.shutters, np.float64),
        )

    def _lost(self, lost: range) -> None:
        self.tally.lost += lost.stop - lost.start
        _log.warning("%s: frames %d to %d lost", self.url, lost.start, lost.stop - 1)
        self._on_loss(lost)

    # Setting up.

    def _identify(self) -> Identity:
        identity = self._ask(Identify(), Identity)
        if identity.version != PROTOCOL_VERSION:
            raise DeviceError(
                f"{self.url}: protocol version {identity.version}, "
                f"this software speaks {PROTOCOL_VERSION}"
            )
        if not (1 <= identity.adc_bits <= 31 and identity.detectors >= 1):
            raise DeviceError(
                f"{self.url}: {identity.adc_bits} bits of {identity.detectors} detectors"
            )
        return identity

    def _configure(self) -> Configured:
        settings, patterns = self.settings, self.settings.patterns
        mode = MODE_CODES.index(patterns.mode)
        by_name = not settings.upload and patterns.order in ORDER_CODES
        order = ORDER_CODES.index(patterns.order) if by_name else UPLOADED
        if order == UPLOADED or not self.identity.orders >> order & 1:
            order = UPLOADED
        if not self.identity.modes >> mode & 1:
            raise DeviceError(f"{self.url}: the device does not know mode {patterns.mode!r}")
        if patterns.n_cells > self.identity.max_cells or self.identity.detectors % patterns.n_arms:
            raise DeviceError(
                f"{self.url}: {patterns.n_cells} cells in mode {patterns.mode!r}; the device has "
                f"{self.identity.max_cells} cells and {self.identity.detectors} detectors"
            )
        table = table_bytes(patterns)
        crc = zlib.crc32(table)
        request = Configure(
            rows=patterns.rows,
            columns=patterns.columns,
            count=patterns.count,
            order=order,
            mode=mode,
            gain=settings.gain,
            exposures_per_frame=settings.exposures_per_frame,
            integration_time_s=settings.integration_time_s,
            pattern_period_s=settings.pattern_period_s,
            shutters=settings.shutters,
        )
        made = self._ask(request, Configured)
        self._check(made, patterns.n_exposures * len(settings.shutters), len(table))
        if order == UPLOADED:
            for at in range(0, len(table), Upload.MOST):
                self._ask(Upload(at, table[at : at + Upload.MOST]), Status)
        elif made.table_crc != crc:
            raise DeviceError(
                f"{self.url}: the device's patterns {patterns.order!r} have the CRC-32 "
                f"{made.table_crc:#010x}, expected {crc:#010x}"
            )
        self._ask(Arm(crc), Status)
        self._configured = made
        return made

    def _check(self, made: Configured, exposures: int, size: int) -> None:
        positive = (made.integration_time_s, made.pattern_period_s, made.electrons_per_count)
        most = Measurement.most_exposures(self.identity.detectors)
        good = (
            made.exposures == exposures
            and made.table_bytes == size
            and 1 <= made.exposures_per_frame <= most
            and made.detectors == self.identity.detectors
            and all(np.isfinite(value) and value > 0 for value in positive)
            and np.isfinite(made.offset_counts)
        )
        if not good:
            raise DeviceError(f"{self.url}: the device cannot mean {made}")

    def _free_run_number(self) -> int:
        """One that is not the device's newest, which is over now."""
        status = self.status()
        if status.state == State.RUNNING:
            self._ask(Stop(), Status)
        return status.run % 0xFFFFFFFF + 1

    def _sync(self, exchanges: int) -> None:
        for _ in range(exchanges):
            self._ask(Time(time.time_ns()), TimeReply)
        self._next_sync_s = time.monotonic() + _SYNC_PERIOD_S

    # Messages.

    def _ask(self, request: Request, expected: type[_Expected]) -> _Expected:
        """Send a request until it is answered. Raises TimeoutError, DeviceError, LinkError."""
        for _ in range(self._patience.attempts):
            tag = next(self._tags)
            self._link.write(encode(to_frame(request, tag)))
            deadline = time.monotonic() + self._patience.reply_s
            answer: _Expected | None = None
            while answer is None and (left := deadline - time.monotonic()) > 0:
                for got_tag, message in self._receive(left):
                    if got_tag != tag:
                        self._keep(got_tag, message)
                    elif isinstance(message, Refused):
                        raise DeviceError(f"{self.url}: the device refuses: {message.text}")
                    elif isinstance(message, expected):
                        answer = message
            if answer is not None:
                return answer
        raise TimeoutError(
            f"{self.url}: no answer to {type(request).__name__} after "
            f"{self._patience.attempts} attempts of {self._patience.reply_s:g} s"
        )

    def _next(self, silence_s: float) -> Measurement | Status | None:
        """Next message of a run; None after a silence."""
        if time.monotonic() > self._next_sync_s:
            self._next_sync_s = time.monotonic() + _SYNC_PERIOD_S
            self._link.write(encode(to_frame(Time(time.time_ns()), 0)))
        deadline = time.monotonic() + silence_s
        while not self._inbox and (left := deadline - time.monotonic()) > 0:
            for tag, message in self._receive(left):
                self._keep(tag, message)
        return self._inbox.popleft() if self._inbox else None

    def _keep(self, tag: int, message: Message) -> None:
        """Put by what the device sends unasked; late answers to old requests are of no use."""
        if tag == 0 and isinstance(message, (Measurement, Status)):
            self._inbox.append(message)

    def _receive(self, timeout_s: float) -> Iterator[tuple[int, Message]]:
        """Messages with their tags, from one read."""
        data = self._link.read(timeout_s)
        now_ns = time.time_ns()
        before = self._deframer.rejected
        frames = self._deframer.feed(data)
        self.tally.rejected += self._deframer.rejected - before
        for frame in frames:
            try:
                message = from_frame(frame)
                if isinstance(message, TimeReply):
                    self._clock.add(message.host_ns, message.received_ns, message.sent_ns, now_ns)
            except ValueError as error:
                self.tally.rejected += 1
                _log.warning("%s: %s", self.url, error)
            else:
                yield frame.tag, message

    # The line.

    def _silence_s(self, made: Configured) -> float:
        """Silence that is too long: three frames' time, and a reply's."""
        return self._patience.reply_s + 3 * made.exposures_per_frame * made.pattern_period_s

    def _open(self) -> Link:
        deadline = time.monotonic() + self._patience.reconnect_s
        while True:
            try:
                return Link(self.url, baud=self._baud)
            except LinkError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(self._patience.between_attempts_s)

    def _reconnect(self) -> None:
        """A new line, on which the device answers."""
        deadline = time.monotonic() + self._patience.reconnect_s
        while True:
            self._link.close()
            self._link, self._deframer = self._open(), Deframer()
            self.tally.reconnects += 1
            try:
                self.status()
                return
            except (LinkError, TimeoutError):
                if time.monotonic() > deadline:
                    raise
                time.sleep(self._patience.between_attempts_s)
