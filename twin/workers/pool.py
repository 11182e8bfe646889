"""The workers of a scheduler, of which any may come, leave, die, or lack the project."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from twin.errors import EngineError
from twin.workers.shared import with_values
from twin.workers.submit import AskedToEndError, SchedulerGoneError, WorkerDiedError

if TYPE_CHECKING:
    from distributed import Client, Future

#: How long a scheduler may be without any worker, and how often it is looked at.
WITHOUT_WORKERS_S, LOOK_S = 60.0, 2.0
_ALIKE = "all machines need the same version of the project and of its libraries"


def _call_of_pickle() -> Callable[[bytes], Any]:
    """What makes a pickled call. As a function within one it is sent by value: a worker that lacks
    this project, or has another version, can load it too, and say so: see `_lack`.
    """

    def call(pickled: bytes) -> Any:
        import pickle

        from distributed import get_worker

        try:
            work, args = pickle.loads(pickled)
        except (ImportError, AttributeError) as error:
            raise ImportError(get_worker().address, str(error)) from None
        return work(*args)

    return call


def _lack(error: BaseException | None) -> tuple[str, str] | None:
    """Address of a worker that could not load a call, and what it lacks; None for other errors."""
    if type(error) is ImportError and len(error.args) == 2:
        return str(error.args[0]), str(error.args[1])
    return None


@dataclass(eq=False)
class _Sent:
    """Work that is sent, and ``workers`` that may do it; None: all."""

    pickled: bytes
    future: "Future | None" = None
    workers: frozenset[str] | None = None


class Pool:
    """The workers of a scheduler.

    Parameters
    ----------
    client
        Of it.
    is_over
        Whether no worker is waited for any more.
    name
        Of the scheduler, in messages.
    advice
        What to do where it has no workers; empty: they come by themselves.
    """

    def __init__(
        self, client: "Client", is_over: Callable[[], bool], name: str, advice: str = ""
    ) -> None:
        self._client, self._is_over, self._name, self._advice = client, is_over, name, advice
        self._waiting = set[_Sent]()
        self._lacking: dict[str, str] = {}
        self._has_answered = False

    def send(self, work: Callable[..., Any], *args: Any) -> _Sent:
        """Work sent. Where a worker dies, leaves or lacks the project another one does it."""
        from distributed.protocol.pickle import dumps

        sent = _Sent(dumps((with_values, (work, args))))
        self._start(sent)
        self._waiting.add(sent)
        return sent

    def result(self, sent: _Sent) -> Any:
        """A result; the last worker may go while one waits for it."""
        from distributed import KilledWorker

        try:
            while True:
                try:
                    found = self._answer(sent)
                except ImportError as error:
                    if (lack := _lack(error)) is None:
                        raise EngineError(f"{self._name}: {error}; {_ALIKE}") from error
                    self._leave_out(*lack)
                else:
                    self._has_answered = True
                    return found
        except KilledWorker as error:
            raise WorkerDiedError("the worker's process died") from error
        finally:
            self._waiting.discard(sent)

    def _start(self, sent: _Sent) -> None:
        """Have work done, once there is a worker for it."""
        sent.workers = self.wait() if self._lacking else None
        with self._told():
            sent.future = self._client.submit(
                _call_of_pickle(), sent.pickled, pure=False, retries=2, workers=sent.workers
            )

    def _answer(self, sent: _Sent) -> Any:
        assert sent.future is not None
        while not self._is_done(sent.future):
            there = self.wait()
            if sent.workers is not None and not sent.workers & there:
                self._start(sent)
        with self._told():
            return sent.future.result()

    def _leave_out(self, address: str, lacks: str) -> None:
        """Give a worker no more work, and what it could not load to others."""
        is_new = address not in self._lacking
        self._lacking[address] = lacks
        self.wait()
        if is_new:
            told = f"{self._name}: worker {address} left out: {lacks}; {_ALIKE}"
            print(told, file=sys.stderr, flush=True)
        for sent in self._waiting:
            if sent.future is not None and sent.future.status == "error":
                with self._told():
                    is_lack = _lack(sent.future.exception()) is not None
                if is_lack:
                    self._start(sent)

    def wait(self) -> frozenset[str]:
        """Addresses of the workers that do not lack the project, once there is one."""
        begin, words = time.monotonic(), f"{self._name}: no workers{{}} {WITHOUT_WORKERS_S:.0f} s"
        words += self._advice and f"; {self._advice}"
        said = not self._advice
        while not (able := (there := self._workers()) - self._lacking.keys()):
            if there and not self._has_answered:
                lacks = "; ".join(f"worker {one}: {self._lacking[one]}" for one in sorted(there))
                raise SchedulerGoneError(f"{self._name}: {lacks}; {_ALIKE}")
            if not said:
                said = True
                print(words.format("; waiting"), file=sys.stderr, flush=True)
            if self._is_over():
                raise AskedToEndError(f"{self._name}: no workers")
            if time.monotonic() - begin > WITHOUT_WORKERS_S:
                raise SchedulerGoneError(words.format(" for"))
            time.sleep(min(LOOK_S, WITHOUT_WORKERS_S / 4))
        return able

    def _is_done(self, future: "Future") -> bool:
        from distributed import TimeoutError as NotYetError

        try:
            with self._told():
                future.exception(timeout=LOOK_S)
        except NotYetError:
            return False
        return True

    def _workers(self) -> frozenset[str]:
        with self._told():
            return frozenset(self._client.scheduler_info(n_workers=-1)["workers"])

    @contextmanager
    def _told(self) -> Iterator[None]:
        """A lost connection, in the words of this place."""
        from distributed import CancelledError
        from distributed.client import ClosedClientError
        from distributed.comm import CommClosedError

        try:
            yield
        except (CancelledError, ClosedClientError, CommClosedError) as error:
            raise SchedulerGoneError(f"{self._name} has gone") from error
