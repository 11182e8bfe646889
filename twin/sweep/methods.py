"""Reconstruction methods of a study: the vehicle's own, and those of installed packages."""

import difflib
import sys
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path
from typing import Any

from hardware.reconstruction import METHODS
from hardware.reconstruction.registry import load_plugins
from twin.files import InputError

#: Digest of each method's module when this process first asked: that is what it runs.
_running: dict[str, str] = {}


def check_methods(names: Iterable[Any]) -> None:
    """Raise InputError, with the nearest name, for a method that does not exist."""
    for name in names:
        if name not in METHODS:
            load_plugins()
        if name not in METHODS:
            near = difflib.get_close_matches(str(name), METHODS, n=1)
            hint = f"did you mean {near[0]}?" if near else f"expected {', '.join(METHODS)}"
            raise InputError(f"processing.method = {name!r}: is unknown; {hint}")


def method_digest(name: str) -> str:
    """SHA-256 of the source of a method's module. Raises InputError when that has changed since
    this process loaded it: a registered method can't be loaded twice.
    """
    check_methods([name])
    file = getattr(sys.modules[METHODS[name].solve.__module__], "__file__", None)
    found = sha256(Path(file).read_bytes()).hexdigest() if file else ""
    if _running.setdefault(name, found) != found:
        raise InputError(f"{file}: has changed since method {name!r} was loaded; start anew")
    return found
