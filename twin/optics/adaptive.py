"""Light of the cells of a grid to a stated error: paths are added where they are needed.

A first look draws a few independent sets of paths in every cell; their scatter is the error of
their mean. Where it matters, more paths are drawn, anew, so that how many are drawn does not depend
on what they bring; until the error of all cells together is as small as asked.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from twin.engine import mitsuba
from twin.optics.paths import DeviceLight
from twin.optics.ray_sets import CellRays, Rays
from twin.optics.tracer import RAYS_AT_ONCE, Tracer
from twin.optics.transport import CellLight
from twin.optics.unseen import contrast, facet_light

Array = NDArray[np.float64]

#: Independent sets of paths in a cell: their scatter has this number less one degrees of freedom.
_SETS = 4
_ROUNDS = 8
#: Of a cell's paths from round to round at most: the first look exaggerates what may be missed.
_GROWTH = 16
#: Of the squared error asked for, what is planned for: estimates of it scatter.
_MARGIN = 0.9
#: Cells whose sets agree by chance are the ones that are not drawn anew: their variance is more
#: than its estimate, by this factor in the yard.
_CHOSEN = 1.15
#: Keys of draws, apart from those of rows of cells.
_DRAWS = 2**16
#: Paths of a set at most, of one cell and of all together.
_MOST, _MOST_TOGETHER = 128**2, 2**17
#: Paths of a set of all cells together where the first look found no light at all.
_IN_THE_DARK = 2**18


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
    trace: Callable[[Rays], Any]
    falls: float
    cost: float
    first: int
    window: int
    mean: Array = field(init=False)
    variance: Array = field(init=False)
    #: Paths of a set, by cell.
    samples: NDArray[np.int64] = field(init=False)
    #: Light of the brightest path of all.
    brightest: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        n = self.tracer.start.size
        self.mean, self.variance = np.zeros((2, n))
        self.samples = np.full(n, self.first)
        self.draw(np.arange(n), self.samples, 0)

    @property
    def paths(self) -> NDArray[np.int64]:
        """Of each cell, in all its sets."""
        return _SETS * self.samples

    def draw(self, cells: NDArray[np.integer], samples: NDArray[np.integer], turn: int) -> None:
        """Paths of these cells anew, in place of all before, ``samples`` of a set in each."""
        scatter = np.empty(len(cells))
        portion = np.cumsum(samples * _SETS) // RAYS_AT_ONCE
        for number in np.unique(portion):
            some = np.flatnonzero(portion == number)
            rays = CellRays(cells[some], samples[some], _SETS, (_DRAWS + turn, int(number)))
            value = np.array(mitsuba().Float64(self.trace(rays)))
            self.brightest = max(self.brightest, float(value.max()))
            sets = np.add.reduceat(value, rays.set_starts).reshape(-1, _SETS)
            sets /= samples[some, None]
            self.mean[cells[some]] = sets.mean(axis=1)
            scatter[some] = sets.var(axis=1, ddof=1) / _SETS
        # Of one path, so that cells of different numbers of paths compare.
        per_path = samples.astype(float) ** self.falls
        around = self._around(cells, scatter * per_path) / per_path
        self.variance[cells] = (scatter + around) / 2
        self.samples[cells] = samples

    def _around(self, cells: NDArray[np.integer], values: Array) -> Array:
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
    tracer: Tracer,
    permitted: Callable[[Array], Array],
    corners: Callable[[], tuple[Array, Array]] | None = None,
) -> CellLight:
    """Light that each cell receives, as `gather`, with as many paths as its error needs.

    ``permitted``: of light (rows, columns) the error that each cell may have, infinite where any
    is; the root mean square over the cells of error over permitted comes below 1, unless that takes
    more paths than a cell may have: `CellLight.standard_error` says what was reached. Bounces end
    by chance instead of at a largest number, so that no light is lost.

    The standard error is from the scatter of independent sets of paths, half of it that of the
    cells around; with what all paths of a cell may miss: one path's share of the contrast to the
    cells around and, with ``corners`` as `LightProblem` has them, of the brightest facet that may
    be there; and for indirect light one path's share, among those of the cells around, of direct
    light or of the brightest path.
    """
    shape = (tracer.start.rows, tracer.start.columns)
    parts = [_Part(tracer, lambda rays: tracer.direct(rays).value, 1.5, 1.0, 4, 3)]
    if tracer.scatters:
        parts.append(_Part(tracer, lambda rays: tracer.scattered(rays).value, 1.0, 3.0, 4, 5))
    parts.append(_Part(tracer, tracer.all_indirect, 1.0, 4.0, 1, 5))
    facets = np.zeros(tracer.start.size)
    if corners is not None and isinstance(tracer.light, DeviceLight):
        facets = facet_light(tracer.start, tracer.light.device, corners())
    if not any(part.mean.any() for part in parts):
        samples = math.isqrt(_IN_THE_DARK // tracer.start.size) ** 2
        for part in parts:
            _draw_more(part, np.full(tracer.start.size, max(samples, 1)), 0)
    for turn in range(1, _ROUNDS + 1):
        light = np.sum([part.mean for part in parts], axis=0)
        limit = permitted(light.reshape(shape)).ravel()
        weight = 1 / np.maximum(limit, 1e-150) ** 2 / limit.size
        variances = _variances(parts, facets, shape)
        if turn == _ROUNDS or sum(float(variance @ weight) for variance in variances) <= 1:
            break
        wanted = _wanted(parts, [variance * weight for variance in variances], up=turn > 1)
        drawn = [_draw_more(*pair, turn) for pair in zip(parts, wanted, strict=True)]
        if not any(drawn):
            break
    direct, error = light - parts[-1].mean, np.sqrt(np.sum(variances, axis=0))
    return CellLight(*(x.reshape(shape) for x in (direct, parts[-1].mean, error)))


def _variances(parts: Sequence[_Part], facets: Array, shape: tuple[int, int]) -> list[Array]:
    """Of each part: from its scatter, and of what all its paths may have missed."""
    direct, indirect = parts[0], parts[-1]
    variances = [_CHOSEN * part.variance for part in parts]
    missed = np.maximum(facets, contrast(direct.mean.reshape(shape)))
    # Up to one path's share, any of which is as likely as any other.
    variances[0] += (missed / direct.paths) ** 2 / 3
    missed = np.maximum(direct.mean, indirect.brightest)
    variances[-1] += (missed / (indirect.paths * indirect.window**2)) ** 2
    return variances


def _draw_more(part: _Part, samples: NDArray[np.int64], turn: int) -> bool:
    """Draw as many paths of a set where there are fewer; whether there are such cells."""
    more = np.flatnonzero(samples > part.samples)
    if len(more):
        part.draw(more, samples[more], turn)
    return bool(len(more))


def _wanted(
    parts: Sequence[_Part], variances: Sequence[Array], *, up: bool
) -> list[NDArray[np.int64]]:
    """Paths of a set of each cell that bring the sum of the variances to `_MARGIN` at the least
    cost; ``up``: rounded up, since the nearest numbers were too few.

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
        low, high = (middle, high) if left <= _MARGIN else (low, middle)
    return [_square_number(*pair, up) for pair in zip(parts, wanted, strict=True)]


def _affordable(part: _Part, variance: Array, log_price: float) -> Array:
    at_one = variance * part.samples.astype(float) ** part.falls
    n = (at_one * part.falls / part.cost * np.exp(-log_price)) ** (1 / (part.falls + 1))
    return np.asarray(np.clip(n, part.samples, max(_MOST, _MOST_TOGETHER / len(n))))


def _square_number(part: _Part, wanted: Array, up: bool) -> NDArray[np.int64]:
    """The nearest square number among those that lie a factor of 2 apart, or the next one up."""
    steps = np.log2(np.minimum(wanted, _GROWTH * part.samples) / part.first)
    steps = np.ceil(steps - 1e-9) if up else np.rint(steps)
    return np.asarray(np.rint(np.sqrt(part.first * 2.0**steps)).astype(np.int64) ** 2)
