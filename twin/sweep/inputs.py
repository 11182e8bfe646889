"""What points depend on beside the study itself: scenes, designs, files, own code, by content.

A study names its inputs; what it computes from them is held by the digest of their content. So a
result is of one content only, in a folder that is resumed, and in a worker that lives long.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from cachetools import LRUCache

import hardware
import twin
from hardware.own_functions import digest_of_given, is_file_function
from twin.digest import digest, file_digest, source_digest
from twin.files import InputError
from twin.radar.device.design import load_radar
from twin.scene import load_scene
from twin.sweep.methods import method_digest, own_detection, own_method, own_metric
from twin.sweep.names import is_own, needs_radar
from twin.sweep.objects import object_digest
from twin.sweep.study import Study
from twin.system import load_part, load_system
from twin.toml import placed

T = TypeVar("T")

#: Rooms of the twin that no point goes through.
_OUTSIDE = ("cli.py", "commands", "regression", "report", "serve", "trade")
_SOURCE = "source of twin and hardware"


class Held:
    """The last few results by key, and how many were made."""

    def __init__(self, most: int) -> None:
        self._items: LRUCache[Any, Any] = LRUCache(most)
        self.made = 0

    def get(self, key: Any, make: Callable[[], T]) -> T:
        """The result of this key, made where there is none."""
        if key not in self._items:
            self._items[key] = make()
            self.made += 1
        found: T = self._items[key]
        return found


_loaded: LRUCache[tuple[str, str, Path], tuple[str, Any]] = LRUCache(64)


@dataclass(frozen=True)
class Inputs:
    """Digests of a study's inputs, by kind and name: ``scene yard``, ``system mine.toml``.

    Travels with every task; a worker reads each input itself, and holds it against its digest.
    ``objects`` are inputs of a study that was made in Python, at hand already.
    """

    folder: Path
    digests: Mapping[str, str]
    objects: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def stamp(self) -> str:
        """One digest of them all: the key of whatever is computed from them."""
        return digest(self.digests)

    def get(self, kind: str, name: str) -> Any:
        """An input as it was when the sweep began.

        Raises InputError where it can't be read, or is another one by now.
        """
        if f"{kind} {name}" in self.objects:
            return self.objects[f"{kind} {name}"]
        expected = self.digests[f"{kind} {name}"]
        found, content = _loaded.get((kind, name, self.folder), ("", None))
        if found != expected:
            found, content = _load(kind, name, self.folder)
        if found != expected:
            raise ChangedError(
                f"{kind} {name}: has changed since this sweep began, or is another one on this "
                "worker; expected the same everywhere, throughout"
            )
        if isinstance(content, InputError):
            raise content
        return content

    def check(self) -> None:
        """Raise `ChangedError` where an input is not, or no longer, what it was: files of curves
        are read while points are computed, so this is asked afterwards.
        """
        for key, expected in self.digests.items():
            kind, _, name = key.partition(" ")
            if key == _SOURCE:
                if _source() != expected:
                    raise ChangedError(f"{_SOURCE}: is another one on this worker; start it anew")
            elif kind == "method" and key not in self.objects:
                if method_digest(name, self.folder) != expected:
                    raise ChangedError(f"{key}: is another one on this worker; start it anew")
            elif kind in ("system", "radar", "part", "file"):
                held, content = _loaded.get((kind, name, self.folder), ("", None))
                if key in self.objects:
                    held, content = expected, self.objects[key]
                if held == expected and _digest(content) != expected:
                    raise ChangedError(f"{key}: a file of it has changed since this sweep began")


class ChangedError(InputError):
    """An input is not what it was when the sweep began."""


def inputs_of(study: Study) -> Inputs:
    """Inputs of a study as they are now, read anew."""
    digests = {_SOURCE: _source()} | {k: object_digest(v) for k, v in study.objects.items()}
    for kind, name in _named(study):
        if (key := f"{kind} {name}") not in digests:
            digests[key] = digest_now(kind, name, study.folder)
    return Inputs(study.folder, digests, study.objects)


def digest_now(kind: str, name: str, folder: Path) -> str:
    """Digest of an input as it is now, read anew; of what can't be read, of the error."""
    return (
        method_digest(name, folder)
        if kind == "method" and ":" not in name
        else _load(kind, name, folder)[0]
    )


def _named(study: Study) -> Iterator[tuple[str, str]]:
    """Every input by kind and name."""
    rendered = study.model == "rendered"
    roots = {"system": study.system}
    if rendered:
        roots["scene"] = study.scene
    if needs_radar(study.metrics):
        roots["radar"] = study.radar
    for root, base in roots.items():
        for name in dict.fromkeys([base, *study.values_of(root)]):
            yield root, str(name)
    for parameter in study.parameters:
        for kind, end in _OF_END:
            if parameter.endswith(end):
                for name in dict.fromkeys(study.values_of(parameter)):
                    if end != "fidelity.radar" or is_file_function(str(name)):
                        yield kind, str(name)
    if rendered:
        for name in dict.fromkeys(study.values_of("processing.method")):
            yield "method", str(name)
        for own in filter(None, dict.fromkeys(study.values_of("processing.detection"))):
            yield "detection", str(own)
        for name in filter(is_own, study.metrics):
            yield "metric", name


#: Kind of input that a parameter names, by its end.
_OF_END = (
    ("part", ".part"),
    ("file", "_csv"),
    ("file", "_file"),
    ("file", ".patterns"),
    ("function", ".function"),
    ("function", "fidelity.radar"),
)


def beside(name: str, folder: Path) -> str | Path:
    """A file or folder beside the study where there is one, else the name as it stands."""
    return folder / name if name and (folder / name).exists() else name


def _load(kind: str, name: str, folder: Path) -> tuple[str, Any]:
    """Digest and content; of what can't be read the InputError that says so."""
    try:
        content = _READERS[kind](name, folder)
        found, content = content if kind in _FUNCTIONS else (_digest(content), content)
    except (InputError, OSError) as error:
        content = error if isinstance(error, InputError) else InputError(str(error))
        found = _digest(content)
    _loaded[kind, name, folder] = found, content
    return found, content


def _function(name: str, folder: Path) -> tuple[str, str]:
    """Digest and place of code that a system names."""
    place = placed("function", name, folder)
    return digest_of_given(place), place


#: Kinds that are read with their digest.
_FUNCTIONS = ("metric", "method", "detection", "function")
_READERS: dict[str, Callable[[str, Path], Any]] = {
    "scene": lambda name, folder: load_scene(beside(name, folder)),
    "system": lambda name, folder: load_system(beside(name, folder)),
    "radar": lambda name, folder: load_radar(beside(name, folder)),
    "part": lambda name, folder: load_part(str(beside(name, folder))),
    "file": lambda name, folder: Path(beside(name, folder)),
    "metric": own_metric,
    "method": own_method,
    "detection": own_detection,
    "function": _function,
}


def _digest(content: Any) -> str:
    """Of what was read; files of curves and patterns are read now."""
    if isinstance(content, InputError):
        return digest(str(content))
    if isinstance(content, Path):
        return file_digest(content)
    return digest(content)


def _source() -> str:
    root = Path(twin.__file__).parent
    outside = tuple(root / name for name in _OUTSIDE)
    return source_digest(root, Path(hardware.__file__).parent, without=outside)
