"""The single-pixel camera behind PROTOCOL.md: its runs, and their frames as records."""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from hardware.drivers.assembly import Assembly, ExposureSet
from hardware.drivers.clock import ClockModel
from hardware.drivers.messages import Configured, Measurement, Start, State, Status, Stop
from hardware.drivers.preparation import identify, prepare
from hardware.drivers.request_client import Patience, RequestClient, Statistics
from hardware.drivers.settings import SpiSettings
from hardware.errors import DeviceError, LinkError
from hardware.records import SpiRecord

__all__ = ["DeviceError", "Patience", "SpiCamera", "SpiSettings", "Statistics"]

_log = logging.getLogger(__name__)

#: Exchanges of time before the first measurement.
_FIRST_SYNCS = 8


@dataclass(eq=False)
class _Run:
    number: int
    assembly: Assembly
    configured: Configured
    #: Device's count of frames at the last silence; None since a frame came.
    frames_at_silence: int | None = None


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
    over
        Once it is set, from another thread or a signal's handler, `records` ends at once and the
        device is told to stop.

    A line that breaks is opened again. If the device still measures, it goes on and what was lost
    in between is marked; if it was reset, it is set up and started anew. Bytes are read only when a
    record is asked for: a slow consumer fills the system's buffers, then the device's, which drops
    whole frames and says so; nothing here grows.

    Raises LinkError where there is no line within ``patience``, NoAnswerError where nobody answers,
    DeviceError for a refusal, and for a device that measures nothing however often it is started.
    """

    def __init__(
        self,
        url: str,
        settings: SpiSettings,
        *,
        on_loss: Callable[[range], None] = lambda lost: None,
        patience: Patience | None = None,
        baud: int = 115_200,
        over: threading.Event | None = None,
    ) -> None:
        self.url, self.settings = url, settings
        self._on_loss = on_loss
        self._run: _Run | None = None
        self._starts_in_vain = 0
        self._device = RequestClient(url, patience=patience or Patience(), baud=baud, over=over)
        self.statistics = self._device.statistics
        try:
            self.identity = identify(self._device)
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
        return self._device.clock.model

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
            while (run := self._run) and not self._device.over.is_set():
                yield from (self._record(found, run.configured) for found in self._step())
        finally:
            if self._run:
                self._stop()

    def status(self) -> Status:
        """State of the device."""
        return self._device.status()

    def close(self) -> None:
        """End a run, close the line; any number of times."""
        if self._run:
            self._stop()
        self._device.close()

    # A run, step by step.

    def _start(self, sets: int) -> None:
        """Set up the device and let it measure."""
        number = self._free_run_number()
        made = prepare(self._device, self.identity, self.settings)
        assembly = Assembly(number, made, self.identity.adc_bits, self._lost)
        self._device.inbox.clear()
        self._device.synchronize(_FIRST_SYNCS)
        self._sets = sets
        self._run = _Run(number, assembly, made)
        self._device.ask(Start(number, sets), Status)

    def _free_run_number(self) -> int:
        """One that is not the device's newest, which is over now."""
        status = self.status()
        if status.state == State.RUNNING:
            self._device.ask(Stop(), Status)
        return status.run % 0xFFFFFFFF + 1

    def _step(self) -> list[ExposureSet]:
        """What the next message brings; mends what is broken."""
        run = self._run
        assert run is not None
        try:
            message = self._device.next(self._silence_s(run.configured))
            if message is None and self._device.over.is_set():
                return []
            if isinstance(message, Measurement):
                self.statistics.frames += 1
                self._starts_in_vain = 0
                run.frames_at_silence = None
                before = run.assembly.refused
                sets = list(run.assembly.take(message))
                self.statistics.refused += run.assembly.refused - before
                return sets
            return self._judge(message or self.status())
        except LinkError as error:
            _log.warning("%s: %s; opening it again", self.url, error)
            self._device.reconnect()
            return self._judge(self.status())

    def _silence_s(self, made: Configured) -> float:
        """Silence that is too long: three frames' time, and a reply's."""
        return self._device.patience.reply_s + 3 * made.exposures_per_frame * made.pattern_period_s

    def _judge(self, status: Status) -> list[ExposureSet]:
        """Go on, end or begin anew, by what the device says of itself."""
        run = self._run
        assert run is not None
        if status.run == run.number and status.state == State.RUNNING:
            if status.frames != run.frames_at_silence or self._device.measured:
                run.frames_at_silence = status.frames
                return []
            _log.warning("%s: the device measures nothing; starting anew", self.url)
        elif status.run == run.number and not status.booted:
            if self._device.measured:  # what it sent before it ended
                self._device.inbox.append(status)
                return []
            self._run = None
            return list(run.assembly.finish(status.frames))
        else:
            _log.warning("%s: the device was reset; starting anew", self.url)
        self.statistics.restarts += 1
        self._starts_in_vain += 1
        if self._starts_in_vain > self._device.patience.attempts:
            raise DeviceError(
                f"{self.url}: measures nothing, though it was started anew "
                f"{self._device.patience.attempts} times"
            )
        sets = list(run.assembly.finish(run.assembly.next_sequence))
        left = self._sets and max(self._sets - self._sets_done(run), 1)
        self._start_anew(left)
        return sets

    def _start_anew(self, sets: int) -> None:
        """Start, though the device may be down again at any moment."""
        deadline = time.monotonic() + self._device.patience.reconnect_s
        while True:
            try:
                return self._start(sets)
            except (LinkError, DeviceError):
                if time.monotonic() > deadline or self._device.over.is_set():
                    raise
                self._device.reconnect()

    def _sets_done(self, run: _Run) -> int:
        per_set = -(-run.configured.exposures // run.configured.exposures_per_frame)
        return run.assembly.next_sequence // per_set

    def _stop(self) -> None:
        """End the run; a line that is down needs no end."""
        run, self._run = self._run, None
        assert run is not None
        try:
            self._device.ask(Stop(), Status)
        except (LinkError, DeviceError) as error:
            _log.warning("%s: not stopped: %s", self.url, error)

    def _record(self, found: ExposureSet, made: Configured) -> SpiRecord:
        settings = self.settings
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
            pose=settings.pose,
            shutters=settings.shutters,
            pulse_width_s=settings.pulse_width_s,
        )

    def _lost(self, lost: range) -> None:
        self.statistics.lost += lost.stop - lost.start
        _log.warning("%s: frames %d to %d lost", self.url, lost.start, lost.stop - 1)
        self._on_loss(lost)
