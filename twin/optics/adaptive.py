"""Light of the cells of a grid to a stated error: paths are added where they are needed.

A first look draws a few independent sets of paths in every cell; their scatter is the error of
their mean. Where it matters, more paths are drawn, anew, so that how many are drawn does not depend
on what they bring; until the error of all cells together is as small as asked.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from twin.engine import mitsuba
from twin.optics.devices import RaySet
from twin.optics.small_surfaces import least_samples
from twin.optics.tracer import RAYS_AT_ONCE, Tracer
from twin.optics.transport import CellLight

Array = NDArray[np.float64]

#: Independent sets of paths in a cell: their scatter has this number less one degrees of freedom.
_SETS = 4
_ROUNDS = 6
#: Of the squared error asked for, what is planned for: estimates of it scatter.
_MARGIN = 0.8
#: Keys of draws, apart from those of rows of cells.
_DRAWS = 2**16
#: Paths of a cell in all, at most.
_MOST = _SETS * 128**2


@dataclass(eq=False)
class _Part:
    """Direct, scattered or indirect light of all cells: mean and its variance, (n_cells,).

    Parameters
    ----------
    trace
        Light of the paths of a set of rays.
    falls
        Power of the number of paths with which the variance falls.
    cost
        Of a path, over that of direct light.
    first
        Paths of a set to begin with.
    window
        Cells, to a side, over which variances are taken together.
    """

    tracer: Tracer
    trace: Callable[[RaySet], Any]
    falls: float
    cost: float
    first: int
    window: int
    mean: Array = field(init=False)
    #: As estimated, and as stated: no less than that of the cells around.
    variance: Array = field(init=False)
    stated: Array = field(init=False)
    #: Paths of a set, by cell.
    samples: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        n = self.tracer.start.size
        self.mean, self.variance, self.stated = np.zeros((3, n))
        self.samples = np.full(n, self.first)
        self.draw(np.arange(n, dtype=np.uint32), self.first, 0)

    def draw(self, cells: NDArray[np.uint32], samples: int, turn: int) -> None:
        """Paths of these cells anew, in place of all before."""
        scatter = np.empty(len(cells))
        at_once = max(1, RAYS_AT_ONCE // (samples * _SETS))
        for start in range(0, len(cells), at_once):
            some = slice(start, start + at_once)
            rays = RaySet(cells[some], samples, _SETS, draw=(_DRAWS + turn, samples, start))
            value = mitsuba().Float64(self.trace(rays))
            sets = np.array(dr.block_reduce(dr.ReduceOp.Add, value, samples)) / samples
            sets = sets.reshape(-1, _SETS)
            self.mean[cells[some]] = sets.mean(axis=1)
            scatter[some] = sets.var(axis=1, ddof=1) / _SETS
        around = self._around(cells, scatter)
        self.variance[cells] = (scatter + around) / 2
        self.stated[cells] = np.maximum(scatter, around)
        self.samples[cells] = samples

    def _around(self, cells: NDArray[np.uint32], values: Array) -> Array:
        """Mean of the values of the cells around that are among these."""
        shape = (self.tracer.start.rows, self.tracer.start.columns)
        total, count = np.zeros((2, self.tracer.start.size))
        total[cells], count[cells] = values, 1
        total, count = (
            uniform_filter(x.reshape(shape), self.window, mode="constant").ravel()[cells]
            for x in (total, count)
        )
        return np.maximum(total / count, 0)


def gather_within(
    tracer: Tracer, permitted: Callable[[Array], Array], boxes_m: Array | None = None
) -> CellLight:
    """Light that each cell receives, as `gather`, with as many paths as its error needs.

    ``permitted``: of light (rows, columns) the error that each cell may have, infinite where any
    is; the root mean square over the cells of error over permitted comes below 1, unless that takes
    more paths than a cell may have: `CellLight.standard_error` says what was reached. Bounces end
    by chance instead of at a largest number, so that no light is lost.

    ``boxes_m``: of the surfaces, as `LightProblem` has them: cells before small ones begin with as
    many paths as it takes to meet them.

    The standard error is from the scatter of independent sets of paths, no less than the mean
    over the cells around; and for indirect light what a kind of path may bring that none of the
    paths around has found: up to direct light over their number.
    """
    shape = (tracer.start.rows, tracer.start.columns)
    parts = [_Part(tracer, lambda rays: tracer.direct(rays).value, 1.5, 1.0, 4, 3)]
    if tracer.scatters:
        parts.append(_Part(tracer, lambda rays: tracer.scattered(rays).value, 1.0, 3.0, 4, 5))
    parts.append(_Part(tracer, tracer.all_indirect, 1.0, 4.0, 1, 5))
    if boxes_m is not None:
        _draw_more(parts[0], least_samples(tracer.start, boxes_m), 0)
    for turn in range(1, _ROUNDS + 1):
        light = np.sum([part.mean for part in parts], axis=0)
        limit = permitted(light.reshape(shape)).ravel()
        weight = 1 / np.maximum(limit, 1e-150) ** 2 / limit.size
        stated = [part.stated.copy() for part in parts]
        unseen = (parts[0].mean / (_SETS * parts[-1].samples * parts[-1].window ** 2)) ** 2
        stated[-1] += unseen
        if sum(float(part @ weight) for part in stated) <= 1:
            break
        variances = [part.variance * weight for part in parts]
        variances[-1] += unseen * weight
        # What is stated is more than what is estimated, and is to come below 1.
        share = sum(map(np.sum, variances)) / sum(float(part @ weight) for part in stated)
        wanted = _wanted(parts, variances, _MARGIN * share)
        drawn = [_draw_more(*pair, turn) for pair in zip(parts, wanted, strict=True)]
        if not any(drawn):
            break
    direct, error = light - parts[-1].mean, np.sqrt(np.sum(stated, axis=0))
    return CellLight(*(x.reshape(shape) for x in (direct, parts[-1].mean, error)))


def _draw_more(part: _Part, samples: NDArray[np.int64], turn: int) -> bool:
    """Draw as many paths of a set where there are fewer; whether there were such cells."""
    more = samples > part.samples
    for number in np.unique(samples[more]):
        part.draw(np.flatnonzero(more & (samples == number)).astype(np.uint32), int(number), turn)
    return bool(more.any())


def _wanted(
    parts: Sequence[_Part], variances: Sequence[Array], target: float
) -> list[NDArray[np.int64]]:
    """Paths of a set of each cell that bring the sum of the variances to ``target`` at the least
    cost.

    By a Lagrange multiplier: the variance a n^-p of n paths at cost c n is worth them up to
    n = (a p / (c multiplier))^(1 / (p + 1)).
    """
    low, high = -60.0, 60.0
    for _ in range(30):
        middle = (low + high) / 2
        wanted = [_affordable(*pair, middle) for pair in zip(parts, variances, strict=True)]
        left = sum(
            float(np.sum(a * (n / part.samples) ** -part.falls))
            for part, a, n in zip(parts, variances, wanted, strict=True)
        )
        low, high = (middle, high) if left <= target else (low, middle)
    return [_on_ladder(*pair) for pair in zip(parts, wanted, strict=True)]


def _affordable(part: _Part, variance: Array, log_price: float) -> Array:
    at_one = variance * part.samples.astype(float) ** part.falls
    n = (at_one * part.falls / part.cost * np.exp(-log_price)) ** (1 / (part.falls + 1))
    return np.asarray(np.clip(n, part.samples, _MOST / _SETS))


def _on_ladder(part: _Part, wanted: Array) -> NDArray[np.int64]:
    """The next square number among those that lie a factor of 2 apart; few launches then do."""
    steps = np.ceil(np.log2(wanted / part.first) - 1e-9)
    return np.asarray(np.rint(np.sqrt(part.first * 2.0**steps)).astype(np.int64) ** 2)
