"""Light of the cells of a grid to a stated error: paths are added where they are needed.

A first look draws a few independent sets of paths in every cell; their scatter is the error of
their mean. Where it matters, the sets are continued, until the error of all cells together is as
small as asked.

Half of the sets are continued by what the other half has found. By their own, those that miss what
is bright and rare would agree, and be left as they are: the whole light was too little by 0.1 to
0.4 %. Of scattered and indirect light, most of which few paths bring, it is what the other half
found at first look. What it finds later depends on how many paths it was given, and so on what this
half had found before: indirect light was too little by 0.6 % in the yard, by 2.3 % in `crossing`.
"""

import math
import time
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

#: Of the permitted error, what an effect that is left out may change at most.
LEFT_OUT = 0.1
#: Independent sets of paths in a cell, in two halves: their scatter has this number less one
#: degrees of freedom.
_SETS = 4
#: Power of the number of paths with which the variance of direct light falls.
_FALLS = 1.7
_ROUNDS = 8
#: Of a cell's paths from round to round at most: the first look exaggerates what may be missed.
_GROWTH = 16
#: Of the squared error asked for, what is planned for: estimates of it scatter.
_MARGIN = 0.9
#: Cells whose sets agree by chance are the ones that are not continued: their variance is more than
#: its estimate, by this factor in the yard.
_CHOSEN = 1.15
#: Number of times that what happens as often is missed altogether in 5 of 100 cases.
_UNSEEN = 3
#: Halvings of a range of 120 of the logarithm of the paths' worth: to 0.7 %.
_BISECTIONS = 14
#: Keys of draws, apart from those of rows of cells.
_DRAWS = 2**16
#: Paths of a set at most, of one cell and of all together.
_MOST, _MOST_TOGETHER = 128**2, 2**17
#: Paths of all cells together where the first look found no light at all.
_IN_THE_DARK = 2**20


