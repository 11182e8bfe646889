"""Paths of a part of the light at any instants: how many of them each cell needs, what they err by.

A path has the same random numbers at all instants, so that light differs between instants by what
moved. Two independent sets of paths tell by their difference what their mean errs by.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from twin.engine import mitsuba
from twin.optics.paths import RAYS
from twin.optics.ray_sets import CellRays, Rays
from twin.optics.tracer import RAYS_AT_ONCE, Tracer

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

#: Independent sets of paths in a cell.
SETS = 2
#: Paths of a set to begin with, and at most.
_FIRST, _MOST = 8, 2**11
#: Share of a cell's own scatter in its variance, which two sets alone hardly know.
_OWN = 0.25
#: Cells, to a side, over which squared errors of smooth light are taken together.
_SMOOTH_CELLS = 5
#: Keys of draws, apart from those of still light.
_DRAWS = 2**17
#: Paths that instants are rendered with at once, at most; and after which no interval is halved,
#: with the usual number of rays.
_MOST_TOGETHER, _MOST_PATHS = 2**24, 2**25


@dataclass(frozen=True)
class Part:
    """A part of the light.

    Parameters
    ----------
    trace
        What of a set of rays it is, and the rays to surfaces that each path takes: an array or,
        where all take as many, a number; 0 where their number is given.
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
    everywhere
        What moves changes it in all cells, by light that comes from there: not direct light.
    """

    trace: Callable[[Tracer, Rays], tuple[Any, Any]]
    falls: float
    is_smooth: bool = False
    step: int = 1
    path_weight: float = 1.0
    motion_weight: float = 1.0
    first: int = _FIRST
    everywhere: bool = False


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
    many_edges
        A cell may be passed by several edges between two instants, as those of a texture: their
        kinks may cancel in the middle, so that a cell whose middle is right is looked at in the
        middles of both halves too.
    """

    limit: Array | int
    motion_limit: Array
    finest_s: float
    exposure_s: float
    noise_growth: Callable[[Array], Array] | None = None
    together: bool = False
    lit_share: float = 0.0
    overlooked: Callable[[Array, Array], Flags] | None = None
    many_edges: bool = False

    def grown(self, light: Array) -> Array:
        """`noise_growth` of light, (n,)."""
        return np.ones(len(light)) if self.noise_growth is None else self.noise_growth(light)

    def of_part(self, path_share: float, motion_share: float) -> "Effort":
        """Of one of the parts, whose errors are independent: shares of squared errors."""
        whole = self.limit
        limit = whole if isinstance(whole, int) else math.sqrt(path_share) * whole
        return replace(self, limit=limit, motion_limit=math.sqrt(motion_share) * self.motion_limit)


class Drawing:
    """Paths of one part of the light, at any instants."""

    def __init__(self, tracer_at: Callable[[Array], Tracer], part: Part, number: int) -> None:
        self._part, self._tracer_at = part, tracer_at
        tracer = tracer_at(np.zeros(1))
        self.grid = tracer.start
        seed = np.random.SeedSequence([tracer.seed, _DRAWS, number])
        self._shift = int(seed.generate_state(1)[0])
        self._most_rays = tracer.quality.rays
        self.looks = self.paths = self._rays = 0

    @property
    def is_spent(self) -> bool:
        """Whether there were as many paths, or rays, as there may be."""
        most = _MOST_PATHS * max(1.0, self._most_rays / RAYS)
        return self.paths > most or self._rays > self._most_rays

    @property
    def is_smooth(self) -> bool:
        """Of its part."""
        return self._part.is_smooth

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
        first = self._part.first if isinstance(limit, np.ndarray) else max(limit // SETS, 1)
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
        found = np.zeros((len(cells), SETS))
        self.paths += int(further.sum()) * SETS
        portion = np.cumsum(further * SETS) // RAYS_AT_ONCE
        for number in np.unique(portion):
            some = np.flatnonzero(portion == number)
            rays = CellRays(
                cells[some], before[some], further[some], SETS, self._shift, (), instant[some]
            )
            light, traced = self._part.trace(tracer, rays)
            light = mitsuba().Float64(light)
            dr.eval(light, traced)
            value, each = np.array(light), np.asarray(traced)
            self._rays += int(each.sum(dtype=np.int64)) * (value.size // each.size)
            found[some] = np.add.reduceat(value, rays.set_starts).reshape(-1, SETS)
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
        missed = contrast.reshape(light.shape)[instant, cells] / (SETS * samples)
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
        left = (self._most_rays - self._rays) * self.paths / max(self._rays, 1)
        most = min(_MOST_TOGETHER, left + samples.sum() * SETS)
        while wanted.sum() * SETS > most and wanted.max() > self._part.first:
            wanted = np.minimum(wanted, wanted.max() // 2)
        return np.asarray(np.maximum(samples, wanted))
