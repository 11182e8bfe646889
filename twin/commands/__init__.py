"""What each command of `twin` does; engines are loaded by the command that needs them."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


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
