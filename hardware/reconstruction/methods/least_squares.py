"""Least squares: the plain inverse of any patterns, with nothing assumed of the image."""

import numpy as np

from hardware.reconstruction.methods.lmmse import lmmse, lmmse_plan
from hardware.reconstruction.methods.zero_fill import zero_fill
from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing
from hardware.reconstruction.standard_error import error_of_plain_inverse, errors_in_95
from hardware.reconstruction.unseen import unseen_of


@method("least-squares", errors_in_95=errors_in_95, linear=True)
def least_squares(
    values: Array, noise_variance: float, sensing: Sensing
) -> tuple[Array, Array | None]:
    """Least squares of least norm, for any patterns; what they do not measure counts as zero.

    The error is that of the noise and of what is not measured, as far as the 1/f^2 prior foresees
    it from what is (`hardware.reconstruction.standard_error`). Of rows of the Hadamard matrix it is
    zero-fill.
    """
    if not sensing.is_dense:
        return zero_fill(values, noise_variance, sensing)
    inverse = sensing.pseudo_inverse
    cells, noise = inverse @ values, noise_variance * np.einsum("ij,ij->i", inverse, inverse)
    if unseen_of(sensing).count == 0:  # no prior is needed
        return cells, np.sqrt(noise)
    level = float(lmmse(values, noise_variance, sensing)[0].mean())
    of_level = level * (1 - inverse @ sensing.of_flat)
    noise += of_level**2  # what is not measured of a flat image, which the prior leaves out
    independent = lmmse_plan(sensing).structure(values)
    return cells, error_of_plain_inverse(cells, noise, independent, noise_variance, sensing)
