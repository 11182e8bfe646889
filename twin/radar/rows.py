"""Products and lengths of vectors in rows of three, phasors, and rows that are alike, in less time
than NumPy takes for sums along so short an axis, exponentials of complex numbers and sorting rows;
and pairs of rows.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_MOST_KEYS = 2**62


def dots(one: Array, other: Array) -> Array:
    """Of vectors (n, 3) each, (n,)."""
    products: Array = np.einsum("ij,ij->i", one, other)
    return products


def lengths(vectors: Array) -> Array:
    """Of vectors (n, 3), (n,)."""
    return np.sqrt(dots(vectors, vectors))


def phasors(phase_rad: Array) -> Complex:
    """exp(j phase), of any shape."""
    turn = np.empty(phase_rad.shape, dtype=np.complex128)
    np.cos(phase_rad, out=turn.real)
    np.sin(phase_rad, out=turn.imag)
    return turn


def alike(columns: Sequence[NDArray[np.integer]]) -> Indices:
    """A number from 0 for each combination of values in columns, at least one, in their order,
    (n,).
    """
    key, keys = np.zeros(len(columns[0]), dtype=np.int64), 1
    for column in columns if len(key) else ():
        least = int(column.min())
        span = int(column.max()) - least + 1
        if keys * span > _MOST_KEYS:
            key = np.unique(key, return_inverse=True)[1]
            keys = int(key.max()) + 1
        key, keys = key * span + (column - least), keys * span
    return np.asarray(np.unique(key, return_inverse=True)[1], dtype=np.int64)


def first_rows(number: Indices) -> Indices:
    """The first row of each number from 0, all of which occur."""
    first = np.empty(int(number.max(initial=-1)) + 1, dtype=np.int64)
    first[number[::-1]] = np.arange(len(number))[::-1]
    return first


def matching_pairs(one: Indices, other: Indices) -> tuple[Indices, Indices]:
    """All pairs of rows with the same number."""
    order = np.argsort(other, kind="stable")
    first, last = (np.searchsorted(other[order], one, side=side) for side in ("left", "right"))
    count = last - first
    rows = np.repeat(np.arange(len(one)), count)
    begin = np.repeat(first - (np.cumsum(count) - count), count)
    return rows, order[begin + np.arange(len(rows))]
