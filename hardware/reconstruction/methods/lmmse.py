"""Linear minimum mean-square error under a 1/f^2 prior, in closed form.

With a prior covariance C that is diagonal in the cosine transform, measurements A and white noise
of variance s:

    x = C A^T (A C A^T + s I)^-1 y

For a full Hadamard set A^T A = n I and the whole estimate is a Wiener filter behind the inverse
transform. For a subset everything that depends on the patterns alone is kept: the eigenvectors of
A C A^T, so that any noise level costs two products. Of Hadamard rows A C A^T falls into four
blocks (`hardware.reconstruction.walsh_blocks`).

The mean stays out of the prior: it is estimated by generalised least squares (universal kriging;
Cressie, Statistics for Spatial Data, 1993, section 3.4). For Hadamard rows it is simply measured.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from hardware.reconstruction.cosine import filtered
from hardware.reconstruction.noise import error_of_repetitions, is_full
from hardware.reconstruction.prior import (
    cell_variance,
    mean_square,
    prior_scale,
    prior_spectrum,
)
from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing
from hardware.reconstruction.standard_error import (
    activity,
    calibration,
    detail_scale,
    errors_in_95,
    structure,
    tells_detail,
    unseen_detail,
)
from hardware.reconstruction.unseen import unseen_of
from hardware.reconstruction.walsh_blocks import WalshBlocks

#: Values of a matrix from measurements to cells, up to which it is faster than the transforms.
_DENSE = 2**17
#: Largest noise in one direction of the plain inverse over the mean, up to which it is compared.
_UNLIKE = 8.0
#: Share of the greatest eigenvalue below which one is roundoff.
_NULL = 1e-9


@method("lmmse", errors_in_95=errors_in_95, linear=True)
def lmmse(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, Array]:
    """Linear minimum mean-square error under a 1/f^2 prior.

    The prior's scale comes from the measurements themselves. The standard error holds noise and
    unseen detail (`hardware.reconstruction.standard_error`, where its coverage stands).
    """
    plan = lmmse_plan(sensing)
    scale = plan.scale(values, noise_variance)
    if scale == 0:  # no structure is measured, or nothing but a flat image without noise
        noise = noise_variance * plan.noise_of_flat if tells_detail(sensing) else np.nan
        return plan.flat(values), np.full(sensing.n_cells, np.sqrt(noise))
    ratio = noise_variance / scale
    cells = plan.image(values, ratio)
    by_detail, by_noise = plan.errors(ratio)
    independent = plan.structure(values)
    unseen = plan.unseen
    error = np.maximum(by_detail - unseen, 0.0)  # what smoothing takes of that which is seen
    error *= activity(cells, sensing, noise_variance * by_noise)
    finest = detail_scale(*independent, noise_variance, ratio)
    error *= finest * calibration(sensing) ** 2
    lost = smoothed_away(plan, values, cells, noise_variance, ratio)
    foreseen = float(error.mean())  # scenes finer than the prior lose more
    error *= max(lost / foreseen, 1.0) if foreseen else 1.0
    stands = activity(cells, sensing)
    error += unseen_detail(unseen, stands, independent, noise_variance, ratio, sensing)
    error += noise_variance * by_noise
    return cells, np.sqrt(error, out=error)


def smoothed_away(
    plan: "MixedPlan | SubsetPlan | FullPlan",
    values: Array,
    cells: Array,
    noise_variance: float,
    ratio: float,
) -> float:
    """Mean square of the detail that smoothing took of the ``cells``, as measurements tell it
    whatever the prior: what it took of their plain inverse, less the noise in that (unbiased;
    Stein, Ann. Stat. 9, 1981), with the standard error of that difference, as detail lost in the
    scatter of the noise is not none. 0 where few patterns or unlike ones tell no plain inverse.
    """
    sensing = plan.sensing
    if not is_full(sensing.n_cells - unseen_of(sensing).count, sensing.n_cells):
        return 0.0
    squares = plan.squares_taken(ratio)
    if squares is None:
        return 0.0
    left = values - sensing.forward(cells)  # Hadamard rows are of length n, the cells' own over it
    taken = sensing.pseudo_inverse @ left if sensing.is_dense else left / math.sqrt(sensing.n_cells)
    noise = float(squares.sum())
    error = noise * error_of_repetitions(sensing.patterns)
    scatter = math.hypot(math.sqrt(2 * float(squares @ squares)), error)
    return (float(taken @ taken) - noise_variance * (noise - scatter)) / sensing.n_cells


@lru_cache(maxsize=16)
def lmmse_plan(sensing: Sensing) -> "MixedPlan | SubsetPlan | FullPlan":
    """What depends on the patterns alone. ``ratio`` is noise variance over the prior's scale."""
    if sensing.is_dense:
        return mixed_plan(sensing)
    if sensing.count == sensing.n_cells:
        return FullPlan(sensing, prior_spectrum(*sensing.shape))
    return SubsetPlan(sensing, lmmse_blocks(sensing))


