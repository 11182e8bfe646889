"""What a set of patterns does not see of an image: how large it is by the prior, and where it acts.

All that is unseen is the projection P x of the image on what no pattern measures. Of rows of the
Hadamard matrix these are the rows that are not there.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import fwht
from hardware.reconstruction.cosine import filtered
from hardware.reconstruction.prior import cell_variance, prior_spectrum, walsh_variance
from hardware.reconstruction.projection import singular_vectors
from hardware.reconstruction.sensing import Sensing

Array = NDArray[np.float64]

#: Prior variances of unseen rows within this factor are taken as one.
_BIN = 2.0
#: Share of what is seen that counts as its finest.
_FINEST = 1 / 8


@dataclass(frozen=True, eq=False)
class Unseen:
    """What is unseen, for a prior of scale 1.

    ``count`` dimensions, the mean not among them; ``told`` are those of detail that are seen.
    ``typical`` (k,) are the prior variances of
    unseen measurements, in bins with shares ``weight`` (k,) of all unseen variance; ``finest`` is
    that below which the finest eighth of what is seen lies. ``variance``
    (n_cells,) is that of each cell of P x. ``kernel`` is the transform of what cells q add to the
    unseen at p, P_pq^2 by p xor q, over its sum; ``local`` (n_cells,) is P_pp, which stands for it
    where P is no matrix of Hadamard rows.
    """

    count: int
    told: int
    typical: Array
    weight: Array
    finest: float
    variance: Array
    kernel: Array | None
    local: Array

    def spread(self, activity: Array) -> Array:
        """The variance of P x in each cell, relative, where that of x has the share ``activity``.

        Rows far apart have a P near the identity: their detail stays where it is. A single row
        shifts all cells alike, wherever the detail stands.
        """
        if self.kernel is not None:
            return np.maximum(fwht(fwht(activity) * self.kernel) / activity.size, 0.0)
        return self.local * activity + (1 - self.local) * float(activity.mean())


@lru_cache(maxsize=16)
def unseen_of(sensing: Sensing) -> Unseen:
    """What the patterns, behind their mixing, do not see."""
    return _of_matrix(sensing) if sensing.is_dense else _of_hadamard_rows(sensing)


def _of_hadamard_rows(sensing: Sensing) -> Unseen:
    n, variance = sensing.n_cells, walsh_variance(*sensing.shape)
    missing = np.ones(n)
    missing[sensing.indices] = 0.0
    missing[0] = 0.0  # the mean has an error of its own
    rows = np.flatnonzero(missing)
    squared = fwht(missing) ** 2
    kernel = fwht(squared) / max(float(squared.sum()), 1.0)
    cells = np.full(n, variance[rows].sum() / n**2)
    shown = variance[sensing.indices]
    finest = float(np.quantile(shown[shown > 0], _FINEST)) if shown.any() else np.inf
    local = np.full(n, rows.size / n)
    told = n - 1 - rows.size
    return Unseen(rows.size, told, *_binned(variance[rows]), finest, cells, kernel, local)


def _binned(variance: Array) -> tuple[Array, Array]:
    """Means of variances within a factor, and the shares of such bins in their sum."""
    if not variance.size:
        return variance, variance
    step = np.floor(np.log(variance.max() / variance) / np.log(_BIN) + 1e-9).astype(np.intp)
    number, total = np.bincount(step), np.bincount(step, variance)
    filled = number > 0
    return total[filled] / number[filled], total[filled] / total.sum()


def _of_matrix(sensing: Sensing) -> Unseen:
    """Of any matrix: its unseen directions count with the mean of their prior variances.

    Raises InputError where no pattern differs from the others.
    """
    _, size, vt = singular_vectors(sensing)
    if size[0] < 1e-9:
        raise InputError("patterns: all alike, so that plain exposures tell nothing of the image")
    seen = vt[size > 1e-9 * size[0]].T
    count, n = sensing.n_cells - seen.shape[1], sensing.n_cells
    told = seen.shape[1] - sensing.measures_level
    if count == 0:
        none = np.zeros(0)
        return Unseen(0, told, none, none, 0.0, np.zeros(n), None, np.zeros(n))
    covariance = filtered(seen, prior_spectrum(*sensing.shape))
    between = seen.T @ covariance
    cells = cell_variance(*sensing.shape) - 2 * np.einsum("ij,ij->i", seen, covariance)
    cells = np.maximum(cells + np.einsum("ij,ij->i", seen @ between, seen), 0.0)
    local = 1 - np.einsum("ij,ij->i", seen, seen)
    typical = np.array([cells.sum() / count])  # of a direction of unit length, as the next
    finest = float(np.quantile(np.linalg.eigvalsh(between), _FINEST))
    gain = float(np.mean(size[: seen.shape[1]] ** 2))
    return Unseen(count, told, gain * typical, np.ones(1), gain * finest, cells, None, local)
