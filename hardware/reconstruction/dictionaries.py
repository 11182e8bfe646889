"""Orthonormal dictionaries in which images are sparse: DCT-II and Haar, as outer products."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.prior import prior_spectrum

Array = NDArray[np.float64]


@lru_cache(maxsize=16)
def haar_matrix(n: int) -> Array:
    """Orthonormal Haar functions, coarse to fine, one per row. ``n`` is a power of two."""
    if n & (n - 1):
        raise InputError(f"Haar functions: {n} is not a power of two")
    matrix = np.ones((1, 1))
    while len(matrix) < n:
        half = len(matrix)
        matrix = np.vstack(
            [np.kron(matrix, [1.0, 1.0]), np.kron(np.eye(half), [1.0, -1.0])]
        ) / np.sqrt(2)
    return matrix


DICTIONARIES = {"dct": dct_matrix, "haar": haar_matrix}


@lru_cache(maxsize=16)
def prior_deviation(name: str, rows: int, columns: int) -> Array:
    """Standard deviation of each coefficient under the unit 1/f^2 prior, ``(rows, columns)``.

    0 for the constant, which stays out of the prior.
    """
    down, along = ((DICTIONARIES[name](n) @ dct_matrix(n).T) ** 2 for n in (rows, columns))
    variance = down @ prior_spectrum(rows, columns) @ along.T
    variance[0, 0] = 0.0
    return np.asarray(np.sqrt(variance))
