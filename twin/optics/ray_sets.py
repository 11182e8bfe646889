"""How many rays start in which cells of a grid, and in which of their strata."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba

#: Of each ray its cell, its stratum, and the strata of the cell across and up.
Strata = tuple[Any, Any, Any, Any]


@dataclass(frozen=True)
class RowRays:
    """As many rays in every cell of some rows, cell by cell.

    Parameters
    ----------
    first, last
        Rows; the last one is excluded.
    samples
        Rays of a cell, stratified.
    """

    first: int
    last: int
    samples: int

    @property
    def key(self) -> tuple[int, ...]:
        """Of their random numbers."""
        return (self.first,)

    def count(self, columns: int) -> int:
        """Number of rays."""
        return (self.last - self.first) * columns * self.samples

    def strata(self, rows: int, columns: int) -> Strata:
        """Cells and strata of the rays of a grid."""
        mi = mitsuba()
        wide, high = (dr.opaque(mi.UInt32, n) for n in strata(self.samples, rows / columns))
        index = dr.arange(mi.UInt32, self.count(columns))
        cell = index // (wide * high) + dr.opaque(mi.UInt32, self.first * columns)
        return cell, index % (wide * high), wide, high


@dataclass(frozen=True, eq=False)
class CellRays:
    """Rays of some cells, cell by cell: of each some sets of stratified rays, independent of each
    other.

    Parameters
    ----------
    cells, samples
        Indices of the cells, row by row, and rays of a set in each, (n,).
    sets
        Of each cell.
    key
        Of their random numbers.
    """

    cells: NDArray[np.integer]
    samples: NDArray[np.integer]
    sets: int
    key: tuple[int, ...]

    @cached_property
    def set_starts(self) -> NDArray[np.int64]:
        """First ray of every set, (n x sets,)."""
        ends = np.cumsum(np.repeat(self.samples, self.sets))
        return np.concatenate([[0], ends[:-1]])

    def count(self, columns: int) -> int:
        """Number of rays."""
        return int(self.samples.sum()) * self.sets

    def strata(self, rows: int, columns: int) -> Strata:
        """Cells and strata of the rays of a grid."""
        mi = mitsuba()
        levels, level = np.unique(self.samples, return_inverse=True)
        shapes = np.array([strata(int(n), rows / columns) for n in levels])[level]
        table = np.column_stack([self.cells, self.samples, shapes]).astype(np.uint32)
        owner = mi.UInt32(
            np.repeat(np.arange(len(table), dtype=np.uint32), self.samples * self.sets)
        )
        cell, samples, wide, high = (
            dr.gather(mi.UInt32, mi.UInt32(np.ascontiguousarray(values)), owner)
            for values in table.T
        )
        # The kernel's unused lanes hold zeros, by which integers must not be divided.
        samples, wide = dr.maximum(samples, 1), dr.maximum(wide, 1)
        start = dr.gather(mi.UInt32, mi.UInt32(self.set_starts[:: self.sets]), owner)
        return cell, (dr.arange(mi.UInt32, dr.width(owner)) - start) % samples, wide, high


Rays = RowRays | CellRays


def strata(samples: int, aspect: float) -> tuple[int, int]:
    """Number of strata across and up in a cell of ``aspect`` width over height: the factors of
    ``samples`` that make the strata most nearly square.
    """
    factors = [n for n in range(1, samples + 1) if samples % n == 0]
    across = min(factors, key=lambda n: abs(np.log(n * n / samples / aspect)))
    return across, samples // across
