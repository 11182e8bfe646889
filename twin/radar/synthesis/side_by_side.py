"""Work on as many threads as the process may use."""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Work = TypeVar("Work")
Result = TypeVar("Result")


def side_by_side(function: Callable[[Work], Result], works: Sequence[Work]) -> Iterable[Result]:
    """Results in order. As many threads as ``OMP_NUM_THREADS`` says, or as there are cores."""
    threads = min(_threads(), len(works))
    if threads < 2:
        yield from map(function, works)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(function, works)


def _threads() -> int:
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return int(asked) if asked.isdecimal() and int(asked) else len(os.sched_getaffinity(0))
