"""Running a study: points in runs over Dask's workers, results kept as they come."""

import os
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.files import InputError
from twin.progress import interrupts
from twin.sweep.evaluate import Chunk, evaluate_chunk
from twin.sweep.store import Store
from twin.sweep.study import Study, load_study

#: Points in a run: what a kill loses at most, for each worker.
_RENDERED_CHUNK, _CLOSED_CHUNK = 16, 32_768
_MANY = 10_000_000
_AHEAD = 3  # runs waiting for each worker: memory stays bounded whatever the number of points


@dataclass(frozen=True)
class Summary:
    """What a sweep did."""

    out: Path
    n_points: int
    n_failed: int
    renders: int


def sweep(
    study: str | Path | Study,
    *,
    out: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    yes: bool = False,
) -> Summary:
    """Run a study, or what is left of it.

    Parameters
    ----------
    study
        Its TOML file.
    out
        Folder; default ``runs/NAME``. The same command goes on where it was interrupted.
    scheduler
        Address of a running Dask scheduler, ``tcp://HOST:PORT``; default: processes here.
    workers
        Processes here; default one per core. The results do not depend on it.
    yes
        Agree to more than 1e7 points.

    Raises InputError for a study that can't be run, a folder of another one, a full disk.
    """
    study = study if isinstance(study, Study) else load_study(study)
    if study.n_points > _MANY and not yes:
        raise InputError(f"{study.name}: {study.n_points} points; --yes to go ahead")
    if workers is not None and workers < 1:
        raise InputError(f"workers: {workers}: expected 1 or more")
    closed = study.model == "closed-form"
    out = Path(out) if out is not None else Path("runs") / study.name
    store = Store(study, out, _CLOSED_CHUNK if closed else _RENDERED_CHUNK)
    if any(True for _ in store.todo()):
        _check(study)
        local = closed and scheduler is None and workers is None
        pool = _here() if local else _dask(scheduler, workers)
        with _bar(study, store) as advance, pool as submit:
            for chunk in _in_flight(submit, study, store):
                store.add(chunk)
                advance(chunk.stop - chunk.start)
    store.finish()
    return Summary(out, study.n_points, len(store.errors), store.renders)


def _check(study: Study) -> None:
    """A fault of the study itself, before any worker starts."""
    from twin.sweep.metrics import metric
    from twin.sweep.setup import setup

    setup(study, {})
    if study.model == "rendered":
        for name in study.metrics:
            metric(name, study.folder)


def _in_flight(submit: Any, study: Study, store: Store) -> Iterator[Chunk]:
    """Results as they come, never more than a few runs ahead of the slowest worker."""
    waiting: deque[Any] = deque()
    todo = store.todo()
    for start, stop in todo:
        waiting.append(submit(study, start, stop))
        if len(waiting) >= submit.ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
    if interrupts:
        raise KeyboardInterrupt


class _Submit:
    def __init__(self, send: Any, ahead: int) -> None:
        self._send, self.ahead = send, ahead

    def __call__(self, study: Study, start: int, stop: int) -> Any:
        return self._send(evaluate_chunk, study, start, stop)


class _Now:
    """A result that is there."""

    def __init__(self, value: Chunk) -> None:
        self._value = value

    def result(self) -> Chunk:
        return self._value


@contextmanager
def _here() -> Iterator[_Submit]:
    yield _Submit(lambda work, *args: _Now(work(*args)), 1)


@contextmanager
def _dask(scheduler: str | None, workers: int | None) -> Iterator[_Submit]:
    """Dask's workers: a local cluster, or a running one."""
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"scheduler: {scheduler!r}: can't be reached ({error})") from error
        with client:
            n = max(1, len(client.scheduler_info()["workers"]))
            yield _Submit(_pure(client), _AHEAD * n)
        return
    cores = len(os.sched_getaffinity(0))
    n = workers or cores
    threads = max(1, cores // n)
    with (
        LocalCluster(
            n_workers=n,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=50,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.run(_use_threads, threads)
        yield _Submit(_pure(client), _AHEAD * n)


def _pure(client: Any) -> Any:
    return lambda work, *args: client.submit(work, *args, pure=False, retries=2)


def _use_threads(n: int) -> None:
    """Workers share the cores instead of fighting for them."""
    os.environ["OMP_NUM_THREADS"] = str(n)
    from twin.engine import mitsuba

    mitsuba()
    import drjit

    drjit.set_thread_count(n)


@contextmanager
def _bar(study: Study, store: Store) -> Iterator[Any]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Left

    done = sum(min(store.chunk, study.n_points - start) for start in store.done)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Left(),
        console=Console(file=sys.stderr),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as progress:
        task = progress.add_task(study.name, total=study.n_points, completed=done)
        yield lambda n: progress.advance(task, n)