@lru_cache(maxsize=16)
def lmmse_blocks(sensing: Sensing) -> WalshBlocks:
    """The covariance between the Hadamard rows shown, as blocks."""
    return WalshBlocks.of(sensing.shape, sensing.indices)


@dataclass(frozen=True, eq=False)
class SubsetPlan:
    """A subset of Hadamard rows: four blocks between them, two fast transforms behind them."""

    sensing: Sensing
    blocks: WalshBlocks

    def scale(self, values: Array, noise_variance: float) -> float:
        """Scale of the prior, from all but the mean."""
        energy = float(values @ values) - self._mean(values) ** 2
        return prior_scale(energy, len(values), noise_variance, self._trace)

    def image(self, values: Array, ratio: float) -> Array:
        """Cells."""
        mean = self._mean(values) / self.sensing.n_cells
        if self._dense is None:
            duals = self.sensing.adjoint(self.blocks.duals(values, ratio))
            return mean + filtered(duals, prior_spectrum(*self.sensing.shape))
        eigenvalues, eigenvectors, cells = self._dense
        weight = 1 / (eigenvalues + max(ratio, self._floor))
        return mean + cells @ (weight * (eigenvectors @ values))

    def errors(self, ratio: float) -> tuple[Array, float]:
        """Mean square errors by detail and by noise, see `WalshBlocks.errors`."""
        detail, noise = self.blocks.errors(ratio)
        return np.maximum(detail, 0.0), noise + self.noise_of_flat

    def squares_taken(self, ratio: float) -> Array:
        """Square of what smoothing takes of the plain inverse, summed over the cells, for each
        independent measurement of variance 1; the mean is kept.
        """
        return self.blocks.taken(ratio) ** 2 / self.sensing.n_cells

    @cached_property
    def unseen(self) -> Array:
        """Mean square error by what no pattern measures: what is left without noise."""
        return self.errors(0.0)[0]

    def structure(self, values: Array) -> tuple[Array, Array]:
        """Measurements without the mean, and their variances for a prior of scale 1."""
        return structure(values, self.sensing)

    def flat(self, values: Array) -> Array:
        """The image when there is no structure: its mean."""
        return np.full(self.sensing.n_cells, self._mean(values) / self.sensing.n_cells)

    @property
    def noise_of_flat(self) -> float:
        """Mean square error of `flat`, per variance of a measurement."""
        return 1 / self.sensing.n_cells**2 if self.blocks.mean_at.size else 0.0

    def _mean(self, values: Array) -> float:
        """Value of row 0, all cells lit; 0 where it is not shown."""
        return float(values[self._mean_at]) if self._mean_at >= 0 else 0.0

    @cached_property
    def _mean_at(self) -> int:
        return int(self.blocks.mean_at[0]) if self.blocks.mean_at.size else -1

    @cached_property
    def _trace(self) -> float:
        return self.blocks.trace

    @cached_property
    def _floor(self) -> float:
        return self.blocks.floor

    @cached_property
    def _dense(self) -> tuple[Array, Array, Array] | None:
        """Eigenvalues (m,), eigenvectors (m, count) and what they are in cells (n_cells, m)."""
        if self.sensing.count * self.sensing.n_cells > _DENSE or not self.blocks.blocks:
            return None
        vectors = np.zeros((self.sensing.count, self.sensing.count - self.blocks.mean_at.size))
        start = 0
        for block in self.blocks.blocks:
            stop = start + len(block.place)
            vectors[block.place, start:stop] = block.eigenvectors
            start = stop
        values = np.concatenate([block.eigenvalues for block in self.blocks.blocks])
        cells = filtered(self.sensing.adjoint(vectors), prior_spectrum(*self.sensing.shape))
        return values, np.ascontiguousarray(vectors.T), np.ascontiguousarray(cells)


