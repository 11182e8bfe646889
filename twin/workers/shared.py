"""What much work needs, once in each process."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from typing import Any, Self


@dataclass(frozen=True)
class Shared:
    """A value that much work needs, as the bytes of its pickle, and their digest.

    The bytes travel with each piece of work. Had they been sent once, work that is waiting would be
    lost with the last process that holds them, and a process that comes later would lack them.
    A process unpickles them once: what is found of the value, and kept by its identity, serves all
    its pieces.
    """

    digest: bytes
    pickled: bytes = field(compare=False, repr=False)

    @classmethod
    def of(cls, value: Any) -> Self:
        """Of a value, pickled as Dask pickles arguments."""
        from distributed.protocol.pickle import dumps

        pickled = dumps(value)
        return cls(blake2b(pickled).digest(), pickled)


@lru_cache(maxsize=1)
def _value_of(shared: Shared) -> Any:
    return pickle.loads(shared.pickled)


def with_values(work: Callable[..., Any], args: tuple[Any, ...]) -> Any:
    """Work done, with the values of what is shared."""
    return work(*(_value_of(arg) if isinstance(arg, Shared) else arg for arg in args))
