"""The linear map from an image to its measurements: H x of Hadamard rows, W x of a user's own
patterns, or H M x and W M x with a calibrated mixing M.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import (
    OwnPatterns,
    Patterns,
    PatternSet,
    RasterScan,
    fwht_in_place,
    hadamard_rows,
)

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

    Applies to arrays ``(n_cells, ...)`` without forming a matrix, unless there is a mixing or the
    patterns are a user's own. A raster scan is taken by the Hadamard transform of its cells: an
    orthogonal one, which leaves white noise white, so that every method takes it as a whole set.
    """

    patterns: Patterns
    mixing: Mixing | None = None

    def __post_init__(self) -> None:
        if self.mixing is not None and not isinstance(self.mixing, Mixing):
            raise InputError(
                f"mixing: {type(self.mixing).__name__}, expected Mixing(matrix, rows, columns)"
            )
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
        return self.patterns.n_cells if self._is_scan else self.patterns.count

    @property
    def _is_scan(self) -> bool:
        return isinstance(self.patterns, RasterScan)

    @property
    def is_dense(self) -> bool:
        """Whether it is a matrix, and no rows of the Hadamard matrix."""
        return self.mixing is not None or isinstance(self.patterns, OwnPatterns)

    @property
    def indices(self) -> NDArray[np.intp]:
        """Rows of the natural-order Hadamard matrix that are shown, ``(count,)``. Raises InputError
        for a user's own patterns.
        """
        if isinstance(self.patterns, PatternSet):
            return self.patterns.indices
        if self._is_scan:
            return np.arange(self.patterns.n_cells)
        raise InputError("patterns: are a user's own, expected rows of the Hadamard matrix")

    def forward(self, cells: Array, *, repeated: bool = False) -> Array:
        """Noise-free measurements ``(count, ...)`` of cells ``(n_cells, ...)``; ``repeated``: as in
        `fwht_in_place`.
        """
        if self.is_dense:
            return np.asarray(np.tensordot(self._dense, cells, 1))
        x = np.array(cells, dtype=np.float64, order="C")
        return np.asarray(fwht_in_place(x, repeated=repeated)[self.indices])

    def adjoint(self, values: Array, *, repeated: bool = False) -> Array:
        """Transpose of `forward`: ``(count, ...)`` to ``(n_cells, ...)``."""
        if self.is_dense:
            return np.asarray(np.tensordot(self._dense.T, values, 1))
        coefficients = np.zeros((self.n_cells, *values.shape[1:]))
        coefficients[self.indices] = values
        return fwht_in_place(coefficients, repeated=repeated)

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
    def of_flat(self) -> Array:
        """Measurements (count,) of an image that is 1 everywhere: none of it is left to rounding
        where no level is measured.
        """
        if not self.measures_level:
            return np.zeros(self.count)
        return np.asarray(self.forward(np.ones(self.n_cells)))

    @property
    def matrix(self) -> Array:
        """The dense matrix ``(count, n_cells)``."""
        if self.is_dense:
            return self._dense
        return hadamard_rows(self.indices, self.n_cells).astype(np.float64)

    @property
    def pseudo_inverse(self) -> Array:
        """The least-squares inverse of least norm, ``(n_cells, count)``: of rows of the Hadamard
        matrix their transpose over n. Singular values below 1e-9 of the largest count as none.
        """
        return _pseudo_inverse(self)

    @cached_property
    def largest_squared(self) -> float:
        """Largest eigenvalue of A^T A: n for Hadamard rows."""
        if not self.is_dense:
            return float(self.n_cells)
        return float(np.linalg.norm(self._dense, 2) ** 2)

    @cached_property
    def _dense(self) -> Array:
        if isinstance(self.patterns, OwnPatterns):
            own = self.patterns.matrix
            return own @ self.mixing.matrix if self.mixing else own
        assert self.mixing is not None
        return fwht_in_place(np.array(self.mixing.matrix, np.float64, order="C"))[self.indices]


@lru_cache(maxsize=16)
def _measured(sensing: Sensing) -> NDArray[np.bool_]:
    told = ~sensing.patterns.unmeasured_cells
    if sensing.mixing:
        told = (sensing.mixing.matrix[told] != 0).any(axis=0)
    told.flags.writeable = False
    return told


@lru_cache(maxsize=16)
def _measures_level(sensing: Sensing) -> bool:
    if not sensing.is_dense:
        return bool((sensing.indices == 0).any())
    flat = sensing.forward(np.ones(sensing.n_cells))
    lit = sensing.mixing.matrix if sensing.mixing else sensing.matrix
    return bool(np.abs(flat).max() > 1e-9 * np.abs(lit).sum())


@lru_cache(maxsize=4)
def _pseudo_inverse(sensing: Sensing) -> Array:
    return np.asarray(np.linalg.pinv(sensing.matrix, rcond=1e-9))
