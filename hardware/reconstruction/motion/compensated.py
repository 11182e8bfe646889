"""From measurements of a moving scene to its image at the reference time."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import Patterns, PatternSet, fwht
from hardware.reconstruction.motion import solvers
from hardware.reconstruction.motion.estimation import FEWEST_SEARCHED, Search, estimated_shift
from hardware.reconstruction.motion.fitting import fitted_prior
from hardware.reconstruction.motion.knobs import Compensation
from hardware.reconstruction.motion.model import Motion
from hardware.reconstruction.motion.operators import (
    MovingPatterns,
    farthest_cells,
    moving_patterns,
)
from hardware.reconstruction.motion.timing import (
    TimedRows,
    exposure_times_s,
    middle_ns,
    timed_rows,
)
from hardware.reconstruction.prior import cell_variance, prior_scale, walsh_variance
from hardware.reconstruction.sensing import Mixing
from hardware.records import SpiRecord

Array = NDArray[np.float64]

#: Side of the blocks over which squared draws of the posterior are averaged, cells.
_BLOCK = 8
#: Share of the solver's residual where each value holds the light of all cells.
_BESIDE_ALL_LIGHT = 0.02
#: Measurements from which on they tell their own prior.
_FEWEST_FITTED = 64
#: Rank correlation of a row's prior variance with its time from which on motion is hardly told.
_IN_ORDER = 0.9
#: Lengths of a record that a reference time may lie before or after it.
_MOST_FRAMES = 100
#: Standard errors that hold 95 % of all cells, see `MovingScene.linear`.
ERRORS_IN_95 = 2.5


@dataclass(frozen=True, eq=False)
class _Estimate:
    """What differs from a flat image of a level, by a prior and its scale, and whether the
    measurements told the prior's steepness (`fitted_prior`). Standard errors are those of
    ``error_prior``, which is no weaker, by an ``error_scale``.
    """

    solved: solvers.Solved
    level: float
    scale: float
    error_prior: solvers.Prior
    error_scale: float
    is_fitted: bool


@dataclass(frozen=True, eq=False)
class MovingScene:
    """The measurements of a record with the operator of a motion.

    ``noise_variance`` (n_images,) is that of one measurement.
    """

    motion: Motion
    patterns: PatternSet
    timed: TimedRows
    operator: MovingPatterns
    noise_variance: Array
    knobs: Compensation

    def linear(self, most_noise: Array) -> tuple[Array, Array | None, tuple[str, ...]]:
        """Cells and standard errors, ``(n_cells, n_images)``, of the linear estimate; warnings.

        ``most_noise`` (n_images,) is the noise variance that standard errors are stated for. Where
        each value holds light that enters and leaves, which no scatter tells from noise, it is the
        noise of the fitted prior.

        Standard errors are those of the prior: they hold noise, and detail that the patterns do not
        tell apart where it moves; larger where measurements predict each other worse than it
        foresees (`Fitted`). Scenes are less normal than their prior: on those of the tests more
        than 93 % of all cells lie within `ERRORS_IN_95` of them.
        """
        cells, errors, worst = [], [], 0.0
        for image in range(self.timed.values.shape[1]):
            found = self._estimate(image)
            worst = max(worst, found.solved.residual)
            cells.append(self.operator.image(found.solved.unknowns).ravel() + found.level)
            if found.scale == 0 or not np.isfinite(most_noise[image]):
                errors.append(np.zeros(self.patterns.n_cells))
            elif self.knobs.error_samples:
                noise = 0.0 if self.timed.centred and found.is_fitted else float(most_noise[image])
                prior = found.error_prior
                prior = replace(prior, ratio=max(prior.ratio, noise / found.scale))
                errors.append(np.sqrt(found.error_scale * self._error_variance(prior)))
        image_cells = np.stack(cells, axis=1)
        told = tuple(self._told(worst))
        return image_cells, np.stack(errors, axis=1) if errors else None, told

    def edges(self) -> tuple[Array, tuple[str, ...]]:
        """Cells of least total variation within the noise, ``(n_cells, n_images)``; warnings."""
        cells, worst = [], 0.0
        for image in range(self.timed.values.shape[1]):
            found = self._estimate(image)
            worst = max(worst, found.solved.residual)
            values = self._without(found.level, image)
            noise, start = float(self.noise_variance[image]), found.solved.unknowns
            unknowns = solvers.total_variation(self.operator, values, noise, start)
            cells.append(self.operator.image(unknowns).ravel() + found.level)
        return np.stack(cells, axis=1), tuple(self._told(worst))

    def at_rest(self, indices: NDArray[np.intp]) -> tuple[Array, tuple[str, ...]]:
        """Measurements ``(len(indices), n_images)`` of Hadamard rows as of a scene that rests as it
        is at the reference time: those of the linear estimate, and what it leaves of the data.

        ``indices`` are the patterns' own, of a reference set with row 0 before them or without.
        """
        n_images = self.timed.values.shape[1]
        found = np.empty((len(indices), n_images))
        own = np.arange(self.timed.count)
        if self.patterns.mode == "reference":
            own = np.concatenate([own[: len(indices) - self.patterns.count], own[2:]])
        worst = 0.0
        for image in range(n_images):
            estimate = self._estimate(image)
            unknowns, level = estimate.solved.unknowns, estimate.level
            worst = max(worst, estimate.solved.residual)
            left = self._without(level, image) - self.operator.forward(unknowns)
            cells = self.operator.image(unknowns).ravel() + level
            found[:, image] = fwht(cells)[indices] + left[own]
        return found, tuple(self._told(worst))

    def _estimate(self, image: int) -> "_Estimate":
        """The linear estimate, with the prior of power 1/f^2 and the scale that its moments tell,
        or with the prior that some of the measurements tell (`fitted_prior`).
        """
        level = self._level(image)
        values = self._without(level, image)
        noise = float(self.noise_variance[image])
        detail = self.timed.rows[0] != 0
        expected = float(
            walsh_variance(self.patterns.rows, self.patterns.columns)[self.timed.rows[0]][
                detail
            ].sum()
        )
        energy = float(values[detail] @ values[detail])
        scale = prior_scale(energy, int(np.count_nonzero(detail)), noise, expected)
        if scale == 0:
            empty = np.zeros(self.operator.grid.shape)
            unsolved = solvers.Solved(empty, 0.0, 0)
            return _Estimate(unsolved, level, 0.0, solvers.Prior(1.0), 0.0, is_fitted=False)
        least = self._least_ratio
        prior = solvers.Prior(max(noise / scale, least))
        fits = self.knobs.prior_rows > 0 and self.timed.count >= _FEWEST_FITTED
        if fits:
            fitted = fitted_prior(
                self.operator,
                self.timed,
                values,
                noise_variance=None if self.timed.centred else noise,
                first=prior,
                least_ratio=least,
                most_rows=self.knobs.prior_rows,
            )
            prior = fitted.prior
        solved = self._solver(prior)(values)
        if not fits:
            return _Estimate(solved, level, scale, prior, scale, is_fitted=False)
        left = values - self.operator.forward(solved.unknowns)
        # Chi-square per measurement of 1.
        scale = max(float(values @ left) / (prior.ratio * self.timed.count), 0.0)
        stronger = prior.ratio / fitted.cautious.ratio
        error_scale = stronger * max(scale, fitted.predicting_scale)
        return _Estimate(
            solved, level, stronger * scale, fitted.cautious, error_scale, is_fitted=True
        )

    @property
    def _least_ratio(self) -> float:
        """Least ratio of noise to the prior's scale that the solver is asked to tell apart."""
        rows, columns = self.patterns.rows, self.patterns.columns
        spread = float(cell_variance(rows, columns).mean())
        return rows * columns * self.knobs.least_noise**2 * spread

    def _level(self, image: int) -> float:
        """Mean light of a cell, from the pattern that lights all; 0 without it."""
        values = self.timed.values[:, image]
        lit = np.flatnonzero(self.timed.rows[0] == 0)
        if lit.size == 0:
            return 0.0
        flat = self.operator.forward(np.ones(self.operator.grid.shape))
        power = float(flat[lit] @ flat[lit])
        return float(flat[lit] @ values[lit]) / power if power else 0.0

    def _without(self, level: float, image: int) -> Array:
        flat = self.operator.forward(np.full(self.operator.grid.shape, level))
        return np.asarray(self.timed.values[:, image] - flat)

    def _solver(self, prior: solvers.Prior) -> Callable[[Array], solvers.Solved]:
        knobs = self.knobs
        if self.timed.centred:
            # Light that enters and leaves is in every value, and rules the residual's norm.
            knobs = replace(knobs, residual=knobs.residual * _BESIDE_ALL_LIGHT)
        return solvers.linear_solver(self.operator, prior, self.timed.count, knobs)

    def _error_variance(self, prior: solvers.Prior) -> Array:
        """Mean square of the posterior's draws, smoothed, ``(n_cells,)``, for scale 1."""
        from scipy.ndimage import uniform_filter  # takes 0.1 s to import

        rng, solver = np.random.default_rng(self.knobs.seed), self._solver(prior)
        draws = [
            solvers.posterior_draw(self.operator, prior, solver, self.timed.count, rng)
            for _ in range(self.knobs.error_samples)
        ]
        squares = np.mean(np.square(draws), axis=0)
        return np.asarray(uniform_filter(squares, _BLOCK, mode="nearest").ravel())

    def _told(self, residual: float) -> Iterator[str]:
        if residual > 10 * self.knobs.residual:
            yield (
                f"motion compensation ended at a residual of {residual:.2g} after "
                f"{self.knobs.most_iterations} steps, expected {self.knobs.residual:.2g}"
            )


