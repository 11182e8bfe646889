"""Rendered truth on disk, named by all it depends on, made once however many ask.

By hand: in joblib's memory a second process does not wait for the first that makes a result, and
locks of diskcache outlive a process that is killed.
"""

import fcntl
import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from hardware.files import whole_file
from twin.digest import source_digest

T = TypeVar("T")

_MOST_FILES = 64


def code() -> str:
    """Digest of the simulator's own source: a change there makes the truth anew."""
    here = Path(__file__).parent
    return source_digest(here.parent, without=(here,))


class TruthCache:
    """A folder of results by key. Processes that want the same one wait for whoever makes it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, key: str, make: Callable[[], T]) -> T:
        """The result of this key, made when there is none."""
        path = self._folder / f"{key}.pickle"
        with suppress(OSError, EOFError, pickle.UnpicklingError):
            return self._read(path)
        with (self._folder / f"{key}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # freed even by kill -9
            with suppress(OSError, EOFError, pickle.UnpicklingError):
                return self._read(path)
            made = make()
            with whole_file(path) as partial:
                partial.write_bytes(pickle.dumps(made))
            self._forget_oldest()
            return made

    def _read(self, path: Path) -> Any:
        content = path.read_bytes()
        os.utime(path)  # the oldest go first
        return pickle.loads(content)  # of a folder that is this user's own, as conftest.py is

    def _forget_oldest(self) -> None:
        for path in sorted(self._folder.glob("*.pickle"), key=_age)[:-_MOST_FILES]:
            path.unlink(missing_ok=True)
            path.with_suffix(".lock").unlink(missing_ok=True)


def _age(path: Path) -> float:
    with suppress(OSError):
        return path.stat().st_mtime
    return 0.0
