"""Rendered truth on disk, named by all it depends on, made once however many ask."""

import fcntl
import hashlib
import os
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

#: Words about values, not values: a better citation renders nothing new.
_WORDS = {"description", "source", "assumed", "origin", "assumptions", "warnings", "path"}
_ENGINES = ("numpy", "scipy", "mitsuba", "drjit", "sionna-rt", "finufft")
_MOST_FILES = 64


def digest(*content: Any) -> str:
    """SHA-256 of what dataclasses, settings and arrays say; the same on every machine.

    Arrays count to 1e-9 of their unit, so that rounding does not show. Files of spectra count by
    what is in them, other paths not at all.
    """
    found = hashlib.sha256()
    for piece in _pieces(content):
        found.update(piece)
    return found.hexdigest()


def versions() -> dict[str, str]:
    """Of this package and the engines under it."""
    from twin import __version__

    return {"ugv-twin": __version__, **{name: metadata.version(name) for name in _ENGINES}}


@lru_cache(maxsize=1)
def code() -> str:
    """Digest of the simulator's own source: a change there makes the truth anew."""
    found, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        if Path(__file__).parent not in path.parents:
            found.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return found.hexdigest()


class Store:
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
            partial = path.with_suffix(f".{os.getpid()}")
            partial.write_bytes(pickle.dumps(made))
            partial.replace(path)
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


def _pieces(value: Any) -> Iterator[bytes]:
    """A value as bytes, each kind led by its name and size so that no two values share theirs."""
    if isinstance(value, np.ndarray):
        exact = np.round(np.asarray(value, np.float64), 9) + 0.0  # + 0: no negative zero
        yield f"array{value.shape}".encode() + exact.tobytes()
    elif isinstance(value, Path):
        yield b"path"
    elif isinstance(value, Mapping):
        yield from _named("mapping", {str(k): v for k, v in value.items()})
    elif is_dataclass(value):
        yield from _named(
            type(value).__name__, {f.name: getattr(value, f.name) for f in fields(value)}
        )
    elif hasattr(type(value), "model_fields"):
        names = type(value).model_fields
        yield from _named(type(value).__name__, {name: getattr(value, name) for name in names})
    elif isinstance(value, Sequence) and not isinstance(value, str):
        yield f"sequence{len(value)}".encode()
        for item in value:
            yield from _pieces(item)
    else:
        yield f"{type(value).__name__} {value!r};".encode()


def _named(kind: str, content: dict[str, Any]) -> Iterator[bytes]:
    # What is not there does not count: a new optional part leaves what was made before valid.
    told = {n: content[n] for n in sorted(content) if n not in _WORDS and content[n] is not None}
    yield f"{kind}{len(told)}".encode()
    for name, value in told.items():
        yield f"{name}=".encode()
        if name.endswith(("_csv", "_file")):
            yield hashlib.sha256(Path(value.value).read_bytes()).digest()
        else:
            yield from _pieces(value)
