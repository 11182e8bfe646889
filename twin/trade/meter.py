"""Time and memory of a computation after a warm-up."""

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import drjit as dr
import numpy as np
import psutil

from twin.trade.measurement import Cost

T = TypeVar("T")
_ENOUGH_S = 1.0
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_SAMPLES_EVERY_S = 1e-3


def measure_cost(
    work: Callable[[int], T], *, least: int = 3, most: int = 9
) -> tuple[Cost, list[T]]:
    """Run a computation several times after a warm-up.

    Parameters
    ----------
    work
        Called with the number of the run, from 0; run 0 is the warm-up, neither timed nor returned.
    least, most
        Limits of the number of timed runs; between them as many as fit into a second.

    Returns
    -------
    Cost and the result of each timed run. The peak is the largest growth of the resident memory
    over the state before; heap freed by earlier work and a GPU's memory are not included. Where the
    system cannot reset its high-water mark, memory is sampled every millisecond.
    """
    work(0)
    dr.flush_malloc_cache()
    peak = _Peak()
    seconds: list[float] = []
    results: list[T] = []
    while len(seconds) < least or (sum(seconds) < _ENOUGH_S and len(seconds) < most):
        start = time.perf_counter()
        results.append(work(len(seconds) + 1))
        seconds.append(time.perf_counter() - start)
    grown = peak.grown_bytes()
    low, median, high = (float(x) for x in np.percentile(seconds, [25, 50, 75]))
    return Cost(median, low, high, len(seconds), grown), results


class _Peak:
    """Largest growth of the resident memory from now on."""

    def __init__(self) -> None:
        self._before = self._highest = psutil.Process().memory_info().rss
        self._stop = threading.Event()
        self._sampler: threading.Thread | None = None
        if not _reset_high_water_mark(self._before):
            self._sampler = threading.Thread(target=self._sample, daemon=True)
            self._sampler.start()

    def grown_bytes(self) -> float:
        """Largest growth so far; ends the measurement."""
        if self._sampler:
            self._stop.set()
            self._sampler.join()
        else:
            self._highest = _high_water_bytes()
        return float(max(0, self._highest - self._before))

    def _sample(self) -> None:
        process = psutil.Process()
        while not self._stop.wait(_SAMPLES_EVERY_S):
            self._highest = max(self._highest, process.memory_info().rss)


def _reset_high_water_mark(resident_bytes: int) -> bool:
    """Reset the high-water mark to the present value (proc(5)); whether that succeeded."""
    try:
        _CLEAR.write_text("5")
    except OSError:
        return False
    return 0 < _high_water_bytes() < 1.05 * resident_bytes


def _high_water_bytes() -> int:
    try:
        match = re.search(r"VmHWM:\s+(\d+) kB", _STATUS.read_text())
    except OSError:
        return 0
    return 1024 * int(match[1]) if match else 0
