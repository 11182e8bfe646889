"""Linear minimum mean-square error under a 1/f^2 prior, in closed form.

Natural images have power spectra near 1/f^2 (Field, J. Opt. Soc. Am. A 4, 1987). With a prior
covariance C that is circulant (diagonal in Fourier space), measured rows H and white noise of
variance s:

    x = C H^T (H C H^T + s I)^-1 y

For a full pattern set H^T H = n I and the whole estimate is a Wiener filter behind the inverse
transform. For a subset the matrix in brackets is small; what is left is one fast Walsh-Hadamard
and one fast Fourier transform. The mean is measured, not guessed: it stays out of the prior.
"""

from functools import lru_cache

import numpy as np
from numpy import fft
from numpy.typing import NDArray

from hardware.patterns import PatternSet, fwht
from hardware.reconstruction.zero_fill import spread

Array = NDArray[np.float64]


def lmmse(values: Array, noise_variance: float, patterns: PatternSet) -> tuple[Array, Array]:
    """Cells and their standard error, both ``(n_cells,)`` in electrons.

    The prior's scale comes from the measurements themselves. The standard error is the
    posterior's, mean over the image: noise and unseen detail together.
    """
    n = patterns.n_cells
    is_mean = patterns.indices == 0
    mean = values[is_mean].sum() / n
    structure = np.where(is_mean, 0.0, values)
    scale = _prior_scale(structure, noise_variance, patterns)
    if scale == 0:  # noiseless and without structure
        return np.full(n, mean), np.zeros(n)
    solve = _wiener if patterns.count == n else _subset
    image, posterior = solve(structure, noise_variance / scale, patterns)
    return mean + image, np.full(n, np.sqrt(scale * posterior + noise_variance / n**2))


def _wiener(values: Array, ratio: float, patterns: PatternSet) -> tuple[Array, float]:
    prior = _prior_spectrum(patterns.rows, patterns.columns)
    weight = prior / (prior + ratio / patterns.n_cells + np.finfo(float).tiny)
    image = _filter(spread(values, patterns) / patterns.n_cells, weight)
    return image, float(np.mean(prior * (1 - weight)))


def _subset(values: Array, ratio: float, patterns: PatternSet) -> tuple[Array, float]:
    from scipy import linalg  # takes 0.1 s to import

    prior = _prior_spectrum(patterns.rows, patterns.columns)
    gram = _gram(patterns, 1)
    # Roundoff alone must not make the matrix singular where there is no noise.
    ridge = max(ratio, 1e-12 * float(np.trace(gram)) / patterns.count)
    factor = linalg.cho_factor(gram + ridge * np.eye(patterns.count), lower=True)
    image = _filter(spread(linalg.cho_solve(factor, values), patterns), prior)
    explained = np.trace(linalg.cho_solve(factor, _gram(patterns, 2))) / patterns.n_cells
    return image, max(float(np.mean(prior) - explained), 0.0)


def _prior_scale(structure: Array, noise_variance: float, patterns: PatternSet) -> float:
    """Scale of the prior by the method of moments: sum(y^2) = scale tr(H C H^T) + count s.

    Never below what a signal lost in the scatter of the noise could have.
    """
    prior = _prior_spectrum(patterns.rows, patterns.columns)
    full = patterns.count == patterns.n_cells
    expected = patterns.n_cells * prior.sum() if full else float(np.trace(_gram(patterns, 1)))
    if expected == 0:  # the mean is the only pattern
        return 0.0
    excess = float(np.sum(structure**2)) - patterns.count * noise_variance
    return max(excess, np.sqrt(2 * patterns.count) * noise_variance) / expected


@lru_cache(maxsize=8)
def _gram(patterns: PatternSet, power: int) -> Array:
    """H C^power H^T of the patterns shown, ``(count, count)``."""
    prior = _prior_spectrum(patterns.rows, patterns.columns)
    rows = np.zeros((patterns.n_cells, patterns.count))
    rows[patterns.indices, np.arange(patterns.count)] = 1.0
    gram = fwht(_filter(fwht(rows), prior**power))[patterns.indices]
    gram.flags.writeable = False
    return gram


@lru_cache(maxsize=8)
def _prior_spectrum(rows: int, columns: int) -> Array:
    """Eigenvalues of the unit prior, 1/f^2 in cycles per image, 0 for the mean."""
    f2 = fft.fftfreq(rows, 1 / rows)[:, None] ** 2 + fft.fftfreq(columns, 1 / columns) ** 2
    f2[0, 0] = np.inf
    spectrum = 1 / f2
    spectrum.flags.writeable = False
    return spectrum


def _filter(cells: Array, weight: Array) -> Array:
    """Multiply ``(n_cells, ...)`` by a real, even weight ``(rows, columns)`` in Fourier space."""
    image = cells.reshape(*weight.shape, -1)
    half = weight[:, : weight.shape[1] // 2 + 1, None]
    filtered = fft.irfft2(fft.rfft2(image, axes=(0, 1)) * half, s=weight.shape, axes=(0, 1))
    return filtered.reshape(cells.shape)
