"""Whether figures became worse: a one-sided paired t-test against a tolerance, seed by seed.

The loss of seed i is l_i = before_i - after_i (or the reverse where lower is better). The same seed
draws the same noise, so what both have in common cancels, and a loss far below the scatter of the
figures shows. Where a change upstream makes the draws differ, pairs are independent and the test
still holds, with less power.

A figure is worse when the lower confidence bound of the mean loss is above the metric's tolerance:

    mean(l) - t(1 - p/m, n - 1) std(l) / sqrt(n) > tolerance

with m metrics (Bonferroni). With a true mean loss at or below the tolerance that happens with
probability p at most for all metrics together, as long as a mean of n losses is normal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin.regression.metrics import Metric

Array = NDArray[np.float64]

#: Power at which `Verdict.finds` and `smallest_loss` are stated.
POWER = 0.95


@dataclass(frozen=True)
class Verdict:
    """One metric before and after, in its unit.

    ``loss`` is positive when it became worse; ``low`` and ``high`` bound it, each one-sided.
    ``finds``: the smallest loss that would be found with `POWER` at this scatter.
    """

    metric: Metric
    before: float
    after: float
    loss: float
    low: float
    high: float
    tolerance: float
    finds: float

    @property
    def worse(self) -> bool:
        """Whether the loss is real and above the tolerance."""
        return not self.low <= self.tolerance  # a loss that is no number is one

    @property
    def better(self) -> bool:
        """Whether it gained more than the tolerance."""
        return self.high < -self.tolerance

    def __str__(self) -> str:
        unit = f" {self.metric.unit}" if self.metric.unit else ""
        word = "WORSE" if self.worse else "better" if self.better else "same"
        return (
            f"{self.metric.name}: {self.before:.6g} before, {self.after:.6g} after: loss "
            f"{self.loss:.3g}{unit} (at least {self.low:.3g}, tolerance {self.tolerance:.3g}; "
            f"finds {self.finds:.2g} with {POWER:.0%} power): {word}"
        )


def compare(
    metrics: Sequence[Metric],
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    false_alarm: float = 0.01,
) -> tuple[Verdict, ...]:
    """A verdict for each metric.

    Parameters
    ----------
    before, after
        Figures by metric, (n_seeds,) each; ``before`` finite.
    false_alarm
        Probability that any of the verdicts is ``worse`` without cause.

    Raises ValueError for fewer than two seeds, numbers of seeds that differ, no metrics, or a
    probability that is none.
    """
    if not metrics:
        raise ValueError("metrics: none given, expected at least one")
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm: {false_alarm} is not between 0 and 1")
    return tuple(
        _verdict(m, before[m.name], after[m.name], false_alarm / len(metrics)) for m in metrics
    )


def smallest_loss(metric: Metric, figures: Array, n_metrics: int, false_alarm: float) -> float:
    """Loss found with `POWER` when draws do not pair: each run scatters for itself."""
    apart = np.std(figures, ddof=1) * np.sqrt(2 / len(figures))
    return _tolerance(metric, figures) + float(
        apart
        * (_quantile(1 - false_alarm / n_metrics, len(figures)) + _quantile(POWER, len(figures)))
    )


def _verdict(metric: Metric, before: Array, after: Array, false_alarm: float) -> Verdict:
    before, after = np.asarray(before, float), np.asarray(after, float)
    n = len(before)
    if n < 2 or after.shape != before.shape:
        raise ValueError(
            f"{metric.name}: {n} seeds before, {len(after)} after: expected as many, at least 2"
        )
    loss = before - after if metric.higher_is_better else after - before
    tolerance = _tolerance(metric, before)
    ends = (float(before.mean()), float(after.mean()))
    if not np.isfinite(loss).all():
        return Verdict(metric, *ends, np.nan, np.nan, np.nan, tolerance, np.nan)
    mean, error = float(loss.mean()), float(loss.std(ddof=1) / np.sqrt(n))
    reach = _quantile(1 - false_alarm, n) * error
    finds = tolerance + reach + _quantile(POWER, n) * error
    return Verdict(metric, *ends, mean, mean - reach, mean + reach, tolerance, finds)


def _tolerance(metric: Metric, before: Array) -> float:
    return metric.tolerance * (abs(float(np.mean(before))) if metric.relative else 1.0)


@lru_cache(maxsize=64)
def _quantile(probability: float, n: int) -> float:
    from scipy.stats import t

    return float(t.ppf(probability, n - 1))