@dataclass(eq=False)
class _Part:
    """Direct, scattered or indirect light of all cells: mean and its variance, (n_cells,).

    Parameters
    ----------
    shift
        Of the random numbers that shift the paths' sequences.
    trace
        Light of the paths of a set of rays.
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
    trace: Callable[[Rays], Any]
    falls: float
    cost: float
    first: int
    window: int
    mean: Array = field(init=False)
    variance: Array = field(init=False)
    #: Paths of a set of each half, and the mean of each half, (n_cells, 2); the sum of the light of
    #: each set, (n_cells, sets).
    samples: NDArray[np.int64] = field(init=False)
    halves: Array = field(init=False)
    sums: Array = field(init=False)
    #: Variance of a half of sets of one path, as each half finds it itself, (n_cells, 2): by all
    #: its paths or, where bright ones are rare, by those of the first look.
    of_path: Array = field(init=False)
    #: Light of the brightest path of all; and the time that all of them took.
    brightest: float = field(init=False, default=0.0)
    cost_s: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        n = self.tracer.start.size
        self.mean, self.variance, self.sums = np.zeros(n), np.zeros(n), np.zeros((n, _SETS))
        self.halves, self.of_path = np.zeros((2, n, 2))
        self.samples = np.zeros((n, 2), np.int64)
        self.draw(np.arange(n), np.full((n, 2), self.first), 0)

    @property
    def paths(self) -> NDArray[np.int64]:
        """Of each cell, in all its sets."""
        return np.asarray(self.samples.sum(axis=1) * (_SETS // 2))

    def draw(self, cells: NDArray[np.integer], samples: NDArray[np.integer], turn: int) -> None:
        """Continue the sets of these cells until there are ``samples`` paths in each of a half."""
        start, before = time.perf_counter(), np.repeat(self.samples[cells], _SETS // 2, axis=1)
        further = np.repeat(samples, _SETS // 2, axis=1) - before
        portion = np.cumsum(further.sum(axis=1)) // RAYS_AT_ONCE
        for number in np.unique(portion):
            some = np.flatnonzero(portion == number)
            key = (_DRAWS + turn, int(number))
            rays = CellRays(cells[some], before[some], further[some], _SETS, self.shift, key)
            value = np.array(mitsuba().Float64(self.trace(rays)))
            self.brightest = max(self.brightest, float(value.max()))
            drawn, sums = further[some].ravel() > 0, np.zeros(some.size * _SETS)
            sums[drawn] = np.add.reduceat(value, rays.set_starts[drawn])
            self.sums[cells[some]] += sums.reshape(-1, _SETS)
        self.samples[cells] = samples
        sets = (self.sums[cells] / np.repeat(samples, _SETS // 2, axis=1)).reshape(
            -1, 2, _SETS // 2
        )
        halves = sets.mean(axis=2)
        self.halves[cells], self.mean[cells] = halves, halves.mean(axis=1)
        # Of one path, so that cells of different numbers of paths compare.
        part = samples.astype(float) ** -self.falls
        within = sets.var(axis=2, ddof=1) / (_SETS // 2) / part
        between = np.diff(halves, axis=1)[:, 0] ** 2 / part.sum(axis=1)
        if turn == 0 or self.falls > 1:
            for half in (0, 1):
                own = within[:, half]
                found = (own + self._around(cells, own)) / 2
                # Most windows have none of rare paths: they are likely wherever some were.
                self.of_path[cells, half] = found if self.falls > 1 else (found + found.mean()) / 2
        own = (within.sum(axis=1) * (_SETS // 2 - 1) + between) / (_SETS - 1)
        of_path = (own + self._around(cells, own)) / 2
        self.variance[cells] = of_path * part.sum(axis=1) / 4
        self.cost_s += time.perf_counter() - start

    @property
    def by_other_half(self) -> Array:
        """Variance that each half adds to the mean of its cell, as the other half tells it,
        (n_cells, 2).
        """
        return np.asarray(self.of_path[:, ::-1] * self.samples.astype(float) ** -self.falls / 4)

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


@dataclass(frozen=True, eq=False)
class LightWithin:
    """Light to a tolerance, and whether its indirect part was traced for it.

    Parameters
    ----------
    light
        Of the cells.
    indirect_over
        Bound of indirect light over the permitted error, root mean square over the cells: that by
        which it was decided, or what its paths say, where that is less and still matters.
    indirect_taken
        Whether it was traced.
    left_out
        Bound of each cell's light that was left out.
    cost_s
        Time that indirect light took.
    """

    light: CellLight
    indirect_over: float
    indirect_taken: bool
    left_out: float
    cost_s: float


def gather_within(
    tracer: Tracer,
    permitted: Callable[[Array], Array],
    corners: Callable[[], tuple[Array, Array]] | None = None,
    largest_indirect: float = math.inf,
    in_the_dark: float = math.inf,
    permitted_alike: Callable[[Array], Array] | None = None,
) -> LightWithin:
    """Light that each cell receives, as `gather`, with as many paths as its error needs.

    ``permitted``: of light (rows, columns) the error that each cell may have, infinite where any
    is; the root mean square over the cells of error over permitted comes below 1, unless that takes
    more paths than a cell may have: `CellLight.standard_error` says what was reached. Bounces end
    by chance instead of at a largest number, so that no light is lost. ``largest_indirect``: bound
    of a cell's indirect light (`LightProblem.largest_indirect`), which is left out where that is
    below a tenth of what is permitted, or of ``permitted_alike``: of errors that cells share.
    ``in_the_dark``: paths of all cells together that are enough where the first ones find no light
    at all, at most a million.

    The standard error is from the scatter of independent sets of paths, half of it that of the
    cells around; with what all paths of a cell may miss: one path's share of the contrast to the
    cells around and, with ``corners`` as `LightProblem` has them, of the brightest facet that may
    be there; and for indirect light what is as bright as the brightest path of all, but rare.
    """
    shape, alike = (tracer.start.rows, tracer.start.columns), permitted_alike or permitted
    shifts = [int(n) for n in np.random.SeedSequence([tracer.seed, _DRAWS]).generate_state(3)]
    parts = [_Part(tracer, shifts[0], lambda rays: tracer.direct(rays).value, _FALLS, 1.0, 4, 3)]
    if tracer.scatters:
        scattered = lambda rays: tracer.scattered(rays).value  # noqa: E731
        parts.append(_Part(tracer, shifts[1], scattered, 1.0, 3.0, 4, 5))
    over = _over(largest_indirect, parts, alike, shape)
    taken = over > LEFT_OUT
    if taken:
        parts.append(_Part(tracer, shifts[2], tracer.all_indirect, 1.0, 4.0, 2, 5))
    facets = np.zeros(tracer.start.size)
    if corners is not None and isinstance(tracer.light, DeviceLight):
        facets = facet_light(tracer.start, tracer.light.device, corners())
    if not any(part.mean.any() for part in parts):
        each = min(_IN_THE_DARK, in_the_dark) / _SETS / tracer.start.size
        samples = 2 ** math.ceil(math.log2(max(each, 1)))
        for part in parts:
            _draw_more(part, np.full((tracer.start.size, 2), samples), 0)
    for turn in range(1, _ROUNDS + 1):
        light = np.sum([part.mean for part in parts], axis=0)
        limit = permitted(light.reshape(shape)).ravel()
        weight = 1 / np.maximum(limit, 1e-150) ** 2 / limit.size
        variances = _variances(parts, facets, shape, taken)
        left = sum(float(variance @ weight) for variance in variances)
        if turn == _ROUNDS or left <= 1:
            break
        told = [part * weight[:, None] for part in _by_other_halves(parts, facets, shape, taken)]
        scale = left / max(sum(float(part.sum()) for part in told), 1e-300)
        wanted = _wanted(parts, [scale * part for part in told], up=turn > 1)
        drawn = [_draw_more(*pair, turn) for pair in zip(parts, wanted, strict=True)]
        if not any(drawn):
            break
    indirect = parts[-1].mean if taken else np.zeros_like(light)
    if taken:
        limit = np.maximum(alike(light.reshape(shape)).ravel(), 1e-150)
        known = float(np.sqrt(np.mean(((indirect + 2 * np.sqrt(variances[-1])) / limit) ** 2)))
        over = min(known, over) if known > LEFT_OUT else over
    error = np.sqrt(np.sum(variances, axis=0))
    return LightWithin(
        CellLight(*(x.reshape(shape) for x in (light - indirect, indirect, error))),
        indirect_over=over,
        indirect_taken=taken,
        left_out=0.0 if taken else largest_indirect,
        cost_s=parts[-1].cost_s if taken else 0.0,
    )


def _over(
    bound: float,
    parts: Sequence[_Part],
    permitted: Callable[[Array], Array],
    shape: tuple[int, int],
) -> float:
    """A bound of every cell's light over the permitted error, root mean square over the cells."""
    light = np.sum([part.mean for part in parts], axis=0)
    limit = np.maximum(permitted(light.reshape(shape)), 1e-150)
    if not bound or np.isinf(limit).all():
        return 0.0
    return bound * math.sqrt(float(np.mean(1 / limit**2)))


