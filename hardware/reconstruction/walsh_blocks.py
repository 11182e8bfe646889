"""The 1/f^2 covariance between Hadamard measurements, as the small blocks it consists of.

A circulant, even covariance commutes with shifts and with reflections, on each axis. Walsh
functions are eigenfunctions of some of them: of the reflection j -> n - 1 - j (sign: parity of the
index), of the shift by n/2 (sign: highest bit), and, where that bit is 0, of the shift by n/4, and
so on. So H C H^T couples only rows whose indices agree in the position of the highest bit and in
parity, on both axes: of 64 x 64, blocks of at most 256. They are kept as eigenvectors and
eigenvalues of the rows shown, for any noise level.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import fwht_in_place, hadamard_rows
from hardware.reconstruction.prior import prior_spectrum

#: What the blocks of a subset may take.
MOST_BYTES = 2**32

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Group:
    """Blocks of one size: g blocks of n rows each, of which up to m are shown (padded).

    ``place`` (g, m) where the shown rows stand in the measurements, ``shown`` 0 for padding;
    ``eigenvectors`` (g, m, m), transposed; ``eigenvalues`` (g, m); ``spread`` (g, n, m) takes
    eigen-coordinates to ``rows`` (g, n). ``pairs`` (g, n, m) are dyadic autocorrelations of
    ``spread``, at the index differences ``lags`` (g, n).
    """

    place: Integers
    shown: Array
    eigenvectors: Array
    eigenvalues: Array
    spread: Array
    rows: Integers
    pairs: Array
    lags: Integers


@dataclass(frozen=True, eq=False)
class WalshBlocks:
    """All groups of a set of rows; ``trace`` of H C H^T, ``mean_at`` the place of row 0."""

    n_cells: int
    groups: tuple[Group, ...]
    trace: float
    mean_at: Integers
    prior_variance: float

    @classmethod
    def of(cls, shape: tuple[int, int], indices: Integers) -> "WalshBlocks":
        """Blocks of the rows ``indices`` of a grid; ValueError where they are too large."""
        size = bytes_needed(shape, indices)
        if size > MOST_BYTES:
            raise ValueError(
                f"patterns: {len(indices)} of {shape[0] * shape[1]} need {size / 2**30:.3g} GiB of "
                f"matrices, at most {MOST_BYTES / 2**30:g} are granted; take all patterns, fewer, "
                "or another method"
            )
        place = np.full(shape[0] * shape[1], -1)
        place[indices] = np.arange(len(indices))
        by_size: dict[int, list[tuple[Integers, Array]]] = defaultdict(list)
        for down in _classes(shape[0]):
            for along in _classes(shape[1]):
                rows = (down[:, None] * shape[1] + along).ravel()
                if (place[rows] >= 0).any():
                    by_size[rows.size].append((rows, _covariance(shape, down, along)))
        groups = tuple(_group(place, members) for _, members in sorted(by_size.items()))
        return cls(
            n_cells=place.size,
            groups=groups,
            trace=sum(float(g.eigenvalues.sum()) for g in groups),
            mean_at=np.flatnonzero(indices == 0),
            prior_variance=float(np.mean(prior_spectrum(*shape))),
        )

    def filter(self, values: Array, ratio: float) -> Array:
        """Hadamard coefficients ``(n_cells,)`` of the estimate; that of the mean is 0."""
        coefficients = np.zeros(self.n_cells)
        ratio = max(ratio, self.floor)
        for g in self.groups:
            y = (values[g.place] * g.shown)[..., None]
            scores = (g.eigenvectors @ y)[..., 0] / (g.eigenvalues + ratio)
            coefficients[g.rows] = (g.spread @ scores[..., None])[..., 0]
        return coefficients

    def filter_unequal(self, values: Array, ratios: Array) -> Array:
        """The same with a noise level of its own for each measurement, ``(count,)``."""
        coefficients = np.zeros(self.n_cells)
        for g in self.groups:
            y = (values[g.place] * g.shown)[..., None]
            noise = np.where(g.shown > 0, np.maximum(ratios[g.place], self.floor), 1.0)
            covariance = (g.eigenvectors.swapaxes(1, 2) * g.eigenvalues[:, None]) @ g.eigenvectors
            diagonal = np.arange(noise.shape[1])
            covariance[:, diagonal, diagonal] += noise
            solved = np.linalg.solve(covariance, y)
            coefficients[g.rows] = (g.spread @ (g.eigenvectors @ solved))[..., 0]
        return coefficients

    def cells(self, coefficients: Array) -> Array:
        """Inverse transform; overwrites its argument."""
        return fwht_in_place(coefficients) / self.n_cells

    def variance(self, ratio: float) -> Array:
        """Variance of each cell after the measurement, without the mean, for a unit prior.

        Cell p has sum over i, j of h_ip h_jp V_ij / n^2, and h_ip h_jp is row i xor j: one
        transform of the sums over equal i xor j.
        """
        explained = np.zeros(self.n_cells)
        ratio = max(ratio, self.floor)
        for g in self.groups:
            sums = (g.pairs @ (1 / (g.eigenvalues + ratio) * g.shown)[..., None])[..., 0]
            np.add.at(explained, g.lags, sums)
        return self.prior_variance - fwht_in_place(explained) / self.n_cells**2

    @property
    def floor(self) -> float:
        """Keeps roundoff from making a block singular where there is no noise."""
        return 1e-12 * self.trace / self.n_cells + 1e-300


def bytes_needed(shape: tuple[int, int], indices: Integers) -> int:
    """Memory for the blocks of a subset: eigenvectors, what spreads them, and their pairs."""
    shown = np.zeros(shape[0] * shape[1], dtype=bool)
    shown[indices] = True
    total = 0
    for down in _classes(shape[0]):
        for along in _classes(shape[1]):
            rows = (down[:, None] * shape[1] + along).ravel()
            m = int(shown[rows].sum())
            # The whole block's covariance is made first, whatever is shown of it.
            total += 8 * (rows.size**2 + m * m + 2 * rows.size * m) if m else 0
    return total


def _classes(n: int) -> list[Integers]:
    """Indices that one axis couples. The smallest classes go together: fewer products."""
    by_class: dict[tuple[int, int], list[int]] = defaultdict(list)
    for index in range(n):
        by_class[max(index.bit_length(), 3), index.bit_count() % 2].append(index)
    return [np.array(members) for members in by_class.values()]


def _covariance(shape: tuple[int, int], down: Integers, along: Integers) -> Array:
    """H C H^T between the rows ``down x along``."""
    products = []
    for n, index in zip(shape, (down, along), strict=True):
        spectrum = np.fft.fft(hadamard_rows(index, n), axis=1) / np.sqrt(n)
        both = np.real(spectrum[:, None] * spectrum[None].conj())
        products.append(both.reshape(-1, n))
    covariance = products[0] @ prior_spectrum(*shape) @ products[1].T
    a, b = down.size, along.size
    return covariance.reshape(a, a, b, b).swapaxes(1, 2).reshape(a * b, a * b)


def _group(place: Integers, members: list[tuple[Integers, Array]]) -> Group:
    n = members[0][0].size
    m = max(int(np.count_nonzero(place[rows] >= 0)) for rows, _ in members)
    parts = [_padded(place, rows, covariance, m) for rows, covariance in members]
    stacked = [np.stack(arrays) for arrays in zip(*parts, strict=True)]
    rows = np.stack([rows for rows, _ in members])
    spread = stacked[4]
    lags = rows ^ rows[:, :1]
    pairs = np.empty_like(spread)
    for g in range(len(members)):
        order = np.argsort(rows[g])
        for lag in range(n):
            partner = order[np.searchsorted(rows[g], rows[g] ^ lags[g, lag], sorter=order)]
            pairs[g, lag] = np.einsum("ik,ik->k", spread[g], spread[g, partner])
    place_of, shown, vectors, values = stacked[:4]
    return Group(place_of, shown, vectors, values, spread, rows, pairs, lags)


def _padded(
    place: Integers, rows: Integers, covariance: Array, m: int
) -> tuple[Integers, Array, Array, Array, Array]:
    """Place, shown, eigenvectors, eigenvalues and spread of one block, padded to m."""
    shown = np.flatnonzero(place[rows] >= 0)
    k = shown.size
    eigenvalues, u = np.linalg.eigh(covariance[np.ix_(shown, shown)])
    places, mask, values = np.zeros(m, np.intp), np.zeros(m), np.zeros(m)
    vectors, spread = np.zeros((m, m)), np.zeros((rows.size, m))
    places[:k], mask[:k], values[:k] = place[rows[shown]], 1.0, np.maximum(eigenvalues, 0.0)
    vectors[:k, :k], spread[:, :k] = u.T, covariance[:, shown] @ u
    return places, mask, vectors, values, spread
