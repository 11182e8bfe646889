"""A raster scan: one cell lit at a time, row by row, as a scanning LIDAR lights them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns.interface import Mode, Patterns, check_grid


@dataclass(frozen=True)
class RasterScan(Patterns):
    """Every cell of a virtual image lit alone, one after another, row by row.

    Parameters
    ----------
    rows, columns
        Cells of the virtual image; powers of two, as those of Hadamard patterns.
    mode
        ``plain``: one exposure a cell, from which nothing takes the background out but gates in
        which no echo falls. ``differential``: each lit exposure is followed by one in the dark.
    subset
        Cells by their index, row by row, in the order lit, where not all of them are.

    >>> scan = RasterScan(4, 4)
    >>> scan.count, scan.n_exposures, scan.masks().sum(axis=(1, 2)).tolist() == [1] * 16
    (16, 16, True)
    """

    rows: int
    columns: int
    mode: Mode = "plain"
    subset: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        check_grid(self.rows, self.columns)
        if self.mode not in ("plain", "differential"):
            raise InputError(f"mode: {self.mode!r}: a raster scan is plain or differential")
        if self.subset is None:
            return
        if not self.subset or len(set(self.subset)) != len(self.subset):
            raise InputError("subset: a cell stands in it twice, or none does")
        outside = [cell for cell in self.subset if not 0 <= cell < self.n_cells]
        if outside:
            raise InputError(f"subset: {outside[0]} is not between 0 and {self.n_cells - 1}")

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Kept, because caches ask for it at every frame."""
        return hash(("raster", self.rows, self.columns, self.mode, self.subset))

    @property
    def order(self) -> str:  # type: ignore[override]
        """Its name in records and settings."""
        return "raster"

    @property
    def count(self) -> int:  # type: ignore[override]
        """Cells that are lit."""
        return self.n_cells if self.subset is None else len(self.subset)

    @property
    def digest(self) -> str:
        """Of what the parameters do not say: nothing."""
        return ""

    @cached_property
    def cells(self) -> NDArray[np.intp]:
        """Cells in the order lit, ``(count,)``."""
        lit = np.arange(self.n_cells) if self.subset is None else np.array(self.subset, np.intp)
        lit.flags.writeable = False
        return lit

    @property
    def common_cells(self) -> NDArray[np.bool_]:
        """Cells on which all exposures agree: those never lit."""
        return self.unmeasured_cells

    @property
    def unmeasured_cells(self) -> NDArray[np.bool_]:
        """Cells that are never lit, ``(n_cells,)``."""
        unlit = np.ones(self.n_cells, np.bool_)
        unlit[self.cells] = False
        return unlit

    def take(self, places: NDArray[np.bool_]) -> "RasterScan":
        """The cells lit at these places, ``(count,)``, in the same order."""
        return RasterScan(self.rows, self.columns, self.mode, tuple(self.cells[places].tolist()))

    def signal(self, cells: NDArray[np.floating]) -> NDArray[np.float64]:
        """See `Patterns.signal`: the cell that is lit, or none."""
        t = np.asarray(cells, dtype=np.float64)
        if t.shape[0] != self.n_cells:
            raise InputError(f"cells: first axis is {t.shape[0]}, expected {self.n_cells}")
        lit = t[self.cells]
        if self.mode == "plain":
            return lit
        return np.stack([lit, np.zeros_like(lit)], axis=1).reshape(-1, *t.shape[1:])

    def masks(self, exposures: slice = slice(None)) -> NDArray[np.uint8]:
        """Patterns as shown, 1 lit and 0 dark, shape ``(n, rows, columns)``."""
        places = np.arange(self.n_exposures)[exposures]
        each = 2 if self.mode == "differential" else 1
        shown = np.zeros((len(places), self.n_cells), np.uint8)
        lit = places % each == 0
        shown[np.flatnonzero(lit), self.cells[places[lit] // each]] = 1
        return shown.reshape(-1, self.rows, self.columns)
