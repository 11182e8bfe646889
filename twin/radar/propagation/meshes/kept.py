"""What was found out about objects, kept for as long as they live."""

from collections.abc import Hashable, Sequence
from typing import Any, Generic, TypeVar
from weakref import ref

Value = TypeVar("Value")


class Kept(Generic[Value]):
    """Values by the identity of one or more objects, and by further keys.

    A value goes when one of its objects does, and not before: a scene may hold any number of them.
    The value itself must not refer to them.
    """

    def __init__(self) -> None:
        self._held: dict[tuple[Hashable, ...], tuple[list[ref[Any]], Value]] = {}

    def __len__(self) -> int:
        return len(self._held)

    def get(self, objects: Sequence[Any], *more: Hashable) -> Value | None:
        """The value kept for these very objects, or None."""
        held = self._held.get((*map(id, objects), *more))
        return None if held is None else held[1]

    def put(self, value: Value, objects: Sequence[Any], *more: Hashable) -> Value:
        """Keep a value, and return it."""
        key = (*map(id, objects), *more)
        held = self._held

        def forget(_: ref[Any]) -> None:
            held.pop(key, None)

        held[key] = [ref(thing, forget) for thing in objects], value
        return value
