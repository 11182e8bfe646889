"""Driving: events in the order of their time, each to the log as soon as it is complete."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from hardware.recording import Log
from twin.drive.log import DriveLog, words_of
from twin.drive.mounting import mounting_of
from twin.drive.plan import Drive, Event
from twin.drive.sensors import CameraFrames, RadarBursts
from twin.drive.truth import STATES, Mark, ObjectStates, images_of
from twin.drive.truth_samples import TruthSamples
from twin.drive.warning_counts import WarningCount, WarningCounts
from twin.engine import return_freed_memory
from twin.progress import interrupts

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
    over: threading.Event | None = None,
    tell: Tell = lambda reference_s: None,
) -> Driven:
    """Record a drive to a log, or go on with it.

    A log that a kill, a full disk or ``over`` cut short is gone on with by the same call, and ends
    with the same bytes as one that was not; a complete one is left as it is. What was computed of
    an event that is not whole is lost. Memory does not grow with the duration.

    Raises InputError for a file at ``path`` that is not the log of this drive, and as `capture` and
    `radar_capture`.
    """
    path, over = Path(path), over or threading.Event()
    about = {
        "scene": plan.scene.name,
        "system": plan.system.name if plan.system else "none",
        "radar": plan.radar.name if plan.radar else "none",
        "duration_s": repr(float(plan.duration_s)),
        "seed": str(plan.seed),
        "digest": plan.digest,
        **words_of(plan.fidelity),
    }
    start, told = time.monotonic(), WarningCounts()
    with DriveLog(path, about, sum(1 for _ in plan.events())) as log:
        resumed = log.events
        begun_s = covered_s = plan.duration_s if log.complete else _end_of(plan, resumed)
        tell(begun_s)
        if not log.complete:
            write = _writer(plan, told)
            for event in islice(plan.events(), resumed, None):
                if over.is_set() or interrupts:
                    break
                log.event(_mark(plan, event, log.events), write(event))
                covered_s = 1e-9 * event.end_ns
                tell(covered_s)
            else:
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


def _end_of(plan: Drive, n_events: int) -> float:
    """Reference time, s, at which so many events are complete."""
    last = deque(islice(plan.events(), n_events), maxlen=1)
    return 1e-9 * last[0].end_ns if last else 0.0


def _mark(plan: Drive, event: Event, number: int) -> Mark:
    clocks = {"camera": plan.camera_clock, "radar": plan.radar_clock}
    shown = {name: clock.model.device_ns(event.end_ns) for name, clock in clocks.items()}
    return Mark(number, event.kind, event.number, event.begin_ns, event.end_ns, shown)


def _writer(plan: Drive, told: WarningCounts) -> Callable[[Event], Callable[[Log], None]]:
    """What writes the messages of an event."""
    camera, radar, samples = CameraFrames(plan, told), RadarBursts(plan, told), TruthSamples(plan)

    def states(log: Log, found: Iterable[ObjectStates], at_ns: Sequence[int], log_ns: int) -> None:
        for state, stamp_ns in zip(found, at_ns, strict=True):
            log.message("/truth/objects", STATES, state.pack(stamp_ns), log_ns, stamp_ns)

    def frame(log: Log, event: Event) -> None:
        record = camera(event.number, event.begin_ns)
        model = plan.camera_clock.model
        log.record("/spi/record", record, host_ns=event.end_ns, clock=model)
        told = mounting_of(plan, event.begin_ns) if event.number == 0 else ()
        for topic, definition, message in told:
            log.message(topic, definition, message, event.end_ns, event.begin_ns)
        middle_ns = (event.begin_ns + event.end_ns) // 2
        for topic, (definition, message) in images_of(camera.truth(middle_ns), middle_ns).items():
            log.message(topic, definition, message, event.end_ns, middle_ns)
        at_ns = (event.begin_ns, middle_ns)
        states(log, ObjectStates.at(plan.scene, 1e-9 * np.array(at_ns)), at_ns, event.end_ns)
        return_freed_memory()

    def burst(log: Log, event: Event) -> None:
        record, middle_ns = radar(event.number), plan.burst_ns(event.number)
        model = plan.radar_clock.model
        log.record("/radar/record", record, host_ns=event.end_ns, clock=model)
        found = ObjectStates.at(plan.scene, 1e-9 * np.array([middle_ns]))
        states(log, found, [middle_ns], event.end_ns)
        return_freed_memory()

    def write(event: Event) -> Callable[[Log], None]:
        if event.kind == "camera":
            return lambda log: frame(log, event)
        if event.kind == "radar":
            return lambda log: burst(log, event)
        return lambda log: states(log, [samples(event.number)], [event.end_ns], event.end_ns)

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
