"""Reconstruction, detection and metrics of a study: the vehicle's own, those of installed packages,
and a user's functions.
"""

import difflib
import importlib
import sys
from collections.abc import Callable, Iterable
from hashlib import sha256
from pathlib import Path
from typing import Any

from hardware.own_functions import OwnFunctionError, is_file_function, own_function
from hardware.radar.own_detection import OwnDetection, detection_of
from hardware.reconstruction import METHODS, Method, method_of
from hardware.reconstruction.registry import load_plugins
from twin.files import InputError
from twin.sweep.names import GROUP

#: Digest of each method's module when this process first asked: that is what it runs.
_running: dict[str, str] = {}


def own_method(name: str, folder: Path) -> tuple[str, Method]:
    """Digest and method of ``file.py:function``. Raises InputError for one that can't be found."""
    try:
        method = method_of(name, folder=folder)
    except InputError as error:
        raise InputError(f"processing.method: {error}") from error
    return method.name, method


def own_detection(name: str, folder: Path) -> tuple[str, OwnDetection]:
    """Digest and detection of ``file.py:function`` or an installed name. Raises InputError."""
    try:
        detection = detection_of(name, folder=folder)
    except OwnFunctionError as error:
        raise InputError(f"processing.detection: {error}") from error
    return detection.name, detection


def own_metric(name: str, folder: Path) -> tuple[str, Callable[..., float]]:
    """Digest and function of ``file.py:function``, of an installed name, or of ``MODULE:FUNCTION``,
    of a module beside the study or an installed one. Raises InputError for one that can't be found.
    """
    module, colon, function = name.rpartition(":")
    given: str | Callable[..., float] = name
    if colon and not is_file_function(name):
        given = f"{module}.py:{function}"
        if not (folder / f"{module}.py").is_file():
            given = _of_installed(module, function, name)
    try:
        own = own_function(given, ("outcome",), group=GROUP, folder=folder)
    except OwnFunctionError as error:
        raise InputError(f"metrics: {error}") from error
    return own.digest, own.function


def _of_installed(module: str, function: str, name: str) -> Callable[..., float]:
    try:
        found: Callable[..., float] = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"metrics: {name!r}: {error}, expected file.py:function") from error
    return found


def check_functions(methods: Iterable[Any], detections: Iterable[Any], folder: Path) -> None:
    """Raise InputError for a user's own function that can't be found."""
    for name in (text for text in map(str, methods) if ":" in text):
        own_method(name, folder)
    for name in filter(None, map(str, detections)):
        own_detection(name, folder)


def check_methods(names: Iterable[Any]) -> None:
    """Raise InputError, with the nearest name, for a method that does not exist; what has the form
    of a function, ``PLACE:FUNCTION``, is looked for when the sweep begins.
    """
    for name in names:
        if ":" in str(name):
            continue
        if name not in METHODS:
            load_plugins()
        if name not in METHODS:
            near = difflib.get_close_matches(str(name), METHODS, n=1)
            hint = f"did you mean {near[0]}?" if near else f"expected {', '.join(METHODS)}"
            raise InputError(f"processing.method = {name!r}: is unknown; {hint}")


def method_digest(name: str, folder: Path) -> str:
    """Digest of the source of a method's module. Raises InputError when that has changed since
    this process loaded it: a registered method can't be loaded twice.
    """
    if ":" in name:
        return own_method(name, folder)[0]
    check_methods([name])
    file = getattr(sys.modules[METHODS[name].solve.__module__], "__file__", None)
    found = sha256(Path(file).read_bytes()).hexdigest() if file else ""
    if _running.setdefault(name, found) != found:
        raise InputError(f"{file}: has changed since method {name!r} was loaded; start anew")
    return found
