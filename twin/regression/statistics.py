"""Whether figures became worse: a paired t-test of their mean, and a test of single seeds.

The loss of seed i is l_i = before_i - after_i (or the reverse where lower is better). The same seed
draws the same noise, so what both have in common cancels, and a loss far below the scatter of the
figures shows. Where a change upstream makes the draws differ, pairs are independent and the test
still holds, with less power.

A figure is worse when the lower confidence bound of the mean loss is above the metric's tolerance:

    mean(l) - t(1 - 0.8 p/m, n - 1) std(l) / sqrt(n) > tolerance

with m metrics (Bonferroni). With a true mean loss at or below the tolerance that happens with
probability 0.8 p at most for all metrics together, as long as a mean of n losses is normal. Where
the seeds are of several views, each scatters about the mean of its own, with n less the number of
views as degrees of freedom.

Losses that are large but rare widen the scatter by as much as they move the mean, and no mean
shows them. So seeds are looked at one by one too. With d_i the loss less the median loss, and S
the median of |d| over that of a standard normal variable, seed i fails where

    min(d_i, l_i) > tolerance + t(1 - 0.2 p/mn, 0.37 (n - 1)) S

which seeds of normal losses do with probability 0.2 p at most for all together (0.37 is the
efficiency of S). Its own loss l_i counts as d_i does, since a seed that gains less than the others
is none that became worse. What a count of such seeds tells depends on whether runs pair:

*Paired*: both runs had the same records, and the method gives the same figure of the same record
each time. A seed that fails is then a fact about the method: one is enough, less the seeds that
gained as much, counted one for one. How likely chance alone gives as many of both, were each
equally likely to be either (McNemar's exact test), is told beside.

*Not paired*: l is the loss from the median of the figures before and S that of their own scatter.
Failures of both runs are counted beyond the same limit, and are too many where Boschloo's exact
test of two proportions gives a p-value of at most 0.2 p/m.

Records of another render, or of another version of the model, differ by the model's own errors too,
which all seeds share. The tolerance then is wider, in both tests, by

    max(z(1 - 0.8 p/m), 1.96) sqrt(s_1^2 + s_2^2) + b_1 + b_2

with quantiles z of a normal variable, the standard errors s of the mean before and after and the
bounds b of what was left out, so that what lies within both intervals is no loss. The probability
of false alarms stays as stated.

Whether the method repeats itself is asked of the seeds that failed, each run `repeats` times anew.
Where all of them give the same again, r times, runs pair. A method that fails at random, with any
probability q up to a half, passes for one that repeats itself with probability 0.2 p/m at most: of
n seeds F fail now and did not before, F binomial with q (1 - q), and the sup over q of
E[q^(r F); F > 0] is that.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Interval
from twin.accuracy.interval import TWO_SIDED_95
from twin.errors import InputError
from twin.regression.metrics import Metric

Array = NDArray[np.float64]

#: Median of the absolute value of a standard normal variable, and how many of n values a standard
#: deviation would need that is known as well as that median (Hampel et al., Robust Statistics,
#: 1986, section 2.3).
_NORMAL_MEDIAN, _EFFICIENCY = 0.6745, 0.37
#: Share of the false alarms that the test of the mean may give; the rest is that of single seeds.
_OF_MEAN = 0.8
#: Power at which `Verdict.finds` and `smallest_loss` are stated.
POWER = 0.95


@dataclass(frozen=True)
class Verdict:
    """One metric before and after, in its unit.

    ``loss`` is positive when it became worse; ``low`` and ``high`` bound it, each one-sided.
    ``finds``: the smallest loss that would be found with `POWER` at this scatter. ``failed``: seeds
    that are worse by themselves, enough of them to fail the test, and ``chance`` the p-value of
    their number; ``no_number``: seeds whose figure is none, of which nothing can be compared.
    ``model_error``: what the errors of both models may change, on top of ``tolerance``.
    """

    metric: Metric
    before: float
    after: float
    loss: float
    low: float
    high: float
    tolerance: float
    finds: float
    failed: tuple[int, ...] = ()
    chance: float = 1.0
    no_number: tuple[int, ...] = ()
    model_error: float = 0.0

    @property
    def allowed(self) -> float:
        """Loss that is none: the tolerance, and what the model may be off by."""
        return self.tolerance + self.model_error

    @property
    def worse(self) -> bool:
        """Whether the loss is real and above what is allowed, in the mean or of single seeds."""
        return bool(self.failed) or not self.low <= self.allowed  # one that is no number is

    @property
    def better(self) -> bool:
        """Whether it gained more than that."""
        return self.high < -self.allowed and not self.worse

    def __str__(self) -> str:
        if self.no_number:
            return f"{self.metric.name}: no number{_at(self.no_number)}: WORSE"
        unit = f" {self.metric.unit}" if self.metric.unit else ""
        word = "WORSE" if self.worse else "better" if self.better else "same"
        return (
            f"{self.metric.name}: {self.before:.6g} before, {self.after:.6g} after: loss "
            f"{self.loss:.3g}{unit} (at least {self.low:.3g}, tolerance {self.tolerance:.3g}"
            f"{self._of_models()}; finds {self.finds:.2g} with {POWER:.0%} power): "
            f"{word}{_at(self.failed)}"
            + (f" (p = {self.chance:.2g} by chance)" if self.failed else "")
        )

    def _of_models(self) -> str:
        if not self.model_error:
            return ""
        within = self.tolerance < self.low <= self.allowed
        so = ", which explain the loss" if within and not self.failed else ""
        return f" and {self.model_error:.3g} for errors of both models, as records differ{so}"


def _at(seeds: tuple[int, ...]) -> str:
    if not seeds:
        return ""
    first = ", ".join(str(seed) for seed in seeds[:8])
    return f" at {len(seeds)} seeds: {first}{', ...' if len(seeds) > 8 else ''}"


def compare(
    metrics: Sequence[Metric],
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    false_alarm: float = 0.01,
    *,
    paired: bool = False,
    views: int = 1,
    errors: Sequence[Mapping[str, Interval]] = (),
) -> tuple[Verdict, ...]:
    """A verdict for each metric.

    Parameters
    ----------
    before, after
        Figures by metric, (n_seeds,) each; ``before`` finite.
    false_alarm
        Probability that any of the verdicts is ``worse`` without cause.
    paired
        Whether both runs had the same records, seed by seed, of a method that repeats itself.
    views
        Seed i is of view i modulo this number.
    errors
        Mean figures with the model's errors, before and after, by metric, where records differ.

    Raises InputError for fewer than two seeds of a view, numbers of seeds that differ, no metrics,
    or a probability that is none.
    """
    if not metrics:
        raise InputError("metrics: none given, expected at least one")
    if not 0 < false_alarm < 1:
        raise InputError(f"false_alarm: {false_alarm} is not between 0 and 1")
    each = false_alarm / len(metrics)
    return tuple(
        _verdict(
            m,
            before[m.name],
            after[m.name],
            each,
            paired,
            views,
            [of_model[m.name] for of_model in errors],
        )
        for m in metrics
    )


def smallest_loss(
    metric: Metric,
    figures: Array,
    n_metrics: int,
    false_alarm: float,
    views: int = 1,
    error: Interval | None = None,
) -> float:
    """Loss found with `POWER` when draws do not pair: each run scatters for itself, and its model
    has this ``error``.
    """
    n, within = len(figures), figures - _usual(figures, views, np.mean)
    apart = np.sqrt(2 * (within @ within) / (n - views) / n)
    each = _OF_MEAN * false_alarm / n_metrics
    sure, of_models = _quantile(1 - each, n - views), _of_models([error] * 2 if error else [], each)
    found = float(apart) * (sure + _quantile(POWER, n - views))
    return _tolerance(metric, figures) + of_models + found


def _verdict(
    metric: Metric,
    before: Array,
    after: Array,
    false_alarm: float,
    paired: bool,
    views: int,
    errors: Sequence[Interval],
) -> Verdict:
    before, after = np.asarray(before, float), np.asarray(after, float)
    n = len(before)
    if n < 2 * views or after.shape != before.shape:
        raise InputError(
            f"{metric.name}: {n} seeds before, {len(after)} after: expected as many, at least "
            f"{2 * views}"
        )
    tolerance = _tolerance(metric, before)
    ends = (float(before.mean()), float(after.mean()))
    down = ends[1] < ends[0] if metric.either_way else metric.higher_is_better
    if metric.either_way:
        false_alarm /= 2
    sign = -1.0 if down else 1.0
    loss = sign * (after - before)
    if (bad := np.flatnonzero(~np.isfinite(loss))).size:
        unknown = (np.nan, np.nan, np.nan, tolerance, np.nan)
        return Verdict(metric, *ends, *unknown, no_number=tuple(bad.tolist()))
    free = n - views
    within = loss - _usual(loss, views, np.mean)
    mean, error = float(loss.mean()), float(np.sqrt(within @ within / free / n))
    reach = _quantile(1 - _OF_MEAN * false_alarm, free) * error
    of_models = _of_models(errors, _OF_MEAN * false_alarm)
    allowed = tolerance + of_models
    finds = allowed + reach + _quantile(POWER, free) * error
    single = (1 - _OF_MEAN) * false_alarm
    failed, chance = _failed(sign * before, sign * after, allowed, single, paired, views)
    high = np.inf if metric.either_way else mean + reach  # no change of it is a gain
    return Verdict(
        metric,
        *ends,
        mean,
        mean - reach,
        high,
        tolerance,
        finds,
        failed,
        chance,
        model_error=of_models,
    )


def _of_models(errors: Sequence[Interval], false_alarm: float) -> float:
    """What errors of models change a figure by at most, with all but this probability."""
    sure = _quantile(1 - false_alarm, np.inf)
    statistical = float(np.linalg.norm([error.standard_error for error in errors]))
    return max(sure, TWO_SIDED_95) * statistical + sum(error.systematic for error in errors)


def _failed(
    before: Array, after: Array, tolerance: float, false_alarm: float, paired: bool, views: int
) -> tuple[tuple[int, ...], float]:
    """Seeds that are worse by themselves, where they are too many, and how likely by chance; higher
    figures are worse.
    """
    n = len(before)
    if paired:
        loss = after - before
        scattered = loss - np.median(loss)
        # A gain of the others makes no seed worse, and a loss of the others none better.
        worse, others = np.minimum(loss, scattered), -np.maximum(loss, scattered)
    else:
        usual = _usual(before, views, np.median)
        scattered, worse, others = before - usual, after - usual, before - usual
    spread = np.median(np.abs(scattered)) / _NORMAL_MEDIAN
    limit = tolerance + _outlier(false_alarm / n, n) * spread
    failed = np.flatnonzero(worse > limit)
    n_others = int(np.count_nonzero(others > limit))
    if failed.size <= n_others:
        return (), 1.0
    chance = (_mcnemar if paired else _boschloo)(failed.size, n_others, n)
    return tuple(failed.tolist()) if paired or chance <= false_alarm else (), chance


@lru_cache(maxsize=256)
def _mcnemar(failed: int, gained: int, _: int) -> float:
    from scipy.stats import binomtest

    return float(binomtest(failed, failed + gained, alternative="greater").pvalue)


@lru_cache(maxsize=256)
def _boschloo(after: int, before: int, n: int) -> float:
    from scipy.stats import boschloo_exact

    table = [[after, before], [n - after, n - before]]
    return float(boschloo_exact(table, alternative="greater").pvalue)


@lru_cache(maxsize=64)
def repeats(n: int, n_metrics: int, false_alarm: float) -> int:
    """How often to run each seed that failed anew, of n, to know a method that fails at random."""
    q = np.linspace(0, 0.5, 501)
    fails_now_only = q * (1 - q)
    for r in count(1):
        all_again = (1 - fails_now_only * (1 - q**r)) ** n - (1 - fails_now_only) ** n
        if all_again.max() <= (1 - _OF_MEAN) * false_alarm / n_metrics:
            return r
    raise AssertionError  # count has no end


def _usual(values: Array, views: int, middle: Callable[[Array], Any]) -> Array:
    """For each seed the mean or median of its view: levels of views are no scatter."""
    found = np.empty(len(values))
    for view in range(views):
        found[view::views] = middle(values[view::views])
    return found


def _tolerance(metric: Metric, before: Array) -> float:
    return metric.tolerance * (abs(float(np.mean(before))) if metric.relative else 1.0)


@lru_cache(maxsize=64)
def _outlier(false_alarm: float, n: int) -> float:
    """Deviations over the spread that one seed exceeds with this probability."""
    from scipy.stats import t

    return float(t.isf(false_alarm, max(_EFFICIENCY * (n - 1), 1.0)))


@lru_cache(maxsize=64)
def _quantile(probability: float, free: float) -> float:
    from scipy.stats import t

    return float(t.ppf(probability, free))
