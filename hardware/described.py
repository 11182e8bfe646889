"""What `print` and a notebook show of a result: a line for each field, arrays by size and range."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

_WIDEST = 88
_FEW = 8  # items that are shown one by one
_MOST_LOOKED_AT = 100_000_000  # elements of an array whose range is told


class Described:
    """A dataclass (``repr=False``) that is shown by its fields, each on a line.

    >>> from dataclasses import dataclass
    >>> @dataclass(repr=False)
    ... class Taken(Described):
    ...     counts: np.ndarray
    ...     name: str
    >>> Taken(np.arange(4096).reshape(64, 64), "yard")
    Taken
      counts: int64 (64, 64), 0 to 4095
      name: yard
    """

    def __repr__(self) -> str:
        lines = [f"  {f.name}: {_shown(getattr(self, f.name))}" for f in fields(self)]  # type: ignore[arg-type]
        return "\n".join([type(self).__name__, *lines])


def _shown(value: Any) -> str:
    """On one line; of a value that cannot show itself its kind."""
    try:
        return _short(value)
    except Exception:  # whatever a user's own object does, the others are shown
        return type(value).__name__


def _short(value: Any) -> str:
    """On one line; whatever a value raises that shows itself goes on."""
    if isinstance(value, np.ndarray) and value.size > _FEW:
        return _of_array(value)
    if isinstance(value, Mapping):
        return _cut(f"{len(value)}: {', '.join(map(str, value))}" if value else "none")
    if isinstance(value, tuple | list) and (len(value) > _FEW or any(map(_is_large, value))):
        kinds = dict.fromkeys(type(item).__name__ for item in value)
        return f"{len(value)} of {', '.join(kinds)}"
    if isinstance(value, Described) or hasattr(type(value), "model_fields"):
        return f"{type(value).__name__} {getattr(value, 'name', '')}".rstrip()
    return _cut(str(value))


def _is_large(value: Any) -> bool:
    """Whether it has fields, and no text of its own."""
    is_model = is_dataclass(value) or hasattr(type(value), "model_fields")
    return is_model and (isinstance(value, Described) or len(str(value)) > _WIDEST)


def _of_array(array: np.ndarray[Any, Any]) -> str:
    text = f"{array.dtype} {array.shape}"
    if array.dtype.kind in "iuf" and array.size <= _MOST_LOOKED_AT:
        known = array[np.isfinite(array)]
        if known.size:
            least, most = known.min(), known.max()
            text += f", {least:.6g} to {most:.6g}" if least < most else f", all {most:.6g}"
        if known.size < array.size:
            text += f", {array.size - known.size} not finite"
    return text


def _cut(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
