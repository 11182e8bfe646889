"""What the sensors of a drive measure, event after event, computed by several processes."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Any

from twin.child_process import attempt
from twin.drive.plan import Drive, Event
from twin.drive.sensors import Measured, Sensors
from twin.workers import Submit, dask, here, usual_workers

#: Frames and bursts for which processes are not started, unless they are asked for: that takes
#: seconds.
_FEW = 3


def pool_of(
    plan: Drive,
    n_measurements: int,
    scheduler: str | None,
    workers: int | None,
    is_over: Callable[[], bool],
) -> AbstractContextManager[Submit]:
    """Who computes so many frames and bursts. By default this process where they are few, or the
    world rests, whose light and echoes are found once. When it ``is_over`` no process is waited
    for.
    """
    if scheduler is None and workers is None:
        workers = usual_workers() if plan.moves and n_measurements > _FEW else 0
        workers = 0 if workers == 1 else workers
    return here() if scheduler is None and workers == 0 else dask(scheduler, workers, is_over)


def in_order(
    plan: Drive, events: Iterable[Event], submit: Submit, is_over: Callable[[], bool]
) -> Iterator[tuple[Event, Measured | None]]:
    """Events as they come, each with what its sensor measured; never more than a few are computed
    ahead. When it ``is_over``, the one that is waited for is the last that is measured.

    Raises what capturing does.
    """
    sensors, waiting = submit.share(Sensors(plan)), deque[tuple[Event, Any]]()
    n_ahead = 0
    for event in events:
        if is_over():
            return
        is_measured = event.kind != "truth"
        waiting.append((event, submit(_measured, sensors, event) if is_measured else None))
        n_ahead += is_measured
        while n_ahead >= submit.ahead or (waiting and waiting[0][1] is None):
            n_ahead -= waiting[0][1] is not None
            yield _answered(submit, *waiting.popleft())
    while waiting and not is_over():
        yield _answered(submit, *waiting.popleft())


def _measured(sensors: Sensors, event: Event) -> tuple[Measured | None, Exception | None]:
    """Or the error to raise: an exception would be tried again."""
    return attempt(sensors.measured, event)


def _answered(submit: Submit, event: Event, handle: Any) -> tuple[Event, Measured | None]:
    if handle is None:
        return event, None
    found, error = submit.result(handle)
    if error is not None:
        raise error
    return event, found
