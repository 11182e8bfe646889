"""Inverse Hadamard transform; patterns that were not shown count as zero."""

import numpy as np

from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing


@method("zero-fill", grid_only=True)
def zero_fill(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, Array]:
    """Inverse transform, patterns not shown count as zero.

    x = H^T y / n. The error is that of the noise alone, without that of missing patterns.
    """
    n = sensing.n_cells
    error = np.sqrt(noise_variance * sensing.count) / n
    return sensing.adjoint(values) / n, np.full(n, error)
