"""Images of patterns by their inverse transform, for what is linear in the exposures."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz, toeplitz

from hardware.patterns import OwnPatterns, Patterns, PatternSet, RasterScan, fwht, fwht_in_place
from hardware.reconstruction.measurements import measured_values
from hardware.reconstruction.noise import finest_patterns
from hardware.reconstruction.sensing import Sensing

Array = NDArray[np.float64]

_AT_ONCE = 2**21  # pairs of patterns: some 50 MB


def inverse_image(electrons: Array, patterns: Patterns) -> Array:
    """Cells (n_cells, n_images) of exposures (n_exposures, n_images); of a user's own patterns by
    least squares.
    """
    if isinstance(patterns, RasterScan):
        each = 2 if patterns.mode == "differential" else 1
        return electrons[::each] - (electrons[1::2] if each == 2 else 0.0)
    return _of_values(measured_values(electrons, patterns), patterns)


def _of_values(values: Array, patterns: Patterns) -> Array:
    """Cells (n_cells, n_images) of measured values (count, n_images)."""
    if isinstance(patterns, RasterScan):
        return values
    if not isinstance(patterns, PatternSet):
        return np.asarray(Sensing(patterns).pseudo_inverse @ values)
    coefficients = np.zeros((patterns.n_cells, values.shape[-1]))
    coefficients[patterns.indices] = values
    return np.asarray(fwht_in_place(coefficients) / patterns.n_cells)


def variance_of_cells(covariance: Array, patterns: Patterns) -> Array:
    """Variance in each cell of `inverse_image`, (n_cells,), of noise whose ``covariance`` between
    exposures 0, 1, ... apart, (n_exposures,), is known up to a constant; of a plain scan, which
    does not take the constant out, less the mean of all exposures.

    A value is the difference of a pair, or a multiple of one exposure less a constant in all.
    """
    if patterns.mode == "differential":
        next_one, before = covariance[1::2], np.append(covariance[1], covariance[1:-2:2])
        return _of_stationary(2 * covariance[::2] - next_one - before, patterns)
    count, factor = patterns.count, 1.0 if isinstance(patterns, RasterScan) else 2.0
    constant = _constant(patterns)
    beside = matmul_toeplitz(covariance, constant)
    ones, linked = _of_values(np.stack([np.ones(count), beside[-count:]], axis=1), patterns).T
    own = _of_stationary(factor**2 * covariance[:count], patterns)
    return np.asarray(own - 2 * factor * ones * linked + ones**2 * (constant @ beside))


def _constant(patterns: Patterns) -> Array:
    """Weights of the exposures, (n_exposures,), in the constant that `measured_values` takes from
    every value.
    """
    weights = np.zeros(patterns.n_exposures)
    if patterns.mode == "reference":
        weights[:2] = 1.0
    elif isinstance(patterns, PatternSet):
        finest = finest_patterns(patterns)
        weights[finest] = 2.0 / max(finest.size, 1)
    else:
        weights[:] = (2.0 if isinstance(patterns, OwnPatterns) else 1.0) / patterns.n_exposures
    return weights


def _of_stationary(covariance: Array, patterns: Patterns) -> Array:
    """Variance of cells, (n_cells,), of values whose covariance depends on their distance alone,
    (count,).
    """
    if isinstance(patterns, RasterScan):
        return np.full(patterns.n_cells, covariance[0])
    if not isinstance(patterns, PatternSet):
        inverse = Sensing(patterns).pseudo_inverse
        return np.asarray(np.sum(inverse @ toeplitz(covariance) * inverse, axis=1))
    # The product of two rows of the Hadamard matrix is a third one.
    rows, by_row = patterns.indices, np.zeros(patterns.n_cells)
    places = np.arange(patterns.count)
    for some in np.array_split(places, max(1, patterns.count**2 // _AT_ONCE)):
        product = rows[some][:, None] ^ rows
        of_pair = covariance[np.abs(some[:, None] - places)]
        by_row += np.bincount(product.ravel(), of_pair.ravel(), minlength=patterns.n_cells)
    return np.asarray(fwht(by_row) / patterns.n_cells**2)
