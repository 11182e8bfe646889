"""Dask's workers: processes here, which share its cores, or those of a running scheduler."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from multiprocessing import active_children, resource_tracker
from typing import TYPE_CHECKING, Any

from twin.files import InputError
from twin.workers.pool import LOOK_S, WITHOUT_WORKERS_S, Pool
from twin.workers.process_counts import n_cores
from twin.workers.shared import Shared
from twin.workers.submit import AskedToEndError, SchedulerGoneError, Submit

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

_AHEAD = 3  # runs waiting for each worker: memory stays bounded whatever the number of points
_TRACKER = "ignore:resource_tracker:UserWarning"
_ENVIRONMENT, _TRIM = "distributed.nanny.pre-spawn-environ", "MALLOC_TRIM_THRESHOLD_"
#: A piece of work may be large, and a process that is started anew come late: by default Dask warns
#: of the one, and gives up the other.
_SETTINGS = {
    "distributed.admin.large-graph-warning-threshold": "1TB",
    "distributed.deploy.lost-worker-timeout": WITHOUT_WORKERS_S,
}
_SILENT = 50  # level of Dask's own messages: that of what is critical


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
            pool = Pool(client, is_over, name, advice)
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
        pool = Pool(client, is_over, "scheduler of this process")
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
        while not started.wait(LOOK_S / 10):
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
