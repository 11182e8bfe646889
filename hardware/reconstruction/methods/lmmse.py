"""Linear minimum mean-square error under a 1/f^2 prior, in closed form.

With a prior covariance C that is circulant (diagonal in Fourier space), measurements A and white
noise of variance s:

    x = C A^T (A C A^T + s I)^-1 y

For a full Hadamard set A^T A = n I and the whole estimate is a Wiener filter behind the inverse
transform. For a subset everything that depends on the patterns alone is kept: the eigenvectors of
A C A^T, so that any noise level costs two products. Large sets use that A C A^T falls into small
blocks (`hardware.reconstruction.walsh_blocks`).

The mean stays out of the prior: it is estimated by generalised least squares (universal kriging;
Cressie, Statistics for Spatial Data, 1993, section 3.4). For Hadamard rows it is simply measured.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hardware.reconstruction.prior import filtered, prior_scale, prior_spectrum
from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing
from hardware.reconstruction.walsh_blocks import WalshBlocks

#: Values of the dense plan, up to which it is faster than the transform.
_DENSE = 2**17


@method("lmmse")
def lmmse(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, Array]:
    """Linear minimum mean-square error under a 1/f^2 prior.

    The prior's scale comes from the measurements themselves. The standard error is the
    posterior's: noise and unseen detail together.
    """
    plan = lmmse_plan(sensing)
    scale = plan.scale(values, noise_variance)
    if scale == 0:  # noiseless and without structure
        return plan.flat(values), np.zeros(sensing.n_cells)
    ratio = noise_variance / scale
    return plan.image(values, ratio), np.sqrt(scale * plan.variance(ratio))


@lru_cache(maxsize=16)
def lmmse_plan(sensing: Sensing) -> "DensePlan | BlockPlan | FullPlan":
    """What depends on the patterns alone. ``ratio`` is noise variance over the prior's scale."""
    if sensing.mixing:
        return dense_plan(sensing)
    if sensing.count == sensing.n_cells:
        return FullPlan(sensing, prior_spectrum(*sensing.shape))
    if sensing.count * sensing.n_cells <= _DENSE:
        return dense_plan(sensing)
    return BlockPlan(sensing, lmmse_blocks(sensing))


@lru_cache(maxsize=16)
def lmmse_blocks(sensing: Sensing) -> WalshBlocks:
    """The covariance between the Hadamard rows shown, as blocks."""
    return WalshBlocks.of(sensing.shape, sensing.patterns.indices)


@dataclass(frozen=True, eq=False)
class DensePlan:
    """Eigenvectors U and eigenvalues of A C A^T, C A^T U, and the response to a flat image."""

    eigenvectors: Array
    eigenvalues: Array
    cells: Array
    cells_squared: Array
    flat_image: Array
    prior_variance: float
    expected: float
    floor: float

    def scale(self, values: Array, noise_variance: float) -> float:
        """Scale of the prior, from what a flat image does not explain."""
        flat = self.flat_image
        power = float(flat @ flat)
        left = values - flat * (float(flat @ values) / power) if power else values
        return prior_scale(float(left @ left), len(values), noise_variance, self.expected)

    def image(self, values: Array, ratio: float) -> Array:
        """Cells."""
        y = self.eigenvectors.T @ values
        flat = self.eigenvectors.T @ self.flat_image
        weight = 1 / (self.eigenvalues + max(ratio, self.floor))
        precision = float(flat @ (weight * flat))
        mean = float(flat @ (weight * y)) / precision if precision else 0.0
        return mean + self.cells @ (weight * (y - flat * mean))

    def variance(self, ratio: float) -> Array:
        """Posterior variance of each cell, for a prior of scale 1."""
        weight = 1 / (self.eigenvalues + max(ratio, self.floor))
        flat = self.eigenvectors.T @ self.flat_image
        precision = float(flat @ (weight * flat))
        variance = self.prior_variance - self.cells_squared @ weight
        if precision:
            variance += (1 - self.cells @ (weight * flat)) ** 2 / precision
        return np.maximum(variance, 0.0)

    def flat(self, values: Array) -> Array:
        """The image when there is no structure: its mean."""
        power = float(self.flat_image @ self.flat_image)
        mean = float(self.flat_image @ values) / power if power else 0.0
        return np.full(len(self.cells), mean)


