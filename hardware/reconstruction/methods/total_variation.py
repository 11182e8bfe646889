"""Least total variation among the images that the measurements allow, within their noise.

    min over x of  sum over cells of |grad x|   with   |A x - y|^2 <= M s

by the primal-dual steps of Chambolle and Pock, J. Math. Imaging Vis. 40, 2011, over-relaxed and
warm-started from LMMSE. Hadamard rows are orthogonal, so the constraint's projection is exact: one
transform there, one back. With a calibrated mixing it takes the singular vectors of A.

The joint method does the same for the columns of a line sensor side by side: differences between
neighbouring columns count too, while every detector's measurements bind its own columns.
"""

from collections.abc import Callable

import numpy as np

from hardware import compiled
from hardware.patterns.transform import small_matrix
from hardware.reconstruction.methods.lmmse import lmmse_plan
from hardware.reconstruction.primal_dual import RELAXATION, ascend, descend
from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing

#: Steps; 48 from LMMSE come within 0.25 dB of the converged image for each test picture, and lie
#: above it in the mean.
ITERATIONS = 48
#: Primal step over the spread of the image; the dual one follows.
STEP = 0.1
#: Side up to which, without numba, matrix products are faster than the transform.
_LARGEST_PRODUCT = 64
#: Squared misfit over its expectation M s, chosen on every other of the test pictures.
MISFIT = 0.6


@method("tv")
def total_variation(
    values: Array, noise_variance: float, sensing: Sensing, *, iterations: int = ITERATIONS
) -> tuple[Array, None]:
    """Least total variation within the noise (Chambolle-Pock, from LMMSE)."""
    cells = total_variation_joint(
        values[:, None], np.array([noise_variance]), sensing, iterations=iterations
    )[0]
    return cells[:, 0], None


@method("tv-joint", joint=True)
def total_variation_joint(
    values: Array, noise_variance: Array, sensing: Sensing, *, iterations: int = ITERATIONS
) -> tuple[Array, None]:
    """Least total variation of all detectors' columns side by side."""
    start = np.stack(
        [_start(y, float(s), sensing) for y, s in zip(values.T, noise_variance, strict=True)],
        axis=1,
    )
    spread = float(start.std())
    if spread == 0:
        return start, None
    radius = np.sqrt(MISFIT * sensing.count * noise_variance)
    onto = projection(values / spread, radius / spread, sensing)
    image = _side_by_side(start / spread, sensing)
    new, duals = image, np.zeros((2, *image.shape))
    weights, dual_step = steps(image.shape)
    for _ in range(iterations):
        moved = descend(image, duals, STEP, weights)
        new = _side_by_side(onto(_stacked(moved, sensing)), sensing)
        change = new - image
        ascend(new + change, duals, dual_step, weights)
        change *= RELAXATION
        image += change
    return spread * _stacked(new, sensing), None


def steps(shape: tuple[int, int]) -> tuple[tuple[float, float], float]:
    """Weights of differences down the rows and along the columns, and the dual step.

    The field is taken as square, as the prior does: where cells are four times as wide as high, a
    difference along the columns is a quarter of that slope. Both steps times |grad|^2 make 1.
    """
    least = min(shape)
    weights = least / shape[1], least / shape[0]
    return weights, 1 / (4 * STEP * (weights[0] ** 2 + weights[1] ** 2))


def _start(values: Array, noise_variance: float, sensing: Sensing) -> Array:
    plan = lmmse_plan(sensing)
    scale = plan.scale(values, noise_variance)
    return plan.image(values, noise_variance / scale) if scale else plan.flat(values)


def _side_by_side(cells: Array, sensing: Sensing) -> Array:
    """Cells (n_cells, n_detectors) as one picture (rows, n_detectors * columns)."""
    rows, columns = sensing.shape
    picture = cells.reshape(rows, columns, -1).swapaxes(1, 2)
    return np.ascontiguousarray(picture.reshape(rows, -1))


def _stacked(picture: Array, sensing: Sensing) -> Array:
    """Inverse of `_side_by_side`."""
    rows, columns = sensing.shape
    cells = picture.reshape(rows, -1, columns).swapaxes(1, 2)
    return np.ascontiguousarray(cells).reshape(rows * columns, -1)


def projection(values: Array, radius: Array, sensing: Sensing) -> Callable[[Array], Array]:
    """Onto the images (n_cells, n_detectors) whose misfit is at most ``radius`` (n_detectors,)."""
    if sensing.mixing:
        return _MixedProjection(values, radius, sensing)
    if values.shape[1] == 1 and max(sensing.shape) <= _LARGEST_PRODUCT and not compiled.available():
        return _ProductProjection(values, radius, sensing)
    return _Projection(values, radius, sensing)


class _Projection:
    """By orthogonal rows: one transform there, one back."""

    def __init__(self, values: Array, radius: Array, sensing: Sensing) -> None:
        self.values, self.radius, self.sensing = values, radius, sensing

    def __call__(self, cells: Array) -> Array:
        misfit = self.values - self.sensing.forward(cells)
        size = np.sqrt(np.einsum("ij,ij->j", misfit, misfit))
        excess = np.maximum(1 - self.radius / np.maximum(size, 1e-300), 0.0)
        return cells + self.sensing.adjoint(misfit * (excess / self.sensing.n_cells))


class _ProductProjection:
    """The same of one small image by matrix products, with the Walsh functions that take part."""

    def __init__(self, values: Array, radius: Array, sensing: Sensing) -> None:
        down, along = divmod(sensing.patterns.indices, sensing.shape[1])
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
        u, size, self.vt = np.linalg.svd(sensing.matrix, full_matrices=False)
        kept = size > 1e-9 * size[0]
        self.size, self.vt, rotated = size[kept], self.vt[kept], u.T @ values
        self.values = rotated[kept]
        outside = np.sum(rotated[~kept] ** 2, axis=0) + np.sum(values**2, axis=0)
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
