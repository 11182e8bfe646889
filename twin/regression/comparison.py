"""Figures of a method over seeds beside those of its baseline, and the baseline that they make."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from twin.accuracy import Interval
from twin.digest import versions
from twin.regression.baseline import Baseline, rounded
from twin.regression.metrics import Metric
from twin.regression.pictures import Pictures
from twin.regression.runs import SeedResults, repeated
from twin.regression.setup import n_views_of
from twin.regression.statistics import Verdict, compare, repeats, smallest_loss


@dataclass(frozen=True)
class Comparison:
    """One method to be compared with its baseline.

    Parameters
    ----------
    method
        Its name.
    run
        Gives its results over seeds.
    errors
        Gives mean figures by metric with the model's errors, where they are needed.
    seeds, metrics, false_alarm
        As of `Regression.camera`.
    setup
        As `twin.regression.setup.setup_of` gives it.
    pictures
        How results are shown.
    """

    method: str
    run: Callable[[Sequence[int]], SeedResults]
    errors: Callable[[], Mapping[str, Interval]]
    seeds: Sequence[int]
    metrics: Sequence[Metric]
    false_alarm: float
    setup: dict[str, Any]
    pictures: Pictures

    def verdicts(
        self, outcome: SeedResults, baseline: Baseline
    ) -> tuple[tuple[Verdict, ...], bool]:
        """A verdict for each metric, and whether the method gives the same figures of the same
        record each time, which is tried where figures of a seed are compared with each other.
        """
        __tracebackhide__ = True
        # On the same records the model's error is the same, and cancels.
        is_same = baseline.records == outcome.records
        judge = partial(
            compare,
            self.metrics,
            baseline.arrays(),
            outcome.figures,
            self.false_alarm,
            views=n_views_of(self.setup),
            errors=() if is_same else (baseline.errors(), self.errors()),
        )
        verdicts = judge(paired=is_same)
        failed = sorted({seed for verdict in verdicts for seed in verdict.failed})
        times = repeats(len(self.seeds), len(self.metrics), self.false_alarm)
        if is_same and not repeated(self.run, outcome, failed, times):
            return judge(paired=False), False
        return verdicts, True

    def without_number(self, outcome: SeedResults) -> str:
        """The first figure that is no number, in words; empty where there is none."""
        for metric in self.metrics:
            values = outcome.figures[metric.name]
            wrong = np.flatnonzero(~np.isfinite(values))
            if wrong.size:
                return (
                    f"metrics: {metric.name} is {values[wrong[0]]} at seed {wrong[0]}, expected a "
                    "number; leave this metric out"
                )
        return ""

    def new_baseline(
        self, outcome: SeedResults, before: Baseline | None, reason: str
    ) -> Baseline | None:
        """What an outcome makes of the baseline before; None where that holds the same figures."""
        __tracebackhide__ = True
        errors = self.errors()
        new = Baseline(
            self.setup,
            {n: [rounded(v) for v in values] for n, values in outcome.figures.items()},
            outcome.records,
            self.pictures.example(outcome),
            (),
            {n: [rounded(e.standard_error), rounded(e.systematic)] for n, e in errors.items()},
        )
        if before and replace(before, example=new.example, history=()) == new:
            return None
        entry = {
            "reason": reason,
            "method": self.method,
            "versions": versions(),
            "before": before.means() if before else None,
            "after": new.means(),
            "finds": self._smallest_losses(outcome, errors),
        }
        return replace(new, history=(*(before.history if before else ()), entry))

    def _smallest_losses(
        self, outcome: SeedResults, errors: Mapping[str, Interval]
    ) -> dict[str, float]:
        """By metric, the loss that figures find even when draws do not pair."""
        loss = partial(
            smallest_loss,
            n_metrics=len(self.metrics),
            false_alarm=self.false_alarm,
            views=n_views_of(self.setup),
        )
        return {
            m.name: float(f"{loss(m, outcome.figures[m.name], error=errors[m.name]):.3g}")
            for m in self.metrics
        }
