"""A radio behind ZeroMQ: the other end of `ZeroMqRadio` and of plain virtual radios.

Three ports from the given one on: commands; received samples, on request; samples to transmit,
which the server requests. The last two are the convention of GNU Radio and srsRAN. While a client
has opened the radio, the second port has a copy of its received samples; otherwise both ports form
a plain virtual radio.

What the radio may take long for, a sweep that is not computed yet, a burst that starts later, is
waited for in a thread: meanwhile all other commands are answered.
"""

import json
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import RadioDriver, RadioError, Reception, Tuned
from hardware.drivers.radio.stream import parse_request, request
from hardware.drivers.radio.zeromq import MOST_JSON, PROTOCOL_VERSION, to_samples
from twin.files import InputError
from twin.serve.faults import RadioFaults
from twin.serve.worker import Worker

_LEASE_S = 10.0  # of silence, after which another client may open the radio
_PATIENCE_S = 60.0  # for the first burst of a scene, for which kernels are compiled
_MOST_WAITING = 64  # bursts not fetched yet, of which older ones are dropped; commands not begun
_POLL_S = 0.1


@dataclass(frozen=True)
class _Job:
    """What the radio has to do, and who is told when it is done: nobody (None) where samples of a
    plain client are sent.
    """

    sender: bytes | None
    number: Any
    call: Callable[[], Tuned | Reception]


