"""Running a study: points in runs over Dask's workers, results stored as they come.

A sweep that was interrupted resumes from its folder: `store.create_or_resume`, `store.Store.todo`.
"""

import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from hardware.formatting import setting_text
from twin.fidelity import Accuracy, Tolerance
from twin.files import InputError, check_out, locked
from twin.progress import interrupts, tell
from twin.sweep.accuracy import with_accuracy
from twin.sweep.dataset import labels, warned_points
from twin.sweep.effects import check_points, without_effect
from twin.sweep.evaluate import Chunk, evaluate_points, failed, in_one_line, joined
from twin.sweep.inputs import Inputs, inputs_of
from twin.sweep.names import is_own, needs_radar
from twin.sweep.refinement import coarse_study
from twin.sweep.store import Points, Store, create_or_resume
from twin.sweep.study import Study, load_study
from twin.workers import (
    SchedulerGoneError,
    Submit,
    WorkerDiedError,
    check_workers,
    dask,
    here,
    n_cores,
    usual_workers,
)

#: Points in a run: what a kill loses at most, for each worker.
_RENDERED_CHUNK, _CLOSED_CHUNK = 16, 32_768
#: More in a run where they share light.
_MOST_SHARING = 2
_MANY = 10_000_000


@dataclass(frozen=True)
class Summary:
    """What a sweep did.

    ``reasons``: why points failed, with how many each, most first; ``failed``: the first of each
    reason, its number with its parameters. ``warned``: by kind, how many
    points a warning was given of, fewest first; ``words``: the first of each kind.
    ``without_effect``: parameters along which no metric changed. ``n_coarse``: points that cannot
    be on the study's front, left at a coarse tolerance; None where all are computed as asked.
    """

    out: Path
    n_points: int
    n_failed: int
    n_void: int
    renders: int
    reasons: tuple[tuple[str, int], ...] = ()
    failed: Mapping[str, str] = field(default_factory=dict)
    warned: tuple[tuple[str, int], ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)
    without_effect: tuple[str, ...] = ()
    n_coarse: int | None = None


def run_sweep(
    study: str | Path | Study,
    *,
    out: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    yes: bool = False,
    fidelity: Accuracy | None = None,
    scores: Tolerance | None = None,
) -> Summary:
    """Run a study, or what is left of it.

    Parameters
    ----------
    study
        Its TOML file, or a study made in Python.
    out
        Folder; default ``runs/NAME``. The same command goes on where it was interrupted.
    scheduler
        Address of a running Dask scheduler, ``tcp://HOST:PORT``; default: processes here.
    workers
        Processes here; default one per core, of studies with the radar as far as memory allows; 0:
        this process itself. The results do not depend on it. Processes import the script that
        starts them: its work belongs under ``if __name__ == "__main__"``.
    yes
        Agree to more than 1e7 points.
    fidelity
        Error that the model may add, a preset's name, or knobs, in place of the preset or tolerance
        that the study sets; knobs that the study sets or varies stay. Default: the study's; where
        it names neither these nor knobs, the default `Tolerance`.
    scores
        What ``fidelity`` was chosen for on the first point, by `twin.fidelity_for_scores`: points
        that know these scores to less are marked and warned of.

    Raises InputError for a study that can't be run, a folder of another one, of the same at another
    accuracy, or in which another sweep works, a full disk.

    >>> from twin.sweep import open_sweep
    >>> study = Study(
    ...     name="lens",
    ...     model="closed-form",
    ...     metrics=["snr"],
    ...     grid={"system.optics.f_number": [0.8, 1.6], "link.distance_m": ["2 m", "5 m"]},
    ... )
    >>> summary = run_sweep(study, workers=0)
    >>> open_sweep(summary.out)["snr"].dims
    ('system.optics.f_number', 'link.distance_m')
    """
    study = study if isinstance(study, Study) else load_study(study)
    if fidelity is not None:
        study = with_accuracy(study, fidelity)
    if study.n_points > _MANY and not yes:
        raise InputError(f"{study.label}: {study.n_points} points; --yes to go ahead")
    check_workers(workers, scheduler)
    closed = study.model == "closed-form"
    usual = usual_workers if needs_radar(study.metrics) else n_cores
    n_workers = None if scheduler else max(1, usual() if workers is None else workers)
    check_out(out)
    out = folder_of(study, out)
    inputs = inputs_of(study)
    try:
        check_points(study, inputs)
    except InputError as error:
        raise type(error)(f"{study.label}: {error}") from error
    own = {name: inputs.get("metric", name) for name in study.metrics if is_own(name)}
    chunk = _CLOSED_CHUNK if closed else points_in_a_run(study, n_workers)
    with locked(out, "sweep"):
        store = create_or_resume(study, out, chunk, inputs, labels(study, own))
        store.chosen_for("" if scores is None else str(scores))
        if any(True for _ in chain(store.todo(), store.to_refine())):
            local = scheduler is None and (workers == 0 or (closed and workers is None))
            pool = here() if local else dask(scheduler, n_workers)
            try:
                _compute(study, store, inputs, pool)
            except SchedulerGoneError as error:
                stored = f"{store.progress.points_done} of {study.n_points} points are stored"
                words = f"{error}; {stored}, the same command resumes"
                raise SchedulerGoneError(words) from error
        store.finish()
        return _summary(store)


