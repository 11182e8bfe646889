"""Inverse Hadamard transform; patterns that were not shown count as zero."""

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet, fwht


def zero_fill(
    values: NDArray[np.float64], noise_variance: float, patterns: PatternSet
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cells x = H^T y / n and their standard error, both ``(n_cells,)`` in electrons.

    The error is that of the noise alone; what unseen patterns would have added is not in it.
    """
    error = np.sqrt(noise_variance * patterns.count) / patterns.n_cells
    return spread(values, patterns) / patterns.n_cells, np.full(patterns.n_cells, error)


def spread(values: NDArray[np.float64], patterns: PatternSet) -> NDArray[np.float64]:
    """H^T y: measurements ``(count, ...)`` back onto the cells ``(n_cells, ...)``."""
    coefficients = np.zeros((patterns.n_cells, *values.shape[1:]))
    coefficients[patterns.indices] = values
    return fwht(coefficients)
