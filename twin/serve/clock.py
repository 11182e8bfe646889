"""The clock of a virtual device."""

import time
from typing import Literal

Pace = Literal["real", "fast"]


class DeviceClock:
    """Device time since it was switched on.

    Parameters
    ----------
    pace
        ``real``: it runs as the host's; ``fast``: it jumps to whatever is waited for.
    """

    def __init__(self, pace: Pace = "real") -> None:
        self.pace = pace
        self._zero_ns = time.monotonic_ns()
        self._now_ns = 0

    def now_ns(self) -> int:
        """Device time."""
        if self.pace == "real":
            return time.monotonic_ns() - self._zero_ns
        return self._now_ns

    def wait_until(self, time_ns: int) -> None:
        """Come back at a time, at once if it is past."""
        if self.pace == "real":
            time.sleep(max(0, time_ns - self.now_ns()) / 1e9)
        else:
            self._now_ns = max(self._now_ns, time_ns)
