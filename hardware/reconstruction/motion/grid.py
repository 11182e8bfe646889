"""The grid of what enters the field during a frame: wider than the image, finer than its cells."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Cells of the image, those around it that enter the field, and unknowns within each.

    Parameters
    ----------
    rows, columns
        Of the image.
    above, below, left, right
        Cells beyond it on each side.
    oversampling
        Unknowns along each side of a cell.
    """

    rows: int
    columns: int
    above: int
    below: int
    left: int
    right: int
    oversampling: int

    @classmethod
    def around(cls, shape: tuple[int, int], low: Array, high: Array, oversampling: int) -> "Grid":
        """Holding the cells whose centres lie from ``low`` (2,) to ``high`` (2,)."""
        before = np.maximum(-np.floor(low), 0).astype(int).tolist()
        after = np.maximum(np.ceil(high) - np.array(shape) + 1, 0).astype(int).tolist()
        return cls(*shape, before[0], after[0], before[1], after[1], oversampling)

    @property
    def shape(self) -> tuple[int, int]:
        """Unknowns down and along."""
        n = self.oversampling
        return (
            n * (self.rows + self.above + self.below),
            n * (self.columns + self.left + self.right),
        )

    def spectrum(self, exponent: float = 1.0) -> Array:
        """Eigenvalues of a prior of power spectrum 1/f^(2 exponent), that of `prior_spectrum` for
        exponent 1, the same for all at `_PIVOT`; 0 for the mean. Read only.
        """
        return _spectrum(self, exponent)

    def image(self, unknowns: Array) -> Array:
        """Cells (rows, columns) of the image at the reference time."""
        n, (down, along) = self.oversampling, self.shape
        cells = unknowns.reshape(down // n, n, along // n, n).mean(axis=(1, 3))
        return cells[
            self.above : self.above + self.rows, self.left : self.left + self.columns
        ].copy()

    def spread(self, cells: Array) -> Array:
        """Unknowns with the values of cells (rows, columns), those beyond as the nearest cell."""
        margins = ((self.above, self.below), (self.left, self.right))
        wide = np.pad(cells, margins, mode="edge")
        return wide.repeat(self.oversampling, 0).repeat(self.oversampling, 1)


#: Cycles per image at which priors of all exponents are alike.
_PIVOT = 8.0


@lru_cache(maxsize=16)
def _spectrum(grid: Grid, exponent: float) -> Array:
    down, along = grid.shape
    n = grid.oversampling
    f2 = (np.arange(down)[:, None] * (n * grid.rows / down)) ** 2 / 4
    f2 = f2 + (np.arange(along) * (n * grid.columns / along)) ** 2 / 4
    f2[0, 0] = np.inf
    spectrum = np.asarray(n**2 / f2)
    if exponent != 1:
        f2[0, 0] = 1.0
        spectrum *= (_PIVOT**2 / f2) ** (exponent - 1)
    spectrum.flags.writeable = False
    return spectrum
