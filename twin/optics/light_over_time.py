"""Light of the cells of a grid while the world moves: rendered at few instants, linear in between.

All cells that may change are rendered at some first instants. The middle of each interval is then
rendered where light may have a kink there, and compared with what interpolation says: the cells
that differ the most are followed into both halves, until what the others are off by is little
enough. A path has the same random numbers at all instants, so that light differs between instants
by what moved. The square of a difference is taken as the product of those of two independent sets
of paths, whose mean is the true one, without what paths err by.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from twin.engine import mitsuba
from twin.optics.ray_sets import CellRays, Rays
from twin.optics.tracer import RAYS_AT_ONCE, Tracer

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

#: Independent sets of paths in a cell; paths of a set to begin with, and at most.
_SETS, _FIRST, _MOST = 2, 8, 2**11
#: Share of a cell's own scatter in its variance, which two sets alone hardly know.
_OWN = 0.25
#: Of the squared error left to an interval, what cells that are not followed further may take.
_LEFT_BEHIND = 0.5
#: Variance of the difference between a middle and the mean of both ends, over that of each.
_OF_MIDDLES = 1.5
#: Cells, to a side, over which squared errors of smooth light are taken together.
_SMOOTH_CELLS = 5
#: Keys of draws, apart from those of still light.
_DRAWS = 2**17
#: Instants at which cells are rendered at most; paths after which no interval is halved, and paths
#: that instants are rendered with at once, at most.
_MOST_INSTANTS, _MOST_PATHS, _MOST_TOGETHER = 2**15, 2**25, 2**24


@dataclass(frozen=True)
class Part:
    """A part of the light.

    Parameters
    ----------
    trace
        What of a set of rays it is.
    falls
        Power of the number of paths with which its variance falls.
    is_smooth
        It has no edges and rare bright paths: the error of a cell follows from the cells around it
        alone. How many paths it has does so of all light: more of them where its own first ones
        happened to be bright would make it darker.
    step
        Of how many first instants one is enough for it.
    path_weight, motion_weight
        Of the squared errors that finitely many paths, and interpolation in time, may leave in all
        parts together, that of this part, over those of the others.
    first
        Paths of a set of a cell to begin with, where their number follows from a tolerance.
    """

    trace: Callable[[Tracer, Rays], Any]
    falls: float
    is_smooth: bool = False
    step: int = 1
    path_weight: float = 1.0
    motion_weight: float = 1.0
    first: int = _FIRST


@dataclass(frozen=True, eq=False)
class Effort:
    """How closely light is followed.

    Parameters
    ----------
    limit : (n_cells,) array
        Error of each cell that finitely many paths may leave, root mean square over the cells; or
        ``paths``, of every cell.
    motion_limit : (n_cells,) array
        The same, of interpolation in time.
    finest_s
        Shortest interval between instants.
    exposure_s
        Over which light counts: what is off for a shorter time counts less.
    noise_growth
        Of light at instants, (n, n_cells): the square of what is permitted there, over that of the
        limits, (n,); None: the same at all.
    together
        Only the sum of all cells counts: their errors in between, which may be of either sign, are
        taken together.
    lit_share
        Of the cells that are added up in a count: errors of as many cells as independent ones, and
        of all cells those that are alike.
    overlooked
        Of intervals, from times (n,) to times (n,), the cells that something may pass unseen from
        both, (n, n_cells): they are followed whatever is seen in the middle.
    """

    limit: Array | int
    motion_limit: Array
    finest_s: float
    exposure_s: float
    noise_growth: Callable[[Array], Array] | None = None
    together: bool = False
    lit_share: float = 0.0
    overlooked: Callable[[Array, Array], Flags] | None = None

    def grown(self, light: Array) -> Array:
        """`noise_growth` of light, (n,)."""
        return np.ones(len(light)) if self.noise_growth is None else self.noise_growth(light)

    def of_part(self, path_share: float, motion_share: float) -> "Effort":
        """Of one of the parts, whose errors are independent: shares of squared errors."""
        whole = self.limit
        limit = whole if isinstance(whole, int) else math.sqrt(path_share) * whole
        return replace(self, limit=limit, motion_limit=math.sqrt(motion_share) * self.motion_limit)


@dataclass(frozen=True, eq=False)
class LightOverTime:
    """Light of cells at instants, ascending, (n, n_cells), linear in between.

    ``path_error`` and ``motion_error``: over what is permitted, root mean square over the cells, at
    the worst instant; of a fixed number of paths over what interpolation is permitted. ``looks``:
    cells rendered, at how many instants each, summed; ``paths``: of
    them all.
    """

    times_s: Array
    light: Array
    path_error: float
    motion_error: float
    looks: int
    paths: int


def light_over_time(
    tracer_at: Callable[[Array], Tracer],
    traces: Sequence[Part],
    times_s: Array,
    changes: Flags,
    effort: Effort,
) -> LightOverTime:
    """Light of a tracer's cells from the first to the last of some instants.

    Parameters
    ----------
    tracer_at
        Gives a tracer in a world with these instants, (n,), numbered.
    traces
        Parts of the light, apart from each other.
    times_s : (n,) array
        First instants, ascending, so close that no edge passes more than a cell in between.
    changes : (n - 1, n_cells) array
        Cells whose light may change from each instant to the next; others are not rendered again.
    effort
        How closely.
    """
    by_path, by_motion = (
        np.array(weights) / sum(weights)
        for weights in zip(*((t.path_weight, t.motion_weight) for t in traces), strict=True)
    )
    parts = [
        _over_time(
            _Drawing(tracer_at, part, number),
            *_thinned(times_s, changes, part.step),
            effort.of_part(float(by_path[number]), float(by_motion[number])),
        )
        for number, part in enumerate(traces)
    ]
    times = np.unique(np.concatenate([part.times_s for part in parts]))
    return LightOverTime(
        times,
        np.sum([_at(part, times) for part in parts], axis=0),
        math.sqrt(
            (by_motion if isinstance(effort.limit, int) else by_path)
            @ np.square([part.path_error for part in parts])
        ),
        math.sqrt(by_motion @ np.square([part.motion_error for part in parts])),
        sum(part.looks for part in parts),
        sum(part.paths for part in parts),
    )


def _thinned(times: Array, changes: Flags, step: int) -> tuple[Array, Flags]:
    """One of ``step`` instants, the last one too, and what changes between them."""
    kept = np.unique(np.append(np.arange(0, len(times) - 1, step), len(times) - 1))
    return times[kept], np.logical_or.reduceat(changes, kept[:-1], axis=0)


def _at(part: LightOverTime, times: Array) -> Array:
    """Light at other instants."""
    if len(times) == len(part.times_s):
        return part.light
    after = np.clip(np.searchsorted(part.times_s, times), 1, len(part.times_s) - 1)
    before = after - 1
    share = (times - part.times_s[before]) / (part.times_s[after] - part.times_s[before])
    return part.light[before] + share[:, None] * (part.light[after] - part.light[before])


def _over_time(drawing: "_Drawing", times: Array, changes: Flags, effort: Effort) -> LightOverTime:
    n_cells = drawing.grid.size
    weight = 1 / np.maximum(effort.motion_limit, 1e-150) ** 2 / n_cells
    wanted = np.zeros((len(times), n_cells), dtype=bool)
    wanted[:-1] |= changes
    wanted[1:] |= changes
    wanted[0] |= ~wanted.any(axis=0)
    nothing = np.zeros((_SETS, *wanted.shape))
    sets, variance, samples = drawing.render(times, wanted, nothing, effort)
    first = np.array([_spread(x, wanted) for x in (*sets, variance)])
    samples, at = _spread(samples, wanted), [float(t) for t in times]
    rows = [(first[:-1, i], first[-1, i], samples[i]) for i in range(len(times))]
    opened = [_Interval(i, i + 1, cells, 1.0) for i, cells in enumerate(changes) if cells.any()]
    worst = 0.0
    while opened:
        fine = [x for x in opened if (at[x.last] - at[x.first]) / 2 >= effort.finest_s]
        if not fine or len(at) + len(fine) > _MOST_INSTANTS or drawing.paths > _MOST_PATHS:
            worst = max(worst, *(1 - x.budget + x.left for x in opened))
            break
        worst = max([worst, *(1 - x.budget + x.left for x in opened if x not in fine)])
        ends = [(rows[x.first], rows[x.last]) for x in fine]
        middles = np.array([(at[x.first] + at[x.last]) / 2 for x in fine])
        cells = np.array([x.cells for x in fine])
        said = np.stack([(a[0] + b[0]) / 2 for a, b in ends], axis=1)
        around = np.array([(a[1] + b[1]) / 2 for a, b in ends])
        at_ends = np.array([np.maximum(a[2], b[2]) for a, b in ends])
        sets, variance, samples = drawing.render(middles, cells, said, effort, around, at_ends)
        grown, further = effort.grown(sets.mean(axis=0)), sets - said
        halves: list[_Interval] = []
        for i, interval in enumerate(fine):
            # Errors of several times within an exposure are averaged.
            length = at[interval.last] - at[interval.first]
            scale = min(length / effort.exposure_s, 1.0) / 4 / grown[i]
            rows.append((sets[:, i], variance[i], samples[i]))
            at.append(float(middles[i]))
            one, other = further[:, i] @ np.sqrt(weight)
            # Of light that errs by chance the product scatters by as much as is subtracted.
            alike = scale * float(one * other - _OF_MIDDLES * (weight @ variance[i]))
            if effort.together:
                halves += interval.whole(max(alike, 0.0), len(at) - 1)
                continue
            alike = effort.lit_share * max(alike, 0.0)
            off = (1 - effort.lit_share) * scale * weight * further[0, i] * further[1, i]
            if (
                alike + float(off.sum()) > interval.budget
                and alike > _LEFT_BEHIND * interval.budget
            ):
                halves += interval.whole(alike + max(float(off.sum()), 0.0), len(at) - 1)
            else:
                likely = drawing.sorted_out(off)
                halves += interval.after(likely, off, alike, len(at) - 1)
        worst = max([worst, *(1 - x.budget for x in halves)])
        opened = [x for x in _with_overlooked(halves, at, effort) if x.cells.any()]
    order = np.argsort(at)
    limit = effort.motion_limit if isinstance(effort.limit, int) else effort.limit
    share = 1 / np.maximum(limit, 1e-150) ** 2 / n_cells
    sets, variance, _ = (np.array(x) for x in zip(*rows, strict=True))
    path_error = float(np.max(variance @ share / effort.grown(sets.mean(axis=1)))) ** 0.5
    return LightOverTime(
        np.array(at)[order],
        np.array([rows[i][0].mean(axis=0) for i in order]),
        path_error,
        worst**0.5,
        drawing.looks,
        drawing.paths,
    )


@dataclass(frozen=True, eq=False)
class _Interval:
    """Between two instants, by number: cells that are followed further, the squared error that they
    may be off by, and what they seem to be off by.
    """

    first: int
    last: int
    cells: Flags
    budget: float
    left: float = 0.0

    def after(self, likely: Array, off: Array, alike: float, middle: int) -> list["_Interval"]:
        """Both halves, with the cells that are to be followed into them; ``off``: squared errors of
        cells with the middle known, right in their sum, and ``likely``, none of them negative, by
        which cells are chosen; ``alike``: of what is the same in all cells.
        """
        whole = float(off.sum()) + alike
        if whole <= self.budget:
            return self.whole(max(whole, 0.0), middle)
        order = np.argsort(likely, kind="stable")
        summed = alike + np.cumsum(likely[order])
        n_left = int(np.searchsorted(summed, _LEFT_BEHIND * self.budget, side="right"))
        cells = np.zeros_like(self.cells)
        cells[order[n_left:]] = True
        taken = float(summed[n_left - 1]) if n_left else min(alike, self.budget)
        return self._halves(middle, cells, self.budget - taken, float(summed[-1]) - taken)

    def whole(self, off: float, middle: int) -> list["_Interval"]:
        """The same with all cells together."""
        if off <= self.budget:
            return self._halves(middle, np.zeros_like(self.cells), self.budget - off, 0.0)
        return self._halves(middle, self.cells, self.budget, off)

    def _halves(self, middle: int, cells: Flags, budget: float, left: float) -> list["_Interval"]:
        ends = ((self.first, middle), (middle, self.last))
        return [_Interval(*pair, cells, budget, left) for pair in ends]


def _with_overlooked(
    halves: Sequence[_Interval], at: Sequence[float], effort: Effort
) -> list[_Interval]:
    """The same with the cells that something may pass in between."""
    if effort.overlooked is None or not halves:
        return list(halves)
    ends = np.array([(at[x.first], at[x.last]) for x in halves])
    passed = effort.overlooked(*ends.T)
    return [replace(x, cells=x.cells | more) for x, more in zip(halves, passed, strict=True)]


def _spread(values: NDArray[Any], known: Flags) -> NDArray[Any]:
    """Values of each cell at all instants from those that are known: where nothing changed in
    between they are the same, so the last known one holds, or the first one before it.
    """
    number = np.where(known, np.arange(len(known))[:, None], -1)
    last = np.maximum.accumulate(number, axis=0)
    last = np.where(last < 0, known.argmax(axis=0), last)
    return np.take_along_axis(values, last, axis=0)


class _Drawing:
    """Paths of one part of the light, at any instants."""

    def __init__(self, tracer_at: Callable[[Array], Tracer], part: Part, number: int) -> None:
        self._part, self._tracer_at = part, tracer_at
        tracer = tracer_at(np.zeros(1))
        self.grid = tracer.start
        seed = np.random.SeedSequence([tracer.seed, _DRAWS, number])
        self._shift = int(seed.generate_state(1)[0])
        self.looks = self.paths = 0

    def sorted_out(self, off: Array) -> Array:
        """Squared errors that single cells are likely to have, of noisy ones whose sum is right."""
        if self._part.is_smooth:
            shape = (self.grid.rows, self.grid.columns)
            off = uniform_filter(off.reshape(shape), _SMOOTH_CELLS, mode="nearest").ravel()
        return np.maximum(off, 0)

    def render(
        self,
        times: Array,
        wanted: Flags,
        said: Array,
        effort: Effort,
        around: Array | None = None,
        at_ends: NDArray[np.int32] | None = None,
    ) -> tuple[Array, Array, NDArray[np.int32]]:
        """Light by set of paths, (sets, n, n_cells), the variance of their mean, (n, n_cells), and
        the number of paths of a set, where ``wanted``; elsewhere ``said``, ``around``, which is
        also what the variance may be in all wanted cells together, and ``at_ends``. Smooth light
        has as many paths as that at least, the same ones as both ends, so that a middle differs
        from their mean by what moved and not by what paths err by.
        """
        tracer, limit = self._tracer_at(times), effort.limit
        instant, cells = np.nonzero(wanted)
        self.looks += len(cells)
        light = said.copy()
        variance = np.zeros(wanted.shape) if around is None else around.copy()
        first = self._part.first if isinstance(limit, np.ndarray) else max(limit // _SETS, 1)
        samples = np.full(len(cells), first)
        if self._part.is_smooth and at_ends is not None:
            samples = np.maximum(at_ends[instant, cells].astype(np.int64), first)
        sums = self._draw(tracer, cells, instant, np.zeros_like(samples), samples)
        for up in (False, True, None):
            light[:, instant, cells] = (sums / samples[:, None]).T
            mean = light.mean(axis=0)
            found, of_others = self._variance(mean, cells, instant, samples, sums)
            if isinstance(limit, int) or up is None:
                break
            weight = 1 / np.maximum(limit, 1e-150) ** 2 / wanted.shape[1]
            allowed = wanted.mean(axis=1) * effort.grown(mean)
            if around is not None:
                allowed = np.maximum(allowed, (wanted * weight * around).sum(axis=1))
                if self._part.is_smooth:
                    # What the other cells leave of what is permitted in all.
                    others = (~wanted * weight * around).sum(axis=1)
                    allowed = np.maximum(allowed, effort.grown(mean) - others)
            further = self._wanted(of_others * weight[cells], instant, samples, allowed, up)
            more = np.flatnonzero(further > samples)
            if not len(more):
                break
            sums[more] += self._draw(
                tracer, cells[more], instant[more], samples[more], further[more] - samples[more]
            )
            samples[more] = further[more]
        variance[instant, cells] = found
        paths = np.zeros(wanted.shape, dtype=np.int32) if at_ends is None else at_ends.copy()
        paths[instant, cells] = samples
        return light, variance, paths

    def _draw(
        self, tracer: Tracer, cells: Ints, instant: Ints, before: Ints, further: Ints
    ) -> Array:
        """Sums of the light of further paths of each set, (n, sets)."""
        found = np.zeros((len(cells), _SETS))
        self.paths += int(further.sum()) * _SETS
        portion = np.cumsum(further * _SETS) // RAYS_AT_ONCE
        for number in np.unique(portion):
            some = np.flatnonzero(portion == number)
            rays = CellRays(
                cells[some], before[some], further[some], _SETS, self._shift, (), instant[some]
            )
            value = np.array(mitsuba().Float64(self._part.trace(tracer, rays)))
            found[some] = np.add.reduceat(value, rays.set_starts).reshape(-1, _SETS)
        return found

    def _variance(
        self, light: Array, cells: Ints, instant: Ints, samples: Ints, sums: Array
    ) -> tuple[Array, Array]:
        """Of the mean of each cell, from the scatter of its sets and of those around it; with what
        all paths may have missed of the contrast to the cells around. And by those around alone.
        """
        shape = (len(light), self.grid.rows, self.grid.columns)
        means = sums / samples[:, None]
        own = np.square(means[:, 0] - means[:, 1]) / 4
        per_path = samples.astype(float) ** self._part.falls
        total, count = np.zeros((2, *light.shape))
        total[instant, cells], count[instant, cells] = own * per_path, 1
        side = 5 if self._part.is_smooth else 3
        total, count = (
            side**2
            * uniform_filter(x.reshape(shape), (1, side, side), mode="constant").reshape(x.shape)
            for x in (total, count)
        )
        total, count = total[instant, cells], count[instant, cells]
        others = np.maximum(total - own * per_path, 0) / np.maximum(count - 1, 1)
        others = np.where(count > 1.5, others / per_path, own)
        if self._part.is_smooth:
            return others, others
        around = np.maximum(total / count, 0) / per_path
        image = light.reshape(shape)
        contrast = maximum_filter(image, (1, 3, 3)) - minimum_filter(
            image, (1, 3, 3), mode="constant"
        )
        missed = contrast.reshape(light.shape)[instant, cells] / (_SETS * samples)
        return _OWN * own + (1 - _OWN) * around + missed**2 / 3, others + missed**2 / 3

    def _wanted(
        self, weighted: Array, instant: Ints, samples: Ints, allowed: Array, up: bool
    ) -> Ints:
        """Paths of a set that bring the sum of the weighted variances of each instant to what is
        allowed, with as few paths as possible: by a Lagrange multiplier.
        """
        falls = self._part.falls
        at_one = weighted * samples.astype(float) ** falls
        root = at_one ** (1 / (falls + 1))
        total = np.bincount(instant, root, len(allowed))
        scale = (total / np.maximum(allowed, 1e-150)) ** (1 / falls)
        steps = np.log2(np.maximum(scale[instant] * root / samples, 1))
        steps = np.ceil(steps - 0.25) if up else np.rint(steps)
        wanted = np.minimum(samples * 2 ** steps.astype(np.int64), _MOST)
        while wanted.sum() * _SETS > _MOST_TOGETHER and wanted.max() > self._part.first:
            wanted = np.minimum(wanted, wanted.max() // 2)
        return np.asarray(np.maximum(samples, wanted))
