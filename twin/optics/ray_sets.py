"""How many rays start in which cells of a grid, and in which of their strata."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.transfer import aligned

#: Of each ray its cell, and its point in the cell, across and up, each from 0 to 1.
Points = tuple[Any, Any, Any]


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

    def cells(self, columns: int) -> Any:
        """Cell of each ray."""
        mi = mitsuba()
        first = dr.opaque(mi.UInt32, self.first * columns)
        return (
            dr.arange(mi.UInt32, self.count(columns)) // dr.opaque(mi.UInt32, self.samples) + first
        )

    def instants(self) -> Any:
        """Number of each ray's instant; None where all rays are of one."""
        return None

    def streams(self) -> Any:
        """Of each ray its stream of random numbers; None: its place among the rays."""
        return None

    def points(self, rows: int, columns: int, rng: Any) -> Points:
        """Cells of the rays of a grid, and their points; without ``rng`` the middles of strata."""
        mi = mitsuba()
        wide, high = (dr.opaque(mi.UInt32, n) for n in strata(self.samples, rows / columns))
        index = dr.arange(mi.UInt32, self.count(columns))
        cell = index // (wide * high) + dr.opaque(mi.UInt32, self.first * columns)
        stratum = index % (wide * high)
        across, up = (0.5, 0.5) if rng is None else (rng.next_float32(), rng.next_float32())
        x = (mi.Float(stratum % wide) + across) / mi.Float(wide)
        return cell, x, (mi.Float(stratum // wide) + up) / mi.Float(high)


@dataclass(frozen=True, eq=False)
class CellRays:
    """Further rays of some cells, cell by cell: of each some sets, independent of each other.

    The points of a set are those of a (0, 2)-sequence in base 2 (Sobol), shifted at random digit by
    digit: any 2^k of them that begin at a multiple of 2^k lie one by one in all strata of equal
    area, the long ones as well as the square ones. The variance of a cell's mean falls as n^-1.5
    at oblique edges and as n^-2 at upright and level ones.

    Parameters
    ----------
    cell
        Indices of the cells, row by row, (n,).
    first, samples
        Number in the sequence of each cell's first ray, and rays of a set: (n,), or of each set
        (n, sets).
    sets
        Of each cell.
    shift
        Of the random numbers that shift the sequences.
    key
        Of all other random numbers.
    instant
        Number of the instant at which each cell is looked at, (n,). The same path of a cell then
        has the same random numbers at all instants.
    """

    cell: NDArray[np.integer]
    first: NDArray[np.integer]
    samples: NDArray[np.integer]
    sets: int
    shift: int
    key: tuple[int, ...]
    instant: NDArray[np.integer] | None = None

    @cached_property
    def set_starts(self) -> NDArray[np.int64]:
        """First ray of every set, (n x sets,)."""
        ends = np.cumsum(self._of_sets(self.samples))
        return np.concatenate([[0], ends[:-1]])

    def count(self, columns: int) -> int:
        """Number of rays."""
        return int(self._of_sets(self.samples).sum())

    def cells(self, columns: int) -> Any:
        """Cell of each ray of a grid of so many columns."""
        return self._own_set(self._owner_and_number[0])[0]

    def instants(self) -> Any:
        """Number of each ray's instant; None where all rays are of one."""
        if self.instant is None:
            return None
        mi, (owner, _) = mitsuba(), self._owner_and_number
        instant = mi.UInt32(aligned(self.instant.astype(np.uint32)))
        return mi.Float(dr.gather(mi.UInt32, instant, owner // self.sets))

    def streams(self) -> Any:
        """Of each ray its stream of random numbers; None: its place among the rays."""
        if self.instant is None:
            return None
        mi, (owner, number) = mitsuba(), self._owner_and_number
        # Scrambled: streams of numbers that differ by powers of 2 are alike.
        return mi.sample_tea_64(self._own_set(owner)[1], number)

    def points(self, rows: int, columns: int, rng: Any) -> Points:
        """Cells of the rays of a grid, and their points."""
        mi, (owner, number) = mitsuba(), self._owner_and_number
        cell, own_set = self._own_set(owner)
        across, up = mi.sample_tea_32(own_set, dr.opaque(mi.UInt32, self.shift))
        return cell, mi.radical_inverse_2(number, across), mi.sobol_2(number, up)

    @cached_property
    def _owner_and_number(self) -> tuple[Any, Any]:
        """Set to which each ray belongs, among all sets, and its number in the set's sequence."""
        mi, each = mitsuba(), self._of_sets(self.samples)
        owner = mi.UInt32(aligned(np.repeat(np.arange(len(each), dtype=np.uint32), each)))
        back = self._of_sets(self.first) - self.set_starts
        back = dr.gather(mi.UInt32, mi.UInt32(back.astype(np.uint32)), owner)
        return owner, dr.arange(mi.UInt32, dr.width(owner)) + back

    def _of_sets(self, values: NDArray[np.integer]) -> NDArray[np.integer]:
        """Of every set, (n x sets,)."""
        return np.broadcast_to(
            values.reshape(len(self.cell), -1), (len(self.cell), self.sets)
        ).ravel()

    def _own_set(self, owner: Any) -> tuple[Any, Any]:
        """Cell of a set, and its number among those of all cells of the grid."""
        mi = mitsuba()
        place = dr.gather(mi.UInt32, mi.UInt32(self.cell.astype(np.uint32)), owner // self.sets)
        return place, place * self.sets + owner % self.sets


Rays = RowRays | CellRays


def strata(samples: int, aspect: float) -> tuple[int, int]:
    """Number of strata across and up in a cell of ``aspect`` width over height: the factors of
    ``samples`` that make the strata most nearly square.
    """
    factors = [n for n in range(1, samples + 1) if samples % n == 0]
    across = min(factors, key=lambda n: abs(np.log(n * n / samples / aspect)))
    return across, samples // across


def strata_beside(count: int, samples: int, wide: int) -> Iterator[tuple[Any, Any]]:
    """Of each of ``count`` rays the ray of the stratum to its right, and of that below, and whether
    there is one in its cell; cells have ``samples`` rays each, ``wide`` in a row.
    """
    mi = mitsuba()
    ray = dr.arange(mi.UInt32, count)
    for step, borders in ((1, wide), (wide, samples)):
        step, borders = dr.opaque(mi.UInt32, step), dr.opaque(mi.UInt32, borders)
        yield ray + step, ray % borders + step < borders


def pairs_of_strata(samples: int, wide: int) -> int:
    """Number of pairs of strata side by side in a cell, 1 where there are none."""
    return max(2 * samples - wide - samples // wide, 1)
