"""The shift of an image while it was measured, from the measurements alone.

Measurements y of an image under the 1/f^2 prior, moved with velocity v, are normal of covariance
s (A_v C A_v^T + r I). The velocity of greatest likelihood, with the scale s that fits it best, is
looked for with the coarsest patterns first: 64 of them tell it to a few cells in a millisecond,
512 to a fraction of a cell. Registration of sub-images of short parts of the frame uses the same
knowledge, but only between parts that show the same rows, which a set does not.

It is taken only where it explains the measurements so much better than rest that chance does not.
Patterns of low and high sequency in turn (order ``interleaved``) tell motion; where each row is
shown once in the order of sequency hardly anything does.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import PatternSet
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.motion.likelihood import cost_of, with_noise
from hardware.reconstruction.motion.model import Shift
from hardware.reconstruction.motion.operators import shifted_rows
from hardware.reconstruction.motion.timing import TimedRows
from hardware.reconstruction.prior import walsh_variance

Array = NDArray[np.float64]

#: Measurements without which motion is not looked for.
FEWEST_SEARCHED = 8
#: Rows of largest prior variance that each stage takes, and the cosine functions along a side.
_STAGES = ((64, 24), (256, 40), (512, 56))
#: Steps of the first stage's grid, cells within the frame; what those of few patterns resolve.
_STEP_CELLS = 2.0
#: Candidates that go on to the second stage and to the third.
_CANDIDATES = (8, 2)
#: Calls of a simplex search in each of them.
_CALLS = (30, 60)
#: Around the best velocity a true one is much less likely: textures that fall more slowly than the
#: prior make any large motion likelier than rest, and all of them alike.
_AROUND_CELLS = 6.0 * np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b])
#: Noise of a cell over the image's spread that the likelihood is not trusted below: edges and what
#: lies between cells are not as the prior has it.
_LEAST_NOISE = 0.3


@dataclass(frozen=True)
class Search:
    """Where motion is looked for, and when it is believed.

    Parameters
    ----------
    most_cells
        Largest displacement from the first exposure to the last, down and to the right, cells.
    evidence
        Least gain of the log-likelihood over rest, and over the opposite velocity: detail that the
        prior does not expect makes any motion likelier than rest, but forth as much as back. None
        of the 10 frames at rest of five pictures that nothing was tuned on, noise of 0.1 and 0.01
        of their range, full sets of the order ``interleaved``, is taken for moving (below 26 % with
        95 % confidence; gains up to 17.7 where the next condition holds too). Of the same moving by
        20 cells, four pass with velocities within a cell a frame, a brick wall does not. A full set
        in the order of sequency tells little, and may pass with a velocity that is off by 6. Motion
        too small to pass is left in the image.
    evidence_beside
        Least gain over velocities 6 cells a frame beside the best.
    prediction
        Least gain over rest in predicting each measurement from all others: the sum of differences
        of squared errors over its standard error. Of 150 frames at rest of 50 scenes of blobs and
        boxes, 16 x 16 cells, noise of 0.1, 0.01 and 0.001 of their range, searched to 5 cells, none
        is taken for moving (below 2 % with 95 % confidence), with gains up to 2.7 where all other
        conditions hold; of 51 of 32 x 32 none (below 6 %). Of 10 that move by 3 cells, 16 x 16,
        noise of 0.01, nine pass; of four that move by one cell, one.
    starts
        Velocities to begin with beside those of the search: of odometry, of a radar's tracks.
    """

    most_cells: float = 32.0
    evidence: float = 20.0
    evidence_beside: float = 10.0
    prediction: float = 4.0
    starts: tuple[Shift, ...] = field(default=())

    def __post_init__(self) -> None:
        for name in ("most_cells", "evidence", "evidence_beside", "prediction"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name}: {value} is not a positive number")


@dataclass(frozen=True)
class EstimatedShift:
    """What was found: the best velocity, its gain of log-likelihood (`Search.evidence`), and
    whether it is believed. ``error_cells_per_s`` is the standard error by the likelihood's
    curvature, down and to the right. It holds as far as the prior of the image does, and is not
    calibrated: in moving scenes of blobs and discs the truth was 1.3 to 2.6 of it off (root mean
    square; up to 5.6), and 60 to 88 % were within 1.96.
    """

    shift: Shift
    evidence: float
    is_significant: bool
    error_cells_per_s: tuple[float, float]


def estimated_shift(
    patterns: PatternSet, timed: TimedRows, noise_variance: Array, search: Search | None = None
) -> EstimatedShift:
    """The velocity of greatest likelihood.

    Parameters
    ----------
    timed
        Measurements ``(count, n_images)`` with their rows and times; images share one velocity.
    noise_variance : (n_images,)
        Of one measurement.
    """
    search = search or Search()
    span_s = float(np.ptp(timed.time_s))
    nothing = EstimatedShift(Shift(0.0, 0.0), 0.0, False, (np.inf, np.inf))
    if span_s == 0 or timed.count < FEWEST_SEARCHED:
        return nothing
    most = search.most_cells
    stages = [_Likelihood.of(patterns, timed, noise_variance, n, k, most) for n, k in _STAGES]
    if not stages[0].values.any():
        return nothing
    steps = np.arange(-np.floor(most / _STEP_CELLS), np.floor(most / _STEP_CELLS) + 1)
    grid = np.array([(a, b) for a in steps for b in steps]) * _STEP_CELLS
    costs = np.array([stages[0].cost(place) for place in grid])
    places = [tuple(grid[k]) for k in _lowest(costs.reshape(len(steps), -1), _CANDIDATES[0])]
    places += [(s.down_cells_per_s * span_s, s.right_cells_per_s * span_s) for s in search.starts]
    for stage, calls, keep in zip(stages[1:], _CALLS, (_CANDIDATES[1], 1), strict=True):
        found = sorted(_refined(stage, place, calls) for place in places)
        places = [place for _, place in found[:keep]]
    best, last = places[0], stages[-1]
    around = [np.array(best) + step for step in _AROUND_CELLS]
    evidence = last.cost((0.0, 0.0)) - found[0][0]
    over_opposite = last.cost(-np.array(best)) - found[0][0]
    beside = min(last.cost(place) for place in around) - found[0][0]
    errors = [e / span_s for e in _errors(last, best)]
    return EstimatedShift(
        Shift(best[0] / span_s, best[1] / span_s),
        float(evidence),
        bool(
            min(evidence, over_opposite) > search.evidence
            and beside > search.evidence_beside
            and _gain_of_prediction(last, best) > search.prediction
        ),
        (errors[0], errors[1]),
    )


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """Of the coarsest measurements: displacements are cells within the frame.

    ``down``, ``along``, ``share``, ``weight`` (n_terms, m): Walsh functions, time over the frame's
    length; ``values`` (m, n_images).
    """

    shape: tuple[int, int]
    margin: int
    functions: int
    down: NDArray[np.intp]
    along: NDArray[np.intp]
    share: Array
    weight: Array
    values: Array
    noise: Array
    centred: bool

    @classmethod
    def of(
        cls,
        patterns: PatternSet,
        timed: TimedRows,
        noise_variance: Array,
        n_rows: int,
        functions: int,
        most_cells: float,
    ) -> "_Likelihood":
        """Of the ``n_rows`` rows of largest prior variance, but that of the level."""
        shape = (patterns.rows, patterns.columns)
        variance = walsh_variance(*shape)[timed.rows[0]]
        variance = np.where(timed.rows[0] == 0, -1.0, variance)
        some = np.sort(np.argsort(-variance, kind="stable")[:n_rows])
        some = some[timed.rows[0][some] != 0]
        down, along = divmod(timed.rows[:, some], patterns.columns)
        values = timed.values[some]
        if timed.centred:
            values = values - values.mean(axis=0)
        energy = np.maximum((values**2).sum(axis=0), 1e-300)
        cell = variance[some].sum() / (patterns.n_cells * _mean_cell_variance(shape))
        least = energy / cell * _LEAST_NOISE**2 if some.size else energy
        noise = np.maximum(noise_variance, least)
        return cls(
            shape,
            int(np.ceil(most_cells / 2)) + 1,
            functions,
            down,
            along,
            timed.time_s[:, some] / np.ptp(timed.time_s),
            timed.weight[:, some],
            values,
            noise,
            timed.centred,
        )

    def cost(self, place: tuple[float, float] | Array) -> float:
        """Minus the log-likelihood at a displacement, for the scale that fits best."""
        gram = self._covariance(place)
        return cost_of(gram, self.values, self._noise_over_scale(gram))

    def left_out(self, place: tuple[float, float] | Array) -> tuple[Array, Array]:
        """Errors of each measurement as all others predict it at a displacement, and their
        variance in units of the scale, ``(m, n_images)`` both (Rasmussen and Williams, Gaussian
        Processes for Machine Learning, 2006, eq. 5.12).
        """
        gram = self._covariance(place)
        errors, variances = np.empty_like(self.values), np.empty_like(self.values)
        for image, noise in enumerate(self._noise_over_scale(gram)):
            inverse = np.linalg.pinv(with_noise(gram, float(noise)), hermitian=True)
            variances[:, image] = 1 / inverse.diagonal()
            errors[:, image] = inverse @ self.values[:, image] * variances[:, image]
        return errors, variances

    def _noise_over_scale(self, gram: Array) -> Array:
        """Of each image, with the scale that the energy of its measurements tells."""
        noise = len(self.values) * self.noise
        energy = (self.values**2).sum(axis=0)
        scale = np.maximum(energy - noise, 0.1 * noise) / np.trace(gram)
        return np.asarray(self.noise / scale)

    def _covariance(self, place: tuple[float, float] | Array) -> Array:
        """A C A^T of unit scale at a displacement, ``(m, m)``."""
        sides = [
            _cosines(
                shifted_rows(
                    rows.ravel(),
                    float(moved) * self.share.ravel(),
                    n,
                    -self.margin,
                    n + 2 * self.margin,
                    1,
                ),
                self.functions,
            )
            for rows, moved, n in zip((self.down, self.along), place, self.shape, strict=True)
        ]
        parts = np.einsum("ki,kj->kij", sides[0] * self.weight.reshape(-1, 1), sides[1])
        parts *= _deviations(self.shape, self.margin, parts.shape[1:])
        rows = parts.reshape(*self.share.shape, -1).sum(axis=0)
        if self.centred:
            rows = rows - rows.mean(axis=0)
        return np.asarray(rows @ rows.T)


def _gain_of_prediction(stage: _Likelihood, best: tuple[float, float]) -> float:
    """See `Search.prediction`; squared errors are in units of their variance by both."""
    rest, rest_variance = stage.left_out((0.0, 0.0))
    moved, moved_variance = stage.left_out(best)
    gain = (rest**2 - moved**2) / (rest_variance + moved_variance)
    power = float(np.sqrt(np.sum(gain**2)))
    return float(gain.sum()) / power if power else 0.0


def _refined(
    stage: _Likelihood, place: tuple[float, float], calls: int
) -> tuple[float, tuple[float, float]]:
    from scipy.optimize import minimize  # takes 0.1 s to import

    simplex = np.array(place) + np.array([[0.0, 0.0], [1.0, 0.3], [-0.3, 1.0]])
    options = {"maxfev": calls, "xatol": 0.01, "fatol": 1e-2, "initial_simplex": simplex}
    found = minimize(stage.cost, place, method="Nelder-Mead", options=options)
    return float(found.fun), (float(found.x[0]), float(found.x[1]))


def _errors(stage: _Likelihood, best: tuple[float, float], step: float = 0.25) -> list[float]:
    """Standard errors by the curvature of the likelihood along each axis; infinite where none."""
    found = []
    middle = stage.cost(best)
    for axis in np.eye(2):
        sides = [stage.cost(np.array(best) + sign * step * axis) for sign in (-1, 1)]
        curvature = (sides[0] + sides[1] - 2 * middle) / step**2
        found.append(float(1 / np.sqrt(curvature)) if curvature > 0 else float("inf"))
    return found


def _lowest(costs: Array, n: int) -> NDArray[np.intp]:
    """Flat places of the n lowest local minima of a grid."""
    from scipy.ndimage import minimum_filter  # takes 0.1 s to import

    local = costs == minimum_filter(costs, 3, mode="nearest")
    order = np.argsort(np.where(local, costs, np.inf), axis=None, kind="stable")
    return np.asarray(order[: min(n, int(np.count_nonzero(local)))])


def _cosines(rows: Array, functions: int) -> Array:
    return rows @ _first_cosines(rows.shape[1], functions)


@lru_cache(maxsize=16)
def _first_cosines(n: int, functions: int) -> Array:
    return np.ascontiguousarray(dct_matrix(n)[:functions].T)


@lru_cache(maxsize=16)
def _deviations(shape: tuple[int, int], margin: int, functions: tuple[int, int]) -> Array:
    """Square roots of the prior's eigenvalues on the widened grid."""
    f2 = [
        (np.arange(k) * n / (n + 2 * margin) / 2) ** 2
        for k, n in zip(functions, shape, strict=True)
    ]
    total = f2[0][:, None] + f2[1]
    total[0, 0] = np.inf
    return np.asarray(1 / np.sqrt(total))


@lru_cache(maxsize=16)
def _mean_cell_variance(shape: tuple[int, int]) -> float:
    from hardware.reconstruction.prior import cell_variance

    return float(cell_variance(*shape).mean())
