"""Gamma numbers that follow their shape: with the same draws, a little more light gives a little
more multiplied charge. `Generator.gamma` rejects some of its draws, others where the shape is
another, and all that come behind are other ones then.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Shape from which on the expansion is taken: 3e-8 of a standard deviation off up to 6 of them.
_EXPANDED_FROM = 1e4


def gamma(shape: Array, rng: np.random.Generator) -> Array:
    """Gamma numbers of scale 1, of any shapes from 0 up: a normal draw each, and the quantile of
    its probability; 0 of shape 0.
    """
    return gamma_quantile(rng.standard_normal(np.shape(shape)), shape)


def gamma_quantile(normal: Array, shape: Array) -> Array:
    """Numbers that are exceeded as often as ``normal``, in standard deviations.

    From `_EXPANDED_FROM` on by the Cornish-Fisher expansion about the normal one (Abramowitz and
    Stegun, 26.2.49, with the cumulants of the gamma distribution).
    """
    from scipy.special import gammainccinv, gammaincinv, ndtr

    z, k = np.broadcast_arrays(normal, shape)
    root = np.sqrt(k)
    with np.errstate(divide="ignore", invalid="ignore"):  # of a shape of 0, which is small
        third = (z**3 - 7 * z) / (36 * root)
        fourth = (3 * z**4 + 7 * z**2 - 16) / (810 * k)
        found = k + root * z + (z * z - 1) / 3 + third - fourth
    small = k < _EXPANDED_FROM
    for few, inverse in ((small & (z < 0), gammaincinv), (small & (z >= 0), gammainccinv)):
        # Either tail by its own probability, which is no difference from 1.
        found[few] = inverse(k[few], ndtr(-np.abs(z[few])))
    return np.where(k > 0, found, 0.0)
