"""The orthonormal cosine transform (DCT-II) of images: products up to 128 cells, FFT above."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Side up to which two small matrix products are faster.
_LARGEST_PRODUCT = 128


@lru_cache(maxsize=16)
def dct_matrix(n: int) -> Array:
    """Orthonormal DCT-II, one basis function per row, ``(n, n)``."""
    k, j = np.arange(n)[:, None], np.arange(n) + 0.5
    matrix = np.sqrt(2 / n) * np.cos(np.pi * k * j / n)
    matrix[0] /= np.sqrt(2)
    matrix.flags.writeable = False
    return np.asarray(matrix)


def filtered(cells: Array, weight: Array) -> Array:
    """Multiply images ``(n_cells, ...)`` by a weight ``(rows, columns)`` in the cosine domain."""
    if max(weight.shape) > _LARGEST_PRODUCT:
        from scipy import fft  # takes 0.1 s to import

        images = cells.reshape(*weight.shape, -1)
        spectrum = fft.dctn(images, axes=(0, 1), norm="ortho") * weight[..., None]
        return np.asarray(fft.idctn(spectrum, axes=(0, 1), norm="ortho").reshape(cells.shape))
    down, along = (dct_matrix(n) for n in weight.shape)
    images = np.ascontiguousarray(cells.reshape(len(weight) * weight.shape[1], -1).T)
    spectrum = down @ images.reshape(-1, *weight.shape) @ along.T * weight
    return (down.T @ spectrum @ along).reshape(len(images), -1).T.reshape(cells.shape)
