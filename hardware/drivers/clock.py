"""Device clock against host clock: offset and drift from exchanged times.

Each exchange (host sends t0, device receives t1 and sends t2, host receives t3) gives the offset
((t1 - t0) + (t2 - t3)) / 2, with an error of half the asymmetry of the two ways, so of less than
half the round trip (Cristian, Distributed Computing 3, 1989; RFC 5905). A clock that drifts evenly
is a line through all these intervals: the model is the middle of all such lines, and half their
spread bounds its error. Where there is none, a clock was set or its drift has changed, and earlier
exchanges count no more.
"""

import logging
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError

_log = logging.getLogger(__name__)

#: Drift of a clock that counts as one: 1 %, a hundred times that of a cheap oscillator.
MOST_DRIFT = 0.01
#: Device times are smaller: they and their offsets are written as 64 bits.
MOST_TIME_NS = 2**62
_KEPT = 64
#: Exchanges in agreement that make a clock.
_SURE = 8
#: Of a clock that has not run at the host's rate so far, smaller steps are not told: they are in
#: the stated error. Between two exchanges a clock that stands still loses a round trip.
_UNTOLD_NS = 1e8
#: The latest exchanges: a second of them in a camera's run.
_LATEST = 4
#: Of times that are whole ns, and of half their sums.
_ROUNDING_NS = 1.0

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClockModel:
    """``device = host + offset + drift (host - reference)``, all ns of the host's clock.

    ``error_ns`` bounds the error of a time from the first exchange that counts on, if the clock
    drifts evenly; it is never less than what one of the latest exchanges alone says, since a step
    or a change of drift within the round trip is not seen. After a jump of the clock it holds the
    jump, until some exchanges agree.
    ``drift`` is a pure number: 1e-6 is a device clock that gains a microsecond a second.
    """

    reference_ns: int
    offset_ns: int
    drift: float
    error_ns: float

    def host_ns(self, device_ns: int) -> int:
        """Host time of a device time."""
        since = device_ns - self.offset_ns - self.reference_ns  # whole ns: floats are too coarse
        return self.reference_ns + since - round(since * self.drift / (1 + self.drift))

    def device_ns(self, host_ns: int) -> int:
        """Device time of a host time."""
        return host_ns + self.offset_ns + round(self.drift * (host_ns - self.reference_ns))


class _Exchange(NamedTuple):
    """Host time in its middle, offset, and round trip without the device's own time, ns."""

    host_ns: int
    offset_ns: int
    trip_ns: int


