"""Plain virtual radios that exchange samples, by the convention of GNU Radio and srsRAN.

The side with samples answers requests (REP), the side that needs samples sends them (REQ); an
answer is raw complex64 without a header. A request is GNU Radio's (a 32-bit integer: largest number
of samples) or srsRAN's (one byte: all that are available). Needs the package `pyzmq`.
"""

import struct
import time

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import Fault, RadioDriver, RadioError, Reception, Tuned
from hardware.drivers.radio.zeromq import to_samples
from hardware.errors import InputError

#: Largest number of samples of one answer.
MOST_SAMPLES = 2**16

_MOST_BYTES = 2**25  # of an answer: srsRAN's radios send what they have, whatever was asked for


def request(n_samples: int) -> bytes:
    """Request for at most so many samples."""
    return struct.pack("<i", min(n_samples, MOST_SAMPLES))


def parse_request(message: bytes) -> int:
    """How many samples a request asks for, at most."""
    if len(message) == 4:
        return max(0, min(int(struct.unpack("<i", message)[0]), MOST_SAMPLES))
    return MOST_SAMPLES


class StreamRadio(RadioDriver):
    """A virtual radio with a fixed carrier, whose only clock is the number of its samples.

    A burst starts with the next sample; its reception has the start time.

    Parameters
    ----------
    transmit
        Address of the transmit samples, such as ``tcp://127.0.0.1:2001``; the port ``*`` is any
        free one, which the attribute ``transmit`` then contains.
    receive
        Address of the received samples, such as ``tcp://127.0.0.1:2000``.
    listen
        Whether this side listens at ``transmit``, as is the convention; else the other side does.
    carrier_hz, sample_rate_hz
        Carrier and sample rate of the radio.
    timeout_s
        Timeout of an answer.
    """

    def __init__(
        self,
        transmit: str,
        receive: str,
        *,
        listen: bool = True,
        carrier_hz: float,
        sample_rate_hz: float,
        timeout_s: float = 5.0,
    ) -> None:
        import zmq

        self.device = f"virtual radio {receive}"
        self.n_receivers = 1
        self.sample_rate_hz = sample_rate_hz
        self.timeout_s = timeout_s
        self._carrier_hz = carrier_hz
        self._n_samples = 0
        self._asked = False  # a request is under way
        self._context = zmq.Context()
        self._transmit, self._receive = (self._context.socket(k) for k in (zmq.REP, zmq.REQ))
        for socket, most in ((self._transmit, 64), (self._receive, _MOST_BYTES)):
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.MAXMSGSIZE, most)
        try:
            (self._transmit.bind if listen else self._transmit.connect)(transmit)
            self.transmit = self._transmit.getsockopt_string(zmq.LAST_ENDPOINT)
            self._receive.connect(receive)
        except zmq.ZMQError as error:
            self.close()
            raise RadioError(f"{transmit}, {receive}: {error}") from error

    def tune(self, carrier_hz: float) -> Tuned:
        """See `RadioDriver.tune`; refuses another carrier than its own."""
        if carrier_hz != self._carrier_hz:
            raise RadioError(
                f"{self.device}: stands at {self._carrier_hz:.0f} Hz, asked for {carrier_hz:.0f} Hz"
            )
        return Tuned(carrier_hz, self.now_ns())

    def now_ns(self) -> int:
        """See `RadioDriver.now_ns`: the samples so far."""
        return round(1e9 * self._n_samples / self.sample_rate_hz)

    def burst(self, samples: NDArray[np.complex64], start_ns: int) -> Reception:
        """See `RadioDriver.burst`."""
        import zmq

        started, left = self.now_ns(), np.asarray(samples, dtype="<c8")
        received = np.empty(len(left), dtype=np.complex64)
        there, until = 0, time.monotonic() + self.timeout_s
        while there < len(received):
            if not self._asked:
                self._receive.send(request(len(received) - there))
                self._asked = True
            sockets = [self._receive, *([self._transmit] if len(left) else [])]
            ready = zmq.select(sockets, [], [], max(0.0, until - time.monotonic()))[0]
            if not ready or time.monotonic() > until:
                raise RadioError(f"{self.device}: no samples within {self.timeout_s:g} s")
            if self._transmit in ready:
                n = parse_request(self._transmit.recv())
                self._transmit.send(left[:n].tobytes())
                left = left[n:]
            if self._receive in ready:
                part = self._receive_samples(len(received) - there)
                received[there : there + len(part)] = part
                there += len(part)
                if len(part):
                    until = time.monotonic() + self.timeout_s
        self._n_samples += len(received)
        return Reception(received[None], np.ones(len(received), dtype=np.bool_), started, Fault(0))

    def close(self) -> None:
        """See `RadioDriver.close`."""
        self._context.destroy(linger=0)

    def _receive_samples(self, most: int) -> NDArray[np.complex64]:
        self._asked = False
        try:
            part = to_samples(self._receive.recv())
        except InputError as error:
            raise RadioError(f"{self.device}: {error}") from error
        if len(part) > most:
            raise RadioError(f"{self.device}: more samples came back than were sent")
        return part
