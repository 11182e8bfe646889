"""Who computes what takes long: this process, a cluster of processes here, or a running Dask
scheduler.
"""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from twin.errors import EngineError
from twin.files import InputError

if TYPE_CHECKING:
    from distributed import LocalCluster

#: What a process that traces a radar's echoes may take.
_MEMORY_BYTES = 3e9
_AHEAD = 3  # runs waiting for each worker: memory stays bounded whatever the number of points
#: How long a scheduler may be without any worker, and how often it is looked at.
_WITHOUT_WORKERS_S, _LOOK_S = 60.0, 2.0
_TRACKER = "ignore:resource_tracker:UserWarning"
_ENVIRONMENT, _TRIM = "distributed.nanny.pre-spawn-environ", "MALLOC_TRIM_THRESHOLD_"
_SILENT = 50  # level of Dask's own messages: that of what is critical


class WorkerDiedError(EngineError):
    """A piece of work ended the process of every worker that tried it."""


class SchedulerGoneError(EngineError):
    """There is nobody to compute: the scheduler is gone, or a process died while it started."""


@dataclass(frozen=True)
class Submit:
    """Starts work, up to ``ahead`` pieces at a time, and waits for its results; `WorkerDiedError`
    where there is none, `SchedulerGoneError` where there will be none any more.
    """

    send: Callable[..., Any]
    result: Callable[[Any], Any]
    ahead: int
    #: Of a large argument of much work: what to give in its place, so that it is sent once.
    share: Callable[[Any], Any] = lambda value: value

    def __call__(self, work: Callable[..., Any], *args: Any) -> Any:
        """A handle for `result`."""
        return self.send(work, *args)


@contextmanager
def here() -> Iterator[Submit]:
    """Where one is, at once."""
    yield Submit(lambda work, *args: work(*args), lambda found: found, 1)


@contextmanager
def dask(scheduler: str | None, workers: int | None) -> Iterator[Submit]:
    """Dask's workers: a local cluster, or a running one.

    Raises InputError where a scheduler can't be reached, or has no workers for a minute.
    """
    from distributed import Client
    from distributed.comm.addressing import get_address_host
    from distributed.utils import silence_logging_cmgr

    if scheduler is not None:
        try:
            # A client that fails at this tells of it once more when it is thrown away.
            get_address_host(scheduler)
            client = Client(scheduler, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"scheduler: {scheduler!r}: can't be reached ({error})") from error
        with silence_logging_cmgr(_SILENT), client:  # a lost connection is told by an error
            watch = _Watch(client, scheduler)
            yield Submit(watch.send, watch.result, _AHEAD * watch.wait(), watch.share)
        return
    n = workers or n_cores()
    threads = max(1, n_cores() // n)
    with (
        _loop() as loop,
        _local(n, loop) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        send, share = partial(_send, client, _on_threads, threads), partial(_share, client)
        yield Submit(send, _result_of_local, _AHEAD * n, share)


def check_workers(workers: int | None) -> None:
    """Raises InputError for a number of processes below 0."""
    if workers is not None and workers < 0:
        raise InputError(f"workers: {workers}: expected 0 or more")


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


def _local(n: int, loop: Any) -> "LocalCluster":
    """Processes here; of one that dies later another takes the place."""
    import dask.config
    from distributed import LocalCluster

    # Dask has all freed memory handed back at once, and large arrays cost a page fault per page
    # each time: a frame of the radar takes 1.4 times as long.
    environment = {n: v for n, v in dask.config.get(_ENVIRONMENT).items() if n != _TRIM}
    try:
        with dask.config.set({_ENVIRONMENT: environment}):
            return LocalCluster(
                n_workers=n,
                loop=loop,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",  # None still takes port 8787, or warns of it
                silence_logs=_SILENT,
            )
    except RuntimeError as error:
        raise SchedulerGoneError(f"a worker's process died while it started ({error})") from error


class _Watch:
    """Waits for a scheduler's workers, and says so while there are none."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address

    def send(self, work: Callable[..., Any], *args: Any) -> Any:
        """Work sent, and what waits for it."""
        with self._told():
            return _send(self._client, work, *args)

    def share(self, value: Any) -> Any:
        """A value that all workers have, by name."""
        with self._told():
            return _share(self._client, value)

    def wait(self) -> int:
        """How many workers there are, once there is one."""
        begin, said = time.monotonic(), False
        while not (n := self._workers()):
            if not said:
                said = True
                print(
                    f"scheduler {self._address}: no workers; waiting {_WITHOUT_WORKERS_S:.0f} s; "
                    f"start one: dask worker {self._address}",
                    file=sys.stderr,
                    flush=True,
                )
            if time.monotonic() - begin > _WITHOUT_WORKERS_S:
                raise InputError(
                    f"scheduler: {self._address!r}: no workers for {_WITHOUT_WORKERS_S:.0f} s; "
                    f"start one: dask worker {self._address}; what is done stays"
                )
            time.sleep(min(_LOOK_S, _WITHOUT_WORKERS_S / 4))
        return n

    def result(self, future: Any) -> Any:
        """A result; the last worker may go while one waits for it."""
        from distributed import TimeoutError as NotYetError

        while True:
            try:
                with self._told():
                    return _result(future, _LOOK_S)
            except NotYetError:
                self.wait()

    def _workers(self) -> int:
        with self._told():
            return len(self._client.scheduler_info(n_workers=-1)["workers"])

    @contextmanager
    def _told(self) -> Iterator[None]:
        """A lost connection, in the words of this place."""
        from distributed import CancelledError
        from distributed.client import ClosedClientError
        from distributed.comm import CommClosedError

        try:
            yield
        except (CancelledError, ClosedClientError, CommClosedError) as error:
            raise SchedulerGoneError(f"scheduler {self._address} has gone") from error


def _result(future: Any, timeout_s: float | None = None) -> Any:
    from distributed import KilledWorker

    try:
        return future.result(timeout=timeout_s)
    except KilledWorker as error:
        raise WorkerDiedError("the worker's process died") from error


def _result_of_local(future: Any) -> Any:
    """What is shared dies with the last process that holds it, and so does work that needs it."""
    from distributed import CancelledError

    try:
        return _result(future)
    except CancelledError as error:
        raise SchedulerGoneError("all processes have died") from error


def _share(client: Any, value: Any) -> Any:
    return client.scatter(value, broadcast=True, hash=False)


def _send(client: Any, work: Callable[..., Any], *args: Any) -> Any:
    return client.submit(work, *args, pure=False, retries=2)


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
