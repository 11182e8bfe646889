"""Intervals of the SNRs of a capture's cells: their median, the largest, the share above 1.

SNRs are predicted, not read from the record: the sensor's noise moves none of them. A quantile of
the cells is drawn anew with their errors, from a seed of its own, so that the same capture has the
same intervals.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from twin.accuracy import Interval
from twin.accuracy.interval import TWO_SIDED_95
from twin.camera.acquisition import Capture
from twin.camera.verdict import LIT

Array = NDArray[np.float64]
Lit = NDArray[np.bool_]

SEED = 17
#: Draws of the cells' errors, with the factor by which their scatter is to be larger so that 1.96
#: of it hold 95 % of cases (Student's distribution).
_DRAWS, FEW = 16, 1.087
#: Errors by which a cell may be beside the median whose errors move it; neighbouring cells from
#: which on quantiles of their differences are known; these quantiles, and of the square of a normal
#: variable (chi-squared of one degree of freedom).
_ABOUT, _LEAST_PAIRS = 2.0, 100
_QUANTILES, _OF_NORMAL = (0.5, 0.75, 0.9), np.array([0.4549, 1.3233, 2.7055])
_ACROSS = (slice(None), slice(1, None)), (slice(None), slice(-1))
#: Cells to a side, of which the mean is taken, and how many of them at least; standard deviations
#: between mean and median of errors with one peak, at most (Johnson and Rogers, 1951).
_AROUND, _LEAST_AROUND, _MOST_SKEWED = 5, 12, 0.6**0.5
#: Of normal errors about one value those within half a standard deviation exceed a quarter of those
#: within two by this share.
_PEAK = 0.376


def snr_interval(capture: Capture, quantity: Literal["median", "best", "above 1"]) -> Interval:
    """A quantity of the SNRs of the lit cells: their median, the largest, the share above 1. Errors
    of light are drawn anew, those of the noise are common to all cells.

    Errors that are drawn to SNRs that have errors already shift a median as those have shifted it
    from the true one, where they are as large as stated. Stated errors of single cells are bounds
    on the safe side; the median's are taken no larger than neighbouring cells let them be. Cells
    with a surface that may have enough light to be lit, or not, count among the lit ones or not.
    """
    lit = capture.lit
    if capture.void or not lit.any():
        return Interval(0.0 if quantity == "above 1" else np.nan)
    value, error, scene_e = _OF_SNR[quantity], capture.model_error, capture.scene_e
    snr = capture.snr[lit]
    relative, bound = (
        np.broadcast_to(_over(part, scene_e), scene_e.shape)
        for part in (capture.cells_error_e, capture.light_systematic_e)
    )
    own, bound = relative[lit], bound[lit]
    skewed = 0.0
    if quantity == "median":
        own = own * _share_seen(capture.snr, capture.snr * relative, lit)
        skewed = _moved_by_skewed(capture.snr, capture.snr * relative, lit)
    common, common_bound = (float(np.max(part)) for part in (error.noise, error.noise_systematic))
    each, together = normal_draws(snr.size)
    drawn = value(snr * np.maximum(1 + own * each, 0) * (1 + common * together))
    here = float(value(snr))
    systematic = abs(float(drawn.mean()) - here)
    if np.isfinite(bound).all():
        ends = np.stack([snr * (1 + bound + common_bound), snr * max(1 - common_bound, 0)])
        systematic += float(np.abs(value(ends) - here).max())
    else:
        systematic = np.inf
    systematic += skewed
    n_more, is_sure = _perhaps_lit(capture, lit)
    others = [np.append(snr, np.zeros(n_more)), snr[is_sure[lit]]]
    systematic += max(abs(float(value(each)) - here) for each in others if each.size)
    return Interval(here, FEW * float(drawn.std(ddof=1)), systematic)


def _perhaps_lit(capture: Capture, lit: Lit) -> tuple[int, Lit]:
    """Number of cells with a surface that exact light might light, as where light was left out or
    no path has found any; and which of the lit ones it lights for sure.
    """
    light, least = capture.scene_e, LIT * capture.scene_e.max(initial=0.0)
    off = TWO_SIDED_95 * capture.cells_error_e + capture.light_systematic_e
    might = ~lit & (light + off > least) & (capture.truth.albedo > 0)
    return int(np.count_nonzero(might)), lit & (light - off > least)


def _share_seen(snr: Array, error: Array, lit: Lit) -> float:
    """Share, at most 1, of the stated errors of cells that the errors have at most, as far as cells
    about the median tell; all (rows, columns).

    With independent errors neighbouring cells differ by at least what these make them differ by:
    whatever the true difference is, it makes each quantile of the difference's size larger
    (Anderson's inequality). Of several quantiles the one counts that permits most.
    """
    about = lit & (np.abs(snr - np.median(snr[lit])) <= _ABOUT * error)
    squares = []
    for one, other in (((slice(1, None),), (slice(-1),)), (_ACROSS[0], _ACROSS[1])):
        both = (about[one] | about[other]) & lit[one] & lit[other]
        variance = error[one][both] ** 2 + error[other][both] ** 2
        squares.append((snr[one][both] - snr[other][both]) ** 2 / variance)
    found = np.concatenate(squares)
    if found.size < _LEAST_PAIRS:
        return 1.0
    return float(min(np.sqrt(np.max(np.quantile(found, _QUANTILES) / _OF_NORMAL)), 1.0))


def _moved_by_skewed(snr: Array, error: Array, lit: Lit) -> float:
    """How far errors move the median that are mostly a little too low and seldom far too high, as
    where few paths bring much of the light; all (rows, columns).

    Cells differ from the mean of those around by their errors, whatever the smooth part of the
    scene is: the median of that difference is that of the errors. It moves the image's as far as
    cells are no less alike than their errors: where they are spread evenly beside the median, what
    comes up from below goes down from above.
    """
    here = float(np.median(snr[lit]))
    count, total = (
        _AROUND**2 * uniform_filter(part, _AROUND, mode="constant") - part
        for part in (lit.astype(float), np.where(lit, snr, 0))
    )
    around = lit & (error > 0) & (np.abs(snr - here) <= _ABOUT * error)
    around &= np.rint(count) >= _LEAST_AROUND
    if np.count_nonzero(around) < _LEAST_PAIRS:
        return 0.0
    count, spread = count[around], float(np.median(error[around]))
    off = (snr[around] - total[around] / count) / (error[around] * np.sqrt(1 + 1 / count))
    skewed = min(abs(float(np.median(off))), _MOST_SKEWED)
    beside = np.abs(snr[lit] - here)
    near, far = (np.count_nonzero(beside <= reach * spread) for reach in (0.5, 2))
    peak = (near - far / 4 + 2 * np.sqrt(near)) / max(near, 1) / _PEAK
    return skewed * spread * float(np.clip(peak, 0, 1))


def snr_errors(capture: Capture) -> tuple[Array, Array]:
    """Standard error and systematic bound of the SNR of each cell, (rows, columns)."""
    error, scene_e = capture.model_error, capture.scene_e
    own = _over(capture.cells_error_e, scene_e)
    bound = _over(capture.light_systematic_e, scene_e) + error.noise_systematic
    return capture.snr * np.hypot(own, error.noise), capture.snr * bound


#: Quantities of the SNRs along the last axis.
_OF_SNR: dict[str, Callable[[Array], Array]] = {
    "median": lambda snr: np.asarray(np.median(snr, axis=-1)),
    "best": lambda snr: np.asarray(snr.max(axis=-1)),
    "above 1": lambda snr: np.asarray(np.mean(snr >= 1, axis=-1)),
}


@lru_cache(maxsize=8)
def normal_draws(n_cells: int) -> tuple[Array, Array]:
    """Normal draws (_DRAWS, n_cells), and those that all cells share, (_DRAWS, 1)."""
    rng = np.random.default_rng(SEED)
    return rng.standard_normal((_DRAWS, n_cells)), rng.standard_normal((_DRAWS, 1))


def _over(part: Array, whole: Array) -> Array:
    return np.divide(part, whole, out=np.zeros_like(whole), where=whole > 0)
