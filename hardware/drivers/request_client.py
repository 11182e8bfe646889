"""A client of the camera's protocol: requests and replies on a line that is reopened after a
failure.
"""

import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

from hardware.drivers.clock import MOST_DRIFT, ClockFilter
from hardware.drivers.framing import Deframer, encode
from hardware.drivers.link import Link
from hardware.drivers.messages import (
    Configure,
    Configured,
    Identity,
    Measurement,
    Message,
    Query,
    Refused,
    Request,
    Status,
    Time,
    TimeReply,
    from_frame,
    to_frame,
)
from hardware.errors import DeviceError, InputError, LinkError, NoAnswerError

_log = logging.getLogger(__name__)
_Expected = TypeVar("_Expected", Identity, Configured, Status, TimeReply)

#: Interval between exchanges of time while measuring; and until the next one has come, at most.
_SYNC_PERIOD_S, _NEXT_SYNC_S = 0.25, 0.3
#: Host times that were sent, of which answers may still come.
_TIMES_KEPT = 64
#: Time that Configure may take a device beyond any other request (protocol, section 1).
_CONFIGURE_S = 0.9
#: Interval at which ``over`` is checked while waiting.
_LOOK_S = 0.1


@dataclass
class Statistics:
    """Counts since the camera was opened: frames measured, lost, broken on the line, refused by the
    driver; reconnections and restarts; tables uploaded.
    """

    frames: int = 0
    lost: int = 0
    rejected: int = 0
    refused: int = 0
    reconnects: int = 0
    restarts: int = 0
    uploads: int = 0


@dataclass(frozen=True)
class Patience:
    """Timeout of a reply, number of attempts, timeout of a reconnection and of a running device
    that answers and measures nothing.
    """

    reply_s: float = 0.5
    attempts: int = 4
    reconnect_s: float = 10.0
    between_attempts_s: float = 0.1


