"""What each command of `twin` does; engines are loaded by the command that needs them."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hardware.formatting import si
from twin.progress import listeners

if TYPE_CHECKING:
    from rich.console import Console

    from hardware.commands.output import Output


@contextmanager
def loading() -> Iterator[None]:
    """While modules are imported: what they hold stays to the end, so that the garbage collector
    need not look through it, neither now nor at each of its full rounds (0.6 s of a run's 9 s).
    """
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():  # where commands follow each other, what died is not kept
            gc.freeze()
        gc.enable()


@contextmanager
def with_stages(say: "Output") -> Iterator[None]:
    """While a command runs: a verbose one tells the stages of its work and their times."""

    def tell(stage: str, took_s: float) -> None:
        say.step(f"{stage}: {si(took_s, 's')}")

    listeners.append(tell)
    try:
        yield
    finally:
        listeners.remove(tell)


def console_of(say: "Output", width: int = 150) -> "Console":
    """Where a command prints its tables, ``width`` characters where that is no terminal."""
    from rich.console import Console

    at_terminal = (sys.stderr if say.json else sys.stdout).isatty()
    return Console(file=say.stream, width=None if at_terminal else width, quiet=say.quiet)
