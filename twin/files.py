"""Files and folders: where bundled data lies, and output that appears whole or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_HERE = Path(__file__).parent


class InputError(ValueError):
    """What the user gave is wrong; the message names the file, the field and what was expected."""


def scenes_folder() -> Path:
    """The bundled scenes: beside the package in a checkout, inside it when installed."""
    installed = _HERE / "scenes"
    return installed if installed.is_dir() else _HERE.parent / "scenes"


def catalog_folder() -> Path:
    """The bundled systems and parts."""
    return _HERE / "catalog"


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A folder to write in, whose files move to ``out`` only when everything is written.

    On any failure, ctrl-C included, everything is as it was; what a kill leaves is removed by the
    next one. Files of an earlier run are replaced, other files stay. Raises InputError when ``out``
    can't be written.
    """
    from hardware.files import naming, partial_path, remove_leftovers

    out = Path(out).absolute()
    partial = partial_path(out)
    created = [folder for folder in out.parents if not folder.exists()]
    try:
        if out.exists() and not (out.is_dir() and os.access(out, os.W_OK)):
            raise InputError(f"{out}: expected a folder that can be written to")
        remove_leftovers(out)
        try:
            partial.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"{out}: can't be written to ({error.strerror})") from error
        with naming(out):
            yield partial
        written = list(partial.iterdir())
        for path in written:
            if (out / path.name).is_dir():
                raise InputError(f"{out / path.name}: is a folder, expected a place for a file")
        out.mkdir(exist_ok=True)
        for path in written:
            os.replace(path, out / path.name)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        for folder in created:
            with suppress(OSError):  # not empty: something was written
                folder.rmdir()


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A folder to write in that becomes ``out``, by one rename, when everything is written.

    ``out`` does not exist yet, or is empty. On any failure nothing of it is left; what a kill
    leaves is removed by the next one. Raises InputError when ``out`` can't be written.
    """
    from hardware.files import partial_path, remove_leftovers

    out = Path(out).absolute()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(out)
        partial = partial_path(out)
        partial.mkdir()
        try:
            yield partial
            os.replace(partial, out)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{out}: {error.strerror or error}") from error
