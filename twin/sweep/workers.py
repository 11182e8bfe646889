"""Who computes: this process, a cluster of processes here, or a running Dask scheduler."""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from twin.errors import EngineError
from twin.files import InputError

_AHEAD = 3  # runs waiting for each worker: memory stays bounded whatever the number of points
#: How long a scheduler may be without any worker, and how often it is looked at.
_WITHOUT_WORKERS_S, _LOOK_S = 60.0, 2.0


class WorkerDiedError(EngineError):
    """A piece of work ended the process of every worker that tried it."""


@dataclass(frozen=True)
class Submit:
    """Starts work, up to ``ahead`` pieces at a time, and waits for its results; `WorkerDiedError`
    where there is none.
    """

    send: Callable[..., Any]
    result: Callable[[Any], Any]
    ahead: int

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
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"scheduler: {scheduler!r}: can't be reached ({error})") from error
        with client:
            watch = _Watch(client, scheduler)
            yield Submit(_pure(client), watch.result, _AHEAD * watch.wait())
        return
    cores = len(os.sched_getaffinity(0))
    n = workers or cores
    threads = max(1, cores // n)
    with (
        LocalCluster(
            n_workers=n,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",  # None still takes port 8787, or warns of it
            silence_logs=50,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.run(_use_threads, threads)
        yield Submit(_pure(client), _result, _AHEAD * n)


class _Watch:
    """Waits for a scheduler's workers, and says so while there are none."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address

    def wait(self) -> int:
        """How many workers there are, once there is one."""
        begin, said = time.monotonic(), False
        while not (n := len(self._client.scheduler_info(n_workers=-1)["workers"])):
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
                return _result(future, _LOOK_S)
            except NotYetError:
                self.wait()


def _result(future: Any, timeout_s: float | None = None) -> Any:
    from distributed import KilledWorker

    try:
        return future.result(timeout=timeout_s)
    except KilledWorker as error:
        raise WorkerDiedError("the worker's process died") from error


def _pure(client: Any) -> Callable[..., Any]:
    return lambda work, *args: client.submit(work, *args, pure=False, retries=2)


def _use_threads(n: int) -> None:
    """Workers share the cores instead of fighting for them."""
    os.environ["OMP_NUM_THREADS"] = str(n)
    from twin.engine import mitsuba

    mitsuba()
    import drjit

    drjit.set_thread_count(n)
