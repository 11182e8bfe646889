"""Studies made in Python: objects and functions in them go by names, as a file's inputs do.

The study holds names, which its results are labelled with; the objects travel beside it, and count
by their content, as files do.
"""

import inspect
import re
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any

import numpy as np

from twin.digest import digest
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.run_folder import knob_words
from twin.scene import Scene
from twin.system import Part, System

_KINDS: dict[str, type] = {
    "scene": Scene,
    "system": System,
    "radar": RadarDesign,
    "part": Part,
    "fidelity": Fidelity,
}
#: Parameters whose values may be objects; those that end in ``.part`` may be parts.
_OF_PARAMETER = {name: name for name in ("scene", "system", "radar")} | {
    "fidelity.preset": "fidelity",
    "processing.method": "method",
    "processing.detection": "detection",
}
_FUNCTIONS = ("metric", "method", "detection")
_ROOTS = ("scene", "system", "radar")


def named(content: Mapping[str, Any]) -> dict[str, Any]:
    """What a study is made of, with names in place of objects, and these by ``KIND NAME`` as
    ``objects``; arrays and ranges of values as lists.
    """
    names = _Names(content)
    changed: dict[str, Any] = dict(content)
    for root in _ROOTS:
        if root in content:
            changed[root] = names.of(root, content[root])
    for field in ("metrics", "front"):
        if isinstance(content.get(field), list | tuple):
            changed[field] = tuple(names.of("metric", item) for item in content[field])
    if isinstance(content.get("set"), Mapping):
        changed["set"] = {n: names.of(_kind(n), value) for n, value in content["set"].items()}
    if isinstance(content.get("grid"), Mapping):
        changed["grid"] = names.of_columns(content["grid"])
    if isinstance(content.get("zip"), list | tuple):
        changed["zip"] = [names.of_columns(together) for together in content["zip"]]
    return {**changed, "objects": names.objects}


def object_digest(content: Any) -> str:
    """Digest of an object of a study; of a function that of its source and what it closes over.

    What has neither, such as a function of a compiled module, counts by how it shows itself.
    """
    if not callable(content):
        return digest(content)
    try:
        source = inspect.getsource(content)
    except (OSError, TypeError):
        source = repr(content)
    code = getattr(content, "__code__", None)
    cells = [cell.cell_contents for cell in getattr(content, "__closure__", None) or ()]
    told = [source, getattr(code, "co_code", b"").hex(), digest(cells)]
    return sha256("\n".join(told).encode()).hexdigest()


def _kind(parameter: str) -> str | None:
    return "part" if parameter.endswith(".part") else _OF_PARAMETER.get(parameter)


class _Names:
    """Gives each object a name of its own, which no input that is given by its name has."""

    def __init__(self, content: Mapping[str, Any]) -> None:
        self.objects: dict[str, Any] = {}
        self._texts = set(_texts(content))

    def of_columns(self, columns: Any) -> Any:
        if not isinstance(columns, Mapping):
            return columns
        return {name: self.of_column(_kind(name), values) for name, values in columns.items()}

    def of_column(self, kind: str | None, values: Any) -> Any:
        if isinstance(values, np.ndarray):
            return values.tolist()
        if isinstance(values, str) or not isinstance(values, Sequence):
            return values
        return [self.of(kind, value) for value in values]

    def of(self, kind: str | None, value: Any) -> Any:
        """A name for an object; everything else as it is."""
        if isinstance(value, np.generic):
            return value.item()
        is_function = kind in _FUNCTIONS and callable(value)
        if kind is None or not (is_function or isinstance(value, _KINDS.get(kind, ()))):
            return value
        for key, other in self.objects.items():
            if other is value and key.startswith(f"{kind} "):
                return key.partition(" ")[2]
        name = first = _name(value)
        number = 1
        while name in self._texts or f"{kind} {name}" in self.objects:
            number += 1
            name = f"{first}_{number}"
        self.objects[f"{kind} {name}"] = value
        return name


def _name(value: Any) -> str:
    """Of a function ``MODULE:NAME``, as a file would say it."""
    if isinstance(value, Fidelity):
        return "-".join(knob_words(value.said())) or "default tolerance"
    if not callable(value):
        return str(value.name)
    name = getattr(value, "__qualname__", type(value).__name__)
    return f"{value.__module__}:{re.sub(r'<locals>|[<>]', '', name).strip('.').replace('..', '.')}"


def _texts(content: Any) -> list[str]:
    if isinstance(content, str):
        return [content]
    if isinstance(content, Mapping):
        content = list(content.values())
    if isinstance(content, list | tuple):
        return [text for item in content for text in _texts(item)]
    return []