class ClockFilter:
    """The latest exchanges with a device, and the clock model that they allow.

    ``name`` is that of the device in warnings. ``ahead_s``: how long after the latest exchange the
    stated error has to hold, since times are told before the next one.
    """

    def __init__(self, name: str = "device", *, ahead_s: float = 0.0) -> None:
        self._name, self._ahead_ns = name, 1e9 * ahead_s
        self._exchanges: deque[_Exchange] = deque(maxlen=_KEPT)
        self._model: ClockModel | None = None
        self._jumped_ns, self._was_told = 0, False

    def add(self, sent_ns: int, received_ns: int, replied_ns: int, returned_ns: int) -> None:
        """Add one exchange: t0, t1, t2, t3.

        Earlier ones that no drift up to `MOST_DRIFT` explains together with it count no more; where
        hardly any does, one of the clocks was set, which is warned of. Raises InputError for a
        reply that came before the request, on either clock, or a device time beyond 146 years.
        """
        held = replied_ns - received_ns  # by the device's clock
        slack = math.ceil(MOST_DRIFT * max(held, 0))
        trip = returned_ns - sent_ns - held + slack
        if returned_ns < sent_ns or replied_ns < received_ns or trip < 0:
            raise InputError(
                f"time exchange: {sent_ns}, {received_ns}, {replied_ns}, {returned_ns} ns run back"
            )
        if abs(received_ns) > MOST_TIME_NS:
            raise InputError(
                f"time exchange: device time {received_ns} ns, expected at most {MOST_TIME_NS:g}"
            )
        middle = sent_ns + (returned_ns - sent_ns) // 2
        new = _Exchange(middle, (received_ns - sent_ns + replied_ns - returned_ns) // 2, trip)
        n_before = len(self._exchanges)
        self._exchanges.append(new)
        found = _model_of(self._exchanges, self._ahead_ns)
        contradicts = found is None
        while found is None:
            self._exchanges.popleft()
            found = _model_of(self._exchanges, self._ahead_ns)
        if contradicts and len(self._exchanges) <= 2:
            found = self._after_jump(new, n_before)
        if len(self._exchanges) >= _SURE:
            self._jumped_ns = 0
        self._model = replace(found, error_ns=found.error_ns + self._jumped_ns)

    def _after_jump(self, new: _Exchange, n_before: int) -> ClockModel:
        """The model of one exchange alone, after a warning."""
        assert self._model is not None
        expected_ns = self._model.device_ns(new.host_ns) - new.host_ns
        jumped_ns = new.offset_ns - expected_ns
        # Told once of a clock that never runs at the host's rate, as that of a fast virtual device.
        is_sure = n_before >= _SURE
        if is_sure or (not self._was_told and abs(jumped_ns) > _UNTOLD_NS):
            self._was_told = True
            _log.warning(
                "%s: its clock jumped by %.6g s against the host's: one of them was set, or they "
                "do not run at one rate; its times are on the host's clock as of now",
                self._name,
                jumped_ns * 1e-9,
            )
        self._jumped_ns = abs(jumped_ns)
        self._exchanges.clear()
        self._exchanges.append(new)
        found = _model_of(self._exchanges, self._ahead_ns)
        assert found is not None
        return found

    @property
    def model(self) -> ClockModel | None:
        """None before the first exchange."""
        return self._model


def _model_of(exchanges: Sequence[_Exchange], ahead_ns: float) -> ClockModel | None:
    """The middle of all lines through what the exchanges allow, None where there is none."""
    latest = exchanges[-1]
    t, offset, trip = (
        np.array([float(part - origin) for part in parts])
        for parts, origin in zip(
            zip(*exchanges, strict=True), (latest.host_ns, latest.offset_ns, 0), strict=True
        )
    )
    half = (1 + MOST_DRIFT) * trip / 2 + _ROUNDING_NS  # the clock drifts within the exchange too
    low, high = offset - half, offset + half
    begin, end = float((t - trip / 2).min()), float(t.max()) + ahead_ns
    first, last = _range_at(t - begin, low, high), _range_at(end - t, low, high)
    if first is None or last is None:
        return None
    drift = (sum(last) - sum(first)) / 2 / (end - begin) if end > begin else 0.0
    at_latest = sum(last) / 2 - drift * end
    error = max(last[1] - last[0], first[1] - first[0]) / 2
    alone = half + np.abs(at_latest + drift * t - offset)
    error = max(error, float(alone[-_LATEST:].min()))
    return ClockModel(latest.host_ns, latest.offset_ns + round(at_latest), drift, error)


def _range_at(away: Array, low: Array, high: Array) -> tuple[float, float] | None:
    """Least and largest offset, at a time ``away`` (n,) >= 0 from exchanges on one side of it, of a
    clock that was within ``low`` and ``high`` (n,) at each and drifts evenly; None: there is none.

    A line through v at that time has the slope (v - offset) / away at each exchange: the slopes
    that two of them allow have to meet.
    """
    near, far = away[:, None], away[None, :]
    apart = far - near
    farther = apart > 0
    span = np.where(farther, apart, 1.0)
    largest = np.where(farther, (high[:, None] * far - low[None, :] * near) / span, np.inf)
    least = np.where(farther, (low[:, None] * far - high[None, :] * near) / span, -np.inf)
    most = min(float(largest.min()), float((high + MOST_DRIFT * away).min()))
    lowest = max(float(least.max()), float((low - MOST_DRIFT * away).max()))
    return (lowest, most) if lowest <= most else None
