"""Arrays that several readers share: none of them can change what the others see."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cached_property, wraps
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


def read_only(value: T) -> T:
    """The same; arrays in it, and in the fields and items of what it holds, can no longer be
    written to. Nothing is copied.
    """
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif is_dataclass(value):
        for field in fields(value):
            read_only(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for item in value:
            read_only(item)
    return value


def cached_read_only(function: Callable[[Any], T]) -> cached_property[T]:
    """A `functools.cached_property` of which `read_only` holds.

    >>> class Grid:
    ...     @cached_read_only
    ...     def range_m(self) -> np.ndarray:
    ...         return np.arange(3.0)
    >>> Grid().range_m[0] = 1.0
    Traceback (most recent call last):
    ValueError: assignment destination is read-only
    """

    @wraps(function)
    def made(owner: Any) -> T:
        return read_only(function(owner))

    return cached_property(made)
