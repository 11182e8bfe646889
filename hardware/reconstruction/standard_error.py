"""Standard errors that cover unseen detail, scaled to the data (empirical Bayes).

The prior tells how unseen detail is spread over patterns, not how much of it this picture has, nor
where. Two kinds of it are told apart.

Beyond: patterns finer than most of those shown. The scale comes from the finest that were shown,
which are nearest to them; the place from the image, whose unseen detail stands where seen detail
does. What is left is one factor, chosen on every other one of the 22 test pictures
(`benchmarks.pictures`).

Between: patterns lost, or left out, among others as coarse. Each has the scale of those of about
its prior variance, without any factor, and shifts the cells that its own shape reaches: a single
one all of them alike (`hardware.reconstruction.unseen.Unseen.spread`). As more than half of all
patterns are shown, those beyond come to count as these.

Errors of unseen detail are not normal: how much of it pictures have differs, and it stands at
edges. So 95 % of them lie within more than 1.96 standard errors (`errors_in_95`), chosen on those
eleven pictures and their quarters.

Coverage of LMMSE on the other eleven, noise of 0, 0.01 and 0.1 of the range, means over pictures,
from 64 of 32 x 32 cells and 128 of 64 x 64 up to half of all: 67 to 72 % lie within one standard
error, 93 to 97 % within `errors_in_95` of them (of 64 of 4096 cells 92 %), 85 to 94 % within 1.96.

On all 22, 32 x 32, noise 0 to 0.01: with 1, 10 or 100 of 1024 patterns lost 93 to 96 %, with 1 or
10 of the 64 coarsest 93 to 95 %, with 10 consecutive coarse ones 92 to 94 %; of the first 600 to
1020 95 to 100 %, of 100 to 512 drawn by chance 95 to 97 %. At noise of 0.1 and 0.3 full sets and
those with up to 100 lost patterns have 96 and 97 % (what smoothing takes of them is told by the
measurements, `lmmse.smoothed_away`). Where pictures are as rich at their finest as the prior, the
first 600 to 800 hold 90 to 95 %, the first half 87 to 94 %. The plain inverse: 90 to 99 %. Of
random patterns of a user's own, 16 x 16, 32 to 255 of 256: 94 to 99 %, least squares 94 to 100 %.

Of independent patterns fewer than about ten, the scale of what is unseen is told by so few values
that Student's quantile of them takes the place of `errors_in_95`; of a single one none is told.

A single picture may be off by much more, as detail that is nowhere in the patterns shown is not
foreseen: with one lost pattern and no noise all cells of 6 % of the images lie outside.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction.noise import student
from hardware.reconstruction.prior import prior_scale, walsh_variance
from hardware.reconstruction.sensing import Sensing
from hardware.reconstruction.unseen import unseen_of

Array = NDArray[np.float64]

#: Share of unseen detail that is spread evenly; keeps the error of a flat part above 0.
_EVEN = 0.05
#: Factor on the error of detail beyond what was seen: pictures are smoother there than the prior.
_SMOOTHER = 0.71

#: Variance within blocks over the mean square below which it is roundoff of their difference.
_ROUNDOFF = 1e-12


def detail_scale(
    values: Array, variance: Array, noise_variance: float, ratio: float, wanted: float = 0.0
) -> float:
    """Scale of the prior for detail of the variance ``wanted``, of the finest where that is 0.

    ``values`` have the ``variance`` v under a prior of scale 1, ``ratio`` is r = noise over the
    scale of all values. Mean of (y^2 - noise) / v with weights (v / u)^2, u = v + r, which is the
    statistical precision, times (w / u)^3 for coarser and u / w for finer values than the wanted w:
    of those that are finer there are more. The standard error of that mean is added: detail lost in
    the scatter of the noise is not taken for none.
    """
    added = max(ratio, 1e-9 * float(variance.max()))
    level = variance + added
    share = max(wanted + added, float(level.min())) / level
    nearness = np.where(share < 1, share * share * share, 1 / share)
    weight = nearness * variance / (level * level)  # over v
    excess = float(weight @ (values * values)) - noise_variance * float(weight.sum())
    scatter = noise_variance * math.sqrt(2 * float(weight @ weight))
    return (max(excess, 0.0) + scatter) / float(weight @ variance)


def unseen_detail(
    each: Array,
    stands: Array,
    independent: tuple[Array, Array],
    noise_variance: float,
    ratio: float,
    sensing: Sensing,
) -> Array:
    """Mean square of what is unseen in each cell, ``(n_cells,)``.

    ``each`` (n_cells,) is that of a prior of scale 1, ``stands`` the `activity`, ``independent``
    the values with their prior variances as in `detail_scale`.
    """
    unseen = unseen_of(sensing)
    if not unseen.count:
        return np.zeros(sensing.n_cells)
    data = *independent, noise_variance, ratio
    within = unseen.typical > unseen.finest
    near = sum(
        float(share) * detail_scale(*data, float(wanted))
        for wanted, share in zip(unseen.typical[within], unseen.weight[within], strict=True)
    )
    far = float(unseen.weight[~within].sum()) * detail_scale(*data)
    nearness = 1 - min(2 * unseen.count / sensing.n_cells, 1.0) ** 2
    near = (near + nearness * far) * (calibration(sensing) / _SMOOTHER) ** 2
    far *= (1 - nearness) * calibration(sensing) ** 2
    return each * (far * stands + near * unseen.spread(stands))


def tells_detail(sensing: Sensing) -> bool:
    """Whether it is known how large unseen detail is: not where one sum of the cells is all that is
    measured, as of a single pattern, however often it is shown.
    """
    unseen = unseen_of(sensing)
    return unseen.count == 0 or unseen.told > 0


def structure(values: Array, sensing: Sensing) -> tuple[Array, Array]:
    """Values of Hadamard rows, and their variances for a prior of scale 1; 0 for the mean."""
    return values, walsh_variance(*sensing.shape)[sensing.indices]


def error_of_plain_inverse(
    cells: Array,
    noise: Array,
    independent: tuple[Array, Array],
    noise_variance: float,
    sensing: Sensing,
) -> Array:
    """Standard error of cells in which what is unseen counts as zero, ``(n_cells,)``.

    ``noise`` (n_cells,) is their mean square error by noise, ``independent`` the measurements with
    their prior variances (`structure`).
    """
    values, variance = independent
    told = variance > 0
    energy = float(values[told] @ values[told])
    count, expected = int(np.count_nonzero(told)), float(variance.sum())
    scale = prior_scale(energy, count, noise_variance, expected)
    unseen = unseen_of(sensing)
    if not tells_detail(sensing):
        return np.full(cells.size, np.nan)
    if unseen.count == 0 or scale == 0:
        return np.sqrt(noise)
    stands, ratio = activity(cells, sensing), noise_variance / scale
    detail = unseen_detail(unseen.variance, stands, independent, noise_variance, ratio, sensing)
    return np.sqrt(noise + detail)


def activity(cells: Array, sensing: Sensing, noise: float | Array = 0.0) -> Array:
    """Where unseen detail stands, ``(n_cells,)`` of mean 1: as the variance within blocks.

    A block is about twice as high and wide as what independent patterns resolve. Where ``noise``,
    the variance of the noise in the cells, explains that variance, it tells no place.
    """
    count = _resolved(sensing)
    high, wide = (_block(side, count) for side in sensing.shape)
    strips, ones = cells.reshape(-1, wide), np.ones(wide)
    grid = (sensing.shape[0] // high, high, sensing.shape[1] // wide)
    mean, square = (
        (values @ ones).reshape(grid).sum(axis=1) / (high * wide) for values in (strips, strips**2)
    )
    variance = np.maximum(square - mean**2, 0.0)
    total = float(variance.mean())
    if total <= _ROUNDOFF * float(square.mean()):
        return np.ones(cells.size)
    even = min(max(_EVEN, float(np.mean(noise)) / total), 1.0)
    share = even + (1 - even) / total * variance
    return share.repeat(high, 0).repeat(wide, 1).ravel()


@lru_cache(maxsize=16)
def _block(side: int, count: int) -> int:
    """Cells of a block along a side: near twice what is resolved, and a divisor of the side."""
    wanted = max(2.0, 2.2 * side / math.sqrt(count))
    divisors = [n for n in range(1, side + 1) if side % n == 0]
    return min(divisors, key=lambda n: abs(math.log(n / wanted)))


def _resolved(sensing: Sensing) -> int:
    """Independent patterns: those that are shown again, or are sums of others, tell no detail."""
    return max(unseen_of(sensing).told + sensing.measures_level, 1)


def calibration(sensing: Sensing) -> float:
    """Factor on the error of detail beyond, with which 68 and 95 % of all cells lie within 1 and
    1.96.

    Pictures are smoother at their finest than the prior, and their errors less normal; few
    patterns tell less of the scale.
    """
    return _SMOOTHER * (1 + 1.6 / math.sqrt(_resolved(sensing)))


def errors_in_95(sensing: Sensing) -> float:
    """How many standard errors hold 95 % of all cells: the more the farther unseen detail is from
    the finest that was seen, from whose scale its own is taken, and no fewer than Student's for a
    scale of as many values as tell detail; 1.96 where only noise is left.
    """
    unseen = unseen_of(sensing)
    if unseen.count == 0:
        return 1.96
    farther = math.log2(sensing.n_cells / max(sensing.n_cells - unseen.count, 1)) / 4
    return max(2 + farther, student(unseen.told))
