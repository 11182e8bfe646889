"""A prefetcher: computes the next items in other processes.

Processes, not threads: a device served in real time must answer within a millisecond, which is not
possible in an interpreter that also runs the simulation. Not those of `concurrent.futures`: they
delay the end of a process until their items are computed, and outlive a parent that is killed.
"""

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from twin.child_process import SPAWN, attempt, start_process
from twin.errors import EngineError

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
        self._closed = self._died = False
        self._failure = ""
        count = min(_MOST_PROCESSES, os.cpu_count() or 1)
        pipes = [SPAWN.Pipe() for _ in range(count)]
        self._lines: list[Connection] = [ours for ours, _ in pipes]
        self._asked = list(range(count))  # what each line computes, or has computed
        self._given_up = [0] * count  # items before it that nobody waits for any more
        for number, line in enumerate(self._lines):
            line.send(number)
        # To start a process takes seconds on a busy machine, and a device has to answer meanwhile.
        ends = [theirs for _, theirs in pipes]
        threading.Thread(target=self._start, args=(make, ends), daemon=True).start()

    def _start(self, make: Callable[[int], _Item], ends: list[Connection]) -> None:
        for theirs in ends:
            try:
                if not self._closed and not self._failure:
                    start_process(_work, theirs, make)
            except Exception as error:  # what cannot be pickled, no memory
                self._failure = f": {type(error).__name__}: {error}"
            theirs.close()

    def __call__(self, number: int) -> _Item:
        """One item; after a failure, another request computes it again.

        Raises InputError as ``make`` does, EngineError for all other errors.
        """
        place = number % len(self._lines)
        line = self._lines[place]
        try:
            for _ in range(self._given_up[place]):
                line.recv()
            self._given_up[place] = 0
            item, error = line.recv()
            self._asked[place] = number if error else number + len(self._lines)
            line.send(self._asked[place])
        except (EOFError, OSError):
            self._died = True
            raise EngineError(f"the process that computes it has died{self._failure}") from None
        if error:
            raise error
        return item

    def ready(self, number: int, timeout_s: float) -> bool:
        """Whether an item is ready, or has failed, within a time."""
        place = number % len(self._lines)
        line = self._lines[place]
        with suppress(EOFError, OSError):  # it has died, which the request tells
            while self._given_up[place] and line.poll(timeout_s):
                line.recv()
                self._given_up[place] -= 1
        return not self._given_up[place] and line.poll(timeout_s)

    def begin_again(self) -> bool:
        """Request items from 0 on again, of the same processes; False where one has died."""
        for place, line in enumerate(self._lines):
            if self._asked[place] == place:
                continue
            try:
                line.send(place)
            except OSError:
                return False
            self._asked[place] = place
            self._given_up[place] += 1
        return not self._died

    def close(self) -> None:
        """End the processes; any number of times. No item can be requested afterwards."""
        self._closed = True
        for line in self._lines:
            line.close()


def _work(line: Connection, make: Callable[[int], Any]) -> None:
    """Compute requested items until the connection is closed; all but the first one, for which a
    device that starts up waits, at low priority.
    """
    try:
        line.send(attempt(make, line.recv()))
        _lower_priority()
        while True:
            line.send(attempt(make, line.recv()))
    except (EOFError, OSError):
        pass


def _lower_priority() -> None:
    """Yield the core to other processes at once, which `nice` alone does only after some time."""
    os.nice(19)
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
