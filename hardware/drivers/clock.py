"""Device clock against host clock: offset and drift from exchanged times.

Each exchange (host sends t0, device receives t1 and sends t2, host receives t3) gives the offset
((t1 - t0) + (t2 - t3)) / 2, with an error of half the asymmetry of the two ways, so of less than
half the round trip (Cristian, Distributed Computing 3, 1989; RFC 5905). Exchanges with short round
trips are the most accurate: a line through the best half gives offset and drift. An exchange that
no drift explains tells that one of the clocks was set, as by a device's restart.
"""

import logging
from collections import deque
from dataclasses import dataclass

import numpy as np

from hardware.errors import InputError

_log = logging.getLogger(__name__)

#: Drift of a clock that counts as one: 1 %, a hundred times that of a cheap oscillator.
MOST_DRIFT = 0.01
_KEPT = 64
#: Exchanges in agreement that make a clock.
_SURE = 8


@dataclass(frozen=True)
class ClockModel:
    """``device = host + offset + drift (host - reference)``, all ns of the host's clock.

    ``error_ns`` bounds the offset: half the shortest round trip. ``drift`` is a pure number: 1e-6
    is a device clock that gains a microsecond a second.
    """

    reference_ns: int
    offset_ns: int
    drift: float
    error_ns: float

    def host_ns(self, device_ns: int) -> int:
        """Host time of a device time."""
        since = (device_ns - self.offset_ns - self.reference_ns) / (1 + self.drift)
        return self.reference_ns + round(since)

    def device_ns(self, host_ns: int) -> int:
        """Device time of a host time."""
        return host_ns + self.offset_ns + round(self.drift * (host_ns - self.reference_ns))


class ClockFilter:
    """The latest exchanges with a device, and the clock model fitted to them.

    ``name`` is that of the device in warnings.
    """

    def __init__(self, name: str = "device") -> None:
        self._name, self._was_told = name, False
        self._exchanges: deque[tuple[int, int, int]] = deque(maxlen=_KEPT)

    def add(self, sent_ns: int, received_ns: int, replied_ns: int, returned_ns: int) -> None:
        """Add one exchange: t0, t1, t2, t3.

        Where it contradicts the one before, by more than `MOST_DRIFT` and half their round trips,
        the earlier ones are of another clock and are dropped, with a warning. Raises InputError for
        a reply that came before the request, on either clock.
        """
        trip = (returned_ns - sent_ns) - (replied_ns - received_ns)
        if returned_ns < sent_ns or replied_ns < received_ns or trip < 0:
            raise InputError(
                f"time exchange: {sent_ns}, {received_ns}, {replied_ns}, {returned_ns} ns run back"
            )
        offset = (received_ns - sent_ns + replied_ns - returned_ns) // 2
        middle = sent_ns + (returned_ns - sent_ns) // 2
        if self._exchanges:
            last, before, trip_before = self._exchanges[-1]
            possible = MOST_DRIFT * abs(middle - last) + (trip + trip_before) / 2 + 1
            if abs(offset - before) > possible:
                self._start_anew(offset - before, middle - last)
        self._exchanges.append((middle, offset, trip))

    def _start_anew(self, jumped_ns: int, within_ns: int) -> None:
        # Told once of a clock that never runs at the host's rate, as that of a fast virtual device.
        if not self._was_told or len(self._exchanges) >= _SURE:
            _log.warning(
                "%s: its clock jumped by %.6g s against the host's within %.6g s: one of them was "
                "set, or they do not run at one rate; its times are on the host's clock as of now",
                self._name,
                jumped_ns * 1e-9,
                within_ns * 1e-9,
            )
        self._was_told = True
        self._exchanges.clear()

    @property
    def model(self) -> ClockModel | None:
        """None before the first exchange.

        The drift is 0 until the exchanges span 100 times their own error.
        """
        if not self._exchanges:
            return None
        times, offsets, trips = zip(*self._exchanges, strict=True)
        reference, base = times[-1], offsets[-1]
        trip = np.array(trips, np.float64)
        good = trip <= np.median(trip)
        t = np.array([float(time - reference) for time in times])[good]
        y = np.array([float(offset - base) for offset in offsets])[good]
        error = float(trip.min()) / 2
        drift = 0.0
        if len(t) > 2 and np.ptp(t) > 100 * max(error, 1.0):
            drift = float(np.polyfit(t - t.mean(), y, 1)[0])
        offset = base + round(float(np.mean(y - drift * t)))
        return ClockModel(reference, offset, drift, error)