def points_in_a_run(study: Study, n_workers: int | None) -> int:
    """Points that a worker computes by itself. Where all that may share a render are few, and there
    are as many renders as workers, a run holds whole sets of them: each is rendered once. Else
    workers that share such a set each make its render, rather than wait for another. ``n_workers``:
    None where it is not known.
    """
    sharing = study.n_sharing
    sets, few = study.n_points // sharing, sharing <= _MOST_SHARING * _RENDERED_CHUNK
    if n_workers is None or not few or sets < n_workers:
        return _RENDERED_CHUNK
    return sharing * max(1, min(_RENDERED_CHUNK // sharing, sets // n_workers))


def _compute(
    study: Study, store: Store, inputs: Inputs, pool: AbstractContextManager[Submit]
) -> None:
    """Compute and store what is left, and tell of each run."""
    with _bar(study, store) as (advance, more), pool as submit:
        before_s = time.perf_counter()
        for refined, result in _of_all_passes(submit, study, store, inputs, more):
            store.add(result, refined=refined)
            advance(len(result.points))
            now_s, progress = time.perf_counter(), store.progress
            done = f"{progress.points_done} of {study.n_points} points"
            if refined:
                done += f", {len(progress.refined)} of them as finely as asked"
            tell(done, now_s - before_s)
            before_s = now_s


def folder_of(study: Study, out: str | Path | None) -> Path:
    """Where a study's results are."""
    return Path(out) if out is not None else Path("runs") / study.name


def _summary(store: Store) -> Summary:
    found, progress = store.dataset(), store.progress
    warned = warned_points(found)
    first: dict[str, int] = {}
    for index, reason in sorted(progress.errors.items()):
        first.setdefault(reason, index)
    return Summary(
        out=store.out,
        n_points=store.study.n_points,
        n_failed=found.attrs["points_failed"],
        n_void=found.attrs["points_void"],
        renders=progress.renders,
        reasons=tuple(Counter(progress.errors.values()).most_common()),
        failed={reason: _point_in_words(store.study, index) for reason, index in first.items()},
        warned=tuple((one.kind, len(one.points)) for one in warned),
        words={one.kind: one.words for one in warned},
        without_effect=tuple(without_effect(found)),
        n_coarse=found.attrs.get("points_coarse"),
    )


def _point_in_words(study: Study, index: int) -> str:
    """Number of a point, with what varies."""
    varied = [name for axis in study.axes for name in axis.columns]
    values = study.point(index)
    return f"{index}: " + ", ".join(f"{n} = {setting_text(n, values[n])}" for n in varied)


def _of_all_passes(
    submit: Submit, study: Study, store: Store, inputs: Inputs, more: Callable[[int], None]
) -> Iterator[tuple[bool, Chunk]]:
    """Results as they come, each to be stored before the next; whether they are of points that are
    computed anew. ``more``: told how many.
    """
    first = coarse_study(study) or study
    for result in _in_flight(submit, first, store.todo(), inputs):
        yield False, result
    while again := list(store.to_refine()):
        more(sum(map(len, again)))
        for result in _in_flight(submit, study, again, inputs):
            yield True, result


def _in_flight(
    submit: Submit, study: Study, todo: Iterable[Points], inputs: Inputs
) -> Iterator[Chunk]:
    """Results as they come, never more than a few runs ahead of the slowest worker."""
    waiting: deque[tuple[Points, Any]] = deque()
    for points in todo:
        waiting.append((points, submit(evaluate_points, study, points, inputs)))
        if len(waiting) >= submit.ahead:
            yield _result(submit, study, inputs, *waiting.popleft())
    while waiting:
        yield _result(submit, study, inputs, *waiting.popleft())
    if interrupts:
        raise KeyboardInterrupt


def _result(submit: Submit, study: Study, inputs: Inputs, points: Points, handle: Any) -> Chunk:
    """Result of a run of points; where workers died of it, of each point by itself."""
    try:
        found: Chunk = submit.result(handle)
    except WorkerDiedError as error:
        if len(points) == 1:
            return failed(study, int(points[0]), in_one_line(error))
        # One after another: with a worker goes what others of its results nobody had fetched yet.
        return joined(
            [
                _result(submit, study, inputs, one, submit(evaluate_points, study, one, inputs))
                for one in np.split(points, len(points))
            ]
        )
    return found


@contextmanager
def _bar(study: Study, store: Store) -> Iterator[Any]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Left

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Left(),
        console=Console(file=sys.stderr),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as progress:
        task = progress.add_task(
            study.name, total=study.n_points, completed=store.progress.points_done
        )

        def more(n: int) -> None:
            progress.update(task, total=(progress.tasks[0].total or 0) + n)

        yield lambda n: progress.advance(task, n), more
