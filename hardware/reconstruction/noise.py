"""The noise of one Hadamard measurement, from the measurements themselves."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import OwnPatterns, Patterns, PatternSet, RasterScan, fwht
from hardware.reconstruction.prior import walsh_variance

Array = NDArray[np.float64]

#: Pairs between the sums whose difference tells 1/f noise; the statistical error of the estimate
#: is 1.1 times that of successive sums alone.
_LAG = 8
#: What 1/f noise leaves in the difference of a pair, and in half the squared difference of the
#: sums of pairs that are 1 and `_LAG` pairs apart, per density at one cycle an exposure. With
#: Cin(x), the integral of (1 - cos t) / t from 0 to x: 2 Cin(pi), and at m pairs
#: 2 Cin(2 m pi) + Cin((2 m + 1) pi) + Cin((2 m - 1) pi) - 2 Cin(pi).
_IN_PAIR, _SUCCESSIVE, _APART = 3.29655528, 6.03696679, 14.67765865
#: Degrees of freedom of successive sums over those of that estimate, at most: with fewest pairs.
_OF_IN_TURN = 2.0
#: Standard errors beyond which a record contradicts itself. Of normal noise one value in 3.5
#: million is as far to one side.
_FAR = 5.0
#: Median absolute deviation of normal numbers over their standard deviation.
NORMAL_MAD = 0.67448975
#: Degrees of freedom of a variance by the median over those by the mean square (its efficiency).
_OF_MEDIAN = 0.3675
#: Factor by which the finest values must scatter more than the flat cells before these tell the
#: noise: by chance in 0.7 % of flat images of 8 x 8 cells, in none of 4000 of 16 x 16.
_SURELY_DETAIL = 4.0
#: Of the finest values at least so many tell the most that noise can be: of two alone, 95 % of
#: errors would lie within 12.7 roots of their variance.
_LEAST_FINEST = 8
#: Exponents of the prior's spectrum that detail may have. Amplitudes of natural scenes fall as
#: f^-0.6 to f^-1.6 (Tolhurst, Tadmor and Chao, Ophthal. Physiol. Opt. 12, 1992), powers of the
#: 1/f^2 prior by as much; steeper ones are smooth objects.
_EXPONENTS = np.arange(0.5, 3.01, 0.25)
#: Share that detail may have in the variance of the finest patterns; the steps bound the error.
_DETAIL = np.concatenate([np.arange(1.0, 0.09, -0.05), np.geomspace(0.05, 1e-8, 24)])
#: What noise must add to twice the log-likelihood of a full set, which no smoothing improves where
#: there is none: a chi-square test with 1 % of false alarms.
_EVIDENCE = 6.63
#: Prior variances within this factor are taken as one.
_BIN = 1.25
#: Share of all patterns from which on a set counts as full: what lost ones leave unseen is little.
_FULL = 7 / 8


def noise_of_sums(constant: Array, *, in_turn: bool) -> Array:
    """Variance of a pair's difference, from the scatter of the pairs' sums, ``(n_images,)``.

    Parameters
    ----------
    constant : (n_pairs, n_images)
        Pattern plus complement: the same for each pair but for noise and slow drift.
    in_turn
        Whether the two of a pair are exposed one after the other. Then 1/f noise is less in their
        difference than between successive sums, and half the squared difference of sums D(m), m
        pairs apart, tells how much: D is constant for white noise and grows with m for 1/f noise,
        both in known proportion to the noise of a pair, which is therefore a D(1) - b D(8).
        From records of up to 16 pairs 1/f noise cannot be told, and D(1) is taken.

    0 where there is only one pair.
    """
    if len(constant) < 2:
        return np.zeros(constant.shape[1])
    successive = _half_square(constant, 1)
    if not in_turn or len(constant) <= 2 * _LAG:
        return successive
    share = (_SUCCESSIVE - _IN_PAIR) / (_APART - _SUCCESSIVE)
    in_pair = successive - share * (_half_square(constant, _LAG) - successive)
    return np.asarray(np.maximum(in_pair, _IN_PAIR / _SUCCESSIVE * successive))  # all of it 1/f


def _half_square(constant: Array, lag: int) -> Array:
    return np.asarray(np.mean((constant[lag:] - constant[:-lag]) ** 2, axis=0) / 2)


def finest_patterns(patterns: PatternSet) -> NDArray[np.intp]:
    """Where the eighth of the patterns stands that carries least of a natural image."""
    order = _fine_to_coarse(patterns)
    return order[: max(2, (patterns.count - 1) // 8)]


def most_scatter(values: Array, patterns: PatternSet) -> Array:
    """The largest variance that the noise in values ``(count, n_images)`` can have,
    ``(n_images,)``: that of the finest ones, detail and all. NaN where there is only one.

    So few values tell it that 95 % of normal errors lie within 1.96 of its roots as they do within
    Student's quantile of the roots found.
    """
    finest = _finest_of_noise(patterns)
    if finest.size < 2:
        return np.full(values.shape[1], np.nan)
    few = student(finest.size - 1) / 1.96
    return np.asarray(few**2 * values[finest].var(axis=0, ddof=1))


def most_noise(values: Array, patterns: PatternSet) -> Array:
    """The largest variance that the noise in values ``(count, n_images)`` can have,
    ``(n_images,)``: by the finest of them, or, where these surely hold detail, by the flat cells.
    """
    scatter, flat = most_scatter(values, patterns), scatter_of_flat_cells(values, patterns)
    return np.where(_SURELY_DETAIL * flat < scatter, flat, scatter)


def scatter_of_flat_cells(values: Array, patterns: PatternSet) -> Array:
    """The largest variance that the noise in values ``(count, n_images)`` of a full set can have,
    ``(n_images,)``, by the cells of its plain inverse.

    White noise is as large in the difference (1, -1; -1, 1) / 2 across each block of 2 x 2 cells,
    and the median of their sizes is that of the noise where most blocks are flat (Donoho and
    Johnstone, Biometrika 81, 1994). Detail makes it larger, never smaller: of all normal numbers of
    one variance those of mean 0 are the smallest. Student's factor as in `most_scatter`. Infinite
    of fewer than 8 blocks, and of sets that lack a pattern, whose detail is then in all blocks.
    """
    n, high, wide = patterns.n_cells, min(patterns.rows, 2), min(patterns.columns, 2)
    n_blocks = n // (high * wide)
    if n_blocks < _LEAST_FINEST or patterns.count < n:
        return np.full(values.shape[1], np.inf)
    down, along = divmod(patterns.indices, patterns.columns)
    across = (down % high == high - 1) & (along % wide == wide - 1)  # others are even in a block
    rows = np.zeros((n, values.shape[1]))
    rows[patterns.indices[across]] = values[across]
    cells = fwht(rows).reshape(patterns.rows, patterns.columns, -1)
    size = np.abs(cells[::high, ::wide].reshape(n_blocks, -1))  # sums of as many values
    median = np.median(size, axis=0) / NORMAL_MAD
    few = student(_OF_MEDIAN * n_blocks) / 1.96
    return np.asarray(few**2 * median**2 / n_blocks)


def noise_of_repetitions(values: Array, patterns: OwnPatterns) -> Array | None:
    """Variance of the noise in values ``(count, n_images)`` of patterns some of which are shown
    again, ``(n_images,)``: that about the mean of each. None of fewer than 8 repetitions. What is
    slower than they follow each other is not in it.
    """
    group, times = _repetitions(patterns)
    if len(group) - len(times) < _LEAST_FINEST:
        return None
    sums = np.zeros((len(times), values.shape[1]))
    np.add.at(sums, group, values)
    off = values - (sums / times[:, None])[group]
    return np.asarray((off**2).sum(axis=0) / (len(group) - len(times)))


@lru_cache(maxsize=16)
def _repetitions(patterns: OwnPatterns) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which of the different patterns each one is, and how often each of these is shown."""
    levels = patterns.levels.reshape(patterns.count, -1)
    _, group, times = np.unique(levels, axis=0, return_inverse=True, return_counts=True)
    return group.ravel(), times


