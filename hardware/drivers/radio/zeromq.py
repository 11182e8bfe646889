"""A tunable radio with a clock behind ZeroMQ: commands and samples on one socket.

A command is a frame of JSON followed by the samples to transmit; an answer is a frame of JSON
followed by the samples received. RADIO.md describes both. Needs the package `pyzmq`.
"""

import json
import threading
import time
import uuid
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.answer import MOST_NS, Answer
from hardware.drivers.radio.interface import RadioDriver, RadioError, Reception, Tuned
from hardware.errors import InputError

PROTOCOL_VERSION = 2
#: Bytes of the JSON of one message, at most.
MOST_JSON = 2**16

_OPEN_S = 5.0  # timeout of the first answer
_CLOSE_S = 1.0  # timeout of the answer to the last command
_LOOK_S = 0.1  # interval at which ``over`` is checked while waiting
_MOST_BYTES = 2**30  # of one frame
_MOST_RECEIVERS = 256
_MOST_PATIENCE_S = 3600.0


def to_samples(frame: bytes) -> NDArray[np.complex64]:
    """Samples of a frame. Raises InputError for a partial or non-finite sample."""
    if len(frame) % 8:
        raise InputError(f"{len(frame)} bytes, expected complex samples of 8")
    samples = np.frombuffer(frame, dtype="<c8")
    if not np.isfinite(samples).all():
        raise InputError("a sample is not a number")
    return samples


class ZeroMqRadio(RadioDriver):
    """A radio that listens at a host and port.

    Parameters
    ----------
    host, port
        Where it listens.
    timeout_s
        Timeout of an answer, in addition to the delay and duration of a burst; by default the one
        that the radio requests.
    over
        Event that ends the wait for an answer.

    Raises RadioError where the radio does not answer, or another client has opened it.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        timeout_s: float | None = None,
        over: threading.Event | None = None,
    ) -> None:
        import zmq

        self.device = f"zmq://{host}:{port}"
        self.timeout_s = timeout_s or _OPEN_S
        self._over = over or threading.Event()
        self._number = 0
        self._known_ns: int | None = None
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.MAXMSGSIZE, _MOST_BYTES)
        self._socket.setsockopt(zmq.ROUTING_ID, uuid.uuid4().bytes)
        try:
            self._socket.connect(f"tcp://{host}:{port}")
            answer, _ = self._command("open", version=PROTOCOL_VERSION)
            self.n_receivers = answer.whole("receivers", 1, _MOST_RECEIVERS)
            self.sample_rate_hz = answer.positive("sample_rate_hz")
            patience_s = answer.positive("patience_s", _MOST_PATIENCE_S)
            self.timeout_s = timeout_s or patience_s
            self.device = f"{answer.text('device')} at {self.device}"
        except (RadioError, zmq.ZMQError) as error:
            self._context.destroy(linger=0)
            raise RadioError(str(error)) from error

    def tune(self, carrier_hz: float) -> Tuned:
        """See `RadioDriver.tune`."""
        answer, _ = self._command("tune", carrier_hz=carrier_hz)
        return Tuned(answer.positive("carrier_hz"), self._time_in(answer))

    def now_ns(self) -> int:
        """See `RadioDriver.now_ns`."""
        answer, _ = self._command("time")
        return self._time_in(answer)

    def burst(self, samples: NDArray[np.complex64], start_ns: int) -> Reception:
        """See `RadioDriver.burst`."""
        n = len(samples)
        # The timeout needs no exact clock, whose request would take a part of the step's time.
        known_ns = self.now_ns() if self._known_ns is None else self._known_ns
        ends_s = (start_ns - known_ns) / 1e9 + n / self.sample_rate_hz
        frame = np.ascontiguousarray(samples, dtype="<c8").tobytes()
        answer, frames = self._command(
            "burst", frame, wait_s=self.timeout_s + max(0.0, ends_s), start_ns=int(start_ns)
        )
        # A burst with another start time does not belong to the schedule.
        started = answer.whole("start_ns", int(start_ns), int(start_ns))
        faults, there = answer.faults(), answer.there(n)
        try:
            received = to_samples(b"".join(frames))
        except InputError as error:
            raise RadioError(f"{self.device}: burst: {error}") from error
        if not received.size:
            return Reception.nothing(self.n_receivers, n, started, faults)
        if len(frames) != 1 or received.size != self.n_receivers * n:
            raise RadioError(
                f"{self.device}: burst: {received.size} samples came back in {len(frames)} frames, "
                f"expected {self.n_receivers} x {n} in one"
            )
        received = received.reshape(self.n_receivers, n)
        if not there.all():
            received = np.where(there, received, np.complex64(0))
        return Reception(received, there, started, faults)

    def close(self) -> None:
        """See `RadioDriver.close`."""
        if self._context.closed:
            return
        try:
            self._command("close", wait_s=min(self.timeout_s, _CLOSE_S))
        except OSError:
            pass  # it drops a silent client by itself
        finally:
            self._context.destroy(linger=0)

    def _command(
        self, name: str, *frames: bytes, wait_s: float | None = None, **fields: Any
    ) -> tuple[Answer, list[bytes]]:
        """Send a command and wait for its answer: the JSON, and the frames behind it."""
        import zmq

        self._number += 1
        message = json.dumps({"do": name, "number": self._number, **fields}).encode()
        self._socket.send_multipart([b"", message, *frames])
        wait_s = self.timeout_s if wait_s is None else wait_s
        until = time.monotonic() + wait_s
        while True:
            left_s = max(0.0, until - time.monotonic())
            if not self._socket.poll(round(1e3 * min(left_s, _LOOK_S)), zmq.POLLIN):
                if left_s == 0:
                    raise RadioError(f"{self.device}: {name}: no answer within {wait_s:.3g} s")
                if self._over.is_set() and name != "close":
                    raise RadioError(f"{self.device}: {name}: given up, no answer yet")
                continue
            _, *parts = self._socket.recv_multipart()
            fields = self._parsed(parts[0] if parts else b"")
            number = fields.get("number")
            if isinstance(number, bool) or number != self._number:
                continue  # answer to an earlier command
            answer = Answer(self.device, name, fields)
            if "error" in fields:
                raise RadioError(f"{self.device}: {answer.text('error')}")
            return answer, parts[1:]

    def _parsed(self, message: bytes) -> dict[str, Any]:
        try:
            if len(message) > MOST_JSON:
                raise InputError(f"{len(message)} bytes")
            answer = json.loads(message)
        except (ValueError, RecursionError) as error:
            raise RadioError(f"{self.device}: answer is no JSON: {error}") from error
        if not isinstance(answer, dict):
            raise RadioError(f"{self.device}: answer {answer!r:.100}")
        return answer

    def _time_in(self, answer: Answer) -> int:
        self._known_ns = answer.whole("time_ns", 0, MOST_NS)
        return self._known_ns
