"""Digests of what a result depends on: content, never names; the same on every machine."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from hardware.files import read_regular
from hardware.own_functions import digest_of_given, is_file_function

#: Words about values, not values: a better citation computes nothing new.
_WORDS = {
    "description",
    "source",
    "assumed",
    "origin",
    "assumptions",
    "warnings",
    "notes",
    "path",
    "unknown_materials",
}
#: Characters of a digest that tell one content from another.
_START = 12
_FEW = 4
_ENGINES = ("numpy", "scipy", "mitsuba", "drjit", "sionna-rt", "finufft")


def digest(*content: Any, exact: bool = False) -> str:
    """SHA-256 of what dataclasses, settings and arrays say; the same on every machine.

    Arrays count to 1e-9 of their unit, so that rounding does not show, and words about values do
    not; ``exact``: every bit of arrays, and words too. Files of spectra and of antenna patterns
    count by what is in them, other paths not at all. Raises OSError for a file that can't be read.
    """
    found = hashlib.sha256()
    for piece in _pieces(content, exact):
        found.update(piece)
    return found.hexdigest()


def parts(content: Any) -> dict[str, Any]:
    """What counts in the digest of a dataclass or a model, but for its name, by dotted name:
    numbers, few of them together and words as they are, all else, and each of several things with
    names, by the start of its own digest.
    """
    return {path: part for path, part in _parts("", "", content) if path != "name"}


def file_digest(path: Path) -> str:
    """SHA-256 of a file, or of the files in a folder with their names."""
    if not path.is_dir():
        return hashlib.sha256(read_regular(path)).hexdigest()
    found = hashlib.sha256()
    for item in sorted(path.iterdir()):
        if item.is_file():
            found.update(item.name.encode() + hashlib.sha256(read_regular(item)).digest())
    return found.hexdigest()


def versions() -> dict[str, str]:
    """Of this package and the engines under it."""
    from twin import __version__

    return {"ugv-twin": __version__, **{name: metadata.version(name) for name in _ENGINES}}


@lru_cache(maxsize=8)
def source_digest(*folders: Path, without: tuple[Path, ...] = ()) -> str:
    """SHA-256 of the Python files in folders, but for those in ``without``; read once a process."""
    found = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            if not any(path.is_relative_to(other) for other in without):
                found.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return found.hexdigest()


def _pieces(value: Any, exact: bool = False) -> Iterator[bytes]:
    """A value as bytes, each kind led by its name and size so that no two values share theirs."""
    if isinstance(value, np.ndarray) and exact:
        yield f"array{value.shape}{value.dtype.str}".encode() + value.tobytes()
    elif isinstance(value, np.ndarray):
        rounded = np.round(np.asarray(value, np.float64), 9) + 0.0  # + 0: no negative zero
        yield f"array{value.shape}".encode() + rounded.tobytes()
    elif hasattr(type(value), "as_matrix"):  # SciPy's rotations and rigid transforms
        yield from _pieces(value.as_matrix(), exact)
    elif isinstance(value, Path):
        yield b"path"
    elif (content := _fields(value)) is not None:
        kind = "mapping" if isinstance(value, Mapping) else type(value).__name__
        yield from _named(kind, content, exact)
    elif callable(value):
        yield digest_of_given(value).encode()
    elif isinstance(value, Sequence) and not isinstance(value, str):
        yield f"sequence{len(value)}".encode()
        for item in value:
            yield from _pieces(item, exact)
    else:
        yield f"{type(value).__name__} {value!r};".encode()


def _parts(path: str, name: str, value: Any) -> Iterator[tuple[str, Any]]:
    plain = getattr(value, "value", value)
    is_several = isinstance(plain, Sequence) and not isinstance(plain, str)
    if is_several and plain and all(hasattr(item, "name") for item in plain):
        for item in plain:
            yield f"{path}.{item.name}", digest(item)[:_START]
    elif plain is value and not hasattr(type(value), "as_matrix") and _fields(value):
        for key, part in _counting(_fields(value) or {}).items():
            yield from _parts(f"{path}.{key}".lstrip("."), key, part)
    elif isinstance(plain, int | float | str) and not name.endswith(("_csv", "_file")):
        yield path, plain
    elif is_several and len(plain) <= _FEW and all(isinstance(n, int | float) for n in plain):
        yield path, list(plain)
    else:
        yield path, digest({name: value})[:_START]


def _fields(value: Any) -> dict[str, Any] | None:
    """Of a mapping, a dataclass or a model; None of all else."""
    if isinstance(value, Mapping):
        return {str(k): v for k, v in value.items()}
    if is_dataclass(value):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    if hasattr(type(value), "model_fields"):
        return {name: getattr(value, name) for name in type(value).model_fields}
    return None


def _counting(content: dict[str, Any], words: bool = False) -> dict[str, Any]:
    # What is not there does not count: a new optional part leaves what was made before valid.
    return {
        name: content[name]
        for name in sorted(content)
        if (words or name not in _WORDS) and content[name] is not None
    }


def _named(kind: str, content: dict[str, Any], exact: bool) -> Iterator[bytes]:
    told = _counting(content, words=exact)
    yield f"{kind}{len(told)}".encode()
    for name, value in told.items():
        yield f"{name}=".encode()
        if name.endswith(("_csv", "_file")):
            yield hashlib.sha256(read_regular(value.value)).digest()
        elif name == "patterns" and isinstance(getattr(value, "value", None), str):
            yield file_digest(Path(value.value)).encode()
        elif name == "patterns" and hasattr(value, "value"):
            yield value.value.digest.encode()
        elif name == "radar" and isinstance(value, str) and is_file_function(value):
            yield digest_of_given(value).encode()
        elif name == "function" and hasattr(value, "value"):
            yield digest_of_given(value.value).encode()
        else:
            yield from _pieces(value, exact)
