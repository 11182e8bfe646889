"""Files and folders: where bundled data lies, and output that appears whole or not at all."""

import fcntl
import os
import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from twin.errors import InputError

__all__ = [
    "InputError",
    "catalog_folder",
    "check_out",
    "locked",
    "new_folder",
    "scenes_folder",
    "whole_folder",
]

_HERE = Path(__file__).parent


def scenes_folder() -> Path:
    """The bundled scenes: beside the package in a checkout, inside it when installed."""
    installed = _HERE / "scenes"
    return installed if installed.is_dir() else _HERE.parent / "scenes"


def catalog_folder() -> Path:
    """The bundled systems and parts."""
    return _HERE / "catalog"


def check_out(out: str | Path | None) -> None:
    """Raise InputError for a folder to write to that is named by an empty text; as a path, which is
    what a command gets, that is the current folder.
    """
    if isinstance(out, Path) and out == Path():
        raise InputError("out: is empty, or the current folder; expected another to write to")
    if out is not None and not str(out).strip():
        raise InputError("out: is empty, expected a folder to write to")


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A folder to write in, whose files move to ``out`` only when everything is written.

    On any failure, ctrl-C included, everything is as it was; what a kill leaves is removed by the
    next one. Files of an earlier run are replaced, other files stay. Raises InputError when ``out``
    can't be written.
    """
    from hardware.files import place_beside

    out = Path(out).absolute()
    created = [folder for folder in out.parents if not folder.exists()]
    try:
        if out.exists() and not (out.is_dir() and os.access(out, os.W_OK)):
            raise InputError(f"{out}: expected a folder that can be written to")
        with place_beside(out) as partial:
            try:
                partial.mkdir(parents=True)
            except OSError as error:
                raise InputError(f"{out}: can't be written to ({error.strerror})") from error
            yield partial
            written = list(partial.iterdir())
            for path in written:
                if (out / path.name).is_dir():
                    raise InputError(f"{out / path.name}: is a folder, expected a place for a file")
            out.mkdir(exist_ok=True)
            for path in written:
                os.replace(path, out / path.name)
    finally:
        for folder in created:
            with suppress(OSError):  # not empty: something was written
                folder.rmdir()


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder to write in that becomes ``out``, by one rename, when everything is written.

    ``out`` does not exist yet, or is empty. On any failure nothing of it is left; what a kill
    leaves is removed by the next one. Raises InputError when ``out`` can't be written.
    """
    from hardware.files import place_beside

    out = Path(out).absolute()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with place_beside(out) as partial:
            partial.mkdir()
            yield partial
            os.replace(partial, out)
    except OSError as error:
        raise InputError(f"{out}: {error.strerror or error}") from error


@contextmanager
def locked(out: Path, work: str) -> Iterator[None]:
    """A folder in which no other process does the same ``work`` meanwhile.

    The lock is on a file beside the folder, which need not exist yet, and ends with the process
    that holds it, however that ends. Raises InputError, which says who holds it (the package
    `filelock` does not know), where another does, and where ``out`` can't be written; OSError, with
    ``out``, where the disk is full. What a file system can't lock is used with a warning.
    """
    from hardware.files import naming

    out = Path(out).resolve()
    path = out.parent / f".{out.name}.lock"
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        file = _locked_file(path)
    except BlockingIOError as error:
        raise InputError(f"{out}: another {work} works in it ({error})") from error
    except OSError as error:
        if not out.is_dir():
            raise InputError(f"{out}: {error.strerror or error}") from error
        print(f"warning: {path}: no lock ({error.strerror}); run one {work} only", file=sys.stderr)
        yield
        return
    with file:
        try:
            now = time.strftime("%Y-%m-%d %H:%M:%S")
            holder = f"process {os.getpid()} on {platform.node()}, since {now}"
            with naming(out):
                os.write(file.fileno(), holder.encode())  # what a full disk leaves is not kept
            yield
        finally:
            path.unlink(missing_ok=True)  # still locked: who opened it meanwhile finds it gone


def _locked_file(path: Path) -> IO[str]:
    """A file, empty, that this process alone has locked.

    Raises BlockingIOError, with what stands in it, where another has; OSError where it can't be.
    """
    while True:
        file = path.open("a+", encoding="utf-8")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(path.stat(), os.fstat(file.fileno())):
                file.truncate(0)
                return file
            file.close()  # its holder has removed it, and another made it anew
        except FileNotFoundError:
            file.close()  # its holder has removed it
        except BlockingIOError:
            with file:
                file.seek(0)
                raise BlockingIOError(file.read() or "it has just begun") from None
        except OSError:
            file.close()
            raise
