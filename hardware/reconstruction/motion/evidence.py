"""How likely the measurements are under a motion: the marginal likelihood of the coarsest of them.

Measurements y of an image under the 1/f^2 prior of covariance C, seen through the patterns A of a
motion, are normal of covariance s (A C A^T + r I). Rows of low sequency are constant on 2 x 2
cells, so that a coarse image tells them exactly; some hundred of them tell motions apart.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import PatternSet
from hardware.reconstruction.motion.knobs import Compensation
from hardware.reconstruction.motion.likelihood import cost_of
from hardware.reconstruction.motion.model import Motion, Shift
from hardware.reconstruction.motion.operators import WarpedPatterns
from hardware.reconstruction.motion.solvers import covariance_of, in_cosines
from hardware.reconstruction.motion.timing import TimedRows
from hardware.reconstruction.prior import cell_variance, walsh_variance

Array = NDArray[np.float64]

#: Cells along a side of the coarse image, at most, and measurements that are taken, at most: to
#: search, and all.
_COARSE, SEARCHED_ROWS, ALL_ROWS = 32, 448, 1024
#: Noise of a cell over the image's spread that the likelihood is not trusted below: edges and what
#: lies between cells are not as the prior has it.
_LEAST_NOISE = 0.1
#: Standard deviation of the image's level over that of a cell.
_LEVEL = 10.0
_KNOBS = Compensation(oversampling=1, step_cells=0.5)
REST = Shift(0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Evidence:
    """The coarsest measurements ``timed`` of an image of ``shape``, coarse cells, and the noise
    variance of each of their images (n_images,).
    """

    shape: tuple[int, int]
    timed: TimedRows
    noise: Array

    @classmethod
    def of(
        cls,
        patterns: PatternSet,
        timed: TimedRows,
        noise_variance: Array,
        most_rows: int = SEARCHED_ROWS,
    ) -> "Evidence":
        """Of the measurements that a coarse image tells, those of largest prior variance."""
        rows, columns = np.array([patterns.rows, patterns.columns])
        down, along = divmod(timed.rows, patterns.columns)
        part_down, part_along = (_part(n) for n in (patterns.rows, patterns.columns))
        told = ((down % part_down == 0) & (along % part_along == 0)).all(axis=0)
        variance = walsh_variance(patterns.rows, patterns.columns)[timed.rows[0]]
        first = np.argsort(np.where(told, -variance, np.inf), kind="stable")
        some = np.sort(first[: min(most_rows, int(np.count_nonzero(told)))])
        shape = (int(rows) // part_down, int(columns) // part_along)
        coarse = down[:, some] // part_down * shape[1] + along[:, some] // part_along
        values = timed.values[some] / (part_down * part_along)
        if timed.centred:
            values = values - values.mean(axis=0)
        taken = TimedRows(
            coarse, timed.time_s[:, some], timed.weight[:, some], values, timed.centred
        )
        return cls(shape, taken, np.asarray(noise_variance) / (part_down * part_along) ** 2)

    def cost(self, motion: Motion) -> float:
        """Minus the log-likelihood of a motion, for the scale that fits best; infinite for one that
        the frame does not allow.
        """
        try:
            gram = self._covariance(motion)
        except InputError:
            return float("inf")
        return cost_of(gram, self.timed.values, self._noise_over_scale())

    def _noise_over_scale(self) -> Array:
        """Of each image, by the energy of its measurements but that of the level."""
        energy = (self.timed.values[self.timed.rows[0] != 0] ** 2).sum(axis=0)
        least = _LEAST_NOISE**2 * energy / self._cells
        return np.asarray(np.maximum(self.noise, least) * self._prior / np.maximum(energy, 1e-300))

    def _covariance(self, motion: Motion) -> Array:
        operator = WarpedPatterns(self.timed, motion, self.shape, _KNOBS)
        rows = operator.rows(np.arange(self.timed.count))
        gram = covariance_of(in_cosines(rows), operator.grid.spectrum())
        level = operator.forward(np.ones(operator.grid.shape))
        spread = float(cell_variance(*self.shape).mean())
        return np.asarray(gram + _LEVEL**2 * spread * np.outer(level, level))

    @property
    def _prior(self) -> float:
        """Energy of the measurements but those of the level, by the prior of scale 1."""
        variance = walsh_variance(*self.shape)[self.timed.rows[0]]
        return float(variance[self.timed.rows[0] != 0].sum())

    @property
    def _cells(self) -> float:
        """Energy of the measurements over the mean variance of a cell."""
        return self._prior / float(cell_variance(*self.shape).mean())


def _part(n: int) -> int:
    """Cells along a side that one of the coarse image holds."""
    part = 1
    while n % (2 * part) == 0 and n // part > _COARSE:
        part *= 2
    return part
