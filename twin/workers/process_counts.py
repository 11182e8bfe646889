"""How many processes compute."""

import os
from numbers import Integral

from twin.files import InputError

#: What a process that traces a radar's echoes may take.
_MEMORY_BYTES = 3e9
#: Processes here: so many anywhere, and of each core; each takes 0.3 GB and seconds to start.
_MOST_WORKERS, _MOST_PER_CORE = 16, 4


def check_workers(workers: object, scheduler: str | None) -> None:
    """Raises InputError for no number of processes, for more than the cores can use, and for
    processes here beside those of a scheduler.
    """
    if workers is None:
        return
    if scheduler is not None:
        raise InputError("workers, scheduler: expected one of them")
    most = max(_MOST_WORKERS, _MOST_PER_CORE * n_cores())
    if not isinstance(workers, Integral) or not 0 <= int(workers) <= most:
        raise InputError(f"workers: {workers!r:.60}: expected a whole number from 0 to {most}")


def n_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def usual_workers() -> int:
    """Processes that trace a radar's echoes where no number is asked for: one per core, as far as
    memory allows.
    """
    from distributed.system import MEMORY_LIMIT

    return max(1, min(n_cores(), int(MEMORY_LIMIT / _MEMORY_BYTES)))
