"""Driver of the single-pixel camera behind PROTOCOL.md: its runs, and their records."""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
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
    #: Device's count of frames at the last silence, None since a frame came; and since when it is
    #: the same, by the host's monotonic clock.
    frames_at_silence: int | None = None
    silent_since_s: float = 0.0
    #: When the latest frame came that was not refused, by the same clock; and the first one after
    #: it that was, None: none.
    heard_s: float = field(default_factory=time.monotonic)
    refused_since_s: float | None = None
    #: Whether the device has given it up, or measures nothing: it is to be started anew.
    is_over: bool = False


class SpiCamera:
    """A camera on a line.

    Parameters
    ----------
    url
        As in pyserial.
    settings
        Sent at the start, and again after a reset of the device.
    on_loss
        Called with the sequence numbers of lost frames.
    over
        Event, set by another thread or a signal handler, that ends `records` at once and stops the
        device.

    A broken line is reopened. If the device still measures, the run continues and lost exposures
    are flagged; after a reset the device is configured and started again. Bytes are read only when
    a record is requested: a slow consumer fills the system's buffers, then the device's, which
    drops whole frames and reports it; no buffer of the driver grows.

    Raises LinkError where no line can be opened within ``patience``, NoAnswerError without a reply,
    DeviceError for a refusal, and for a device that does not measure after repeated starts.
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

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def clock(self) -> ClockModel | None:
        """Device clock against ``time.time_ns``; None before the first exchange."""
        return self._device.clock.model

    def acquire(self) -> SpiRecord:
        """One record of one pattern set. Raises LinkError where all of its frames were lost."""
        for record in self.records(sets=1):
            return record
        raise LinkError(f"{self.url}: every frame of the set was lost")

    def records(self, sets: int = 0) -> Iterator[SpiRecord]:
        """Records of ``sets`` pattern sets, 0: without end.

        A set of which nothing arrived gives no record. Ends early where sets were lost.
        """
        try:
            self._start(sets)
            while (run := self._run) and not self._device.over.is_set():
                yield from (self._record(exposures, run.configured) for exposures in self._step())
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
        """Configure the device and start the run."""
        number = self._free_run_number()
        configured = prepare(self._device, self.identity, self.settings)
        self._device.inbox.clear()
        self._device.synchronize(_FIRST_SYNCS)
        assembly = Assembly(
            number,
            configured,
            self.identity.adc_bits,
            self._lost,
            begun_ns=self._device.told_ns,
            clock_has_come_to=self._device.clock_has_come_to,
        )
        self._sets = sets
        self._run = _Run(number, assembly, configured)
        self._device.ask(Start(number, sets), Status)

    def _free_run_number(self) -> int:
        """A number other than that of the device's last run, which is stopped."""
        status = self.status()
        if status.state == State.RUNNING:
            self._device.ask(Stop(), Status)
        return status.run % 0xFFFFFFFF + 1

    def _step(self) -> list[ExposureSet]:
        """Sets completed by the next message; reconnects where the line is broken."""
        run = self._run
        assert run is not None
        try:
            if run.is_over:
                self._restart(self._sets and max(self._sets - self._sets_done(run), 1))
                return []
            message = self._device.next(self._silence_s(run.configured))
            if message is None and self._device.over.is_set():
                return []
            if isinstance(message, Measurement):
                return self._take(message)
            return self._handle_status(message or self.status())
        except LinkError as error:
            _log.warning("%s: %s; opening it again", self.url, error)
            status = self._device.reconnect()
            return self._give_up(run) if run.is_over else self._handle_status(status)

    def _take(self, frame: Measurement) -> list[ExposureSet]:
        """Sets completed by a frame; the first fault of a run is warned of. Where every frame has
        one for long, the device is started anew.
        """
        run = self._run
        assert run is not None
        self.statistics.frames += 1
        assembly, before, fault = run.assembly, run.assembly.refused, run.assembly.fault
        sets = list(assembly.take(frame))
        if assembly.refused > before:
            self.statistics.refused += assembly.refused - before
            if assembly.fault and not fault:
                _log.warning("%s: refused, as are others like it: %s", self.url, assembly.fault)
            return sets + self._refused(run)
        self._starts_in_vain = 0
        run.frames_at_silence, run.heard_s = None, time.monotonic()
        run.refused_since_s = None
        return sets

    def _refused(self, run: _Run) -> list[ExposureSet]:
        """After a refused frame: the set that was being measured, if the run is given up."""
        now_s, deaf_s = time.monotonic(), self._deaf_s(run)
        if run.refused_since_s is None:
            run.refused_since_s = now_s
        if now_s - run.refused_since_s <= deaf_s:
            return []
        _log.warning("%s: every frame was refused for %.3g s; starting anew", self.url, deaf_s)
        return self._give_up(run)

    def _deaf_s(self, run: _Run) -> float:
        """For how long no frame of a device that measures may come whole."""
        return max(self._device.patience.reconnect_s, 3 * self._silence_s(run.configured))

    def _silence_s(self, configured: Configured) -> float:
        """Timeout of silence: the time of three frames and of a reply."""
        return (
            self._device.patience.reply_s
            + 3 * configured.exposures_per_frame * configured.pattern_period_s
        )

    def _handle_status(self, status: Status) -> list[ExposureSet]:
        """Continue, end or restart the run, according to the status of the device."""
        run = self._run
        assert run is not None
        if status.run == run.number and status.state == State.RUNNING:
            if not (fault := self._fault_of_silence(run, status)):
                return []
            _log.warning("%s: %s; starting anew", self.url, fault)
        elif status.run == run.number and not status.booted:
            if self._device.measured:  # what it sent before it ended
                self._device.inbox.append(status)
                return []
            self._run = None
            return list(run.assembly.finish(status.frames))
        else:
            _log.warning("%s: the device was reset; starting anew", self.url)
        return self._give_up(run)

    def _give_up(self, run: _Run) -> list[ExposureSet]:
        """The set that a run was measuring; the next step starts the device anew."""
        self.statistics.restarts += 1
        self._starts_in_vain += 1
        if self._starts_in_vain > self._device.patience.attempts:
            raise DeviceError(
                f"{self.url}: measures nothing, though it was started anew "
                f"{self._device.patience.attempts} times"
                + (f"; {run.assembly.fault}" if run.assembly.fault else "")
            )
        run.is_over = True  # what it measured goes out before, while its clock is that of the run
        return list(run.assembly.cut_off())

    def _fault_of_silence(self, run: _Run, status: Status) -> str:
        """Of a device that is running: why it has to be started anew; empty where it may be late,
        since what it has measured is lost then.
        """
        now_s, patience_s = time.monotonic(), self._device.patience.reconnect_s
        if self._device.measured:
            return ""
        deaf_s = self._deaf_s(run)
        if status.frames > run.assembly.next_sequence and now_s - run.heard_s > deaf_s:
            return (
                f"the device has measured {status.frames} frames, and none has come whole for "
                f"{deaf_s:.3g} s"
            )
        if status.frames != run.frames_at_silence:
            run.frames_at_silence, run.silent_since_s = status.frames, now_s
            return ""
        is_silent = now_s - run.silent_since_s >= patience_s
        return "the device measures nothing" if is_silent else ""

    def _restart(self, sets: int) -> None:
        """Start, with further attempts where the device fails again; it may be another one."""
        deadline = time.monotonic() + self._device.patience.reconnect_s
        while True:
            try:
                identity = identify(self._device)
                if identity != self.identity:
                    _log.warning(
                        "%s: is another device now, %s; it was %s",
                        self.url,
                        identity.in_words,
                        self.identity.in_words,
                    )
                self.identity = identity
                return self._start(sets)
            except (LinkError, DeviceError):
                if time.monotonic() > deadline or self._device.over.is_set():
                    raise
                self._device.reconnect()

    def _sets_done(self, run: _Run) -> int:
        per_set = -(-run.configured.exposures // run.configured.exposures_per_frame)
        return run.assembly.next_sequence // per_set

    def _stop(self) -> None:
        """End the run; errors of a broken line are only logged."""
        run, self._run = self._run, None
        assert run is not None
        try:
            self._device.ask(Stop(), Status)
        except (LinkError, DeviceError) as error:
            _log.warning("%s: not stopped: %s", self.url, error)

    def _record(self, exposures: ExposureSet, configured: Configured) -> SpiRecord:
        settings = self.settings
        return SpiRecord(
            counts=exposures.counts,
            device_time_ns=exposures.device_time_ns,
            sequence=exposures.sequence,
            flags=exposures.flags,
            patterns=settings.patterns,
            integration_time_s=configured.integration_time_s,
            electrons_per_count=configured.electrons_per_count,
            offset_counts=configured.offset_counts,
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
