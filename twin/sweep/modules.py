"""A user's own metrics: functions of modules beside the study, or of installed ones."""

import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from modulefinder import ModuleFinder
from pathlib import Path

from twin.files import InputError

#: What this process has imported: files of the module and of what it imports, with their digests.
_imported: dict[tuple[str, Path], dict[str, str]] = {}


def own_metric(name: str, folder: Path) -> tuple[str, Callable[..., float]]:
    """Digest and function of ``MODULE:FUNCTION``; a module beside the study goes before others.

    A module whose source has changed since this process imported it is imported anew, with what it
    imports from beside the study. Raises InputError for one that can't be found.
    """
    module, _, function = name.partition(":")
    try:
        files = _files(module, folder)
        sources = {key: sha256(path.read_bytes()).hexdigest() for key, path in files.items()}
        if _imported.get((module, folder)) != sources:
            _import(module, files, folder)
            _imported[module, folder] = sources
        own: Callable[..., float] = getattr(sys.modules[module], function)
    except (ImportError, AttributeError, SyntaxError, ValueError) as error:
        raise InputError(f"metrics: {name!r}: {error}") from error
    return sha256(repr(sorted(sources.items())).encode()).hexdigest(), own


def _files(module: str, folder: Path) -> dict[str, Path]:
    """Source files of a module by its dotted name, and of what it imports from beside the study."""
    finder = ModuleFinder(path=[str(folder)])
    with suppress(ImportError):
        finder.import_hook(module)
    found = {
        name: Path(file)
        for name, item in finder.modules.items()
        if (file := getattr(item, "__file__", None))
    }
    if module in found:
        return found
    spec = importlib.util.find_spec(module)
    if spec is None:
        raise ImportError(f"No module named {module!r}")
    return {module: Path(spec.origin)} if spec.origin and Path(spec.origin).is_file() else {}


def _import(module: str, files: dict[str, Path], folder: Path) -> None:
    before = {name: sys.modules.pop(name) for name in files if name in sys.modules}
    for path in files.values():
        with suppress(OSError):  # bytecode is told apart by seconds and size alone
            Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)
    importlib.invalidate_caches()
    with _path(folder):
        importlib.import_module(module)
    if str(folder) not in sys.path:
        sys.path.append(str(folder))  # for what a metric imports when it is called
    for name, other in before.items():
        if name != module and getattr(other, "__file__", None) != str(files[name]):
            sys.modules[name] = other  # of the same name, and somebody else's


@contextmanager
def _path(folder: Path) -> Iterator[None]:
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        with suppress(ValueError):
            sys.path.remove(str(folder))