def check_known(patterns: Patterns, mixing: Mixing | None) -> PatternSet:
    """The patterns, if motion compensation can take them. Raises InputError."""
    if mixing is not None:
        raise InputError("motion: needs a clean grid of cells, without mixing")
    if not isinstance(patterns, PatternSet):
        raise InputError(
            "motion: needs rows of the Hadamard matrix, these patterns are a user's own"
        )
    return patterns


def check_reference(record: SpiRecord, reference_ns: int | None) -> None:
    """Raise InputError unless the reference time is on the record's clock, within `_MOST_FRAMES` of
    the record's length from it: a motion is not known for longer.
    """
    if reference_ns is None:
        return
    first, last = int(record.device_time_ns[0]), int(record.device_time_ns[-1])
    last += round(1e9 * record.integration_time_s)
    beyond = _MOST_FRAMES * (last - first)
    whole = isinstance(reference_ns, int | np.integer)
    if not whole or not first - beyond <= reference_ns <= last + beyond:
        raise InputError(
            f"reference_ns: {reference_ns!r:.60}, expected a whole number from {first - beyond} to "
            f"{last + beyond}, the record is from {first} to {last}"
        )


def motion_found(
    record: SpiRecord,
    received: SpiRecord,
    noise_variance: Array,
    search: Search,
    reference_ns: int | None = None,
) -> tuple[Motion | None, tuple[str, ...]]:
    """The shift that the measurements tell, None where they tell none (see `estimated_shift`), and
    why they may not, where their order is to blame.
    """
    patterns = check_known(received.patterns, None)
    time_s = exposure_times_s(received, middle_ns(record) if reference_ns is None else reference_ns)
    timed = timed_rows(patterns, received.electrons, time_s, pairs_apart=False)
    estimate = estimated_shift(patterns, timed, noise_variance, search)
    if estimate.is_significant:
        return estimate.shift, tuple(_badly_told(patterns, timed))
    return None, tuple(hardly_told(patterns, timed))