def _variances(
    parts: Sequence[_Part], facets: Array, shape: tuple[int, int], taken: bool
) -> list[Array]:
    """Of each part: from its scatter, and of what all its paths may have missed; ``taken``: the
    last part is indirect light.
    """
    direct, indirect = parts[0], parts[-1]
    variances = [_CHOSEN * part.variance for part in parts]
    variances[0] += _missed(facets, direct.mean, direct.paths, shape)
    if taken:
        variances[-1] += _too_rare(direct, indirect, indirect.paths)
    return variances


def _by_other_halves(
    parts: Sequence[_Part], facets: Array, shape: tuple[int, int], taken: bool
) -> list[Array]:
    """The same of each half as the other tells it, (n_cells, 2); both as many paths as each has."""
    direct, indirect = parts[0], parts[-1]
    variances = [_CHOSEN * part.by_other_half for part in parts]
    for half in (0, 1):
        other = direct.halves[:, 1 - half]
        variances[0][:, half] += _missed(facets, other, _SETS * direct.samples[:, half], shape) / 2
        if taken:
            paths = _SETS * indirect.samples[:, half]
            variances[-1][:, half] += _too_rare(direct, indirect, paths) / 2
    return variances


def _missed(
    facets: Array, light: Array, paths: NDArray[np.integer], shape: tuple[int, int]
) -> Array:
    """Variance of direct light that all paths of a cell may have missed: up to one path's share,
    any of which is as likely as any other.
    """
    missed = np.maximum(facets, contrast(light.reshape(shape)))
    return np.asarray((missed / paths) ** 2 / 3)