@dataclass(frozen=True, eq=False)
class FullPlan:
    """All Hadamard rows: a Wiener filter behind the inverse transform."""

    sensing: Sensing
    spectrum: Array

    def scale(self, values: Array, noise_variance: float) -> float:
        """Scale of the prior, from all but the mean."""
        structure = np.where(self.sensing.indices == 0, 0.0, values)
        expected = self.sensing.n_cells * float(self.spectrum.sum())
        energy = float(structure @ structure)
        return prior_scale(energy, len(values), noise_variance, expected)

    def image(self, values: Array, ratio: float) -> Array:
        """Cells."""
        weight = self._weight(ratio)
        weight[0, 0] = 1.0  # the mean
        return filtered(self.sensing.adjoint(values) / self.sensing.n_cells, weight)

    def errors(self, ratio: float) -> tuple[Array, float]:
        """Mean square errors by detail and by noise, see `WalshBlocks.errors`."""
        weight, n = self._weight(ratio), self.sensing.n_cells
        detail = mean_square(self.spectrum * (1 - weight) ** 2)
        return detail, (float(np.vdot(weight, weight)) + 1) / n**2

    def squares_taken(self, ratio: float) -> Array:
        """See `SubsetPlan.squares_taken`."""
        return (1 - self._weight(ratio)).ravel()[1:] ** 2 / self.sensing.n_cells

    @cached_property
    def unseen(self) -> Array:
        """Nothing is: see `SubsetPlan.unseen`."""
        return np.zeros(self.sensing.n_cells)

    def structure(self, values: Array) -> tuple[Array, Array]:
        """Measurements without the mean, and their variances for a prior of scale 1."""
        return structure(values, self.sensing)

    def flat(self, values: Array) -> Array:
        """The image when there is no structure: its mean."""
        n = self.sensing.n_cells
        return np.full(n, values[self.sensing.indices == 0].sum() / n)

    @property
    def noise_of_flat(self) -> float:
        """See `SubsetPlan.noise_of_flat`."""
        return 1 / self.sensing.n_cells**2

    def _weight(self, ratio: float) -> Array:
        noise = ratio / self.sensing.n_cells + np.finfo(float).tiny
        return np.asarray(self.spectrum / (self.spectrum + noise))


