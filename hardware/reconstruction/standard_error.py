"""Standard errors of LMMSE that cover: unseen detail scaled to the data (empirical Bayes).

The prior tells how unseen detail is spread over patterns, not how much of it this picture has, nor
where. Its scale comes from the finest patterns that were shown, which are nearest to those that
were not; its place from the image, whose unseen detail stands where seen detail does. What is left
is one factor, chosen on every other one of the 22 test pictures (`benchmarks.pictures`).

Errors of unseen detail are not normal: how much of it pictures have differs, and it stands at
edges. So 95 % of them lie within more than 1.96 standard errors (`errors_in_95`), chosen on those
eleven pictures and their quarters.

Coverage on the other eleven, noise of 0, 0.01 and 0.1 of the range, means over pictures, from 64 of
32 x 32 cells and 128 of 64 x 64 up to half of all: 67 to 72 % lie within one standard error, 93 to
97 % within `errors_in_95` of them (of 64 of 4096 cells 92 %), 85 to 94 % within 1.96. A single
picture may be off by much more, as detail that is nowhere in the patterns shown is not foreseen.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction.sensing import Sensing

Array = NDArray[np.float64]

#: Share of unseen detail that is spread evenly; keeps the error of a flat part above 0.
_EVEN = 0.05


def detail_scale(values: Array, variance: Array, noise_variance: float, ratio: float) -> float:
    """Scale of the prior, as the finest detail above the noise has it.

    ``values`` have the ``variance`` v under a prior of scale 1, ``ratio`` is r = noise over the
    scale of all values. Mean of (y^2 - noise) / v with weights v^2 / (v + r)^5: as 1 / v^3 where
    there is no noise, as the statistical precision where there is little else. The standard error
    of that mean is added: detail lost in the scatter of the noise is not taken for none.
    """
    least = variance + max(ratio, 1e-9 * float(variance.max()))
    share = float(least.min()) / least
    square = share * share
    weight = square * square * share * variance  # v^2 / (v + r)^5, over v
    excess = float(weight @ (values * values)) - noise_variance * float(weight.sum())
    scatter = noise_variance * math.sqrt(2 * float(weight @ weight))
    return (max(excess, 0.0) + scatter) / float(weight @ variance)


def activity(cells: Array, sensing: Sensing) -> Array:
    """Where unseen detail stands, ``(n_cells,)`` of mean 1: as the variance within blocks.

    A block is about twice as high and wide as what ``count`` patterns resolve.
    """
    high, wide = (_block(side, sensing.count) for side in sensing.shape)
    strips, ones = cells.reshape(-1, wide), np.ones(wide)
    grid = (sensing.shape[0] // high, high, sensing.shape[1] // wide)
    mean, square = (
        (values @ ones).reshape(grid).sum(axis=1) / (high * wide) for values in (strips, strips**2)
    )
    variance = np.maximum(square - mean**2, 0.0)
    total = float(variance.mean())
    if total == 0:
        return np.ones(cells.size)
    share = _EVEN + (1 - _EVEN) / total * variance
    return share.repeat(high, 0).repeat(wide, 1).ravel()


@lru_cache(maxsize=16)
def _block(side: int, count: int) -> int:
    """Cells of a block along a side: near twice what is resolved, and a divisor of the side."""
    wanted = max(2.0, 2.2 * side / math.sqrt(count))
    divisors = [n for n in range(1, side + 1) if side % n == 0]
    return min(divisors, key=lambda n: abs(math.log(n / wanted)))


def calibration(count: int) -> float:
    """Factor on the error of detail with which 68 and 95 % of all cells lie within 1 and 1.96.

    Pictures are smoother at their finest than the prior, and their errors less normal; few
    patterns tell less of the scale.
    """
    return 0.71 * (1 + 1.6 / np.sqrt(count))


def errors_in_95(sensing: Sensing) -> float:
    """How many standard errors hold 95 % of all cells: the more the farther unseen detail is from
    the finest that was seen, from whose scale its own is taken; 1.96 where only noise is left.
    """
    if sensing.count >= sensing.n_cells:
        return 1.96
    return 2 + math.log2(sensing.n_cells / sensing.count) / 4
