"""A prefetcher: computes the next items in other processes.

Processes, not threads: a device served in real time must answer within a millisecond, which is not
possible in an interpreter that also runs the simulation. Not those of `concurrent.futures`: they
delay the end of a process until their items are computed, and outlive a parent that is killed.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from twin.engine import EngineError
from twin.files import InputError

_Item = TypeVar("_Item")

_MOST_PROCESSES = 4  # each holds an engine of its own: some 400 MB


class Prefetcher(Generic[_Item]):
    """Items 0, 1, 2 ... of a function, requested in this order.

    Each process computes one item in advance, and waits until it is requested. Processes end with
    `close`, or with the parent process.

    Parameters
    ----------
    make
        Item k, which depends on k alone; it and what it gives can be pickled.
    """

    def __init__(self, make: Callable[[int], _Item]) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._lines: list[Connection] = []
        # Ctrl-C goes to all processes of a terminal: it is left to this one.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            for number in range(min(_MOST_PROCESSES, os.cpu_count() or 1)):
                ours, theirs = spawn.Pipe()
                spawn.Process(target=_work, args=(theirs, make), daemon=True).start()
                theirs.close()
                ours.send(number)
                self._lines.append(ours)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __call__(self, number: int) -> _Item:
        """One item; after a failure, another request computes it again.

        Raises InputError as ``make`` does, EngineError for all other errors.
        """
        line = self._lines[number % len(self._lines)]
        try:
            item, error = line.recv()
            line.send(number if error else number + len(self._lines))
        except (EOFError, OSError):
            raise EngineError("the process that computes it has died") from None
        if error:
            raise error
        return item

    def ready(self, number: int, timeout_s: float) -> bool:
        """Whether an item is ready, or has failed, within a time."""
        return self._lines[number % len(self._lines)].poll(timeout_s)

    def close(self) -> None:
        """End the processes; any number of times. No item can be requested afterwards."""
        for line in self._lines:
            line.close()


def _work(line: Connection, make: Callable[[int], Any]) -> None:
    """Compute requested items until the connection is closed."""
    _lower_priority()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        while True:
            number = line.recv()
            line.send(_attempt(make, number))
    except (EOFError, OSError):
        pass


def _lower_priority() -> None:
    """Yield the core to other processes at once, which `nice` alone does only after some time."""
    os.nice(19)
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def _end_with_parent() -> None:
    """End this process at once when the parent has ended."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(0)


def _attempt(make: Callable[[int], Any], number: int) -> tuple[Any, Exception | None]:
    try:
        return make(number), None
    except InputError as error:
        return None, error
    except Exception as error:  # any engine's; not every one can be pickled
        return None, EngineError(f"{type(error).__name__}: {error}")
