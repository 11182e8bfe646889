"""Who computes what takes long: this process, a cluster of processes here, or a running Dask
scheduler.
"""

import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, lru_cache, partial
from hashlib import blake2b
from multiprocessing import active_children, resource_tracker
from numbers import Integral
from typing import TYPE_CHECKING, Any, Self

from twin.errors import EngineError
from twin.files import InputError

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

#: What a process that traces a radar's echoes may take.
_MEMORY_BYTES = 3e9
#: Processes here: so many anywhere, and of each core; each takes 0.3 GB and seconds to start.
_MOST_WORKERS, _MOST_PER_CORE = 16, 4
_AHEAD = 3  # runs waiting for each worker: memory stays bounded whatever the number of points
#: How long a scheduler may be without any worker, and how often it is looked at.
_WITHOUT_WORKERS_S, _LOOK_S = 60.0, 2.0
_TRACKER = "ignore:resource_tracker:UserWarning"
_ENVIRONMENT, _TRIM = "distributed.nanny.pre-spawn-environ", "MALLOC_TRIM_THRESHOLD_"
#: A piece of work may be large, and a process that is started anew come late: by default Dask warns
#: of the one, and gives up the other.
_SETTINGS = {
    "distributed.admin.large-graph-warning-threshold": "1TB",
    "distributed.deploy.lost-worker-timeout": _WITHOUT_WORKERS_S,
}
_SILENT = 50  # level of Dask's own messages: that of what is critical
_ALIKE = "all machines need the same version of the project and of its libraries"


class WorkerDiedError(EngineError):
    """A piece of work ended the process of every worker that tried it."""


class SchedulerGoneError(EngineError):
    """There is nobody to compute: the scheduler is gone, has had no workers for a minute, or none
    that has the project, or a process died while it started.
    """


class AskedToEndError(EngineError):
    """What was to compute was asked to end while it waited for workers."""


@dataclass(frozen=True)
class Submit:
    """Starts work, up to ``ahead`` pieces at a time, and waits for its results; `WorkerDiedError`
    where there is none, `SchedulerGoneError` where there will be none any more.
    """

    send: Callable[..., Any]
    result: Callable[[Any], Any]
    ahead: int
    #: Of an argument of much work: what to give in its place, so that each process has one object.
    share: Callable[[Any], Any] = lambda value: value

    def __call__(self, work: Callable[..., Any], *args: Any) -> Any:
        """A handle for `result`."""
        return self.send(work, *args)


@contextmanager
def here() -> Iterator[Submit]:
    """Where one is, at once."""
    yield Submit(lambda work, *args: work(*args), lambda found: found, 1)


