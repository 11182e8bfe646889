"""Driving: events in the order of their time, each to the log as soon as it is complete."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from hardware.recording import Log
from twin.drive.log import DriveLog, words_of
from twin.drive.measuring import in_order, pool_of
from twin.drive.mounting import mounting_of
from twin.drive.plan import Drive, Event
from twin.drive.sensors import Measured
from twin.drive.truth import STATES, Mark, ObjectStates, images_of
from twin.drive.truth_samples import TruthSamples
from twin.drive.warning_counts import WarningCount, WarningCounts
from twin.progress import interrupts
from twin.workers import AskedToEndError, SchedulerGoneError, WorkerDiedError, check_workers

#: Called with the reference time that is recorded, s.
Tell = Callable[[float], None]


@dataclass(frozen=True)
class Driven:
    """What a call of `drive` did: events in the log, of which ``resumed`` were there before; the
    time that they cover, of which ``computed_s`` was computed in ``elapsed_s``; whether the log
    is complete; and what the records that were computed are ``warned`` of.
    """

    path: Path
    events: int
    resumed: int
    covered_s: float
    computed_s: float
    elapsed_s: float
    complete: bool
    warned: tuple[WarningCount, ...] = ()

    @property
    def pace(self) -> float:
        """Seconds of the drive computed in one second."""
        return self.computed_s / self.elapsed_s if self.elapsed_s > 0 else 0.0


def drive(
    plan: Drive,
    path: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    over: threading.Event | None = None,
    tell: Tell = lambda reference_s: None,
) -> Driven:
    """Record a drive to a log, or go on with it.

    A log that a kill, a full disk or ``over`` cut short is gone on with by the same call, and ends
    with the same bytes as one that was not; a complete one is left as it is, one without any event
    is removed. What was computed of events that are not in the log is lost. Of a damaged log all
    behind the damage is computed anew; whole events there stay in a copy, NAME-damaged, which a
    line on stderr tells. Memory does not grow with the duration.

    ``workers`` processes here compute frames and bursts, 0: this process itself, or those of a Dask
    ``scheduler`` at this address; the bytes do not depend on it. By default one per core, as far as
    memory allows, of a world that moves. Processes import the script that starts them: its work
    belongs under ``if __name__ == "__main__"``.

    Raises InputError for a file at ``path`` that is not the log of this drive, for ``workers`` that
    are no number from 0 to 16, or to 4 per core, or given beside a scheduler, and as `capture` and
    `radar_capture`; `WorkerDiedError` and `SchedulerGoneError`, after which the same call goes on.
    """
    check_workers(workers, scheduler)
    path, over = Path(path), over or threading.Event()
    about = {
        "scene": plan.scene.name,
        "system": plan.system.name if plan.system else "none",
        "radar": plan.radar.name if plan.radar else "none",
        "duration_s": repr(float(plan.duration_s)),
        "seed": str(plan.seed),
        "digest": plan.digest,
        **words_of(plan.knobs),
    }

    def is_over() -> bool:
        return over.is_set() or bool(interrupts)

    start, told = time.monotonic(), WarningCounts()
    n_events = sum(1 for _ in plan.events())
    with DriveLog(path, about, n_events) as log:
        resumed = log.events
        begun_s = covered_s = plan.duration_s if resumed == n_events else _end_of(plan, resumed)
        tell(begun_s)
        if resumed < n_events:
            write = _writer(plan)
            n_left = sum(event.kind != "truth" for event in islice(plan.events(), resumed, None))
            with (
                suppress(AskedToEndError),
                _told_where_it_stands(log, n_events),
                pool_of(plan, n_left, scheduler, workers, is_over) as submit,
            ):
                todo = islice(plan.events(), resumed, None)
                for event, found in in_order(plan, todo, submit, is_over):
                    log.event(_mark(plan, event, log.events), write(event, found))
                    if found is not None:
                        told.add(event.kind, found.warnings)
                    covered_s = 1e-9 * event.end_ns
                    tell(covered_s)
        if log.events == n_events and not log.complete:
            log.finish()
            covered_s = plan.duration_s
        return Driven(
            path=path,
            events=log.events,
            resumed=resumed,
            covered_s=covered_s,
            computed_s=covered_s - begun_s,
            elapsed_s=time.monotonic() - start,
            complete=log.complete,
            warned=told.counts,
        )


@contextmanager
def _told_where_it_stands(log: DriveLog, n_events: int) -> Iterator[None]:
    """Errors of processes that are gone, with what is done and how it goes on."""
    try:
        yield
    except (SchedulerGoneError, WorkerDiedError) as error:
        if not log.events:
            raise
        stands = f"{log.events} of {n_events} events are in {log.path}"
        raise type(error)(f"{error}; {stands}, the same command continues it") from error


def _end_of(plan: Drive, n_events: int) -> float:
    """Reference time, s, at which so many events are complete."""
    last = deque(islice(plan.events(), n_events), maxlen=1)
    return 1e-9 * last[0].end_ns if last else 0.0


def _mark(plan: Drive, event: Event, number: int) -> Mark:
    clocks = {"camera": plan.camera_clock, "radar": plan.radar_clock}
    shown = {name: clock.model.device_ns(event.end_ns) for name, clock in clocks.items()}
    return Mark(number, event.kind, event.number, event.begin_ns, event.end_ns, shown)


def _writer(plan: Drive) -> Callable[[Event, Measured | None], Callable[[Log], None]]:
    """What writes the messages of an event, given what its sensor measured."""
    samples = TruthSamples(plan)

    def states(log: Log, found: Iterable[ObjectStates], at_ns: Sequence[int], log_ns: int) -> None:
        for state, stamp_ns in zip(found, at_ns, strict=True):
            log.message("/truth/objects", STATES, state.pack(stamp_ns), log_ns, stamp_ns)

    def frame(log: Log, event: Event, found: Measured) -> None:
        model = plan.camera_clock.model
        log.record("/spi/record", found.record, host_ns=event.end_ns, clock=model)
        told = mounting_of(plan, event.begin_ns) if event.number == 0 else ()
        for topic, definition, message in told:
            log.message(topic, definition, message, event.end_ns, event.begin_ns)
        assert found.truth is not None
        for topic, (definition, message) in images_of(found.truth, event.middle_ns).items():
            log.message(topic, definition, message, event.end_ns, event.middle_ns)
        at_ns = (event.begin_ns, event.middle_ns)
        states(log, ObjectStates.at(plan.scene, 1e-9 * np.array(at_ns)), at_ns, event.end_ns)

    def burst(log: Log, event: Event, found: Measured) -> None:
        middle_ns, model = plan.burst_ns(event.number), plan.radar_clock.model
        log.record("/radar/record", found.record, host_ns=event.end_ns, clock=model)
        at_s = 1e-9 * np.array([middle_ns])
        states(log, ObjectStates.at(plan.scene, at_s), [middle_ns], event.end_ns)

    def write(event: Event, found: Measured | None) -> Callable[[Log], None]:
        if found is None:
            return lambda log: states(log, [samples(event.number)], [event.end_ns], event.end_ns)
        one = frame if event.kind == "camera" else burst
        return lambda log: one(log, event, found)

    return write


@contextmanager
def progress_of(plan: Drive) -> Iterator[Tell]:
    """A bar on a terminal: reference time, and its ratio to real time."""
    import sys

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    bar = Progress(
        TextColumn("{task.description:<24}"),
        BarColumn(),
        TextColumn("{task.fields[pace]}"),
        TimeRemainingColumn(),
        console=Console(file=sys.stderr),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    with bar:
        task, start = bar.add_task("", total=plan.duration_s, pace=""), time.monotonic()
        first: list[float] = []

        def tell(reference_s: float) -> None:
            first[:] = first or [reference_s]
            elapsed_s = time.monotonic() - start
            pace = (reference_s - first[0]) / elapsed_s if elapsed_s > 0 else 0.0
            bar.update(
                task,
                completed=reference_s,
                description=f"{reference_s:.2f} of {plan.duration_s:g} s",
                pace=f"{pace:.3g} of real time",
            )

        yield tell
