"""Light of the cells of a grid while the world moves: rendered at few instants, linear in between.

All cells that may change are rendered at some first instants. The middle of each interval is then
rendered where light may have a kink there, and compared with what interpolation says: the cells
that differ the most are followed into both halves, until what the others are off by is little
enough; where textures move, cells that are right are followed once more. A path has the same random
numbers at all instants, so that light differs between instants by what moved. The square of a
difference is taken as the product of those of two independent sets of paths, whose mean is the true
one, without what paths err by.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.optics.path_drawing import SETS, Drawing, Effort, Part
from twin.optics.tracer import Tracer

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

#: Of the squared error left to an interval, what cells that are not followed further may take.
_LEFT_BEHIND = 0.5
#: Variance of the difference between a middle and the mean of both ends, over that of each.
_OF_MIDDLES = 1.5
#: Instants at which cells are rendered at most.
_MOST_INSTANTS = 2**15


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
        Cells whose direct light may change from each instant to the next; others are not rendered
        again, but for parts that change everywhere.
    effort
        How closely.
    """
    by_path, by_motion = (
        np.array(weights) / sum(weights)
        for weights in zip(*((t.path_weight, t.motion_weight) for t in traces), strict=True)
    )
    parts = [
        _over_time(
            Drawing(tracer_at, part, number),
            *_thinned(times_s, np.ones_like(changes) if part.everywhere else changes, part.step),
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


def _over_time(drawing: Drawing, times: Array, changes: Flags, effort: Effort) -> LightOverTime:
    """Of one part of the light."""
    known = _Instants.at(drawing, times, changes, effort)
    opened = [_Interval(i, i + 1, cells, 1.0) for i, cells in enumerate(changes) if cells.any()]
    worst = 0.0
    while opened:
        fine = [x for x in opened if known.length_s(x) / 2 >= effort.finest_s]
        if not fine or len(known.at_s) + len(fine) > _MOST_INSTANTS or drawing.is_spent:
            worst = max(worst, *(1 - x.budget + x.left for x in opened))
            break
        worst = max([worst, *(1 - x.budget + x.left for x in opened if x not in fine)])
        halves = known.with_middles(fine)
        worst = max([worst, *(1 - x.budget for x in halves)])
        if effort.many_edges and not drawing.is_smooth:
            # Both halves of each, in turn.
            halves = [x.looked_at_again(fine[i // 2]) for i, x in enumerate(halves)]
        opened = [x for x in _with_overlooked(halves, known.at_s, effort) if x.cells.any()]
    order = np.argsort(known.at_s)
    return LightOverTime(
        np.array(known.at_s)[order],
        np.array([known.rows[i].sets.mean(axis=0) for i in order]),
        known.path_error(),
        worst**0.5,
        drawing.looks,
        drawing.paths,
    )


class _Instant(NamedTuple):
    """Light of all cells by each set of paths, (n_sets, n_cells), its variance, and how many paths
    it is of, (n_cells,).
    """

    sets: Array
    variance: Array
    samples: Ints


@dataclass(frozen=True, eq=False)
class _Instants:
    """Times of instants as they were rendered, one after the other, and the light at each."""

    drawing: Drawing
    effort: Effort
    at_s: list[float]
    rows: list[_Instant]

    @staticmethod
    def at(drawing: Drawing, times: Array, changes: Flags, effort: Effort) -> "_Instants":
        """The first ones, at each of which those cells are rendered that change beside it."""
        wanted = np.zeros((len(times), drawing.grid.size), dtype=bool)
        wanted[:-1] |= changes
        wanted[1:] |= changes
        wanted[0] |= ~wanted.any(axis=0)
        nothing = np.zeros((SETS, *wanted.shape))
        sets, variance, samples = drawing.render(times, wanted, nothing, effort)
        first = np.array([_spread(x, wanted) for x in (*sets, variance)])
        samples = _spread(samples, wanted)
        rows = [_Instant(first[:-1, i], first[-1, i], samples[i]) for i in range(len(times))]
        return _Instants(drawing, effort, [float(t) for t in times], rows)

    def length_s(self, interval: "_Interval") -> float:
        """Of an interval."""
        return self.at_s[interval.last] - self.at_s[interval.first]

    def with_middles(self, intervals: Sequence["_Interval"]) -> list["_Interval"]:
        """Both halves of each, with the cells that are to be followed into them."""
        ends = [(self.rows[x.first], self.rows[x.last]) for x in intervals]
        middles = [(self.at_s[x.first] + self.at_s[x.last]) / 2 for x in intervals]
        said = np.stack([(a.sets + b.sets) / 2 for a, b in ends], axis=1)
        sets, variance, samples = self.drawing.render(
            np.array(middles),
            np.array([x.cells for x in intervals]),
            said,
            self.effort,
            np.array([(a.variance + b.variance) / 2 for a, b in ends]),
            np.array([np.maximum(a.samples, b.samples) for a, b in ends]),
        )
        grown, further = self.effort.grown(sets.mean(axis=0)), sets - said
        halves: list[_Interval] = []
        for i, interval in enumerate(intervals):
            # Errors of several times within an exposure are averaged.
            scale = min(self.length_s(interval) / self.effort.exposure_s, 1.0) / 4 / grown[i]
            self.rows.append(_Instant(sets[:, i], variance[i], samples[i]))
            self.at_s.append(float(middles[i]))
            halves += self._halves(interval, further[:, i], variance[i], scale)
        return halves

    def _halves(
        self, interval: "_Interval", further: Array, variance: Array, scale: float
    ) -> list["_Interval"]:
        """Of an interval whose middle was rendered last: by each set of paths ``further`` (n_sets,
        n_cells) than interpolation says, of which ``scale`` is the share of the squared error.
        """
        weight, effort, middle = self._weight, self.effort, len(self.at_s) - 1
        one, other = further @ np.sqrt(weight)
        # Of light that errs by chance the product scatters by as much as is subtracted.
        alike = scale * float(one * other - _OF_MIDDLES * (weight @ variance))
        if effort.together:
            return interval.whole(max(alike, 0.0), middle)
        alike = effort.lit_share * max(alike, 0.0)
        off = (1 - effort.lit_share) * scale * weight * further[0] * further[1]
        whole = float(off.sum())
        if alike + whole > interval.budget and alike > _LEFT_BEHIND * interval.budget:
            return interval.whole(alike + max(whole, 0.0), middle)
        return interval.after(self.drawing.sorted_out(off), off, alike, middle)

    @property
    def _weight(self) -> Array:
        """Of a cell's squared error, as a share of what is permitted of all."""
        return 1 / np.maximum(self.effort.motion_limit, 1e-150) ** 2 / self.drawing.grid.size

    def path_error(self) -> float:
        """As of `LightOverTime`."""
        effort = self.effort
        limit = effort.motion_limit if isinstance(effort.limit, int) else effort.limit
        share = 1 / np.maximum(limit, 1e-150) ** 2 / self.drawing.grid.size
        sets, variance, _ = (np.array(x) for x in zip(*self.rows, strict=True))
        return float(np.max(variance @ share / effort.grown(sets.mean(axis=1)))) ** 0.5


@dataclass(frozen=True, eq=False)
class _Interval:
    """Between two instants, by number: cells that are followed further, the squared error that they
    may be off by, and what they seem to be off by; ``again``: those of them whose last middle was
    right.
    """

    first: int
    last: int
    cells: Flags
    budget: float
    left: float = 0.0
    again: Flags | None = None

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

    def looked_at_again(self, whole: "_Interval") -> "_Interval":
        """As this half of an interval, with the cells too that were right there for the first
        time.
        """
        again = whole.cells & ~self.cells
        if whole.again is not None:
            again &= ~whole.again
        return replace(self, cells=self.cells | again, again=again)

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
