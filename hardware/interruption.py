"""Signals at a bad time: the first asks for an orderly end, or waits until a step is over."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@contextmanager
def asked_to_end() -> Iterator[threading.Event]:
    """An event that SIGINT, SIGTERM or a hang-up sets.

    SIGINT counts also where the shell has started the program in the background, which makes it
    be ignored; a hang-up does not where it is ignored (nohup). After the first signal all have
    their usual effect again. In another thread than the main one no signal is caught.
    """
    over = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield over
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    if before.get(getattr(signal, "SIGHUP", None)) is signal.SIG_IGN:
        del before[signal.SIGHUP]

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)
        if before[signal.SIGINT] is signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def end(number: int, frame: FrameType | None) -> None:
        over.set()
        restore()

    for number in before:
        signal.signal(number, end)
    try:
        yield over
    finally:
        restore()


@contextmanager
def signals_deferred() -> Iterator[None]:
    """SIGINT and the like take effect after this block, where an exception would do harm within.

    Only those with a Python handler are deferred; in another thread than the main one none acts.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {n: h for n in _SIGNALS if callable(h := signal.getsignal(n))}
    for number in before:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in came:
        signal.raise_signal(number)