def _shown_again(patterns: OwnPatterns) -> int:
    """Repetitions that tell the noise (`noise_of_repetitions`), 0 where none do."""
    again = patterns.count - len(_repetitions(patterns)[1]) if patterns.mode == "plain" else 0
    return again if again >= _LEAST_FINEST else 0


def error_of_repetitions(patterns: Patterns) -> float:
    """Standard error of the noise's variance over it, as repetitions tell it (of a chi-square); 0
    where none do: that of pairs counts as known, that of all others is the most it can be.
    """
    again = _shown_again(patterns) if isinstance(patterns, OwnPatterns) else 0
    return (2 / again) ** 0.5 if again else 0.0


def freedom(patterns: Patterns) -> float:
    """Degrees of freedom with which a record tells the most noise that there can be."""
    if patterns.mode in ("differential", "complementary") and not isinstance(patterns, RasterScan):
        found = freedom_of_successive(patterns.count)
        in_turn = patterns.mode == "differential" and patterns.count > 2 * _LAG
        return found / _OF_IN_TURN if in_turn else found
    if isinstance(patterns, OwnPatterns):
        return float(_shown_again(patterns) or patterns.count - 1)
    whole = patterns
    if not isinstance(whole, PatternSet):  # a scan is transformed whole
        whole = PatternSet(whole.rows, whole.columns, whole.n_cells, "natural", "plain")
    return _finest_of_noise(whole).size - 1.0


def freedom_of_successive(n: int) -> float:
    """Degrees of freedom of half the mean squared difference of n successive normal values, whose
    relative variance is (3 n - 4) / (n - 1)^2.
    """
    return 2 * (n - 1) ** 2 / (3 * n - 4) if n > 1 else 0.0


