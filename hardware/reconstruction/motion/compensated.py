"""From measurements of a moving scene to its image at the reference time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import Patterns, PatternSet, fwht
from hardware.reconstruction.motion import solvers
from hardware.reconstruction.motion.estimation import Search, estimated_shift
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
#: Measurements from which on noise is told by cross-validation.
_FEWEST_VALIDATED = 64
#: Share of the solver's residual where each value holds the light of all cells.
_BESIDE_ALL_LIGHT = 0.02
#: Standard errors that hold 95 % of all cells, see `MovingScene.linear`.
ERRORS_IN_95 = 2.5


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

        ``most_noise`` (n_images,) is the noise variance that standard errors are stated for.

        Standard errors are those of the 1/f^2 prior: they hold noise, and detail that the patterns
        do not tell apart where it moves. Scenes are less normal than their prior: on those of the
        tests more than 93 % of all cells lie within `ERRORS_IN_95` of them.
        """
        cells, errors, worst = [], [], 0.0
        for image in range(self.timed.values.shape[1]):
            solved, level, scale = self._solved(image)
            worst = max(worst, solved.residual)
            cells.append(self.operator.grid.image(solved.unknowns).ravel() + level)
            if scale == 0 or not np.isfinite(most_noise[image]):
                errors.append(np.zeros(self.patterns.n_cells))
            elif self.knobs.error_samples:
                ratio = max(self._ratio(image, scale), float(most_noise[image]) / scale)
                errors.append(np.sqrt(scale * self._error_variance(ratio)))
        found = np.stack(cells, axis=1)
        return found, np.stack(errors, axis=1) if errors else None, tuple(self._told(worst))

    def edges(self) -> tuple[Array, tuple[str, ...]]:
        """Cells of least total variation within the noise, ``(n_cells, n_images)``; warnings."""
        cells, worst = [], 0.0
        for image in range(self.timed.values.shape[1]):
            solved, level, _ = self._solved(image)
            worst = max(worst, solved.residual)
            values = self._without(level, image)
            noise = float(self.noise_variance[image])
            unknowns = solvers.total_variation(self.operator, values, noise, solved.unknowns)
            cells.append(self.operator.grid.image(unknowns).ravel() + level)
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
            solved, level, _ = self._solved(image)
            worst = max(worst, solved.residual)
            left = self._without(level, image) - self.operator.forward(solved.unknowns)
            cells = self.operator.grid.image(solved.unknowns).ravel() + level
            found[:, image] = fwht(cells)[indices] + left[own]
        return found, tuple(self._told(worst))

    def _solved(self, image: int) -> tuple[solvers.Solved, float, float]:
        """The linear estimate of what differs from a flat image, that image's level, the scale."""
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
            return solvers.Solved(empty, 0.0, 0), level, scale
        ratio = self._ratio(image, scale)
        count, knobs = self.timed.count, self.knobs
        if self.timed.centred and count >= _FEWEST_VALIDATED:
            # Light that enters and leaves is in every value: it is no measure of noise or scale.
            knobs = replace(knobs, residual=knobs.residual * _BESIDE_ALL_LIGHT)
            ratio = solvers.cross_validated(self.operator, values, ratio, count, knobs)
            solved = solvers.lmmse(self.operator, values, ratio, count, knobs)
            left = values - self.operator.forward(solved.unknowns)
            return solved, level, max(float(values @ left) / (ratio * count), 0.0)
        return solvers.lmmse(self.operator, values, ratio, count, knobs), level, scale

    def _ratio(self, image: int, scale: float) -> float:
        """Noise over the prior's scale, at least what the solver is asked to tell apart."""
        rows, columns = self.patterns.rows, self.patterns.columns
        spread = float(cell_variance(rows, columns).mean())
        least = rows * columns * self.knobs.least_noise**2 * spread
        noise = float(self.noise_variance[image])
        return max(noise / scale, least) if scale else 1.0

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

    def _error_variance(self, ratio: float) -> Array:
        """Mean square of the posterior's draws, smoothed, ``(n_cells,)``, for scale 1."""
        from scipy.ndimage import uniform_filter  # takes 0.1 s to import

        rng = np.random.default_rng(self.knobs.seed)
        draws = [
            solvers.posterior_draw(self.operator, ratio, self.timed.count, self.knobs, rng)
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


def motion_found(
    record: SpiRecord,
    received: SpiRecord,
    noise_variance: Array,
    search: Search,
    reference_ns: int | None = None,
) -> Motion | None:
    """The shift that the measurements tell; None where they tell none. See `estimated_shift`."""
    patterns = check_known(received.patterns, None)
    time_s = exposure_times_s(received, middle_ns(record) if reference_ns is None else reference_ns)
    timed = timed_rows(patterns, received.electrons, time_s, pairs_apart=False)
    estimate = estimated_shift(patterns, timed, noise_variance, search)
    return estimate.shift if estimate.is_significant else None


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
