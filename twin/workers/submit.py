"""Work handed to whoever computes it, and what ends that."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from twin.errors import EngineError


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
