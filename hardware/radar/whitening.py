"""Whitening of noise that several channels share, by range, before powers are added.

Phase noise of the leakage is the same for all receivers. The mean power of V channels with common
noise varies as if there were fewer of them (the effective number of looks, mean^2 over variance),
and exceeds a threshold for V independent channels far too often. After multiplication by the
inverse root of the noise covariance the channels are independent and equally noisy; the power of
an echo is preserved in the mean over directions, and its SNR is highest from directions other than
that of the common noise.

A combination of channels without noise, a dead channel or the difference between one and its copy,
tells nothing: divided by its noise, which is rounding error, it would be all there is.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

_BLOCKS = 32  # of ranges, at most, each with a covariance of its own
_CELLS = 40  # of a block, per channel: the covariance is known within a sixth
_LOUD = 6.0  # times the median, above which a cell counts as an echo
_ALIKE = 2.0  # neighbouring cells correlated by a window, which count as one
#: Power of noise over the largest, below which it is none: of 16 bits full scale has 1e10 times the
#: power of rounding, and no receiver has less noise than that.
_NONE = 1e-10


def whiten(images: Sequence[Complex]) -> tuple[list[Complex], float]:
    """Whitened images (n_rates, n_ranges) of channels, and their effective looks before whitening.

    Without significant correlation the images are not changed, and the looks are their number;
    otherwise the looks are the least over range. Combinations of channels without noise are left
    out: there are fewer images then, with the power of all.
    """
    n = len(images)
    n_rates, n_ranges = images[0].shape
    size = max(-(-n_ranges // _BLOCKS), -(-4 * _CELLS * n // n_rates))
    if n == 1 or n_rates * n_ranges < 4 * _CELLS * n:
        return list(images), float(n)
    stack = np.stack(images)
    looks = float(n)
    for start in range(0, n_ranges, size):
        # Of the images, since a last, short block is told by ranges that are whitened already.
        first = max(0, min(start, n_ranges - size))
        covariance, n_cells = _covariance(np.stack([i[:, first : start + size] for i in images]))
        values, vectors = np.linalg.eigh(covariance)
        if values[-1] <= 0:
            continue
        if values[0] <= _NONE * values[-1]:
            noisy = vectors[:, values > _NONE * values[-1]].conj().T.astype(stack.dtype)
            return whiten(list(np.tensordot(noisy, np.stack(images), axes=1)))
        chance = np.sqrt(_ALIKE * n / n_cells)
        if values[-1] / values[0] < ((1 + chance) / (1 - chance)) ** 2:
            continue  # as far apart as independent noise makes them (Marchenko and Pastur, 1967)
        looks = min(looks, float(values.sum() ** 2 / np.sum(values**2)))
        mean = n / np.sum(1 / values)
        root = (vectors * np.sqrt(mean / values)) @ vectors.conj().T
        block = stack[..., start : start + size]
        block[...] = np.tensordot(root.astype(stack.dtype), block, axes=1)
    return list(stack), looks


def _covariance(part: Complex) -> tuple[Complex, int]:
    """Covariance of channels (n_channels, n_rates, n_ranges) over every other cell that holds no
    strong echo, and their number.
    """
    cells = part[:, ::2, ::2].reshape(len(part), -1)
    power = np.mean(np.abs(cells) ** 2, axis=0)
    quiet = cells[:, power <= _LOUD * np.median(power)]
    covariance = quiet @ quiet.conj().T / quiet.shape[1]
    return np.asarray(covariance.astype(np.complex128)), quiet.shape[1]
