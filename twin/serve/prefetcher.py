"""A prefetcher: computes the next items in other processes.

Processes, not threads: a device served in real time must answer within a millisecond, which is not
possible in an interpreter that also runs the simulation. Not those of `concurrent.futures`: they
delay the end of a process until their items are computed, and outlive a parent that is killed.
"""

import os
import pickle
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from twin.child_process import SPAWN, attempt, start_process
from twin.errors import EngineError

_Item = TypeVar("_Item")

_MOST_PROCESSES = 4  # each holds an engine of its own: some 400 MB
#: Bytes of arguments, and requests that are not read yet: together less than a line holds unread.
_MOST_SENT, _MOST_GIVEN_UP = 16384, 4


class Prefetcher(Generic[_Item]):
    """Items 0, 1, 2 ... of a function, requested in this order.

    Each process computes one item in advance, and waits until it is requested. Processes end with
    `close`, or with the parent process.

    Parameters
    ----------
    make
        Item k, which depends on k and ``args`` alone; it and what it gives can be pickled.
    args
        See `begin_again`.
    begins_later
        Until `begin_again` nothing is computed in advance but the first item of each process.
    """

    def __init__(self, make: Callable[..., _Item], *args: Any, begins_later: bool = False) -> None:
        self._args, self._waits = pickle.dumps(args), begins_later
        self._closed = self._died = False
        self._failure = ""
        count = min(_MOST_PROCESSES, os.cpu_count() or 1)
        pipes = [SPAWN.Pipe() for _ in range(count)]
        self._lines: list[Connection] = [ours for ours, _ in pipes]
        #: What each line computes, or has computed; None where nothing is asked.
        self._asked: list[int | None] = list(range(count))
        self._given_up = [0] * count  # items before it that nobody waits for any more
        for number, line in enumerate(self._lines):
            line.send((number, None))
        # To start a process takes seconds on a busy machine, and a device has to answer meanwhile.
        ends = [theirs for _, theirs in pipes]
        threading.Thread(target=self._start, args=(make, args, ends), daemon=True).start()

    def _start(
        self, make: Callable[..., _Item], args: tuple[Any, ...], ends: list[Connection]
    ) -> None:
        for theirs in ends:
            try:
                if not self._closed and not self._failure:
                    start_process(_work, theirs, make, args, len(ends))
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
            if self._asked[place] is None:
                line.send((number, None))
            for _ in range(self._given_up[place]):
                line.recv()
            self._given_up[place] = 0
            item, error = line.recv()
            following = number if error else number + len(self._lines)
            self._asked[place] = None if self._waits else following
            if not self._waits:
                line.send((following, None))
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

    def begin_again(self, *args: Any) -> bool:
        """Request items from 0 on again, of the same processes, with other arguments maybe. What
        they compute meanwhile for the earlier ones is finished first.

        False where others have to be started: one has died, or would have to read before the
        request is sent, for which a device has no time.
        """
        asked = pickle.dumps(args)
        changed = None if asked == self._args else args
        if changed and (len(asked) > _MOST_SENT or max(self._given_up) >= _MOST_GIVEN_UP):
            return False
        for place, line in enumerate(self._lines):
            if self._asked[place] == place and changed is None:
                continue
            try:
                line.send((place, changed))
            except OSError:
                return False
            self._given_up[place] += self._asked[place] is not None
            self._asked[place] = place
        self._args, self._waits = asked, False
        return not self._died

    def close(self) -> None:
        """End the processes; any number of times. No item can be requested afterwards."""
        self._closed = True
        for line in self._lines:
            line.close()


def _work(line: Connection, make: Callable[..., Any], args: tuple[Any, ...], count: int) -> None:
    """Compute requested items until the connection is closed. From the first one on that is asked
    for when another is delivered, at low priority: until then a device waits that starts up.
    """
    is_low = False
    try:
        while True:
            number, changed = line.recv()
            args = args if changed is None else changed
            if number >= count and not is_low:
                _lower_priority()
                is_low = True
            line.send(attempt(make, number, *args))
    except (EOFError, OSError):
        pass


def _lower_priority() -> None:
    """Yield the core to other processes at once, which `nice` alone does only after some time."""
    os.nice(19)
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
