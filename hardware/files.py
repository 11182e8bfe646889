"""Files of a user: text formats read with errors that name the file, and output that is whole."""

import errno
import glob
import json
import os
import platform
import re
import shutil
import stat
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tokenize import TokenError
from typing import IO, TYPE_CHECKING, Any

from hardware.errors import InputError
from hardware.interruption import signals_deferred

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Of a dotted key of TOML.
_MOST_KEY_PARTS = 64
#: Characters of an error; the longest of the tools' own are about half of that.
_MOST_LINE = 3000


def read_toml(path: str | Path) -> dict[str, Any]:
    """Content of a TOML file; a byte-order mark, as editors on Windows write it, is none of it.

    Raises OSError where it cannot be read; InputError, one line that begins with the file, where
    it is no regular file, no TOML, no UTF-8, nested too deeply, or holds a whole number beyond the
    64 bits of TOML 1.0.
    """
    content: dict[str, Any] = _parsed(path, "TOML", _toml)
    return content


def _toml(text: str) -> dict[str, Any]:
    # Each part of a key is a table within a table, and tomllib takes the square of their number.
    for part in re.split(r"[=,{}\[\]\n]", re.sub(r"\.{2,}", "", text)):
        if part.count(".") >= _MOST_KEY_PARTS:
            raise InputError(f"nested too deeply: more than {_MOST_KEY_PARTS} parts of a key")
    content = tomllib.loads(text)
    left: list[tuple[str, Any]] = list(content.items())
    while left:
        name, value = left.pop()
        if isinstance(value, dict):
            left += [(f"{name}.{key}"[:80], inner) for key, inner in value.items()]
        elif isinstance(value, list):
            left += [(name, inner) for inner in value]
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise InputError(f"{name}: a whole number of {value.bit_length()} bits, expected 64")
    return content


def read_json(path: str | Path) -> Any:
    """Content of a JSON file. Raises as `read_toml`."""
    return _parsed(path, "JSON", json.loads)


def _parsed(path: str | Path, kind: str, parse: Callable[[str], Any]) -> Any:
    content = read_regular(path)
    try:
        return parse(content.decode("utf-8-sig"))
    except RecursionError:
        raise InputError(f"{path}: no valid {kind}: nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{path}: no valid {kind}: {error}") from error


def read_regular(path: str | Path) -> bytes:
    """Content of a file. Raises OSError; InputError for a device or pipe, which may never end."""
    with Path(path).open("rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise InputError(f"{path}: expected a regular file")
        return file.read()


def read_array(path: str | Path) -> "NDArray[Any]":
    """The array of a NumPy file (.npy), memory-mapped: a file that promises too much takes no
    memory.

    Raises OSError; InputError for another file, a damaged one, or one of Python objects.
    """
    import numpy as np

    with Path(path).open("rb") as file:
        if file.read(6) != b"\x93NUMPY":
            raise InputError(f"{path}: is no NumPy array (.npy)")
    try:
        array: NDArray[Any] = np.load(path, mmap_mode="r")
    except (ValueError, EOFError, OSError, TokenError, SyntaxError) as error:
        raise InputError(f"{path}: can't be read as a NumPy array ({error})") from error
    return array


def one_line(message: str) -> str:
    """A message on one line that a terminal can show, its middle cut where it is very long."""
    line = " ".join("".join(c if c.isprintable() else " " for c in message).split())
    if len(line) <= _MOST_LINE:
        return line
    return f"{line[: _MOST_LINE // 2]} ... {line[-_MOST_LINE // 2 :]}"


@contextmanager
def place_beside(path: str | Path) -> Iterator[Path]:
    """A place to write a file or a folder to, beside ``path``; what is still there at the end is
    removed.

    What killed processes of this machine left of the same path is removed too. An OSError that
    names no file, or this place, names ``path``.
    """
    path = Path(path)
    partial = partial_path(path)
    with naming(path):
        _remove_leftovers(path)
        try:
            yield partial
        except OSError as error:
            named, hidden = str(error.filename), str(partial)
            if error.errno is None or not named.startswith(hidden):
                raise
            place = f"{path}{named.removeprefix(hidden)}"
            raise OSError(error.errno, error.strerror, place) from error
        finally:
            with signals_deferred():
                _remove(partial)


def expect_writable(path: str | Path) -> None:
    """Raise an OSError that names the file where it most likely can't be written, before the work
    whose result it is to hold.
    """
    path = Path(path)
    place = path if path.exists() else path.parent
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not place.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    if not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """A `place_beside` that takes the name of ``path`` at the end, if nothing fails.

    A pipe or a device (`/dev/stdout`) is written to as it is: another file would take its place.
    """
    if Path(path).exists() and not Path(path).is_file():
        yield Path(path)
        return
    with place_beside(path) as partial:
        yield partial
        os.replace(partial, path)


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """OSErrors that name no file (a full disk's, met in a write) name this one."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def hold(file: IO[Any]) -> None:
    """Mark an open file as being written, for every process, until it is closed or this one ends.

    Where neither the system nor the file system knows locks it is not marked.
    """
    with suppress(ImportError, OSError):
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX)


def is_held(path: str | Path) -> bool:
    """Whether a file is marked by `hold`."""
    try:
        import fcntl

        with Path(path).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (ImportError, OSError):
        pass
    return False


def said(error: OSError) -> str:
    """An OSError in words: the file, and what is wrong with it."""
    if error.filename is None or error.strerror is None:
        return str(error)
    return f"{os.fsdecode(error.filename)}: {error.strerror}"


def partial_path(path: Path) -> Path:
    """Where this process writes a file or folder until it is whole."""
    return path.with_name(f".{path.name}.{_machine()}-{os.getpid()}.partial")


def _remove_leftovers(path: Path) -> None:
    """Remove what processes of this machine that run no more left at their `partial_path`."""
    ours = re.compile(re.escape(f".{path.name}.{_machine()}-") + r"(\d+)\.partial")
    for partial in path.parent.glob(f".{glob.escape(path.name)}.*.partial"):
        match = ours.fullmatch(partial.name)
        if match and not _runs(int(match[1])):
            _remove(partial)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _machine() -> str:
    """Process numbers mean something on one machine only, folders may be shared by several."""
    return re.sub(r"[^\w-]", "", platform.node())[:32] or "machine"


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # another user's
    return True
