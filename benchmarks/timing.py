"""Timings that compare between machines: each beside a fixed workload timed in the same run."""

import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

_Result = TypeVar("_Result")
_LEAST_S = 0.2


@dataclass(frozen=True)
class Timing:
    """Median of several runs, with the quartiles as spread, in seconds."""

    median_s: float
    low_s: float
    high_s: float
    runs: int
    note: str = ""

    def scaled(self, factor: float, note: str) -> "Timing":
        """The same for ``factor`` times the work; the note says that it was not run."""
        low, high = factor * self.low_s, factor * self.high_s
        return Timing(factor * self.median_s, low, high, self.runs, note)


#: Name, value (a time or a number), unit.
Figure = tuple[str, float | Timing, str]


def timed(work: Callable[[], Any], runs: int = 9, warm_up: int = 1) -> Timing:
    """Time a function."""
    for _ in range(warm_up):
        work()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    low, median, high = np.percentile(seconds, [25, 50, 75])
    return Timing(float(median), float(low), float(high), runs)


def processor_time(work: Callable[[], _Result]) -> tuple[float, list[_Result]]:
    """Mean processor time of a call, s, and what the calls gave: as many as take 0.2 s together,
    since some machines count it in steps of 4 ms.
    """
    results, begin = list[_Result](), time.process_time()
    while (spent := time.process_time() - begin) < _LEAST_S:
        results.append(work())
    return spent / len(results), results


def timed_command(
    command: Sequence[str], runs: int = 5, environment: Mapping[str, str] | None = None
) -> Timing:
    """Time a whole process."""
    return timed(
        lambda: subprocess.run(command, check=True, capture_output=True, env=environment), runs
    )


def fft_workload() -> Timing:
    """The unit: one complex FFT of 2^20 points in NumPy."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=2**20) + 1j * rng.normal(size=2**20)
    return timed(lambda: np.fft.fft(x), runs=15, warm_up=2)
