"""The linear map from an image to its measurements: H x, or H M x with a calibrated mixing M."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import PatternSet, fwht_in_place, hadamard_rows

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mixing:
    """What each emitter element lights, as calibrated: no clean grid of cells.

    Parameters
    ----------
    matrix : (n_emitters, n_cells) array
        Share of each image cell that an emitter element lights; the identity is a clean grid.
        LEDs without a lens, unequal LEDs and blur are all rows of it. With detector j's response
        in it, its cells are what that detector receives.
    rows, columns
        Of the image; ``rows * columns`` is ``n_cells`` and need not be a power of two.
    """

    matrix: Array
    rows: int
    columns: int

    def __post_init__(self) -> None:
        if self.matrix.ndim != 2 or self.matrix.shape[1] != self.rows * self.columns:
            raise InputError(
                f"mixing: shape {self.matrix.shape}, expected (n_emitters, "
                f"{self.rows} * {self.columns})"
            )
        if not np.isfinite(self.matrix).all():
            raise InputError("mixing: holds what is not a number")


@dataclass(frozen=True)
class Sensing:
    """Which combinations of an image's cells are measured.

    Applies to arrays ``(n_cells, ...)`` without forming a matrix, unless there is a mixing.
    """

    patterns: PatternSet
    mixing: Mixing | None = None

    def __post_init__(self) -> None:
        if self.mixing and len(self.mixing.matrix) != self.patterns.n_cells:
            raise InputError(
                f"mixing: {len(self.mixing.matrix)} emitters, the patterns have "
                f"{self.patterns.n_cells}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        grid = self.mixing or self.patterns
        return grid.rows, grid.columns

    @property
    def n_cells(self) -> int:
        """Cells of the image."""
        return self.shape[0] * self.shape[1]

    @property
    def count(self) -> int:
        """Measurements."""
        return self.patterns.count

    def forward(self, cells: Array) -> Array:
        """Noise-free measurements ``(count, ...)`` of cells ``(n_cells, ...)``."""
        if self.mixing:
            return np.asarray(np.tensordot(self._mixed, cells, 1))
        x = np.array(cells, dtype=np.float64, order="C")
        return np.asarray(fwht_in_place(x)[self.patterns.indices])

    def adjoint(self, values: Array) -> Array:
        """Transpose of `forward`: ``(count, ...)`` to ``(n_cells, ...)``."""
        if self.mixing:
            return np.asarray(np.tensordot(self._mixed.T, values, 1))
        coefficients = np.zeros((self.n_cells, *values.shape[1:]))
        coefficients[self.patterns.indices] = values
        return fwht_in_place(coefficients)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Cells of which the measurements tell anything, ``(n_cells,)``."""
        return _measured(self)

    @property
    def measures_level(self) -> bool:
        """Whether any measurement depends on a constant added to all cells: of Hadamard rows only
        row 0 does, all cells lit.
        """
        return _measures_level(self)

    @property
    def matrix(self) -> Array:
        """The dense matrix ``(count, n_cells)``."""
        if self.mixing:
            return self._mixed
        return hadamard_rows(self.patterns.indices, self.n_cells).astype(np.float64)

    @cached_property
    def largest_squared(self) -> float:
        """Largest eigenvalue of A^T A: n for Hadamard rows."""
        if self.mixing is None:
            return float(self.n_cells)
        return float(np.linalg.norm(self._mixed, 2) ** 2)

    @cached_property
    def _mixed(self) -> Array:
        assert self.mixing is not None
        return fwht_in_place(np.array(self.mixing.matrix, np.float64, order="C"))[
            self.patterns.indices
        ]


@lru_cache(maxsize=16)
def _measured(sensing: Sensing) -> NDArray[np.bool_]:
    told = ~sensing.patterns.unmeasured_cells
    if sensing.mixing:
        told = (sensing.mixing.matrix[told] != 0).any(axis=0)
    told.flags.writeable = False
    return told


@lru_cache(maxsize=16)
def _measures_level(sensing: Sensing) -> bool:
    if sensing.mixing is None:
        return bool((sensing.patterns.indices == 0).any())
    flat = sensing.forward(np.ones(sensing.n_cells))
    return bool(np.abs(flat).max() > 1e-9 * np.abs(sensing.mixing.matrix).sum())
