"""The prior of a moving image, its scale and steepness, from some of its measurements.

Measurements y of an image under a prior of power spectrum 1/f^(2 e) and scale s have covariance
s A C A^T + n I. Where the noise n of a measurement is known, s and e are those of greatest
likelihood (empirical Bayes); where it is not, those that predict measurements left out best
(generalised cross-validation; Golub, Heath and Wahba, Technometrics 21, 1979). Some hundred
measurements of all sequencies suffice for two numbers, and their covariance is small.

They also tell how far to trust the prior: each is predicted from the others, and where pictures are
less alike than the prior at the places that count, as sharp ones are, or their motion is another,
errors of prediction are larger than those that the prior foresees. Errors of the image are, too.
Where the light is faint, many priors are as likely, down to one of no picture at all: errors are
those of the one that leaves the most unknown.
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
    measurements that are left out one by one have the mean square that the prior foresees; and the
    ``cautious`` one of those that the measurements do not rule out, which leaves the most unknown.
    """

    prior: Prior
    predicting_scale: float
    cautious: Prior


#: Exponents that are tried, ascending in equal steps, and ratios about the first one.
_EXPONENTS = np.linspace(0.7, 2.2, 6)
_RATIOS = 2.0 ** np.arange(-12, 13)
#: Where the noise is unknown, ratios are tried from this many down: per squared rows of the image.
_LARGEST_RATIO, _RATIO_COUNT = 4.0, 40
#: Twice the logarithm of the likelihood, by which priors that are not ruled out are below the most
#: likely one at most: 95 % of chi-square of one degree of freedom.
_NOT_RULED_OUT = 3.84
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
    def scores(exponent: float) -> Array:
        """Of every ratio, the lower the better."""
        covariance = covariance_of(parts, operator.grid.spectrum(exponent))
        eigenvalues, vectors = np.linalg.eigh(covariance)
        variance = np.maximum(eigenvalues, 0.0) + ratios[:, None]
        energy = (vectors.T @ y) ** 2
        if noise_variance:
            total = noise_variance / ratios[:, None] * variance
            score: Array = (energy / total + np.log(total)).sum(axis=1)
            return score
        free = ratios[:, None] / variance
        return np.asarray(np.mean(energy * free**2, axis=1) / np.mean(free, axis=1) ** 2)

    def tried(exponent: float) -> tuple[float, float]:
        """The best score, and the ratio that has it."""
        best = int(np.argmin(scores(exponent)))
        return float(scores(exponent)[best]), float(ratios[best])

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
    priors, least = [prior], tried(exponent)[0] + _NOT_RULED_OUT
    beside = _EXPONENTS[max(at - 1, 0) : at + 2].tolist()  # known by now
    if noise_variance and sum(int(np.sum(scores(other) <= least)) for other in beside) > 1:
        likely = {other: ratios[scores(other) <= least] for other in _EXPONENTS.tolist()}
        priors += [Prior(float(r.min()), other) for other, r in likely.items() if len(r)]
    unknown = [_unknown(operator.grid.spectrum(one.exponent), one, timed) for one in priors]
    return Fitted(prior, _predicting_scale(covariance, y), priors[int(np.argmax(unknown))])


def _unknown(spectrum: Array, prior: Prior, timed: TimedRows) -> float:
    """Variance of an image that measurements leave to a prior, over theirs, about: as if each told
    of every cosine coefficient the same.
    """
    return float(np.sum(spectrum / (prior.ratio + timed.count * spectrum)))


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