@contextmanager
def dask(
    scheduler: str | None, workers: int | None, is_over: Callable[[], bool] = lambda: False
) -> Iterator[Submit]:
    """Dask's workers: a local cluster, or a running one. When it ``is_over``, nothing waits for
    workers any more.

    A worker that lacks the project is told on stderr, and left out. Raises InputError where a
    scheduler can't be reached, `SchedulerGoneError` where it has no workers for a minute or all
    that it has lack the project, `AskedToEndError`.
    """
    from dask.config import set as configured
    from distributed import Client
    from distributed.utils import silence_logging_cmgr

    if scheduler is not None:
        client = _client_of(scheduler)
        # A lost connection is told by an error.
        with configured(_SETTINGS), silence_logging_cmgr(_SILENT), client:
            name, advice = f"scheduler {scheduler}", f"start one: dask worker {scheduler}"
            pool = _Pool(client, is_over, name, advice)
            yield Submit(pool.send, pool.result, _AHEAD * len(pool.wait()), Shared.of)
        return
    n = workers or n_cores()
    threads = max(1, n_cores() // n)
    with (
        configured(_SETTINGS),
        _loop() as loop,
        _local(n, loop, is_over) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        pool = _Pool(client, is_over, "scheduler of this process")
        yield Submit(partial(pool.send, _on_threads, threads), pool.result, _AHEAD * n, Shared.of)


def _client_of(scheduler: str) -> "Client":
    """Raises InputError where it can't be reached."""
    from distributed import Client
    from distributed.comm.addressing import get_address_host

    try:
        # A client that fails at this tells of it once more when it is thrown away.
        get_address_host(scheduler)
        return Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler: {scheduler!r}: can't be reached ({error})") from error


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


@contextmanager
def _loop() -> Iterator[Any]:
    """The event loop that starts processes, in a thread that blocks SIGINT, which they inherit:
    Ctrl-C in a terminal goes to them too, and one that still imports would print a trace of it.
    """
    from distributed.utils import LoopRunner

    # What an interrupt or a kill leaves of them Python's tracker removes, a process that is given
    # these options when it starts. It need not be told: nothing is lost.
    if _TRACKER not in sys.warnoptions:
        sys.warnoptions.append(_TRACKER)
    resource_tracker.ensure_running()  # which would unblock SIGINT in the thread that first asks
    runner = LoopRunner()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        runner.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    try:
        yield runner.loop
    finally:
        runner.stop()


def _local(n: int, loop: Any, is_over: Callable[[], bool]) -> "LocalCluster":
    """Processes here; of one that dies later another takes the place."""
    import dask.config
    from distributed import LocalCluster

    # Dask has all freed memory handed back at once, and large arrays cost a page fault per page
    # each time: a frame of the radar takes 1.4 times as long.
    environment = {n: v for n, v in dask.config.get(_ENVIRONMENT).items() if n != _TRIM}
    try:
        with dask.config.set({_ENVIRONMENT: environment}), _children_killed_when(is_over):
            return LocalCluster(
                n_workers=n,
                loop=loop,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",  # None still takes port 8787, or warns of it
                silence_logs=_SILENT,
            )
    except RuntimeError as error:
        if is_over():
            raise AskedToEndError("workers were starting") from error
        raise SchedulerGoneError(f"a worker's process died while it started ({error})") from error


@contextmanager
def _children_killed_when(is_over: Callable[[], bool]) -> Iterator[None]:
    """Processes that this one starts meanwhile are killed when it is over: a cluster ends only when
    all of its processes have started, or failed to.
    """
    before, started = set(active_children()), threading.Event()

    def watch() -> None:
        while not started.wait(_LOOK_S / 10):
            if is_over():
                for child in set(active_children()) - before:
                    child.kill()

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        started.set()
        watching.join()


@dataclass(frozen=True)
class Shared:
    """A value that much work needs, as the bytes of its pickle, and their digest.

    The bytes travel with each piece of work. Had they been sent once, work that is waiting would be
    lost with the last process that holds them, and a process that comes later would lack them.
    A process unpickles them once: what is found of the value, and kept by its identity, serves all
    its pieces.
    """

    digest: bytes
    pickled: bytes = field(compare=False, repr=False)

    @classmethod
    def of(cls, value: Any) -> Self:
        """Of a value, pickled as Dask pickles arguments."""
        from distributed.protocol.pickle import dumps

        pickled = dumps(value)
        return cls(blake2b(pickled).digest(), pickled)


@lru_cache(maxsize=1)
def _value_of(shared: Shared) -> Any:
    return pickle.loads(shared.pickled)


def _with_values(work: Callable[..., Any], args: tuple[Any, ...]) -> Any:
    """Work done, with the values of what is shared."""
    return work(*(_value_of(arg) if isinstance(arg, Shared) else arg for arg in args))


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


class _Pool:
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

        sent = _Sent(dumps((_with_values, (work, args))))
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
        begin, words = time.monotonic(), f"{self._name}: no workers{{}} {_WITHOUT_WORKERS_S:.0f} s"
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
            if time.monotonic() - begin > _WITHOUT_WORKERS_S:
                raise SchedulerGoneError(words.format(" for"))
            time.sleep(min(_LOOK_S, _WITHOUT_WORKERS_S / 4))
        return able

    def _is_done(self, future: "Future") -> bool:
        from distributed import TimeoutError as NotYetError

        try:
            with self._told():
                future.exception(timeout=_LOOK_S)
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


def _on_threads(n: int, work: Callable[..., Any], *args: Any) -> Any:
    """Work in a process that shares the cores with others, and keeps no memory from them; each is
    told by its first work, so that one that takes a dead one's place is told too.
    """
    from twin.engine import return_freed_memory

    _use_threads(n)
    try:
        return work(*args)
    finally:
        return_freed_memory()


@cache
def _use_threads(n: int) -> None:
    """Workers share the cores instead of fighting for them."""
    os.environ["OMP_NUM_THREADS"] = str(n)
    from twin.engine import mitsuba

    mitsuba()
    import drjit

    drjit.set_thread_count(n)