def errors_in_95_of_noise(patterns: Patterns) -> float:
    """How many standard errors hold 95 % of the errors by noise: Student's, for as many values as
    told it. The noise of sets that show nothing twice holds that already (`most_scatter`).
    """
    paired = patterns.mode in ("differential", "complementary")
    if isinstance(patterns, RasterScan) or not (paired or isinstance(patterns, OwnPatterns)):
        return 1.96
    return student(freedom(patterns))


def student(degrees: float) -> float:
    """Standard errors, found with these degrees of freedom, that hold 95 % of normal errors; 1.96
    where there are none, of which nothing is told.
    """
    from scipy.special import stdtrit  # takes 0.1 s to import

    return max(float(stdtrit(degrees, 0.975)), 1.96) if degrees > 0 else 1.96


def errors_of_few(degrees: float) -> float:
    """Standard errors, found with these degrees of freedom, beyond which a value is as seldom as a
    normal one beyond 5; infinite of none.
    """
    from scipy.special import ndtr, stdtrit  # takes 0.1 s to import

    return -float(stdtrit(degrees, ndtr(-_FAR))) if degrees > 0 else np.inf


def is_full(count: int, n_cells: int) -> bool:
    """Whether almost all patterns are shown, so that the finest of them are those of the image."""
    return count >= _FULL * n_cells


def noise_beside_detail(values: Array, patterns: PatternSet) -> Array:
    """Variance of the noise in values ``(count, n_images)`` that hold detail too, ``(n_images,)``.

    Detail has a variance that falls with the prior's, noise the same in every value: a w^g + s,
    with a, g and s of greatest likelihood (normal values of mean 0). g is common to all images, and
    so is the share of noise in the finest values. Noise of less than a twentieth of the finest
    detail's variance, and of a full set noise without evidence, is given as 0. A scene whose detail
    falls more slowly than 1/f is taken for noise here; how much of it is believed is told by the
    photons (`hardware.reconstruction.measurements.MOST_OVER_PHOTONS`).
    """
    bins = _bins(patterns)
    if bins is None:
        return np.zeros(values.shape[1])
    squares = np.add.reduceat(values[bins.order] ** 2, bins.starts, axis=0)
    scale = bins.inverse @ squares / len(bins.order)  # (n_models, n_images)
    log_scale = np.log(np.maximum(scale, np.finfo(float).tiny))
    misfit = len(bins.order) * log_scale.sum(axis=1) + values.shape[1] * bins.logarithm
    best = int(np.argmin(misfit))
    if (
        is_full(patterns.count, patterns.n_cells)
        and misfit[bins.noise == 0].min() - misfit[best] < _EVIDENCE
    ):
        return np.zeros(values.shape[1])
    return np.asarray(scale[best] * bins.noise[best])


@dataclass(frozen=True, eq=False)
class _Bins:
    """Patterns by falling prior variance in bins that begin at ``starts``; a row per model.

    ``inverse`` (n_models, n_bins) of a value's variance, ``logarithm`` (n_models,) of it summed
    over all values, ``noise`` (n_models,) its share of noise, for unit variance of the finest.
    """

    order: NDArray[np.intp]
    starts: NDArray[np.intp]
    inverse: Array
    logarithm: Array
    noise: Array


@lru_cache(maxsize=16)
def _bins(patterns: PatternSet) -> _Bins | None:
    """None where fewer than two patterns tell more than the mean."""
    order = _fine_to_coarse(patterns)[::-1]
    if order.size < 2:
        return None
    variance = walsh_variance(patterns.rows, patterns.columns)[patterns.indices][order]
    step = np.floor(np.log(variance[0] / variance) / np.log(_BIN) + 1e-9)
    starts = np.flatnonzero(np.diff(step, prepend=-1.0))
    sizes = np.diff(starts, append=order.size)
    finest = np.exp(np.log(variance[-max(2, order.size // 8) :]).mean())
    relative = np.add.reduceat(variance, starts) / sizes / finest
    detail = _DETAIL[None, :, None] * relative ** _EXPONENTS[:, None, None]
    model = (detail + (1 - _DETAIL)[None, :, None]).reshape(-1, len(starts))
    noise = np.tile(1 - _DETAIL, len(_EXPONENTS))
    return _Bins(order, starts, 1 / model, np.log(model) @ sizes, noise)


def _finest_of_noise(patterns: PatternSet) -> NDArray[np.intp]:
    """Where the patterns stand whose scatter is the most that noise can be."""
    return _fine_to_coarse(patterns)[: max(_LEAST_FINEST, (patterns.count - 1) // 8)]


def _fine_to_coarse(patterns: PatternSet) -> NDArray[np.intp]:
    """Places of all patterns but the mean, by rising prior variance."""
    variance = walsh_variance(patterns.rows, patterns.columns)[patterns.indices]
    order = np.argsort(np.where(patterns.indices == 0, np.inf, variance), kind="stable")
    return order[: patterns.count - int(np.count_nonzero(patterns.indices == 0))]
