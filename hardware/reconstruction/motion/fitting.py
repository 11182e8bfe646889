"""The prior of a moving image, its scale and steepness, from some of its measurements.

Measurements y of an image under a prior of power spectrum 1/f^(2 e) and scale s have covariance
s A C A^T + n I. Where the noise n of a measurement is known, s and e are those of greatest
likelihood (empirical Bayes); where it is not, those that predict measurements left out best
(generalised cross-validation; Golub, Heath and Wahba, Technometrics 21, 1979). Some hundred
measurements of all sequencies suffice for two numbers, and their covariance is small.

They also tell how far to trust the prior: each is predicted from the others, and where pictures are
less alike than the prior at the places that count, as sharp ones are, or their motion is another,
errors of prediction are larger than those that the prior foresees. Errors of the image are, too.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction.motion.operators import MOST_VALUES, MovingPatterns
from hardware.reconstruction.motion.solvers import Prior, covariance_of, in_cosines
from hardware.reconstruction.motion.timing import TimedRows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fitted:
    """A prior and its ``predicting_scale``: the scale under which errors of prediction of
    measurements that are left out one by one have the mean square that the prior foresees.
    """

    prior: Prior
    predicting_scale: float


#: Exponents that are tried, ascending in equal steps, and ratios about the first one.
_EXPONENTS = np.linspace(0.7, 2.2, 6)
_RATIOS = 2.0 ** np.arange(-12, 13)
#: Where the noise is unknown, ratios are tried from this many down: per squared rows of the image.
_LARGEST_RATIO, _RATIO_COUNT = 4.0, 40
#: Share of `MOST_VALUES` that the rows may take.
_SHARE = 1 / 4


def fitted_prior(
    operator: MovingPatterns,
    timed: TimedRows,
    values: Array,
    *,
    noise_variance: float | None,
    first: Prior,
    least_ratio: float,
    most_rows: int,
) -> Fitted:
    """The prior that measurements ``values`` (count,), less the image's level, tell.

    ``noise_variance`` of one measurement, None: unknown. ``first`` is the prior to start from, and
    ``least_ratio`` the least ratio that is taken. At most ``most_rows`` measurements are used.
    """
    some = _of_all_sequencies(operator, timed, most_rows)
    parts, y = in_cosines(operator.rows(some)), values[some]
    ratios = first.ratio * _RATIOS
    if noise_variance is None:
        ratios = _LARGEST_RATIO * operator.grid.rows**2 * 2.0 ** -np.arange(_RATIO_COUNT)
    ratios = np.unique(np.maximum(ratios, least_ratio))

    @cache
    def tried(exponent: float) -> tuple[float, float]:
        """Score, the lower the better, and the ratio that has it."""
        covariance = covariance_of(parts, operator.grid.spectrum(exponent))
        eigenvalues, vectors = np.linalg.eigh(covariance)
        variance = np.maximum(eigenvalues, 0.0) + ratios[:, None]
        energy = (vectors.T @ y) ** 2
        if noise_variance:
            total = noise_variance / ratios[:, None] * variance
            score = (energy / total + np.log(total)).sum(axis=1)
        else:
            free = ratios[:, None] / variance
            score = np.mean(energy * free**2, axis=1) / np.mean(free, axis=1) ** 2
        best = int(np.argmin(score))
        return float(score[best]), float(ratios[best])

    at = int(np.argmin(np.abs(_EXPONENTS - first.exponent)))
    for step in (1, -1):
        while 0 <= at + step < len(_EXPONENTS) and (
            tried(float(_EXPONENTS[at + step])) < tried(float(_EXPONENTS[at]))
        ):
            at += step
    exponent = float(_EXPONENTS[at])
    prior = Prior(tried(exponent)[1], exponent)
    covariance = covariance_of(parts, operator.grid.spectrum(exponent))
    np.fill_diagonal(covariance, covariance.diagonal() + prior.ratio)
    return Fitted(prior, _predicting_scale(covariance, y))


def _predicting_scale(covariance: Array, values: Array) -> float:
    """See `Fitted`; ``covariance`` of the values is that of scale 1.

    With P its inverse, value k is off its prediction from all others by (P y)_k / P_kk, which has
    the variance 1 / P_kk (Rasmussen and Williams, Gaussian Processes, 2006, eq. 5.12).
    """
    from scipy.linalg import cho_factor, cho_solve  # takes 0.1 s to import

    factor = cho_factor(covariance, lower=True, check_finite=False)
    precision = cho_solve(factor, np.eye(len(values)), check_finite=False)
    variance = 1 / np.diag(precision)
    errors = variance * (precision @ values)
    return float(errors @ errors / variance.sum())


def _of_all_sequencies(
    operator: MovingPatterns, timed: TimedRows, most_rows: int
) -> NDArray[np.intp]:
    """Measurements but that of the level, evenly over rows by falling prior variance."""
    from hardware.reconstruction.prior import walsh_variance

    variance = walsh_variance(operator.grid.rows, operator.grid.columns)[timed.rows[0]]
    order = np.argsort(-variance, kind="stable")
    order = order[timed.rows[0][order] != 0]
    unknowns = operator.grid.shape[0] * operator.grid.shape[1]
    most = max(min(most_rows, int(_SHARE * MOST_VALUES / unknowns), len(order)), 1)
    return np.unique(order[np.linspace(0, len(order) - 1, most).astype(np.intp)])
