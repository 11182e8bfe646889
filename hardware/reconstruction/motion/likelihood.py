"""Minus the logarithm of the marginal likelihood of measurements, for the scale that fits best."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def with_noise(gram: Array, noise_over_scale: float) -> Array:
    """Covariance of measurements in units of their scale: ``gram`` (m, m) of the image at scale
    one, and independent noise.
    """
    system = gram.copy()
    np.fill_diagonal(system, gram.diagonal() + noise_over_scale)
    return system


def cost_of(gram: Array, values: Array, noise_over_scale: Array) -> float:
    """Sum over images of minus the log-likelihood; infinite where a covariance is not positive.

    The scale that maximises the likelihood of one image is ``y' K^-1 y / m`` (Rasmussen and
    Williams, Gaussian Processes for Machine Learning, 2006, eq. 2.30, with the scale profiled out).

    Parameters
    ----------
    gram : (m, m)
        Covariance of the measurements of an image of unit scale, without noise.
    values : (m, n_images)
        Measurements without their mean.
    noise_over_scale : (n_images,)
        Variance of the noise of one measurement over the scale of the image.
    """
    from scipy.linalg import LinAlgError, cho_factor, cho_solve  # takes 0.1 s to import

    total, m = 0.0, len(values)
    for y, noise in zip(values.T, noise_over_scale, strict=True):
        system = with_noise(gram, float(noise))
        try:
            factor = cho_factor(system, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            return float("inf")
        misfit = float(y @ cho_solve(factor, y, check_finite=False))
        total += m / 2 * np.log(max(misfit, 1e-300) / m)
        total += float(np.log(factor[0].diagonal()).sum())
    return float(total)
