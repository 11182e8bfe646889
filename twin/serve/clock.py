"""The clock of a virtual device."""

import time
from typing import Literal

Pace = Literal["real", "fast"]


class DeviceClock:
    """Device time since it was switched on.

    Parameters
    ----------
    pace
        ``real``: runs with the host's clock; ``fast``: jumps to each time that is waited for.
    drift
        Relative to the host's clock: 1e-6 gains a microsecond a second.
    """

    def __init__(self, pace: Pace = "real", drift: float = 0.0) -> None:
        self.pace, self._rate = pace, 1 + drift
        self._zero_ns = time.monotonic_ns()
        self._now_ns = 0

    def now_ns(self) -> int:
        """Device time."""
        if self.pace == "real":
            return round((time.monotonic_ns() - self._zero_ns) * self._rate)
        return self._now_ns

    def left_s(self, time_ns: int) -> float:
        """Seconds of the host's clock until a time; 0 where it is past, or the clock is fast."""
        if self.pace == "fast":
            return 0.0
        return max(0.0, (time_ns - self.now_ns()) / 1e9 / self._rate)

    def wait_until(self, time_ns: int) -> None:
        """Wait until a time; return at once if it is past."""
        if (left_s := self.left_s(time_ns)) > 0:
            time.sleep(left_s)
        self._now_ns = max(self._now_ns, time_ns)