def _badly_told(patterns: PatternSet, timed: TimedRows) -> Iterator[str]:
    """Where a motion was found in patterns of one sequency that are all shown at about one time."""
    if _is_in_order(patterns, timed):
        yield (
            "motion: may be off by some cells a frame: patterns were shown from coarse to fine; "
            "show them in the order `interleaved`"
        )


def _is_in_order(patterns: PatternSet, timed: TimedRows) -> bool:
    """Whether patterns are shown from coarse to fine, or the other way."""
    from scipy.stats import spearmanr  # takes 0.3 s to import

    detail = timed.rows[0] != 0
    variance = walsh_variance(patterns.rows, patterns.columns)[timed.rows[0][detail]]
    in_turn = spearmanr(variance, timed.time_s[0][detail]).statistic
    return abs(float(in_turn)) > _IN_ORDER


def hardly_told(patterns: PatternSet, timed: TimedRows) -> Iterator[str]:
    """Where patterns of one sequency are all shown at about one time."""
    detail = timed.rows[0] != 0
    if np.count_nonzero(detail) < FEWEST_SEARCHED or np.ptp(timed.time_s) == 0:
        yield (
            f"motion: not looked for: {timed.count} patterns do not tell it, at least "
            f"{FEWEST_SEARCHED + 1} shown at different times are needed"
        )
        return
    if _is_in_order(patterns, timed):
        yield (
            "motion: none is compensated, and if there is any this record hardly tells it: its "
            "patterns were shown from coarse to fine; show them in the order `interleaved`, or "
            "give the motion"
        )


def moving_scene(
    record: SpiRecord,
    received: SpiRecord,
    noise_variance: Array,
    motion: Motion,
    knobs: Compensation,
    reference_ns: int | None = None,
) -> MovingScene | None:
    """A record with its motion; None where nothing moves within it.

    ``record`` is all that was asked for, whose middle is the reference time; ``received`` what of
    it arrived. Raises InputError for a motion that does not fit the image.
    """
    patterns = check_known(received.patterns, None)
    shape = (patterns.rows, patterns.columns)
    reference = middle_ns(record) if reference_ns is None else reference_ns
    time_s = exposure_times_s(received, reference)
    farthest = farthest_cells(motion, time_s, shape)
    if not np.isfinite(farthest):
        raise InputError("motion: leads to what is not a number")
    if farthest <= knobs.still_cells:
        return None
    pair_s = float(np.diff(time_s).max(initial=0.0))
    speed = farthest / float(np.abs(time_s).max())
    apart = speed * pair_s > knobs.within_pair_cells
    timed = timed_rows(patterns, received.electrons, time_s, pairs_apart=apart)
    operator = moving_patterns(timed, motion, shape, knobs)
    return MovingScene(motion, patterns, timed, operator, noise_variance, knobs)
