"""The world that several virtual devices show: one instant for all of them."""

import threading
import time

from twin.serve.clock import Pace


class SharedWorld:
    """Time of a world that begins with the first device that measures in it.

    ``real``: it goes on with the host's clock, whether devices hold its pace or not. ``fast``: it
    is as far as the device that has come farthest.
    """

    def __init__(self, pace: Pace) -> None:
        self._pace, self._lock = pace, threading.Lock()
        self._begun_ns: int | None = None
        self._reached_s = 0.0

    def begin(self) -> float:
        """Seconds of the world at which a device that starts now begins: 0 for the first."""
        with self._lock:
            if self._begun_ns is None:
                self._begun_ns = time.monotonic_ns()
                return 0.0
        return self.now_s()

    def now_s(self) -> float:
        """Seconds since it began; 0 before."""
        with self._lock:
            if self._pace == "fast" or self._begun_ns is None:
                return self._reached_s
            return (time.monotonic_ns() - self._begun_ns) / 1e9

    def reached(self, world_s: float) -> float:
        """A device shows the world of this time: by how many seconds it is late."""
        with self._lock:
            self._reached_s = max(self._reached_s, world_s)
        return max(0.0, self.now_s() - world_s)