class RequestClient:
    """Sends requests to the device at a URL.

    ``inbox`` holds its unsolicited messages, ``clock`` its clock relative to ``time.time_ns``.

    Parameters
    ----------
    url
        As in pyserial.
    patience, baud
        Timeouts; baud rate of a serial line.
    over
        Event that ends all waiting after at most one reply.

    Raises LinkError where no line can be opened within ``patience``.
    """

    def __init__(
        self, url: str, *, patience: Patience, baud: int, over: threading.Event | None = None
    ) -> None:
        self.over = over or threading.Event()
        self.url, self.patience, self.statistics = url, patience, Statistics()
        self.inbox: deque[Measurement | Status] = deque(maxlen=4096)
        self.clock = ClockFilter(url, ahead_s=_NEXT_SYNC_S)
        self._baud = baud
        self._tags = itertools.cycle(range(1, 256))
        self._next_sync_s = 0.0
        self._asked_ns: deque[int] = deque(maxlen=_TIMES_KEPT)
        #: Of the answer since `synchronize` with the latest device time: when the host asked, and
        #: that time. One of a device that was reset is earlier.
        self._told_ns: tuple[int, int] | None = None
        self._link, self._deframer = self._open(), Deframer()

    @property
    def measured(self) -> bool:
        """Whether measurements wait in the inbox."""
        return any(isinstance(message, Measurement) for message in self.inbox)

    def ask(self, request: Request, expected: type[_Expected]) -> _Expected:
        """Send a request, repeatedly, until it is answered.

        Raises NoAnswerError, DeviceError, LinkError.
        """
        asked = 0
        reply_s = self.patience.reply_s + (_CONFIGURE_S if isinstance(request, Configure) else 0.0)
        while asked < self.patience.attempts and not (asked and self.over.is_set()):
            asked += 1
            tag = next(self._tags)
            self._link.write(encode(to_frame(request, tag)))
            deadline = time.monotonic() + reply_s
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
        raise NoAnswerError(
            f"{self.url}: no answer to {type(request).__name__} after "
            f"{asked} attempts of {reply_s:g} s"
        )

    def status(self) -> Status:
        """State of the device."""
        return self.ask(Query(), Status)

    def synchronize(self, exchanges: int) -> None:
        """Make several exchanges of time, with a device whose clock may have begun anew."""
        self._told_ns = None
        for _ in range(exchanges):
            self.ask(self._time(), TimeReply)
        self._next_sync_s = time.monotonic() + _SYNC_PERIOD_S

    @property
    def told_ns(self) -> int | None:
        """The latest time of the device's clock that it has told; None: none."""
        return None if self._told_ns is None else self._told_ns[1]

    def clock_has_come_to(self, device_ns: int) -> bool:
        """Whether the device's clock has, by its latest answer and the time since; where these do
        not allow it, the device is asked. True where it was reset meanwhile: what it sent before
        is of a clock that is gone. Raises as `ask`.
        """
        if self._told_ns is not None:
            asked_ns, told_ns = self._told_ns
            since_ns = max(time.time_ns() - asked_ns, 0) * (1 + MOST_DRIFT)
            if device_ns <= told_ns + since_ns:
                return True
        now = self.status()
        return bool(now.booted) or device_ns <= now.time_ns

    def next(self, silence_s: float) -> Measurement | Status | None:
        """Next message of a run; None after a silence, or when it is over."""
        deadline = time.monotonic() + silence_s
        self._synchronize_if_due()
        while not self.inbox and (left := deadline - time.monotonic()) > 0:
            if self.over.is_set():
                break
            self._synchronize_if_due()
            for tag, message in self._receive(min(left, _LOOK_S)):
                self._keep(tag, message)
        return self.inbox.popleft() if self.inbox else None

    def _synchronize_if_due(self) -> None:
        if time.monotonic() > self._next_sync_s:
            self._next_sync_s = time.monotonic() + _SYNC_PERIOD_S
            self._link.write(encode(to_frame(self._time(), 0)))

    def reconnect(self) -> Status:
        """Open a new line on which the device answers; its state."""
        deadline = time.monotonic() + self.patience.reconnect_s
        while True:
            self._link.close()
            self._link, self._deframer = self._open(), Deframer()
            self.statistics.reconnects += 1
            try:
                return self.status()
            except LinkError:
                if time.monotonic() > deadline or self.over.is_set():
                    raise
                time.sleep(self.patience.between_attempts_s)

    def close(self) -> None:
        """Close the line; any number of times."""
        self._link.close()

    def _keep(self, tag: int, message: Message) -> None:
        """Store unsolicited messages of the device; late replies to old requests are dropped."""
        if tag == 0 and isinstance(message, (Measurement, Status)):
            self.inbox.append(message)

    def _receive(self, timeout_s: float) -> Iterator[tuple[int, Message]]:
        """Messages with their tags, from one read."""
        data = self._link.read(timeout_s)
        now_ns = time.time_ns()
        before = self._deframer.rejected
        frames = self._deframer.feed(data)
        self.statistics.rejected += self._deframer.rejected - before
        for frame in frames:
            try:
                message = from_frame(frame)
                if isinstance(message, TimeReply):
                    self._exchanged(message, now_ns)
            except InputError as error:
                self.statistics.rejected += 1
                _log.warning("%s: %s", self.url, error)
            else:
                yield frame.tag, message

    def _time(self) -> Time:
        """A request of the device's time."""
        self._asked_ns.append(time.time_ns())
        return Time(self._asked_ns[-1])

    def _exchanged(self, reply: TimeReply, now_ns: int) -> None:
        """Add a reply to the clock. Raises InputError for one to no request."""
        if reply.host_ns not in self._asked_ns:
            raise InputError(f"time exchange: {reply.host_ns} ns: the host sent another time")
        self.clock.add(reply.host_ns, reply.received_ns, reply.sent_ns, now_ns)
        if self._told_ns is None or reply.sent_ns > self._told_ns[1]:
            self._told_ns = reply.host_ns, reply.sent_ns

    def _open(self) -> Link:
        deadline = time.monotonic() + self.patience.reconnect_s
        while True:
            try:
                return Link(self.url, baud=self._baud)
            except LinkError:
                if time.monotonic() > deadline or self.over.is_set():
                    raise
                time.sleep(self.patience.between_attempts_s)
