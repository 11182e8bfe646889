"""A user's own patterns in a system: a file's name, or in Python an array."""

import os
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, WithJsonSchema

from hardware.patterns import Mode, OwnPatterns, own_patterns
from twin.errors import InputError


def _source(value: Any) -> Any:
    if isinstance(value, str | OwnPatterns):
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray | list):
        return own_patterns(value)
    raise InputError("expected the name of a file, or an array (count, rows, columns)")


#: Name of a file, or what `hardware.own_patterns` takes.
OwnPatternSource = Annotated[
    Any, BeforeValidator(_source), WithJsonSchema({"type": "string", "description": "a file"})
]


def read_own_patterns(
    given: str | OwnPatterns, *, count: int, shape: tuple[int, int], mode: Mode
) -> OwnPatterns:
    """The first ``count`` patterns of a file or an object, shown in a ``mode``.

    Raises FileNotFoundError and InputError for what they are not.
    """
    if isinstance(given, str):
        given = _of_file(given, _stamp(Path(given)))
    if (given.rows, given.columns) != shape:
        raise InputError(
            f"{given.rows} x {given.columns} cells, emitter.rows x columns are {shape[0]} x "
            f"{shape[1]}"
        )
    if count > given.count:
        raise InputError(f"{given.count} patterns, acquisition.n_patterns = {count}")
    return _shown(given, count, mode)


def _stamp(path: Path) -> tuple[int, ...]:
    """Tells versions of a file, or of the files in a folder, apart without reading them."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return tuple(n for f in files if f.exists() for n in (os.stat(f).st_mtime_ns, f.stat().st_size))


@lru_cache(maxsize=8)
def _of_file(path: str, _stamp: tuple[int, ...]) -> OwnPatterns:
    return own_patterns(path)


@lru_cache(maxsize=8)
def _shown(patterns: OwnPatterns, count: int, mode: Mode) -> OwnPatterns:
    return own_patterns(patterns.first(count), mode)
