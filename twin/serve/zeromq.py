"""A radio behind ZeroMQ: the other end of `ZeroMqRadio` and of plain virtual radios.

Three ports from the given one on: commands; received samples, on request; samples to transmit,
which the server requests. The last two are the convention of GNU Radio and srsRAN. While a client
has opened the radio, the second port has a copy of its received samples; otherwise both ports form
a plain virtual radio.
"""

import json
import time
from collections import deque
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import RadioDriver, RadioError, Reception
from hardware.drivers.radio.stream import parse_request, request
from hardware.drivers.radio.zeromq import MOST_JSON, PROTOCOL_VERSION, to_samples
from twin.files import InputError
from twin.serve.faults import RadioFaults

_LEASE_S = 10.0  # of silence, after which another client may open the radio
_PATIENCE_S = 60.0  # for the first burst of a scene, for which kernels are compiled
_MOST_WAITING = 64  # bursts not fetched yet; older ones are dropped
_POLL_S = 0.1


class RadioServer:
    """Serves a radio until it is stopped.

    Parameters
    ----------
    radio
        The radio to serve.
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
        self._stopped = False
        self._context = zmq.Context()
        frame = 8 * n_samples + MOST_JSON
        kinds = ((zmq.ROUTER, frame), (zmq.ROUTER, 64), (zmq.DEALER, max(frame, 2**25)))
        sockets = []
        for k, (kind, most) in enumerate(kinds):
            socket = self._context.socket(kind)
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.MAXMSGSIZE, most)
            try:
                socket.bind(f"tcp://{host}:{port + k}")
            except zmq.ZMQError as error:
                self._context.destroy(linger=0)
                raise InputError(f"radar: tcp:{host}:{port + k}: {error}") from error
            sockets.append(socket)
        self._commands, self._received, self._transmit = sockets

    def run(self) -> None:
        """Serve until `stop`."""
        import zmq

        try:
            while not self._stopped:
                sockets = [self._commands, self._received, self._transmit]
                ready = zmq.select(sockets, [], [], _POLL_S)[0]
                if self._commands in ready:
                    self._serve(self._commands.recv_multipart())
                if self._received in ready:
                    *way, asked = self._received.recv_multipart()
                    self._readers.append((way, parse_request(asked)))
                if self._transmit in ready:
                    self._queue_samples(self._transmit.recv_multipart()[-1])
                self._answer_readers()
        finally:
            self._context.destroy(linger=0)

    def stop(self) -> None:
        """End `run` soon; from any thread."""
        self._stopped = True

    def _serve(self, message: list[bytes]) -> None:
        """Answer one command, or leave it unanswered by an injected fault."""
        sender, *rest = message
        frames = rest[1:] if rest and not rest[0] else rest
        command: dict[str, Any] = {}
        answer: dict[str, Any] = {}
        samples: list[bytes] = []
        try:
            command = _parsed(frames[0] if frames else b"")
            if command.get("do") == "burst":
                if self._happens(self._faults.drop):
                    self._client = None
                    return
                if self._happens(self._faults.stall):
                    time.sleep(self._faults.stall_s)
            answer, samples = self._execute(sender, command, frames[1:])
        except (RadioError, InputError) as error:
            answer = {"error": str(error)}
        number = command.get("number")
        answer["number"] = number if isinstance(number, int) else None
        self._commands.send_multipart([sender, b"", json.dumps(answer).encode(), *samples])

    def _execute(
        self, sender: bytes, command: dict[str, Any], frames: list[bytes]
    ) -> tuple[dict[str, Any], list[bytes]]:
        name, now = command.get("do"), time.monotonic()
        if name == "open":
            if self._client not in (None, sender) and now - self._heard_at < _LEASE_S:
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
            }, []
        if name == "close":
            self._client = None
            return {}, []
        if name == "tune":
            tuned = self.radio.tune(_number(command, "carrier_hz", float))
            return {"carrier_hz": tuned.carrier_hz, "time_ns": tuned.locked_ns}, []
        if name == "time":
            return {"time_ns": self.radio.now_ns()}, []
        if name == "burst":
            heard = self._burst(
                to_samples(frames[0] if frames else b""), _number(command, "start_ns", int)
            )
            return _reception_fields(heard), [heard.samples.tobytes()] if heard.there.any() else []
        raise InputError(f"do: {name!r:.40}, expected open, tune, time, burst or close")

    def _burst(self, samples: NDArray[np.complex64], start_ns: int) -> Reception:
        heard = self.radio.burst(samples, start_ns)
        self._waiting.extend(heard.samples)
        self._heard_at = time.monotonic()
        return heard

    def _queue_samples(self, message: bytes) -> None:
        """Queue samples of a plain client, and transmit each complete burst."""
        self._asked = False
        try:
            samples = to_samples(message)
        except InputError:
            return  # the convention has no way to refuse
        self._to_send = np.concatenate([self._to_send, samples])[-2 * self.n_samples :]
        while self._client is None and len(self._to_send) >= self.n_samples:
            with suppress(RadioError):  # which the radio tells whoever started it
                self._burst(self._to_send[: self.n_samples], self.radio.now_ns())
            self._to_send = self._to_send[self.n_samples :]

    def _answer_readers(self) -> None:
        """Answer requests for received samples; without any, request samples to transmit."""
        while self._readers and self._waiting:
            way, most = self._readers.popleft()
            samples = self._waiting.popleft()
            self._received.send_multipart([*way, samples[:most].tobytes()])
            if len(samples) > most:
                self._waiting.appendleft(samples[most:])
        if self._readers and self._client is None and not self._asked:
            self._asked = self._request_samples(self.n_samples - len(self._to_send))

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


def _reception_fields(heard: Reception) -> dict[str, Any]:
    """Fields of the answer to a burst, beside its samples."""
    edges = np.flatnonzero(np.diff(heard.there, prepend=True, append=True))
    return {
        "start_ns": heard.start_ns,
        "faults": [fault.name.lower() for fault in heard.faults if fault.name],
        "gaps": edges.reshape(-1, 2).tolist(),
    }
