"""Least squares: the plain inverse of any patterns, with nothing assumed of the image."""

import numpy as np

from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing


@method("least-squares")
def least_squares(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, Array]:
    """Least squares of least norm, for any patterns; what they do not measure counts as zero.

    The error is that of the noise alone; what unseen patterns would have added is not in it. Of
    rows of the Hadamard matrix it is zero-fill.
    """
    if not sensing.is_dense:
        n = sensing.n_cells
        return sensing.adjoint(values) / n, np.full(n, np.sqrt(noise_variance * sensing.count) / n)
    inverse = sensing.pseudo_inverse
    return inverse @ values, np.sqrt(noise_variance * np.einsum("ij,ij->i", inverse, inverse))
