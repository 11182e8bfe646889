"""Time that goes into choosing what is computed, in place of computing it."""

import importlib
import time
from collections.abc import Callable
from contextlib import ExitStack
from operator import attrgetter
from typing import Any, Self
from unittest import mock

#: Functions that decide, and compute nothing of the result, in the modules that call them.
_DECIDING = (
    ("twin.camera.permitted_error", "PermittedError.of"),
    ("twin.camera.permitted_error", "PermittedError.sun_error"),
    ("twin.optics.problem", "indirect_bound"),
    ("twin.optics.adaptive", "wanted_paths"),
    ("twin.optics.adaptive", "affordable_paths"),
    ("twin.optics.adaptive", "_by_other_halves"),
    ("twin.optics.adaptive", "_variances"),
    ("twin.optics.problem", "facet_light"),
)


class Choosing:
    """Adds up the CPU time of all functions that decide, while it is entered."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._inside = False

    def __enter__(self) -> Self:
        self._stack = ExitStack()
        for module, name in _DECIDING:
            known = attrgetter(name)(importlib.import_module(module))
            self._stack.enter_context(mock.patch(f"{module}.{name}", self._timed(known)))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **named: Any) -> Any:
            if self._inside:
                return function(*args, **named)
            self._inside, begin = True, time.process_time()
            try:
                return function(*args, **named)
            finally:
                self._inside = False
                self.seconds += time.process_time() - begin

        return timed