def _too_rare(direct: _Part, indirect: _Part, paths: NDArray[np.integer]) -> Array:
    """Variance of indirect light as bright as any path so far, and too rare for those of a window.

    Elsewhere paths would have met it, so that it is in one window of the image, up to three times
    (95 %) one path's share.
    """
    brightest, window = max(float(direct.mean.max()), indirect.brightest), indirect.window**2
    windows = min(1.0, _UNSEEN**2 * window / direct.mean.size)
    return np.asarray(windows * (brightest / (paths * window)) ** 2)


def _draw_more(part: _Part, samples: NDArray[np.int64], turn: int) -> bool:
    """Continue the sets of paths that are shorter; whether there are such cells."""
    more = np.flatnonzero((samples > part.samples).any(axis=1))
    if len(more):
        part.draw(more, samples[more], turn)
    return bool(len(more))


def _wanted(
    parts: Sequence[_Part], variances: Sequence[Array], *, up: bool
) -> list[NDArray[np.int64]]:
    """Paths of a set of each half of each cell, (n_cells, 2), that bring the sum of the variances
    to `_MARGIN` at the least cost; ``up``: rounded up, since the nearest numbers were too few.

    By a Lagrange multiplier: the variance a n^-p of n paths at cost c n is worth them up to
    n = (a p / (c multiplier))^(1 / (p + 1)).
    """
    sizes = [part.samples.astype(float) for part in parts]
    at_one = [a * n**part.falls for part, a, n in zip(parts, variances, sizes, strict=True)]
    best = [
        (a * part.falls / part.cost) ** (1 / (part.falls + 1))
        for part, a in zip(parts, at_one, strict=True)
    ]
    low, high = -60.0, 60.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        wanted = [
            np.clip(n * math.exp(-middle / (part.falls + 1)), size, _most(len(size)))
            for part, n, size in zip(parts, best, sizes, strict=True)
        ]
        left = sum(
            float(np.sum(a * n**-part.falls))
            for part, a, n in zip(parts, at_one, wanted, strict=True)
        )
        low, high = (middle, high) if left <= _MARGIN else (low, middle)
    return [_power_of_2(*pair, up) for pair in zip(parts, wanted, strict=True)]


def _most(n_cells: int) -> float:
    """Paths of a set of one cell."""
    return max(_MOST, _MOST_TOGETHER / n_cells)


def _power_of_2(part: _Part, wanted: Array, up: bool) -> NDArray[np.int64]:
    """The nearest power of 2 times the first number, or the next one up."""
    steps = np.log2(np.minimum(wanted, _GROWTH * part.samples) / part.first)
    steps = np.ceil(steps - 1e-9) if up else np.rint(steps)
    return np.asarray(part.first * 2 ** np.maximum(steps, 0).astype(np.int64))
