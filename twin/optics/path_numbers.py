"""How many paths of each part of the light bring its error to what is asked for, or as near to it
as the rays that are left allow.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.optics.path_sets import SETS, PathSets
from twin.optics.paths import RAYS

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Of a cell's paths from round to round at most: the first look exaggerates what may be missed.
_GROWTH = 16
#: Of the squared error asked for, what is planned for: estimates of it scatter.
_MARGIN = 0.9
#: Range of the logarithm of the paths' worth, and halvings of it: to 0.7 %.
_RANGE, _BISECTIONS = (-60.0, 60.0), 14
#: Paths of a set at most, of one cell and of all together, with the usual number of rays.
_MOST, _MOST_TOGETHER = 128**2, 2**17


def wanted_paths(parts: Sequence[PathSets], variances: Sequence[Array], *, up: bool) -> list[Ints]:
    """Paths of a set of each half of each cell, (n_cells, 2), that bring the sum of the variances
    to `_MARGIN` at the least cost; ``up``: rounded up, since the nearest numbers were too few.
    """
    best = _best(parts, variances)
    at_one = [
        a * part.samples.astype(float) ** part.falls
        for part, a in zip(parts, variances, strict=True)
    ]
    low, high = _RANGE
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        wanted = _worth(parts, best, middle)
        left = sum(
            float(np.sum(a * n**-part.falls))
            for part, a, n in zip(parts, at_one, wanted, strict=True)
        )
        low, high = (middle, high) if left <= _MARGIN else (low, middle)
    rounded = np.ceil if up else np.rint
    return [_power_of_2(*pair, rounded) for pair in zip(parts, wanted, strict=True)]


def affordable_paths(
    parts: Sequence[PathSets], variances: Sequence[Array], rays: float
) -> list[Ints]:
    """The same with as many further rays as there may be, in place of an error."""
    best = _best(parts, variances)
    low, high = _RANGE
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        enough = further_rays(parts, _rounded_down(parts, best, middle)) <= rays
        low, high = (low, middle) if enough else (middle, high)
    return _rounded_down(parts, best, high)


def further_rays(parts: Sequence[PathSets], samples: Sequence[Ints]) -> float:
    """Rays that it takes to continue the sets to these numbers of paths."""
    return sum(
        part.rays_per_path * float(np.maximum(n - part.samples, 0).sum()) * (SETS // 2)
        for part, n in zip(parts, samples, strict=True)
    )


def _best(parts: Sequence[PathSets], variances: Sequence[Array]) -> list[Array]:
    """Paths that are worth their cost where a variance of 1 is worth a cost of 1.

    By a Lagrange multiplier: the variance a n^-p of n paths at cost c n is worth them up to
    n = (a p / (c multiplier))^(1 / (p + 1)).
    """
    return [
        (a * part.samples.astype(float) ** part.falls * part.falls / part.cost)
        ** (1 / (part.falls + 1))
        for part, a in zip(parts, variances, strict=True)
    ]


def _worth(parts: Sequence[PathSets], best: Sequence[Array], multiplier: float) -> list[Array]:
    """Paths where a variance is worth less by the logarithm of a multiplier; none are taken back.

    A cell has as many at most as it may have with the usual number of rays, in proportion to it.
    """
    found = []
    for part, n in zip(parts, best, strict=True):
        most = max(_MOST, _MOST_TOGETHER / len(n)) * max(1.0, part.tracer.quality.rays / RAYS)
        found.append(
            np.clip(n * math.exp(-multiplier / (part.falls + 1)), part.samples.astype(float), most)
        )
    return found


def _rounded_down(
    parts: Sequence[PathSets], best: Sequence[Array], multiplier: float
) -> list[Ints]:
    wanted = _worth(parts, best, multiplier)
    return [_power_of_2(*pair, np.floor) for pair in zip(parts, wanted, strict=True)]


def _power_of_2(part: PathSets, wanted: Array, rounded: np.ufunc) -> Ints:
    """A power of 2 times the first number, its logarithm rounded; whole ones stay."""
    steps = np.log2(np.minimum(wanted, _GROWTH * part.samples) / part.first)
    if rounded is not np.rint:
        steps = steps + (-1e-9 if rounded is np.ceil else 1e-9)
    steps = rounded(steps)
    return np.asarray(part.first * 2 ** np.maximum(steps, 0).astype(np.int64))
