"""Inverse Hadamard transform; patterns that were not shown count as zero."""

import numpy as np

from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing
from hardware.reconstruction.standard_error import error_of_plain_inverse, errors_in_95, structure


@method("zero-fill", grid_only=True, errors_in_95=errors_in_95, linear=True)
def zero_fill(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, Array]:
    """Inverse transform, patterns not shown count as zero.

    x = H^T y / n. The error is that of the noise and of what missing patterns would have added,
    as far as those shown tell it (`hardware.reconstruction.standard_error`).
    """
    n = sensing.n_cells
    cells = sensing.adjoint(values) / n
    noise = np.full(n, noise_variance * sensing.count / n**2)
    independent = structure(values, sensing)
    return cells, error_of_plain_inverse(cells, noise, independent, noise_variance, sensing)