def dense_plan(sensing: Sensing) -> DensePlan:
    """Make a plan with a dense matrix ``(n_cells, count)``."""
    spectrum = prior_spectrum(*sensing.shape)
    covariance = filtered(sensing.adjoint(np.eye(sensing.count)), spectrum)
    gram = sensing.forward(covariance)
    gram = (gram + gram.T) / 2
    eigenvalues, eigenvectors = np.linalg.eigh(gram)
    cells = np.ascontiguousarray(covariance @ eigenvectors)
    flat = sensing.forward(np.ones(sensing.n_cells))
    power = float(flat @ flat)
    trace = float(np.trace(gram))
    return DensePlan(
        eigenvectors=eigenvectors,
        eigenvalues=np.maximum(eigenvalues, 0.0),
        cells=cells,
        cells_squared=cells**2,
        flat_image=flat,
        prior_variance=float(np.mean(spectrum)),
        expected=trace - (float(flat @ gram @ flat) / power if power else 0.0),
        floor=1e-12 * trace / sensing.count + 1e-300,  # roundoff must not make it singular
    )


@dataclass(frozen=True, eq=False)
class BlockPlan:
    """A subset of Hadamard rows: small blocks between them, one fast transform behind them."""

    sensing: Sensing
    blocks: WalshBlocks

    def scale(self, values: Array, noise_variance: float) -> float:
        """Scale of the prior, from all but the mean."""
        energy = float(values @ values) - float(np.sum(self._mean(values) ** 2))
        return prior_scale(energy, len(values), noise_variance, self.blocks.trace)

    def image(self, values: Array, ratio: float) -> Array:
        """Cells."""
        coefficients = self.blocks.filter(values, ratio)
        coefficients[0] = self._mean(values).sum()
        return self.blocks.cells(coefficients)

    def variance(self, ratio: float) -> Array:
        """Posterior variance of each cell, for a prior of scale 1."""
        n = self.sensing.n_cells
        return np.maximum(self.blocks.variance(ratio) + self._mean_variance(ratio) / n**2, 0.0)

    def flat(self, values: Array) -> Array:
        """The image when there is no structure: its mean."""
        return np.full(self.sensing.n_cells, self._mean(values).sum() / self.sensing.n_cells)

    def _mean(self, values: Array) -> Array:
        return values[self.blocks.mean_at]

    def _mean_variance(self, ratio: float) -> float:
        return ratio if self.blocks.mean_at.size else 0.0


@dataclass(frozen=True, eq=False)
class FullPlan:
    """All Hadamard rows: a Wiener filter behind the inverse transform."""

    sensing: Sensing
    spectrum: Array

    def scale(self, values: Array, noise_variance: float) -> float:
        """Scale of the prior, from all but the mean."""
        structure = np.where(self.sensing.patterns.indices == 0, 0.0, values)
        expected = self.sensing.n_cells * float(self.spectrum.sum())
        energy = float(structure @ structure)
        return prior_scale(energy, len(values), noise_variance, expected)

    def image(self, values: Array, ratio: float) -> Array:
        """Cells."""
        weight = self._weight(ratio)
        weight[0, 0] = 1.0  # the mean
        return filtered(self.sensing.adjoint(values) / self.sensing.n_cells, weight)

    def variance(self, ratio: float) -> Array:
        """Posterior variance of each cell, for a prior of scale 1; the same for all of them."""
        n = self.sensing.n_cells
        variance = np.mean(self.spectrum * (1 - self._weight(ratio))) + ratio / n**2
        return np.full(n, variance)

    def flat(self, values: Array) -> Array:
        """The image when there is no structure: its mean."""
        n = self.sensing.n_cells
        return np.full(n, values[self.sensing.patterns.indices == 0].sum() / n)

    def _weight(self, ratio: float) -> Array:
        noise = ratio / self.sensing.n_cells + np.finfo(float).tiny
        return np.asarray(self.spectrum / (self.spectrum + noise))
