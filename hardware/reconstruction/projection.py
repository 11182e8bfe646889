"""Projection onto the images that the measurements allow, within their noise.

|A x - y| at most a radius: every method that claims to agree with the data ends there, and so
inverts a full set without noise. Hadamard rows are orthogonal, so the projection is exact: one
transform there, one back. With a calibrated mixing, or a user's own patterns, it takes the singular
vectors of A.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware import compiled
from hardware.patterns.transform import small_matrix
from hardware.reconstruction.sensing import Sensing

Array = NDArray[np.float64]

#: Side up to which, without numba, matrix products are faster than the transform.
_LARGEST_PRODUCT = 64


def allowed(cells: Array, values: Array, noise_variance: float, sensing: Sensing) -> Array:
    """The image nearest to ``cells`` (n_cells,) whose squared misfit is at most the noise's.

    The true image has that misfit in the mean, so that projecting brings no image farther from it.
    """
    radius = np.sqrt(np.array([sensing.count * noise_variance]))
    return projection(values[:, None], radius, sensing)(cells[:, None])[:, 0]


def projection(values: Array, radius: Array, sensing: Sensing) -> Callable[[Array], Array]:
    """Onto the images (n_cells, n_detectors) whose misfit is at most ``radius`` (n_detectors,)."""
    if sensing.is_dense:
        return _MixedProjection(values, radius, sensing)
    if values.shape[1] == 1 and max(sensing.shape) <= _LARGEST_PRODUCT and not compiled.available():
        return _ProductProjection(values, radius, sensing)
    return _Projection(values, radius, sensing)


class _Projection:
    """By orthogonal rows: one transform there, one back."""

    def __init__(self, values: Array, radius: Array, sensing: Sensing) -> None:
        self.values, self.radius, self.sensing = values, radius, sensing

    def __call__(self, cells: Array) -> Array:
        misfit = self.values - self.sensing.forward(cells, repeated=True)
        size = np.sqrt(np.einsum("ij,ij->j", misfit, misfit))
        excess = np.maximum(1 - self.radius / np.maximum(size, 1e-300), 0.0)
        step = misfit * (excess / self.sensing.n_cells)
        return cells + self.sensing.adjoint(step, repeated=True)


class _ProductProjection:
    """The same of one small image by matrix products, with the Walsh functions that take part."""

    def __init__(self, values: Array, radius: Array, sensing: Sensing) -> None:
        down, along = divmod(sensing.indices, sensing.shape[1])
        rows, row = np.unique(down, return_inverse=True)
        columns, column = np.unique(along, return_inverse=True)
        self.down = small_matrix(sensing.shape[0])[rows]
        self.along = small_matrix(sensing.shape[1])[:, columns]
        self.values, self.shown = np.zeros((2, len(rows), len(columns)))
        self.values[row, column], self.shown[row, column] = values[:, 0], 1.0
        self.shape, self.n_cells, self.radius = sensing.shape, sensing.n_cells, float(radius[0])

    def __call__(self, cells: Array) -> Array:
        misfit = self.down @ cells.reshape(self.shape) @ self.along
        np.subtract(self.values, misfit, out=misfit)
        misfit *= self.shown
        size = float(np.sqrt(np.vdot(misfit, misfit)))
        excess = max(1 - self.radius / max(size, 1e-300), 0.0)
        misfit *= excess / self.n_cells
        return cells + (self.down.T @ misfit @ self.along.T).reshape(cells.shape)


class _MixedProjection:
    """The same for any matrix A = U S V^T.

    In singular coordinates the projection of c is (c + m S y) / (1 + m S^2), with the multiplier m
    that gives the misfit its radius.
    """

    def __init__(self, values: Array, radius: Array, sensing: Sensing) -> None:
        u, size, self.vt = singular_vectors(sensing)
        nonzero = size > 1e-9 * size[0]
        self.size, self.vt, rotated = size[nonzero], self.vt[nonzero], u.T @ values
        self.values = rotated[nonzero]
        outside = np.sum(rotated[~nonzero] ** 2, axis=0) + np.sum(values**2, axis=0)
        outside -= np.sum(rotated**2, axis=0)  # no image explains this part
        self.radius = np.sqrt(np.maximum(radius**2 - outside, 0.0))

    def __call__(self, cells: Array) -> Array:
        here = self.vt @ cells
        misfit = self.values - self.size[:, None] * here
        moves = [self._move(m, r) for m, r in zip(misfit.T, self.radius, strict=True)]
        return cells + self.vt.T @ np.stack(moves, axis=1)

    def _move(self, misfit: Array, radius: float) -> Array:
        if radius == 0:
            return misfit / self.size
        multiplier = 0.0
        for _ in range(50):  # Newton on 1/|misfit| - 1/radius, which is nearly linear
            left = misfit / (1 + multiplier * self.size**2)
            length = float(np.sqrt(left @ left))
            if length <= radius * (1 + 1e-9):
                break
            slope = float(left**2 @ (self.size**2 / (1 + multiplier * self.size**2))) / length**3
            multiplier += (1 / radius - 1 / length) / slope
        return multiplier * self.size * misfit / (1 + multiplier * self.size**2)


@lru_cache(maxsize=4)
def singular_vectors(sensing: Sensing) -> tuple[Array, Array, Array]:
    """U, singular values (falling) and V^T of the matrix of any patterns."""
    u, size, vt = np.linalg.svd(sensing.matrix, full_matrices=False)
    return u, size, vt
