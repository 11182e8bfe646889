"""A thread that makes one call at a time, while the loop that asks goes on with its sockets."""

import socket
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from queue import SimpleQueue
from typing import Any


class Worker:
    """Makes calls in a thread of its own, which does not delay the end of the process.

    The file descriptor ``done`` becomes readable when a call has ended, so that a loop can wait for
    it beside sockets.
    """

    def __init__(self) -> None:
        self._heard, self._ended = socket.socketpair()
        self.done = self._heard.fileno()
        self._calls: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = SimpleQueue()
        self._future: Future[Any] | None = None
        threading.Thread(target=self._work, daemon=True).start()

    @property
    def busy(self) -> bool:
        """From `start` to `result`."""
        return self._future is not None

    def start(self, call: Callable[[], Any]) -> None:
        """Make a call; not while busy."""
        self._future = Future()
        self._calls.put((self._future, call))

    def result(self) -> Any:
        """What the call gives, once ``done`` is readable. Raises what the call raises."""
        assert self._future is not None
        self._heard.recv(1)
        future, self._future = self._future, None
        return future.result()

    def close(self) -> None:
        """End the thread after the call that it makes; nothing can be started afterwards."""
        self._calls.put(None)
        self._heard.close()

    def _work(self) -> None:
        with self._ended:
            while (asked := self._calls.get()) is not None:
                future, call = asked
                try:
                    future.set_result(call())
                except BaseException as error:
                    future.set_exception(error)
                with suppress(OSError):  # closed meanwhile
                    self._ended.send(b"\0")
