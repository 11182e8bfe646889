"""Independent sets of paths from each cell of a grid: their mean light, and its variance.

Four sets hardly know the variance of a cell whose light scatters as that of no cell around: a tiny
bright facet, of which all four happen to meet as many points, seemed right and was 4 % off. Such
cells have further sets in the end.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from twin.engine import mitsuba
from twin.optics.ray_sets import CellRays, Rays
from twin.optics.tracer import RAYS_AT_ONCE, Tracer

Array = NDArray[np.float64]

#: Independent sets of paths in a cell, in two halves: their scatter has this number less one
#: degrees of freedom.
SETS = 4
#: Keys of draws, apart from those of rows of cells.
DRAWS = 2**16
#: Further sets of a half of a cell that needs them: where its scatter is so many times that around.
_FURTHER, _ALONE = 6, 6.0
#: Times the variance of a cell that scatters alone, which its own sets have to tell: by Student's
#: distribution 1.96 deviations then hold 95 %, with what `adaptive` adds.
_FEW = 2.3


@dataclass(eq=False)
class PathSets:
    """Direct, scattered or indirect light of all cells: mean and its variance, (n_cells,).

    Parameters
    ----------
    shift
        Of the random numbers that shift the paths' sequences.
    trace
        Light of the paths of a set of rays, and the rays to surfaces that each path takes: an array
        or, where all take as many, a number.
    falls
        Power of the number of paths with which the variance falls; 1: of rare bright paths.
    cost
        Of a path, over that of direct light.
    first
        Paths of a set to begin with.
    window
        Cells, to a side, over which variances are taken together.
    """

    tracer: Tracer
    shift: int
    trace: Callable[[Rays], tuple[Any, Any]]
    falls: float
    cost: float
    first: int
    window: int
    mean: Array = field(init=False)
    #: Paths of a set of each half, and the mean of each half, (n_cells, 2); the sum of the light of
    #: each set, (n_cells, sets).
    samples: NDArray[np.int64] = field(init=False)
    halves: Array = field(init=False)
    sums: Array = field(init=False)
    #: Variance of a half of sets of one path, as each half finds it itself, (n_cells, 2): by all
    #: its paths or, where bright ones are rare, by those of the first look.
    of_path: Array = field(init=False)
    #: Variance of all sets of one path, by those of each cell itself, and with its share of the
    #: cells around, (n_cells,).
    own: Array = field(init=False)
    shared: Array = field(init=False)
    #: Paths of each further set of a half, 0 if it has none, and the variance of the half's mean by
    #: all its sets, (n_cells, 2).
    further: NDArray[np.int64] = field(init=False)
    by_all: Array = field(init=False)
    #: Light of the brightest path of all; the time that all of them took, and their rays.
    brightest: float = field(init=False, default=0.0)
    cost_s: float = field(init=False, default=0.0)
    rays: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        n = self.tracer.start.size
        self.mean, self.own, self.shared = np.zeros((3, n))
        self.sums = np.zeros((n, SETS))
        self.halves, self.of_path, self.by_all = np.zeros((3, n, 2))
        self.samples, self.further = np.zeros((2, n, 2), np.int64)
        self.draw(np.arange(n), np.full((n, 2), self.first), 0)

    @property
    def paths(self) -> NDArray[np.int64]:
        """Of each cell, in all its sets."""
        return np.asarray((self.samples * (SETS // 2) + self.further * _FURTHER).sum(axis=1))

    @property
    def variance(self) -> Array:
        """Of the mean, (n_cells,): where a cell scatters alone, those around tell nothing of it."""
        part = self.samples.astype(float) ** -self.falls
        is_alone = (self.own > _ALONE * self._beside(self.own)) & (self.falls > 1)
        by_sets = np.where(is_alone, _FEW * self.own, self.shared) * part.sum(axis=1) / 4
        return np.where((self.further > 0).all(axis=1), self.by_all.sum(axis=1) / 4, by_sets)

    @property
    def rays_per_path(self) -> float:
        """Mean over all paths so far."""
        return self.rays / float(self.paths.sum())

    def draw(self, cells: NDArray[np.integer], samples: NDArray[np.integer], turn: int) -> None:
        """Continue the sets of these cells until there are ``samples`` paths in each of a half."""
        start, before = time.perf_counter(), np.repeat(self.samples[cells], SETS // 2, axis=1)
        further = np.repeat(samples, SETS // 2, axis=1) - before
        portion = np.cumsum(further.sum(axis=1)) // RAYS_AT_ONCE
        for number in np.unique(portion):
            some = np.flatnonzero(portion == number)
            key = (DRAWS + turn, int(number))
            rays = CellRays(cells[some], before[some], further[some], SETS, self.shift, key)
            value = self._traced(rays)
            drawn, sums = further[some].ravel() > 0, np.zeros(some.size * SETS)
            sums[drawn] = np.add.reduceat(value, rays.set_starts[drawn])
            self.sums[cells[some]] += sums.reshape(-1, SETS)
        self.samples[cells] = samples
        sets = (self.sums[cells] / np.repeat(samples, SETS // 2, axis=1)).reshape(-1, 2, SETS // 2)
        halves = sets.mean(axis=2)
        self.halves[cells], self.mean[cells] = halves, halves.mean(axis=1)
        # Of one path, so that cells of different numbers of paths compare.
        part = samples.astype(float) ** -self.falls
        within = sets.var(axis=2, ddof=1) / (SETS // 2) / part
        between = np.diff(halves, axis=1)[:, 0] ** 2 / part.sum(axis=1)
        if turn == 0 or self.falls > 1:
            for half in (0, 1):
                own = within[:, half]
                found = (own + self._around(cells, own)) / 2
                # Most windows have none of rare paths: they are likely wherever some were.
                self.of_path[cells, half] = found if self.falls > 1 else (found + found.mean()) / 2
        own = (within.sum(axis=1) * (SETS // 2 - 1) + between) / (SETS - 1)
        self.own[cells], self.shared[cells] = own, (own + self._around(cells, own)) / 2
        self.cost_s += time.perf_counter() - start

    def settle(self, permitted: Array, missed: Array, turn: int, most_paths: float) -> None:
        """Further sets where the other half of a cell's sets scatters as no cell around does, by
        more than a ``permitted`` variance, or where a set may miss as much: ``missed``, of one
        path, (n_cells,). As far as ``most_paths`` of each half go; none is continued afterwards.
        """
        start, part = time.perf_counter(), self.samples.astype(float) ** -self.falls
        sets = (self.sums / np.repeat(self.samples, SETS // 2, axis=1)).reshape(-1, 2, SETS // 2)
        of_halves = sets.var(axis=2, ddof=1) / (SETS // 2)
        of_halves = np.where(self.further > 0, self.by_all, of_halves)
        of_path = of_halves / part
        beside = np.stack([self._beside(column) for column in of_path.T], axis=1)
        is_unsure = (of_path > _ALONE * beside) & (of_halves / 2 > permitted[:, None])
        is_unsure |= (missed[:, None] / self.samples) ** 2 / SETS / 3 > permitted[:, None]
        for half in (0, 1):
            cells = np.flatnonzero(is_unsure[:, 1 - half] & (self.further[:, half] == 0))
            paths = np.cumsum(self.samples[cells, half]) * _FURTHER
            cells, portion = cells[paths <= most_paths], paths[paths <= most_paths] // RAYS_AT_ONCE
            for number in np.unique(portion).tolist():
                self._add_sets(cells[portion == number], half, (DRAWS + turn, half, number))
        self.cost_s += time.perf_counter() - start

    def _add_sets(self, cells: NDArray[np.integer], half: int, key: tuple[int, ...]) -> None:
        samples = self.samples[cells, half]
        shift = self.shift + 1 + half  # other points than those of the first sets
        rays = CellRays(cells, np.zeros_like(samples), samples, _FURTHER, shift, key)
        sums = np.add.reduceat(self._traced(rays), rays.set_starts).reshape(-1, _FURTHER)
        first_ones = self.sums[cells].reshape(-1, 2, SETS // 2)[:, half]
        means = np.concatenate([first_ones, sums], axis=1) / samples[:, None]
        self.further[cells, half] = samples
        self.halves[cells, half] = means.mean(axis=1)
        self.by_all[cells, half] = means.var(axis=1, ddof=1) / means.shape[1]
        self.mean[cells] = self.halves[cells].mean(axis=1)

    def _traced(self, rays: Rays) -> Array:
        """Light of each path."""
        light, traced = self.trace(rays)
        light = mitsuba().Float64(light)
        dr.eval(light, traced)
        value, each = np.array(light), np.asarray(traced)
        self.rays += int(each.sum(dtype=np.int64)) * (value.size // each.size)
        self.brightest = max(self.brightest, float(value.max()))
        return value

    @property
    def by_other_half(self) -> Array:
        """Variance that each half adds to the mean of its cell, as the other half tells it,
        (n_cells, 2).
        """
        return np.asarray(self.of_path[:, ::-1] * self.samples.astype(float) ** -self.falls / 4)

    def _beside(self, values: Array) -> Array:
        """Mean of the values of the cells around each, without its own."""
        shape, all_cells = (self.tracer.start.rows, self.tracer.start.columns), self.window**2
        total, count = (
            all_cells * uniform_filter(x.reshape(shape), self.window, mode="constant").ravel()
            for x in (values, np.ones_like(values))
        )
        return np.asarray(np.maximum(total - values, 0) / np.maximum(count - 1, 1))

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