@dataclass(frozen=True, eq=False)
class MixedPlan:
    """Of any matrix: eigenvectors U, eigenvalues of A C A^T, C A^T U, the flat image as seen.

    ``independent`` (count, k) are those eigenvectors of A C A^T, without what a flat image can
    explain, that measure anything; ``variances`` (k,) those measurements' for a prior of scale 1.
    """

    sensing: Sensing
    eigenvectors: Array
    eigenvalues: Array
    cells: Array
    cells_squared: Array
    flat_image: Array
    prior_variance: Array
    expected: float
    floor: float
    independent: Array
    variances: Array

    def scale(self, values: Array, noise_variance: float) -> float:
        """Scale of the prior, from what a flat image does not explain."""
        left = _without(self.flat_image, values)
        return prior_scale(float(left @ left), len(values), noise_variance, self.expected)

    def image(self, values: Array, ratio: float) -> Array:
        """Cells."""
        y = self.eigenvectors.T @ values
        flat = self.eigenvectors.T @ self.flat_image
        weight = 1 / (self.eigenvalues + max(ratio, self.floor))
        precision = float(flat @ (weight * flat))
        mean = float(flat @ (weight * y)) / precision if precision else 0.0
        return mean + self.cells @ (weight * (y - flat * mean))

    def errors(self, ratio: float) -> tuple[Array, Array]:
        """Mean square errors by detail and by noise of each cell, see `WalshBlocks.errors`."""
        weight = 1 / (self.eigenvalues + max(ratio, self.floor))
        flat = self.eigenvectors.T @ self.flat_image
        precision = float(flat @ (weight * flat))
        detail = self.prior_variance - self.cells_squared @ (
            weight * (2 - self.eigenvalues * weight)
        )
        noise = self.cells_squared @ weight**2
        if precision:  # the error of the mean, and what it is in each cell
            each = ((1 - self.cells @ (weight * flat)) / precision) ** 2
            detail += each * float((weight * flat) ** 2 @ self.eigenvalues)
            noise += each * float((weight * flat) ** 2 @ np.ones_like(weight))
        return np.maximum(detail, 0.0), noise

    def squares_taken(self, ratio: float) -> Array | None:
        """See `SubsetPlan.squares_taken`; None where few directions hold most of the noise of the
        plain inverse, which would hide what smoothing takes of all others.
        """
        plain = self._plain
        if plain is None:
            return None
        weight = 1 / (self.eigenvalues + max(ratio, self.floor))
        flat = self.eigenvectors.T @ self.flat_image
        taken = plain * (1 - self.eigenvalues * weight)
        if precision := float(flat @ (weight * flat)):  # the mean is kept
            taken -= np.outer(taken @ flat / precision, weight * flat)
        return np.asarray((taken**2).sum(axis=0))

    @cached_property
    def _plain(self) -> Array | None:
        """Plain inverse of each eigenvector, (n_cells, count)."""
        inverse = self.sensing.pseudo_inverse
        noise = np.linalg.eigvalsh(inverse @ inverse.T)
        seen = len(noise) - unseen_of(self.sensing).count
        alike = noise[-1] < _UNLIKE * noise.sum() / seen
        return inverse @ self.eigenvectors if alike else None

    @cached_property
    def unseen(self) -> Array:
        """See `SubsetPlan.unseen`."""
        return self.errors(0.0)[0]

    def structure(self, values: Array) -> tuple[Array, Array]:
        """Independent measurements without the mean, their variances for a prior of scale 1."""
        return self.independent.T @ values, self.variances

    def flat(self, values: Array) -> Array:
        """The image when there is no structure: its mean."""
        power = float(self.flat_image @ self.flat_image)
        mean = float(self.flat_image @ values) / power if power else 0.0
        return np.full(len(self.cells), mean)

    @property
    def noise_of_flat(self) -> float:
        """See `SubsetPlan.noise_of_flat`."""
        power = float(self.flat_image @ self.flat_image)
        return 1 / power if power else 0.0


def mixed_plan(sensing: Sensing) -> MixedPlan:
    """Plan of any sensing, with a dense matrix ``(n_cells, count)``."""
    spectrum = prior_spectrum(*sensing.shape)
    covariance = filtered(sensing.adjoint(np.eye(sensing.count)), spectrum)
    gram = sensing.forward(covariance)
    gram = (gram + gram.T) / 2
    eigenvalues, eigenvectors = np.linalg.eigh(gram)
    cells = np.ascontiguousarray(covariance @ eigenvectors)
    flat = sensing.of_flat
    without = _without(flat, _without(flat, gram).T)
    variances, independent = np.linalg.eigh((without + without.T) / 2)
    # Where a flat image explains all, nothing is left but roundoff of what was subtracted.
    roundoff = _NULL**2 * sensing.largest_squared * float(spectrum.max())
    told = variances > max(_NULL * float(variances[-1]), roundoff)
    trace = float(np.trace(gram))
    return MixedPlan(
        sensing=sensing,
        eigenvectors=eigenvectors,
        eigenvalues=np.maximum(eigenvalues, 0.0),
        cells=cells,
        cells_squared=cells**2,
        flat_image=flat,
        prior_variance=cell_variance(*sensing.shape),
        expected=float(variances[told].sum()),
        floor=1e-12 * trace / sensing.count + 1e-300,  # roundoff must not make it singular
        independent=np.ascontiguousarray(independent[:, told]),
        variances=variances[told],
    )


def _without(flat: Array, values: Array) -> Array:
    """Measurements ``(count, ...)`` less what a flat image explains of them."""
    power = float(flat @ flat)
    return values - np.multiply.outer(flat, flat @ values / power) if power else values
