"""Whether figures became worse: a paired t-test of their mean, and a test of single seeds.

The loss of seed i is l_i = before_i - after_i (or the reverse where lower is better). The same seed
draws the same noise, so what both have in common cancels, and a loss far below the scatter of the
figures shows. Where a change upstream makes the draws differ, pairs are independent and the test
still holds, with less power.

A figure is worse when the lower confidence bound of the mean loss is above the metric's tolerance:

    mean(l) - t(1 - 0.8 p/m, n - 1) std(l) / sqrt(n) > tolerance

with m metrics (Bonferroni). With a true mean loss at or below the tolerance that happens with
probability 0.8 p at most for all metrics together, as long as a mean of n losses is normal.

Losses that are large but rare widen the scatter by as much as they move the mean, and no mean
shows them. So seeds are looked at one by one too. With d_i the loss less the median loss, and S
the median of |d| over that of a standard normal variable, seed i fails where

    d_i > tolerance + t(1 - 0.2 p/mn, 0.37 (n - 1)) S

which seeds of normal losses do with probability 0.2 p at most for all together (0.37 is the
efficiency of S). Where both runs had the same records, a seed that fails is a fact about the
method: one is enough, less the seeds that gained as much, counted one for one. That takes a method
without draws of its own, or figures that are near normal: rare failures of a random method fall on
other seeds each time, and alarm. Where records differ, l is the loss
from the median of the figures before and S that of their own scatter, and as many seeds have to
fail, where none did before, as chance alone gives with probability 0.2 p/m at most, whatever the
probability q of a seed to fail: sup over q of (1 - q)^n P(Binomial(n, q) >= k).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

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
    that are worse by themselves, enough of them to be no chance; ``no_number``: seeds whose
    figure is none, of which nothing can be compared.
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
    no_number: tuple[int, ...] = ()

    @property
    def worse(self) -> bool:
        """Whether the loss is real and above the tolerance, in the mean or of single seeds."""
        return bool(self.failed) or not self.low <= self.tolerance  # one that is no number is

    @property
    def better(self) -> bool:
        """Whether it gained more than the tolerance."""
        return self.high < -self.tolerance and not self.worse

    def __str__(self) -> str:
        if self.no_number:
            return f"{self.metric.name}: no number{_at(self.no_number)}: WORSE"
        unit = f" {self.metric.unit}" if self.metric.unit else ""
        word = "WORSE" if self.worse else "better" if self.better else "same"
        return (
            f"{self.metric.name}: {self.before:.6g} before, {self.after:.6g} after: loss "
            f"{self.loss:.3g}{unit} (at least {self.low:.3g}, tolerance {self.tolerance:.3g}; "
            f"finds {self.finds:.2g} with {POWER:.0%} power): {word}{_at(self.failed)}"
        )


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
    same_records: bool = False,
) -> tuple[Verdict, ...]:
    """A verdict for each metric.

    Parameters
    ----------
    before, after
        Figures by metric, (n_seeds,) each; ``before`` finite.
    false_alarm
        Probability that any of the verdicts is ``worse`` without cause.
    same_records
        Whether both runs had the same records, seed by seed.

    Raises ValueError for fewer than two seeds, numbers of seeds that differ, no metrics, or a
    probability that is none.
    """
    if not metrics:
        raise ValueError("metrics: none given, expected at least one")
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm: {false_alarm} is not between 0 and 1")
    each = false_alarm / len(metrics)
    return tuple(_verdict(m, before[m.name], after[m.name], each, same_records) for m in metrics)


def smallest_loss(metric: Metric, figures: Array, n_metrics: int, false_alarm: float) -> float:
    """Loss found with `POWER` when draws do not pair: each run scatters for itself."""
    apart = np.std(figures, ddof=1) * np.sqrt(2 / len(figures))
    return _tolerance(metric, figures) + float(
        apart
        * (
            _quantile(1 - _OF_MEAN * false_alarm / n_metrics, len(figures))
            + _quantile(POWER, len(figures))
        )
    )


def _verdict(
    metric: Metric, before: Array, after: Array, false_alarm: float, same_records: bool
) -> Verdict:
    before, after = np.asarray(before, float), np.asarray(after, float)
    n = len(before)
    if n < 2 or after.shape != before.shape:
        raise ValueError(
            f"{metric.name}: {n} seeds before, {len(after)} after: expected as many, at least 2"
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
    mean, error = float(loss.mean()), float(loss.std(ddof=1) / np.sqrt(n))
    reach = _quantile(1 - _OF_MEAN * false_alarm, n) * error
    finds = tolerance + reach + _quantile(POWER, n) * error
    single = (1 - _OF_MEAN) * false_alarm
    failed = _failed(sign * before, sign * after, tolerance, single, same_records)
    high = np.inf if metric.either_way else mean + reach  # no change of it is a gain
    return Verdict(metric, *ends, mean, mean - reach, high, tolerance, finds, failed)


def _failed(
    before: Array, after: Array, tolerance: float, false_alarm: float, same_records: bool
) -> tuple[int, ...]:
    """Seeds that are worse by themselves, where they are enough; higher figures are worse."""
    n = len(before)
    if same_records:
        scattered = after - before
        off = scattered - np.median(scattered)
    else:
        scattered = before
        off = after - np.median(before)
    spread = np.median(np.abs(scattered - np.median(scattered))) / _NORMAL_MEDIAN
    limit = tolerance + _outlier(false_alarm / n, n) * spread
    failed = np.flatnonzero(off > limit)
    if same_records:
        enough = failed.size > int(np.count_nonzero(off < -limit))
    else:
        none_before = not (before - np.median(before) > limit).any()
        enough = none_before and failed.size >= _enough(n, false_alarm)
    return tuple(int(seed) for seed in failed) if enough else ()


def _tolerance(metric: Metric, before: Array) -> float:
    return metric.tolerance * (abs(float(np.mean(before))) if metric.relative else 1.0)


@lru_cache(maxsize=64)
def _outlier(false_alarm: float, n: int) -> float:
    """Deviations over the spread that one seed exceeds with this probability."""
    from scipy.stats import t

    return float(t.isf(false_alarm, max(_EFFICIENCY * (n - 1), 1.0)))


@lru_cache(maxsize=64)
def _enough(n: int, false_alarm: float) -> int:
    """Failures of n seeds that chance does not give where there were none of n; n + 1: never."""
    from scipy.stats import binom

    q = np.linspace(0, 1, 1001)
    for k in range(1, n + 1):
        if np.max((1 - q) ** n * binom.sf(k - 1, n, q)) <= false_alarm:
            return k
    return n + 1


@lru_cache(maxsize=64)
def _quantile(probability: float, n: int) -> float:
    from scipy.stats import t

    return float(t.ppf(probability, n - 1))
