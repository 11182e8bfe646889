"""Which level is chosen: the cheapest within a tolerance, or the most accurate within a time."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from twin.errors import InputError
from twin.trade.criterion import Criterion, of_noise
from twin.trade.measurement import LevelMeasurement


@dataclass(frozen=True)
class Choice:
    """The level chosen; ``within``: its error is below the tolerance, or its time within the limit
    that was asked for instead.
    """

    measurement: LevelMeasurement
    within: bool
    reason: str


def cheapest(measurements: Iterable[LevelMeasurement], tolerance: Criterion | float) -> Choice:
    """The cheapest level whose measured error, over the sensor's noise unless the criterion names
    another, is below the tolerance; among levels of equal time within the quartiles, the most
    accurate.

    Where none is below, the most accurate of all; where none has such an error, that over the noise
    decides. Raises InputError without any level.
    """
    asked = tolerance if isinstance(tolerance, Criterion) else of_noise(tolerance)
    error = asked.error
    levels = sorted((m for m in measurements if m.fidelity), key=lambda m: m.cost.seconds)
    if not levels:
        raise InputError("measurements: no level of the twin")
    good = [m for m in levels if error(m) < asked.limit]
    if not good:
        return _none_within(levels, asked)
    alike = [m for m in good if m.cost.low_s <= good[0].cost.high_s]
    best_level = min(alike, key=error)
    reason = f"cheapest below {asked.limit:.3g} {asked.unit}: {error(best_level):.2g}"
    if best_level is not good[0]:
        reason += f"; as fast as {good[0].name} within the spread of the runs, and more accurate"
    cheaper = [m for m in levels if m.cost.seconds < best_level.cost.seconds and m not in good]
    cheaper = [m for m in cheaper if not math.isnan(error(m))]
    if cheaper:
        next_best = min(cheaper, key=error)
        reason += f"; the best of the cheaper ones, {next_best.name}, has {error(next_best):.2g}"
    finest = min(levels, key=_unmeasured_last(error))
    if finest is not best_level:
        factor = finest.cost.seconds / best_level.cost.seconds
        reason += f"; {finest.name} takes {factor:.3g} times as long for {error(finest):.2g}"
    return Choice(best_level, True, reason)


def _none_within(levels: list[LevelMeasurement], asked: Criterion) -> Choice:
    best = min(levels, key=_unmeasured_last(asked.error))
    if math.isnan(asked.error(best)):
        usual = of_noise(asked.limit)
        best = min(levels, key=_unmeasured_last(usual.error))
        reason = (
            f"no level has an error {asked.unit} that was measured; the most accurate has "
            f"{usual.error(best):.2g} {usual.unit}"
        )
    else:
        reason = (
            f"no level is below {asked.limit:.3g} {asked.unit}; the most accurate has "
            f"{asked.error(best):.2g}"
        )
    return Choice(best, False, reason)


def _unmeasured_last(
    error: Callable[[LevelMeasurement], float],
) -> Callable[[LevelMeasurement], tuple[bool, float]]:
    """An order by an error in which levels come last whose error is NaN."""
    return lambda m: (math.isnan(error(m)), error(m))


def most_accurate(measurements: Iterable[LevelMeasurement], within_s: float) -> Choice:
    """The level of the smallest measured error among those that take no longer than a time; where
    none does, the cheapest of all. Raises InputError without any level.
    """
    levels = [m for m in measurements if m.fidelity]
    if not levels:
        raise InputError("measurements: no level of the twin")
    fast = [m for m in levels if m.cost.seconds <= within_s]
    if not fast:
        best = min(levels, key=lambda m: m.cost.seconds)
        reason = (
            f"no level takes {within_s:g} s or less; the cheapest takes {best.cost.seconds:.2g} s"
        )
        return Choice(best, False, reason)
    best = min(fast, key=lambda m: (m.over_noise != m.over_noise, m.over_noise))
    reason = (
        f"the most accurate within {within_s:g} s: {best.over_noise:.2g} of the sensor's noise in "
        f"{best.cost.seconds:.2g} s"
    )
    return Choice(best, True, reason)
