"""The 1/f^2 prior of natural images, its covariance, and its scale from the measurements.

Natural images have power spectra near 1/f^2 (Field, J. Opt. Soc. Am. A 4, 1987). The covariance C
is diagonal in the cosine transform: an image goes on beyond its edge as its own mirror image. A
circulant one, diagonal in Fourier space, would tie each edge to the opposite one, with which it
has nothing to do; that costs 0.2 to 0.5 dB. The mean is measured, not guessed: it stays out of it,
and where no pattern measures it, `hardware.reconstruct` says so.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import fwht
from hardware.reconstruction.cosine import dct_matrix

Array = NDArray[np.float64]


@lru_cache(maxsize=8)
def prior_spectrum(rows: int, columns: int) -> Array:
    """Eigenvalues of the unit prior, one per cosine function, 1/f^2; 0 for the mean.

    Function k has k/2 cycles per image.
    """
    f2 = (np.arange(rows)[:, None] ** 2 + np.arange(columns) ** 2) / 4.0
    f2[0, 0] = np.inf
    return _kept(1 / f2)


@lru_cache(maxsize=8)
def walsh_variance(rows: int, columns: int) -> Array:
    """Diagonal of H C H^T: prior variance of every Hadamard measurement, natural order."""
    down, along = (walsh_to_cosine(n) ** 2 for n in (rows, columns))
    return _kept((down @ prior_spectrum(rows, columns) @ along.T).ravel())


@lru_cache(maxsize=8)
def cell_variance(rows: int, columns: int) -> Array:
    """Diagonal of C, ``(n_cells,)``."""
    return mean_square(prior_spectrum(rows, columns))


def mean_square(spectrum: Array) -> Array:
    """Variance of each cell for variances of the cosine coefficients, ``(n_cells,)``."""
    down, along = (_squared_cosines(n) for n in spectrum.shape)
    return np.asarray((down.T @ spectrum @ along).ravel())


@lru_cache(maxsize=8)
def _squared_cosines(n: int) -> Array:
    return _kept(dct_matrix(n) ** 2)


@lru_cache(maxsize=8)
def walsh_to_cosine(n: int) -> Array:
    """Cosine spectrum of each Hadamard row in natural order, ``(n, n)``."""
    spectra = fwht(dct_matrix(n).T)
    spectra[np.abs(spectra) < 1e-12] = 0.0  # a row and a function of other parity, exactly
    return _kept(spectra)


def prior_scale(energy: float, count: int, noise_variance: float, expected: float) -> float:
    """Scale of the prior by the method of moments: sum(y^2) = scale tr(A C A^T) + count s.

    ``energy`` is the sum, ``expected`` the trace. Never below what a signal lost in the scatter of
    the noise could have; 0 when the mean is all that is measured.
    """
    if expected <= 0:
        return 0.0
    excess = energy - count * noise_variance
    return float(max(excess, np.sqrt(2 * count) * noise_variance) / expected)


def _kept(array: Array) -> Array:
    array.flags.writeable = False
    return array
