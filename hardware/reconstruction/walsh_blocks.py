"""The prior covariance between Hadamard measurements, as the four blocks it consists of.

Mirroring an image about its middle leaves the prior as it is, on each axis. Walsh functions are
even or odd under it (the parity of their index), and so are cosine functions: H C H^T couples only
rows whose indices agree in parity, on both axes. Each block is kept as eigenvectors and
eigenvalues of the rows shown, for any noise level.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.prior import cell_variance, prior_spectrum, walsh_to_cosine

#: What the blocks of a subset may take.
MOST_BYTES = 2**32
#: Relative error of a posterior variance from noise levels being interpolated.
_INTERPOLATION = 1e-5

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of one parity: m of them shown, k cosine functions.

    ``place`` (m,) in the measurements; ``covariance`` (m, m) with its ``eigenvectors``, one per
    column, and ``eigenvalues``; ``cosines`` (k, m), coefficients of C A^T.
    """

    place: Integers
    covariance: Array
    eigenvectors: Array
    eigenvalues: Array
    cosines: Array
    parity: tuple[int, int]


@dataclass(frozen=True, eq=False)
class WalshBlocks:
    """Blocks of a set of rows; ``mean_at`` is the place of row 0, which is in none."""

    shape: tuple[int, int]
    count: int
    blocks: tuple[Block, ...]
    mean_at: Integers

    @classmethod
    def of(cls, shape: tuple[int, int], indices: Integers) -> "WalshBlocks":
        """Blocks of the rows ``indices`` of a grid; InputError where they are too large."""
        size = bytes_needed(shape, indices)
        if size > MOST_BYTES:
            raise InputError(
                f"patterns: {len(indices)} of {shape[0] * shape[1]} need {size / 2**30:.3g} GiB of "
                f"matrices, at most {MOST_BYTES / 2**30:g} are granted; take all patterns, fewer, "
                "or another method"
            )
        blocks = tuple(
            _block(shape, indices, place, parity) for parity, place in _classes(shape, indices)
        )
        return cls(shape, len(indices), blocks, np.flatnonzero(indices == 0))

    @property
    def trace(self) -> float:
        """Sum of the prior variances of all measurements."""
        return sum(float(block.eigenvalues.sum()) for block in self.blocks)

    @property
    def floor(self) -> float:
        """Keeps roundoff from making a block singular where there is no noise."""
        return 1e-12 * self.trace / self.count + 1e-300

    def duals(self, values: Array, ratio: float) -> Array:
        """Solve (A C A^T + ratio I) w = y, ``(count,)``; 0 for the mean. Then x = C A^T w."""
        w = np.zeros(self.count)
        ratio = max(ratio, self._floor)
        for b in self.blocks:
            scores = (values[b.place] @ b.eigenvectors) / (b.eigenvalues + ratio)
            w[b.place] = b.eigenvectors @ scores
        return w

    def duals_unequal(self, values: Array, ratios: Array) -> Array:
        """The same with a noise level of its own for each measurement, ``(count,)``."""
        if np.ptp(ratios) == 0:
            return self.duals(values, float(ratios[0]))
        from scipy import linalg  # takes 0.1 s to import

        w = np.zeros(self.count)
        for b in self.blocks:
            system = b.covariance.copy()
            np.fill_diagonal(
                system, b.covariance.diagonal() + np.maximum(ratios[b.place], self._floor)
            )
            factor = linalg.cho_factor(system, lower=True, overwrite_a=True, check_finite=False)
            w[b.place] = linalg.cho_solve(factor, values[b.place], check_finite=False)
        return w

    def taken(self, ratio: float) -> Array:
        """Share of each independent measurement that smoothing takes, (m,), without the mean."""
        ratio = max(ratio, self._floor)
        parts = [ratio / (block.eigenvalues + ratio) for block in self.blocks]
        return np.concatenate(parts) if parts else np.zeros(0)

    def errors(self, ratio: float) -> tuple[Array, float]:
        """Mean square error of each cell by detail, ``(n_cells,)``, per variance of the prior; and
        of all cells by noise, per variance of a measurement. Without the mean.

        Noise differs by less than a tenth between cells, and is given as one number.
        """
        nodes, shares = self._explained
        left = max(ratio, self._floor) / (nodes + max(ratio, self._floor))
        detail = cell_variance(*self.shape) - self._mirrored(shares @ (1 - left**2))
        return detail, float(self._mean_shares @ ((1 - left) ** 2 / nodes))

    @cached_property
    def _mean_shares(self) -> Array:
        return np.asarray(self._explained[1].mean(axis=0))

    @cached_property
    def _floor(self) -> float:
        return self.floor

    @cached_property
    def _explained(self) -> tuple[Array, Array]:
        """Eigenvalues (k,) and what each explains of the cells of one quarter, (n_quarter, k).

        Cell p has sum over eigenvalues of s_pi v_i / (v_i + ratio). As a function of log v that
        fraction is so smooth that a few Chebyshev nodes stand for all eigenvalues, at any ratio.
        """
        parts = [_explained_quarter(self.shape, block) for block in self.blocks]
        if not parts:
            return np.ones(1), np.zeros((-(-self.shape[0] // 2) * -(-self.shape[1] // 2), 1))
        values = np.concatenate([block.eigenvalues for block in self.blocks])
        return compressed(values, np.hstack(parts))

    def _mirrored(self, quarter: Array) -> Array:
        """All cells ``(n_cells,)`` from those of the first quarter and their mirror images."""
        down, along = self.shape
        first = quarter.reshape(-(-down // 2), -1)
        half = np.concatenate([first, first[: down // 2][::-1]])
        return np.concatenate([half, half[:, : along // 2][:, ::-1]], axis=1).ravel()


def compressed(values: Array, shares: Array) -> tuple[Array, Array]:
    """Fewer eigenvalues with which sums of shares v / (v + ratio) are the same at any ratio > 0.

    ``values`` (m,), ``shares`` (n, m). With u = log v the fraction is 1 / (1 + ratio exp(-u)),
    analytic for |Im u| < pi: Chebyshev interpolation over a range of half-width h converges as
    rho^-k with rho = pi/h + sqrt(1 + (pi/h)^2) (Trefethen, Approximation Theory and Approximation
    Practice, theorem 8.2).
    """
    u = np.log(np.maximum(values, 1e-9 * values.max() + 1e-300))
    middle, half = (u.max() + u.min()) / 2, max((u.max() - u.min()) / 2, 1e-3)
    rho = np.pi / half + np.hypot(1, np.pi / half)
    k = int(np.ceil(-np.log(_INTERPOLATION) / np.log(rho))) + 4
    if k >= len(values):
        return np.exp(u), shares
    nodes = np.cos(np.pi * (np.arange(k) + 0.5) / k)
    weights = chebyshev.chebvander(nodes, k - 1) * (2 / k)
    weights[:, 0] /= 2
    lagrange = chebyshev.chebvander(np.clip((u - middle) / half, -1, 1), k - 1) @ weights.T
    return np.exp(middle + half * nodes), shares @ lagrange


def bytes_needed(shape: tuple[int, int], indices: Integers) -> int:
    """Memory for the blocks of a subset: covariances, eigenvectors, cosine spectra, quarters."""
    quarter = -(-shape[0] // 2) * -(-shape[1] // 2)
    sizes = (len(place) for _, place in _classes(shape, indices))
    return sum(8 * m * (2 * m + 3 * quarter) for m in sizes)


def _classes(
    shape: tuple[int, int], indices: Integers
) -> Iterator[tuple[tuple[int, int], Integers]]:
    """Parity and places of the rows shown that one block couples, all but row 0."""
    down, along = (np.bitwise_count(i) & 1 for i in divmod(indices, shape[1]))
    for parity in ((0, 0), (0, 1), (1, 0), (1, 1)):
        place = np.flatnonzero((down == parity[0]) & (along == parity[1]) & (indices != 0))
        if place.size:
            yield parity, place


def _block(
    shape: tuple[int, int], indices: Integers, place: Integers, parity: tuple[int, int]
) -> Block:
    down, along = divmod(indices[place], shape[1])
    rows = walsh_to_cosine(shape[0])[down, parity[0] :: 2]
    columns = walsh_to_cosine(shape[1])[along, parity[1] :: 2]
    spectrum = prior_spectrum(*shape)[parity[0] :: 2, parity[1] :: 2]
    measured = np.einsum("mi,mj->mij", rows, columns).reshape(len(place), -1)
    cosines = (measured * spectrum.ravel()).T
    covariance = measured @ cosines
    covariance = (covariance + covariance.T) / 2
    eigenvalues, eigenvectors = np.linalg.eigh(covariance)
    return Block(place, covariance, eigenvectors, np.maximum(eigenvalues, 0.0), cosines, parity)


def _explained_quarter(shape: tuple[int, int], block: Block) -> Array:
    """Square of each eigenvector's cells over its eigenvalue, in the first quarter, (n, m)."""
    down, along = (
        dct_matrix(n)[p::2, : -(-n // 2)] for n, p in zip(shape, block.parity, strict=True)
    )
    spectra = (block.cosines @ block.eigenvectors).T.reshape(-1, len(down), len(along))
    cells = (down.T @ spectra @ along).reshape(len(spectra), -1)
    return np.asarray((cells**2 / np.maximum(block.eigenvalues, 1e-300)[:, None]).T)
