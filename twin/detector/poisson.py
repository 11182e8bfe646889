"""Poisson numbers that follow their mean: with the same draws, a little more light gives a little
more charge. `Generator.poisson` rejects some of its draws, others where the mean is another, and
all that come behind are other ones then.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Mean from which on the expansion is taken: one number of 1e5 is off there, by 1.
_EXPANDED_FROM = 1e3


def poisson(mean: Array, rng: np.random.Generator) -> Array:
    """Poisson numbers, as float64, of any means from 0 up: a normal draw each, and the quantile of
    its probability.
    """
    return poisson_quantile(rng.standard_normal(np.shape(mean)), mean)


def poisson_quantile(normal: Array, mean: Array) -> Array:
    """The least numbers whose probability not to be exceeded is at least that of ``normal``, in
    standard deviations.

    From `_EXPANDED_FROM` on by the Cornish-Fisher expansion about the normal one (Giles, ACM Trans.
    Math. Softw. 42, 2016).
    """
    from scipy.special import ndtr, pdtrik

    z, m = np.broadcast_arrays(normal, mean)
    root = np.sqrt(m)
    few = m < _EXPANDED_FROM
    with np.errstate(divide="ignore", invalid="ignore"):  # of a mean of 0, which is few
        found = np.floor(m + root * z + (z * z + 2) / 6 - z * (z * z + 2) / (72 * root))
    if few.any():
        exact = np.ceil(pdtrik(np.minimum(ndtr(z[few]), 1 - 1e-16), np.maximum(m[few], 1e-300)))
        found[few] = np.where(m[few] > 0, np.maximum(np.nan_to_num(exact), 0.0), 0.0)
    return np.asarray(found)