class RadioServer:
    """Serves a radio until it is stopped.

    Parameters
    ----------
    radio
        The radio to serve. It is tuned and sends in one thread, and tells its time in another.
    host, port
        Where to listen: at ``port`` and the next two.
    n_samples
        Of a burst; longer messages are not received.
    faults, seed
        Injected faults of the connection, and the seed of their random numbers.

    Raises InputError where it cannot listen.
    """

    def __init__(
        self,
        radio: RadioDriver,
        host: str,
        port: int,
        *,
        n_samples: int,
        faults: RadioFaults | None = None,
        seed: int = 0,
    ) -> None:
        import zmq

        self.radio, self.n_samples = radio, n_samples
        self._faults, self._rng = faults or RadioFaults(), np.random.default_rng([seed, 9])
        self._client: bytes | None = None
        self._heard_at = 0.0
        self._waiting: deque[NDArray[np.complex64]] = deque(maxlen=_MOST_WAITING)
        self._to_send = np.zeros(0, dtype=np.complex64)
        self._readers: deque[tuple[list[bytes], int]] = deque(maxlen=_MOST_WAITING)
        self._asked = False
        self._jobs: deque[_Job] = deque()
        self._job: _Job | None = None  # at work
        self._stopped = False
        self._context = zmq.Context()
        frame = 8 * n_samples + MOST_JSON
        kinds = ((zmq.ROUTER, frame), (zmq.ROUTER, 64), (zmq.DEALER, max(frame, 2**25)))
        sockets = []
        for k, (kind, most) in enumerate(kinds):
            socket = self._context.socket(kind)
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.MAXMSGSIZE, most)
            if kind == zmq.ROUTER:  # a client that has gone is an error of what is sent to it
                socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
            try:
                socket.bind(f"tcp://{host}:{port + k}")
            except zmq.ZMQError as error:
                self._context.destroy(linger=0)
                raise InputError(f"radar: tcp:{host}:{port + k}: {error}") from error
            sockets.append(socket)
        self._commands, self._received, self._transmit = sockets
        self._worker = Worker()

    def run(self) -> None:
        """Serve until `stop`."""
        import zmq

        try:
            while not self._stopped:
                sockets = [self._commands, self._received, self._transmit]
                ready = zmq.select([*sockets, self._worker.done], [], [], _POLL_S)[0]
                if self._worker.done in ready:
                    self._end_job()
                if self._commands in ready:
                    self._serve(self._commands.recv_multipart())
                if self._received in ready:
                    *way, asked = self._received.recv_multipart()
                    self._readers.append((way, parse_request(asked)))
                if self._transmit in ready:
                    self._queue_samples(self._transmit.recv_multipart()[-1])
                self._begin_job()
                self._answer_readers()
        finally:
            self._worker.close()
            self._context.destroy(linger=0)

    def stop(self) -> None:
        """End `run` soon; from any thread."""
        self._stopped = True

    def _serve(self, message: list[bytes]) -> None:
        """Answer one command, or leave it unanswered by an injected fault."""
        sender, *rest = message
        frames = rest[1:] if rest and not rest[0] else rest
        command: dict[str, Any] = {}
        try:
            command = _parsed(frames[0] if frames else b"")
            if command.get("do") == "burst":
                if self._happens(self._faults.drop):
                    self._client = None
                    return
                if self._happens(self._faults.stall):
                    time.sleep(self._faults.stall_s)
            fields = self._execute(sender, command, frames[1:])
        except (RadioError, InputError) as error:
            fields = {"error": str(error)}
        if fields is not None:
            self._send(sender, command.get("number"), fields)

    def _send(
        self, sender: bytes, number: Any, fields: dict[str, Any], samples: list[bytes] | None = None
    ) -> None:
        """Send an answer; the radio is free again where the client that has it is gone."""
        import zmq

        numbered = {**fields, "number": number if isinstance(number, int) else None}
        frames = [sender, b"", json.dumps(numbered).encode(), *(samples or [])]
        try:
            self._commands.send_multipart(frames, flags=zmq.NOBLOCK)
        except zmq.Again:
            pass  # it does not read its answers
        except zmq.ZMQError:
            self._release(sender)

    def _release(self, sender: bytes) -> None:
        """Free the radio of a client, and of what it has asked for that is not begun."""
        if sender == self._client:
            self._client = None
        self._jobs = deque(job for job in self._jobs if job.sender != sender)

    def _held(self, now: float) -> bool:
        """Whether a client has the radio: while it waits for an answer it is silent by right."""
        if self._client is None:
            return False
        waits = any(job.sender == self._client for job in (self._job, *self._jobs) if job)
        return waits or now - self._heard_at < _LEASE_S

    def _execute(
        self, sender: bytes, command: dict[str, Any], frames: list[bytes]
    ) -> dict[str, Any] | None:
        """Fields of the answer to a command; None where it comes when the radio has done it."""
        name, now = command.get("do"), time.monotonic()
        if name == "open":
            if sender != self._client and self._held(now):
                raise InputError("busy: another client has the radio")
            if command.get("version") != PROTOCOL_VERSION:
                raise InputError(f"version {command.get('version')!r}, expected {PROTOCOL_VERSION}")
            self._client = sender
        if sender != self._client:
            raise InputError("open the radio first")
        self._heard_at = now
        if name == "open":
            return {
                "device": self.radio.device,
                "receivers": self.radio.n_receivers,
                "sample_rate_hz": self.radio.sample_rate_hz,
                "patience_s": _PATIENCE_S,
            }
        if name == "close":
            self._release(sender)
            return {}
        if name == "time":
            return {"time_ns": self.radio.now_ns()}
        self._queue_job(_Job(sender, command.get("number"), self._call(command, frames)))
        return None

    def _call(
        self, command: dict[str, Any], frames: list[bytes]
    ) -> Callable[[], Tuned | Reception]:
        """What a command has the radio do."""
        name = command.get("do")
        if name == "tune":
            return partial(self.radio.tune, _number(command, "carrier_hz", float))
        if name == "burst":
            samples = to_samples(frames[0] if frames else b"")
            return partial(self.radio.burst, samples, _number(command, "start_ns", int))
        raise InputError(f"do: {name!r:.40}, expected open, tune, time, burst or close")

    def _queue_job(self, job: _Job) -> None:
        if len(self._jobs) >= _MOST_WAITING:
            raise InputError(f"{len(self._jobs)} commands are waiting, expected one at a time")
        self._jobs.append(job)

    def _begin_job(self) -> None:
        """Begin the next command, or without any the burst of a plain client, if complete."""
        if self._job is not None:
            return
        if self._jobs:
            self._job = self._jobs.popleft()
        elif self._client is None and len(self._to_send) >= self.n_samples:
            samples = self._to_send[: self.n_samples]
            self._to_send = self._to_send[self.n_samples :]
            self._job = _Job(None, None, lambda: self.radio.burst(samples, self.radio.now_ns()))
        if self._job is not None:
            self._worker.start(self._job.call)

    def _end_job(self) -> None:
        """Answer the command that the radio has done."""
        assert self._job is not None
        job, self._job = self._job, None
        fields: dict[str, Any]
        samples: list[bytes] = []
        try:
            done = self._worker.result()
            if isinstance(done, Reception):
                self._waiting.extend(done.samples)
            fields, samples = _fields_of(done)
        except (RadioError, InputError) as error:
            fields = {"error": str(error)}
        if job.sender is None:
            return  # the radio tells errors whoever started it
        if job.sender == self._client:
            self._heard_at = time.monotonic()
        self._send(job.sender, job.number, fields, samples)

    def _queue_samples(self, message: bytes) -> None:
        """Queue samples of a plain client; each complete burst is transmitted."""
        self._asked = False
        try:
            samples = to_samples(message)
        except InputError:
            return  # the convention has no way to refuse
        self._to_send = np.concatenate([self._to_send, samples])[-2 * self.n_samples :]

    def _answer_readers(self) -> None:
        """Answer requests for received samples; without any, request samples to transmit."""
        import zmq

        while self._readers and self._waiting:
            way, most = self._readers.popleft()
            samples = self._waiting.popleft()
            with suppress(zmq.ZMQError):  # the reader has gone, or does not read
                self._received.send_multipart([*way, samples[:most].tobytes()], flags=zmq.NOBLOCK)
            if len(samples) > most:
                self._waiting.appendleft(samples[most:])
        lacks = self.n_samples - len(self._to_send)
        if self._readers and self._client is None and not self._asked and lacks > 0:
            self._asked = self._request_samples(lacks)

    def _request_samples(self, n_samples: int) -> bool:
        """Request samples to transmit; False where no client is connected."""
        import zmq

        try:
            self._transmit.send_multipart([b"", request(n_samples)], flags=zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def _happens(self, chance: float) -> bool:
        return chance > 0 and bool(self._rng.random() < chance)


def _parsed(frame: bytes) -> dict[str, Any]:
    if len(frame) > MOST_JSON:
        raise InputError(f"command of {len(frame)} bytes, expected at most {MOST_JSON}")
    try:
        command = json.loads(frame)
    except (ValueError, RecursionError) as error:
        raise InputError("command is no JSON") from error
    if not isinstance(command, dict):
        raise InputError("command is no JSON object")
    return command


_Number = TypeVar("_Number", int, float)


def _number(command: dict[str, Any], name: str, kind: type[_Number]) -> _Number:
    """A number of a command. Raises InputError."""
    if name not in command:
        raise InputError(f"{name!r} is missing")
    try:
        return kind(command[name])
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: {command[name]!r:.40}, expected a number") from error


def _fields_of(done: Tuned | Reception) -> tuple[dict[str, Any], list[bytes]]:
    """Fields of the answer to what the radio has done, and the samples received."""
    if isinstance(done, Tuned):
        return {"carrier_hz": done.carrier_hz, "time_ns": done.locked_ns}, []
    edges = np.flatnonzero(np.diff(done.there, prepend=True, append=True))
    fields = {
        "start_ns": done.start_ns,
        "faults": [fault.name.lower() for fault in done.faults if fault.name],
        "gaps": edges.reshape(-1, 2).tolist(),
    }
    return fields, [done.samples.tobytes()] if done.there.any() else []
