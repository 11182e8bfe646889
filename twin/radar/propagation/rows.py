"""Products and lengths of vectors in rows of three: sums of NumPy along so short an axis take three
times as long.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dots(one: Array, other: Array) -> Array:
    """Of vectors (n, 3) each, (n,)."""
    products: Array = np.einsum("ij,ij->i", one, other)
    return products


def lengths(vectors: Array) -> Array:
    """Of vectors (n, 3), (n,)."""
    return np.sqrt(dots(vectors, vectors))
