"""The virtual camera: the twin behind hardware/drivers/PROTOCOL.md, independent of the line."""

import logging
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hardware.drivers.framing import Deframer, ProtocolFrame, encode
from hardware.drivers.messages import (
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
    Refusal,
    Refused,
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
from hardware.records import Flag, SpiRecord
from twin import __version__
from twin.camera.chain import Chain
from twin.engine import EngineError
from twin.files import InputError
from twin.scene import Sun
from twin.serve.clock import DeviceClock
from twin.serve.configuration import INTEGRATION_S
from twin.serve.frames import FramesAhead
from twin.serve.requested_system import (
    MODES,
    RefusedError,
    requested_system,
    uploaded_system,
)
from twin.serve.table import UploadedTable
from twin.system import System

_log = logging.getLogger(__name__)

_FRAME_EXPOSURES = 64
_POLLING_S = 0.01  # at which a record that is being computed is looked for
_COMPUTING_S = 3.0  # that a frame is due, before it is said; a host's driver waits 10 s
_SETS_BEFORE_WARNING = 2  # of a run, before there is a warning that they are late
_FROM_CAMERA = 0x80  # types from here on are those that a camera sends
_NO_REQUEST = "no request of the protocol"


@dataclass
class _CameraRun:
    number: int
    sets: int
    start_ns: int
    records: Iterator[SpiRecord]
    record: SpiRecord | None = None
    set: int = 0
    exposure: int = 0
    frames: int = 0
    dropped: int = 0
    is_warned_of: bool = False
    waits_since_s: float | None = None  # by the host's clock, for the next record


class VirtualCamera:
    """A camera with the emitter, optics and detector of a system, in a scene.

    What the host configures beyond them (patterns of the emitter's cells, integration time,
    period) makes another system of it; gain and shutters are those of the system. An uploaded table
    is shown where it is that of an order with a name.

    Parameters
    ----------
    system, sun
        Design of the camera, and the scene's sun.
    records
        Records of a system, set after set.
    clock
        Device time.
    send
        Sends a frame's bytes; returns False where the line is full.
    overrun
        Called for every frame: whether the ADC misses it.

    Raises InputError for a system whose frames the protocol cannot carry.
    """

    def __init__(
        self,
        system: System,
        sun: Sun,
        records: Callable[[System], Iterator[SpiRecord]],
        *,
        clock: DeviceClock,
        send: Callable[[bytes], bool],
        overrun: Callable[[], bool] = lambda: False,
    ) -> None:
        self.system, self.clock, self.send = system, clock, send
        self._sun, self._records, self._overrun = sun, records, overrun
        self._has_told_computing = False
        chain = Chain.of(system, sun)
        self._adc_bits = chain.front_end.adc_bits
        self._n_shutters = len(chain.shutters)
        if system.n_detectors > 255:
            raise InputError(
                f"{system.name}: {system.n_detectors} detectors, the protocol carries up to 255"
            )
        if system.is_raster:
            raise InputError(
                f"{system.name}: a raster scan, the protocol is that of a camera that shows "
                "patterns: expected another acquisition.order"
            )
        self.start_up()

    def start_up(self) -> None:
        """Switch on or reset: clear all state but the time."""
        self._deframer = Deframer()
        self._state, self._booted = State.IDLE, True
        self._configuration: Configured | None = None
        self._configured_system = self.system
        self._table = UploadedTable()
        self._run: _CameraRun | None = None
        self._mark = Flag.RESET  # on the next exposure
        self._send_message(self._status())

    def meet_host(self) -> None:
        """Forget the half of a frame that another host has left."""
        self._deframer = Deframer()

    def receive(self, data: bytes) -> None:
        """Process bytes from the host; replies are sent at once."""
        for frame in self._deframer.feed(data):
            self._send_message(self._answer(frame), frame.tag)

    def poll(self) -> float | None:
        """Send one frame if it is due. Seconds until the next one is; None where none will be."""
        run, made = self._run, self._configuration
        if self._state != State.RUNNING or run is None or made is None:
            return None
        stop = min(run.exposure + made.exposures_per_frame, made.exposures)
        due = run.start_ns + self._since(run.set * made.exposures + stop)
        if (left := self.clock.left_s(due)) > 0:
            return left
        if run.record is None and not self._next_record(run):
            return _POLLING_S if self._run is run and self._state == State.RUNNING else None
        self._send_frame(run, made, stop)
        self.clock.wait_until(due)
        if stop == made.exposures:
            run.set, run.exposure, run.record = run.set + 1, 0, None
            if run.set == run.sets:
                self._end_run()
                return None
        else:
            run.exposure = stop
        return 0.0

    def _next_record(self, run: _CameraRun) -> bool:
        """Take the next record of a run; whether it is there. A run of which it fails ends."""
        frames = run.records
        if isinstance(frames, FramesAhead) and not frames.ready():
            self._tell_computing(run)
            return False
        run.waits_since_s = None
        try:
            run.record = next(run.records)
        except (InputError, EngineError) as error:
            _log.error("%s: frame %d: %s", self.system.name, run.set, error)
            self._end_run()
            return False
        self._warn_late(run)
        return True

    def _tell_computing(self, run: _CameraRun) -> None:
        """Tell once that a frame that is due is still being computed."""
        now_s = time.monotonic()
        if run.waits_since_s is None:
            run.waits_since_s = now_s
        if now_s - run.waits_since_s > _COMPUTING_S and not self._has_told_computing:
            self._has_told_computing = True
            _log.warning(
                "%s: frame %d is due for %.3g s and still being computed; it is sent late",
                *(self.system.name, run.set, now_s - run.waits_since_s),
            )

    def _warn_late(self, run: _CameraRun) -> None:
        """Tell once in a run that records come later than they were measured."""
        made = self._configuration
        if made is None or self.clock.pace == "fast" or run.is_warned_of:
            return
        lasts_s = made.exposures * made.pattern_period_s
        first = made.exposures_per_frame
        due = run.start_ns + self._since(run.set * made.exposures + min(first, made.exposures))
        late_s = (self.clock.now_ns() - due) / 1e9
        if run.set >= _SETS_BEFORE_WARNING and late_s > lasts_s:
            run.is_warned_of = True
            _log.warning(
                "%s: slower than real time: a frame lasts %.3g s, frame %d is sent %.3g s late; "
                "none is lost",
                *(self.system.name, lasts_s, run.set, late_s),
            )

    def _end_run(self) -> None:
        self._state = State.ARMED
        self._send_message(self._status())

    def _send_frame(self, run: _CameraRun, made: Configured, stop: int) -> None:
        assert run.record is not None
        part = slice(run.exposure, stop)
        flags = run.record.flags[part].copy()
        flags[0] |= self._mark
        frame = Measurement(
            run=run.number,
            sequence=run.frames,
            time_ns=run.start_ns + self._since(run.set * made.exposures + run.exposure),
            first=run.exposure,
            counts=run.record.counts[part],
            flags=flags,
        )
        run.frames += 1
        self._mark = Flag(0)
        if self._overrun() or not self._send_message(frame):
            run.dropped += 1
            self._mark = Flag.OVERRUN

    def _since(self, exposures: int) -> int:
        assert self._configuration is not None
        return round(exposures * self._configuration.pattern_period_s * 1e9)

    def _send_message(self, message: Message, tag: int = 0) -> bool:
        return self.send(encode(to_frame(message, tag)))

    def _answer(self, frame: ProtocolFrame) -> Message:
        received_ns = self.clock.now_ns()
        try:
            if frame.type >= _FROM_CAMERA:
                raise RefusedError(Refusal.UNKNOWN, _NO_REQUEST)
            match from_frame(frame):
                case Identify():
                    return self._identity()
                case Configure() as request:
                    return self._configure(request)
                case Upload(offset, data):
                    return self._upload(offset, data)
                case Arm(crc):
                    return self._arm(crc)
                case Start(run, sets):
                    return self._start(run, sets)
                case Stop():
                    return self._stop()
                case Query():
                    return self._status()
                case Time(host_ns):
                    return TimeReply(host_ns, received_ns, self.clock.now_ns())
                case _:
                    raise RefusedError(Refusal.UNKNOWN, _NO_REQUEST)
        except RefusedError as error:
            return Refused(*error.args)
        except InputError as error:
            unknown = str(error).startswith("type ")
            return Refused(Refusal.UNKNOWN if unknown else Refusal.MALFORMED, str(error)[:150])

    def _identity(self) -> Identity:
        cells = self.system.patterns.n_cells
        return Identity(
            version=PROTOCOL_VERSION,
            adc_bits=self._adc_bits,
            detectors=self.system.n_detectors,
            max_cells=cells,
            max_table_bytes=2 * (cells + 1) * -(-cells // 8),
            orders=(1 << len(ORDER_CODES)) - 1,
            modes=MODES,
            gains=1,
            min_integration_time_s=INTEGRATION_S[0],
            max_integration_time_s=INTEGRATION_S[1],
            device=f"twin {__version__}: {self.system.name}",
        )

    def _configure(self, request: Configure) -> Configured:
        if self._state == State.RUNNING:
            raise RefusedError(Refusal.STATE, "Configure: a run is on")
        system = requested_system(self.system, request)
        if request.order == UPLOADED:
            size = system.patterns.n_exposures * -(-system.patterns.n_cells // 8)
            self._table.expect(size)
            crc = zlib.crc32(self._table.data)
        else:
            table = table_bytes(system.patterns)
            self._table.expect(0)
            size, crc = len(table), zlib.crc32(table)
        shown, front_end = system.acquisition, Chain.of(system, self._sun).front_end
        most = Measurement.most_exposures(self.system.n_detectors)
        self._request, self._configured_system, self._state = request, system, State.CONFIGURED
        self._configuration = Configured(
            exposures=system.patterns.n_exposures * self._n_shutters,
            exposures_per_frame=min(request.exposures_per_frame or _FRAME_EXPOSURES, most),
            detectors=self.system.n_detectors,
            table_bytes=size,
            table_crc=crc,
            integration_time_s=shown.integration_time_s.value,
            pattern_period_s=shown.pattern_period_s.value,
            electrons_per_count=front_end.electrons_per_count,
            offset_counts=front_end.offset_counts,
        )
        return self._configuration

    def _upload(self, offset: int, portion: bytes) -> Status:
        if self._state != State.CONFIGURED or self._request.order != UPLOADED:
            raise RefusedError(Refusal.STATE, "Upload: configure for it first")
        if not portion:
            raise RefusedError(Refusal.MALFORMED, "Upload: no bytes")
        try:
            self._table.take(offset, portion)
        except InputError as error:
            raise RefusedError(Refusal.TABLE, str(error)) from error
        return self._status()

    def _arm(self, crc: int) -> Status:
        if self._state not in (State.CONFIGURED, State.ARMED) or self._configuration is None:
            raise RefusedError(Refusal.STATE, "Arm: configure first")
        if (self._configuration.table_bytes, crc) != self._table_state():
            raise RefusedError(Refusal.TABLE, "Arm: this is not the table that I hold")
        if self._state == State.CONFIGURED and self._request.order == UPLOADED:
            table = bytes(self._table.data)
            self._configured_system = uploaded_system(self.system, self._request, table)
        self._state = State.ARMED
        return self._status()

    def _table_state(self) -> tuple[int, int]:
        """Number of bytes of the table received, and their CRC-32."""
        if self._configuration is None:
            return 0, 0
        if self._request.order == UPLOADED:
            return len(self._table.data), zlib.crc32(self._table.data)
        return self._configuration.table_bytes, self._configuration.table_crc

    def _start(self, number: int, sets: int) -> Status:
        if self._run is None or number != self._run.number:
            if self._state != State.ARMED:
                raise RefusedError(Refusal.STATE, "Start: arm first")
            self._run = _CameraRun(
                number, sets, self.clock.now_ns(), self._records(self._configured_system)
            )
            self._state, self._booted = State.RUNNING, False
        return self._status()

    def _stop(self) -> Status:
        if self._state == State.RUNNING:
            self._state = State.ARMED
        return self._status()

    def _status(self) -> Status:
        run, (held, crc) = self._run, self._table_state()
        return Status(
            state=self._state,
            booted=int(self._booted),
            run=run.number if run else 0,
            frames=run.frames if run else 0,
            dropped=run.dropped if run else 0,
            time_ns=self.clock.now_ns(),
            table_bytes=held,
            table_crc=crc,
        )
