"""The 1/f^2 prior of natural images, its covariance, and its scale from the measurements.

Natural images have power spectra near 1/f^2 (Field, J. Opt. Soc. Am. A 4, 1987). The covariance C
is circulant, diagonal in Fourier space. The mean is measured, not guessed: it stays out of it.
"""

from functools import lru_cache

import numpy as np
from numpy import fft
from numpy.typing import NDArray

from hardware.patterns.orders import spectra, squared_frequency

Array = NDArray[np.float64]


@lru_cache(maxsize=8)
def prior_spectrum(rows: int, columns: int) -> Array:
    """Eigenvalues of the unit prior, 1/f^2 in cycles per image, 0 for the mean."""
    spectrum = 1 / squared_frequency(rows, columns)
    spectrum.flags.writeable = False
    return spectrum


@lru_cache(maxsize=8)
def walsh_variance(rows: int, columns: int) -> Array:
    """Diagonal of H C H^T: prior variance of every Hadamard measurement, natural order."""
    spectrum = prior_spectrum(rows, columns)
    variance = np.asarray((spectra(rows) @ spectrum @ spectra(columns).T).ravel())
    variance[0] = 0.0  # exactly
    variance.flags.writeable = False
    return variance


def filtered(cells: Array, weight: Array) -> Array:
    """Multiply ``(n_cells, ...)`` by a real, even weight ``(rows, columns)`` in Fourier space."""
    image = cells.reshape(*weight.shape, -1)
    half = weight[:, : weight.shape[1] // 2 + 1, None]
    spectrum = fft.rfft2(image, axes=(0, 1)) * half
    return fft.irfft2(spectrum, s=weight.shape, axes=(0, 1)).reshape(cells.shape)


def prior_scale(energy: float, count: int, noise_variance: float, expected: float) -> float:
    """Scale of the prior by the method of moments: sum(y^2) = scale tr(A C A^T) + count s.

    ``energy`` is the sum, ``expected`` the trace. Never below what a signal lost in the scatter of
    the noise could have; 0 when the mean is all that is measured.
    """
    if expected <= 0:
        return 0.0
    excess = energy - count * noise_variance
    return float(max(excess, np.sqrt(2 * count) * noise_variance) / expected)
