"""Hadamard pattern sets: which patterns are shown, in which order, and their fast transform.

A virtual image of ``rows x columns`` cells (both powers of two) is flattened row by row. Its
patterns are rows of the Sylvester matrix H = H_rows (x) H_columns, entries +1 and -1, which a
projector shows as 1 (lit) and 0 (dark).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Order = Literal["natural", "sequency"]
Mode = Literal["differential", "plain"]


@dataclass(frozen=True)
class PatternSet:
    """A set of Hadamard patterns, by name and parameters.

    Parameters
    ----------
    rows, columns
        Cells of the virtual image; powers of two.
    count
        Number of Hadamard rows shown, 1 to ``rows * columns``.
    order
        ``sequency``: ascending sum of the sign changes along rows and along columns, ties by
        index, so that the first patterns carry most of a natural image. ``natural``: Sylvester's
        own order.
    mode
        ``differential``: each pattern is followed by its complement, and their difference is the
        measurement. ``plain``: the lit pattern alone.
    """

    rows: int
    columns: int
    count: int
    order: Order = "sequency"
    mode: Mode = "differential"

    def __post_init__(self) -> None:
        for name in ("rows", "columns"):
            size = getattr(self, name)
            if size < 1 or size & (size - 1):
                raise ValueError(f"{name}: {size} is not a power of two")
        if not 1 <= self.count <= self.n_cells:
            raise ValueError(f"count: {self.count} is not between 1 and {self.n_cells}")
        if self.order not in get_args(Order):
            raise ValueError(f"order: {self.order!r} is none of {', '.join(get_args(Order))}")
        if self.mode not in get_args(Mode):
            raise ValueError(f"mode: {self.mode!r} is none of {', '.join(get_args(Mode))}")

    @property
    def n_cells(self) -> int:
        """Cells of the virtual image."""
        return self.rows * self.columns

    @property
    def n_exposures(self) -> int:
        """Patterns shown one after another: two per Hadamard row when differential."""
        return self.count * (2 if self.mode == "differential" else 1)

    @property
    def indices(self) -> NDArray[np.intp]:
        """Rows of the natural-order Hadamard matrix that are shown, shape ``(count,)``."""
        return _ordered_indices(self.rows, self.columns, self.order)[: self.count]

    def signal(self, cells: NDArray[np.floating]) -> NDArray[np.float64]:
        """Sum of the lit cells for every exposure, without forming a matrix.

        Parameters
        ----------
        cells : (n_cells, ...) array
            What each cell contributes when lit; any unit.

        Returns
        -------
        (n_exposures, ...) array of the same unit. With H t from one fast transform, pattern and
        complement are (sum(t) +/- H t) / 2.
        """
        t = np.asarray(cells, dtype=np.float64)
        if t.shape[0] != self.n_cells:
            raise ValueError(f"cells: first axis is {t.shape[0]}, expected {self.n_cells}")
        projected = fwht(t)[self.indices]
        total = t.sum(axis=0)
        lit = (total + projected) / 2
        if self.mode == "plain":
            return lit
        return np.stack([lit, (total - projected) / 2], axis=1).reshape(-1, *t.shape[1:])

    def masks(self, exposures: slice = slice(None)) -> NDArray[np.uint8]:
        """Patterns as shown, 1 lit and 0 dark, shape ``(n, rows, columns)``."""
        wanted = np.arange(self.n_exposures)[exposures]
        step = 2 if self.mode == "differential" else 1
        positive = hadamard_rows(self.indices[wanted // step], self.n_cells) > 0
        complement = (wanted % step).astype(bool)[:, None]
        return (positive ^ complement).astype(np.uint8).reshape(-1, self.rows, self.columns)


def fwht(values: NDArray[np.floating] | NDArray[np.integer]) -> NDArray[np.float64]:
    """Walsh-Hadamard transform H x along the first axis, natural order, unnormalised.

    Additions only, in float64: exact for integers as long as sums stay below 2**53. Applied twice
    it returns n x. Raises ValueError unless the first axis is a power of two.
    """
    x = np.array(values, dtype=np.float64)
    n = x.shape[0]
    if n < 1 or n & (n - 1):
        raise ValueError(f"length {n} is not a power of two")
    half = 1
    while half < n:
        pairs = x.reshape(n // (2 * half), 2, half, *x.shape[1:])
        upper = pairs[:, 0].copy()
        pairs[:, 0] += pairs[:, 1]
        np.subtract(upper, pairs[:, 1], out=pairs[:, 1])
        half *= 2
    return x


def hadamard_rows(indices: NDArray[np.integer], n_cells: int) -> NDArray[np.int8]:
    """Rows of the natural-order Hadamard matrix, +1 and -1, shape ``(len(indices), n_cells)``.

    H[i, j] = (-1)^popcount(i & j).
    """
    i = np.asarray(indices, dtype=np.uint64)[:, None]
    parity = np.bitwise_count(i & np.arange(n_cells, dtype=np.uint64)) & 1
    return (1 - 2 * parity.astype(np.int8)).astype(np.int8)


@lru_cache(maxsize=32)
def _ordered_indices(rows: int, columns: int, order: Order) -> NDArray[np.intp]:
    index = np.arange(rows * columns)
    if order == "sequency":
        changes = _sign_changes(rows)[index // columns] + _sign_changes(columns)[index % columns]
        index = np.argsort(changes, kind="stable")
    index.flags.writeable = False
    return index


def _sign_changes(n: int) -> NDArray[np.int64]:
    """Sign changes along each row of the natural-order n x n Hadamard matrix."""
    rows = hadamard_rows(np.arange(n), n)
    return np.count_nonzero(np.diff(rows, axis=1), axis=1)
