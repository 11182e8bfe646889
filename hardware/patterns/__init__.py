"""Hadamard pattern sets: which patterns are shown, in which order, and their fast transform.

A user's own sets stand beside them (`hardware.patterns.own`), and the scan of one cell after
another (`hardware.patterns.raster`).

A virtual image of ``rows x columns`` cells (both powers of two) is flattened row by row. Its
patterns are rows of the Sylvester matrix H = H_rows (x) H_columns, entries +1 and -1, which a
projector shows as 1 (lit) and 0 (dark).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, is_whole
from hardware.patterns.interface import Mode, Patterns, check_grid
from hardware.patterns.orders import ORDERS, ordered_indices, shown_indices
from hardware.patterns.own import OwnPatterns, own_patterns
from hardware.patterns.raster import RasterScan
from hardware.patterns.transform import fwht, fwht_in_place, hadamard_rows
from hardware.read_only import cached_read_only

__all__ = [
    "ORDERS",
    "Mode",
    "Order",
    "OwnPatterns",
    "PatternSet",
    "Patterns",
    "RasterScan",
    "fwht",
    "fwht_in_place",
    "hadamard_rows",
    "ordered_indices",
    "own_patterns",
]

Order = Literal[
    "natural",
    "sequency",
    "sequency-max",
    "walsh",
    "zigzag",
    "cake-cutting",
    "russian-dolls",
    "total-variation",
    "prior-variance",
    "interleaved",
    "custom",
]


@dataclass(frozen=True)
class PatternSet(Patterns):
    """A set of Hadamard patterns, by name and parameters.

    Parameters
    ----------
    rows
        Rows of cells of the virtual image, a power of two.
    columns
        Columns of cells, a power of two.
    count
        Number of Hadamard rows shown, 1 to ``rows * columns``.
    order
        One of `ORDERS`, of which the first ``count`` rows are shown, or ``custom``: ``subset``.
        ``sequency``: ascending sum of the sign changes along rows and along columns, ties by
        index, so that the first patterns carry most of a natural image. ``natural``: Sylvester's
        own order. ``interleaved``: the first ``count`` rows of sequency, low and high in turn, for
        scenes that move.
    mode
        How a row of +1 and -1 becomes light.
        ``differential``: each pattern is followed by its complement, and their difference is the
        measurement. ``plain``: the lit pattern alone. ``reference``: all cells lit and all dark
        once, then the lit patterns. ``s-matrix``: the cells where the row is -1, so that one cell
        is never lit and row 0 is the dark frame. ``complementary``: the lit pattern, while a
        second detector sees its complement (both sides of a micro-mirror).
    subset
        With order ``custom``: rows of the natural-order matrix, in the order shown.

    >>> patterns = PatternSet(rows=8, columns=8, count=16)
    >>> patterns.n_cells, patterns.n_exposures  # every pattern, and its complement
    (64, 32)
    """

    rows: int
    columns: int
    count: int
    order: Order = "sequency"
    mode: Mode = "differential"
    subset: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        check_grid(self.rows, self.columns)
        if not is_whole(self.count) or not 1 <= self.count <= self.n_cells:
            raise InputError(
                f"count: {self.count!r:.60} is not a whole number between 1 and {self.n_cells}"
            )
        if self.order not in get_args(Order):
            raise InputError(f"order: {self.order!r} is none of {', '.join(get_args(Order))}")
        if self.mode not in get_args(Mode):
            raise InputError(f"mode: {self.mode!r} is none of {', '.join(get_args(Mode))}")
        if self.order == "custom" and self.subset is None:
            raise InputError("subset: missing, order 'custom' needs the rows that are shown")
        if self.order != "custom" and self.subset is not None:
            raise InputError(f"subset: belongs to order 'custom', but the order is {self.order!r}")
        if self.subset is not None:
            self._check_subset(self.subset)
        if self.mode == "s-matrix" and 0 not in self.indices:
            raise InputError("mode: 's-matrix' needs row 0, its dark frame, among the patterns")

    def _check_subset(self, subset: tuple[int, ...]) -> None:
        if len(subset) != self.count:
            raise InputError(f"subset: {len(subset)} rows, expected {self.count}")
        if len(set(subset)) != len(subset):
            raise InputError("subset: a row stands in it twice")
        outside = [row for row in subset if not 0 <= row < self.n_cells]
        if outside:
            raise InputError(f"subset: {outside[0]} is not between 0 and {self.n_cells - 1}")

    @classmethod
    def of(
        cls, rows: int, columns: int, indices: Sequence[int], mode: Mode = "differential"
    ) -> "PatternSet":
        """Any rows of the natural-order matrix, in the order given.

        Raises InputError for what is no whole number, and for what `PatternSet` refuses.
        """
        rows_shown = np.asarray(indices)
        if rows_shown.size and rows_shown.dtype.kind not in "iu":
            raise InputError(f"indices: {rows_shown.dtype}, expected whole numbers")
        subset = tuple(int(row) for row in rows_shown)
        return cls(rows, columns, len(subset), "custom", mode, subset)

    @property
    def digest(self) -> str:
        """Of what the parameters do not say: nothing."""
        return ""

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Kept, because caches ask for it at every frame."""
        fields = (self.rows, self.columns, self.count, self.order, self.mode, self.subset)
        return hash(fields)

    @cached_property
    def indices(self) -> NDArray[np.intp]:
        """Rows of the natural-order Hadamard matrix that are shown, shape ``(count,)``."""
        if self.subset is not None:
            index = np.array(self.subset, dtype=np.intp)
            index.flags.writeable = False
            return index
        return shown_indices(self.rows, self.columns, self.order, self.count)

    def take(self, places: NDArray[np.bool_]) -> "PatternSet":
        """The patterns at these places, ``(count,)``, in the order shown."""
        return PatternSet.of(self.rows, self.columns, self.indices[places].tolist(), self.mode)

    @cached_read_only
    def common_cells(self) -> NDArray[np.bool_]:
        """Cells on which all patterns agree: lit in each, or (S-matrix) in none; ``(n_cells,)``.

        Of a full set this is the first cell alone. Their light is one constant in all exposures,
        as the background is.
        """
        shown = np.zeros(self.n_cells)
        shown[self.indices] = 1.0
        return np.asarray(fwht_in_place(shown) == self.count)

    @property
    def unmeasured_cells(self) -> NDArray[np.bool_]:
        """Cells of which the exposures tell nothing, ``(n_cells,)``: the `common_cells` of a plain
        set, which cannot be told from the background, and of an S-matrix, which are never lit.
        """
        if self.mode in ("plain", "s-matrix"):
            return self.common_cells
        return np.zeros(self.n_cells, np.bool_)

    @property
    def exposures(self) -> tuple[NDArray[np.intp], NDArray[np.int8]]:
        """Hadamard row and sign of each exposure: lit are the cells where sign x row is +1."""
        plus = np.ones(self.count, np.int8)
        if self.mode == "differential":
            return np.repeat(self.indices, 2), np.stack([plus, -plus], axis=1).ravel()
        if self.mode == "reference":
            signs = np.concatenate([np.array([1, -1], np.int8), plus])
            return np.concatenate([[0, 0], self.indices]), signs
        return self.indices, -plus if self.mode == "s-matrix" else plus

    def signal(self, cells: NDArray[np.floating]) -> NDArray[np.float64]:
        """See `Patterns.signal`; no matrix is formed: with H t from one fast transform, pattern and
        complement are (sum(t) +/- H t) / 2.
        """
        t = np.asarray(cells, dtype=np.float64)
        if t.shape[0] != self.n_cells:
            raise InputError(f"cells: first axis is {t.shape[0]}, expected {self.n_cells}")
        rows, signs = self.exposures
        total = t.sum(axis=0)
        projected = fwht(t)[rows] * signs.reshape(-1, *(1,) * (t.ndim - 1))
        lit = (total + projected) / 2
        if self.n_arms == 1:
            return lit
        complement = (total - projected) / 2
        return np.hstack([lit.reshape(self.count, -1), complement.reshape(self.count, -1)])

    def masks(self, exposures: slice = slice(None)) -> NDArray[np.uint8]:
        """Patterns as shown, 1 lit and 0 dark, shape ``(n, rows, columns)``."""
        rows, signs = (part[exposures] for part in self.exposures)
        lit = hadamard_rows(rows, self.n_cells) * signs[:, None] > 0
        return lit.astype(np.uint8).reshape(-1, self.rows, self.columns)
