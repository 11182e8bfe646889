"""Stages of a job: shown while they run, timed, interruptible."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

#: Opens a named stage of the work; what is run inside belongs to it.
OpenStage = Callable[[str], AbstractContextManager[Any]]

#: Signals received. A library may swallow the KeyboardInterrupt that one raises in its callback;
#: the next stage raises it again.
interrupts: list[int] = []

#: Files that the command goes on with where they are there already.
continued: list[Path] = []

#: Told of each stage that ends, with its time in s.
listeners: list[Callable[[str, float], None]] = []


def silently(name: str) -> AbstractContextManager[None]:
    """A stage that nobody is told of."""
    return nullcontext()


def tell(stage: str, took_s: float) -> None:
    """Tell all listeners of a stage that has ended."""
    for listener in listeners:
        listener(stage, took_s)


class StageTimes:
    """Times named stages; `stage` is what the work calls. Several times of one stage add up."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One stage of the work."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.ended(name, time.perf_counter() - start)

    def ended(self, name: str, took_s: float) -> None:
        """Count a stage that has taken this time."""
        self.seconds[name] = self.seconds.get(name, 0.0) + took_s


class Stages(StageTimes):
    """Stages shown as one progress bar on a terminal; a context manager."""

    def __init__(self, expected: int) -> None:
        super().__init__()
        self._expected = expected

    def __enter__(self) -> "Stages":
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._progress = Progress(
            TextColumn("{task.description:<24}"),
            BarColumn(),
            TimeElapsedColumn(),
            console=Console(file=sys.stderr),
            transient=True,
            disable=not sys.stderr.isatty(),
        )
        self._progress.start()
        self._task = self._progress.add_task("", total=self._expected)
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """One stage of the work."""
        if interrupts:
            raise KeyboardInterrupt
        self._progress.update(self._task, description=name)
        with super().stage(name):
            yield

    def ended(self, name: str, took_s: float) -> None:
        """Count and tell a stage that has taken this time, here or in another process."""
        super().ended(name, took_s)
        tell(name, took_s)
        self._progress.advance(self._task)
