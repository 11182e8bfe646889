"""Cost and error measured at each fidelity level, and the choice of a level."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from twin.errors import InputError
from twin.fidelity import Fidelity

#: Models with several fidelity levels: light of emitter and sun; noise of an exposure; the radar's
#: channel.
Model = Literal["light", "noise", "radar"]

#: Settings that the radar's levels vary.
RADAR_KNOBS = (
    "radar",
    "radar_tolerance",
    "radar_bounces",
    "radar_images",
    "radar_edges",
    "radar_shadowed",
    "nufft_tolerance",
)
#: Settings that each model's levels vary.
_KNOBS: dict[Model, tuple[str, ...]] = {
    "light": (
        "samples",
        "max_depth",
        "indirect_samples",
        "start",
        "light_tolerance",
        "light_tolerance_relative",
    ),
    "noise": ("noise",),
    "radar": RADAR_KNOBS,
}


@dataclass(frozen=True)
class Cost:
    """Median of warm runs with its quartiles, s; growth of the process's peak memory, bytes."""

    seconds: float
    low_s: float
    high_s: float
    runs: int
    peak_bytes: float


@dataclass(frozen=True)
class BodyError:
    """Complex error of one body's echo, rms over the band and relative to the echo itself.

    ``level_db``: of the echo, over that of the strongest body; ``is_converged``: whether the error
    is at most the tolerance; ``reference``: name of the reference.
    """

    body: str
    level_db: float
    error: float
    is_converged: bool
    reference: str


@dataclass(frozen=True)
class LevelMeasurement:
    """Cost and error of one level, on one scene and one machine.

    ``error`` is in ``unit``, ``over_noise`` in units of the sensor's own noise; both contain the
    error of the reference itself. ``detail`` holds further figures by name, ``bodies`` the errors
    of the radar's strongest bodies. A level without a ``fidelity`` is for comparison only: it is
    not one of the twin's, and never chosen. ``leaves_out``: what a level of the radar has no model
    of, in words.
    """

    model: Model
    name: str
    fidelity: Fidelity | None
    cost: Cost
    error: float
    unit: str
    over_noise: float
    detail: dict[str, float] = field(default_factory=dict)
    note: str = ""
    bodies: tuple[BodyError, ...] = ()
    leaves_out: str = ""

    @property
    def knobs(self) -> dict[str, Any]:
        """Values of the settings that the model's levels vary."""
        if self.fidelity is None:
            return {}
        return {name: getattr(self.fidelity, name) for name in _KNOBS[self.model]}


@dataclass(frozen=True)
class Choice:
    """The level chosen; ``within``: its error is below the tolerance, or its time within the limit
    that was asked for instead.
    """

    measurement: LevelMeasurement
    within: bool
    reason: str


def cheapest(measurements: Iterable[LevelMeasurement], tolerance: float) -> Choice:
    """The cheapest level whose measured error over the sensor's noise is below the tolerance; among
    levels of equal time within the quartiles, the most accurate.

    Where none is below, the most accurate of all. Raises InputError without any level.
    """
    levels = sorted((m for m in measurements if m.fidelity), key=lambda m: m.cost.seconds)
    if not levels:
        raise InputError("measurements: no level of the twin")
    good = [m for m in levels if m.over_noise < tolerance]
    if not good:
        # A level whose error is NaN is chosen only if there is no other.
        best = min(levels, key=lambda m: (m.over_noise != m.over_noise, m.over_noise))
        reason = (
            f"no level is below {tolerance:g} of the sensor's noise; the most accurate has "
            f"{best.over_noise:.2g}"
        )
        return Choice(best, False, reason)
    alike = [m for m in good if m.cost.low_s <= good[0].cost.high_s]
    best_level = min(alike, key=lambda m: m.over_noise)
    reason = f"cheapest below {tolerance:g} of the sensor's noise: {best_level.over_noise:.2g}"
    if best_level is not good[0]:
        reason += f"; as fast as {good[0].name} within the spread of the runs, and more accurate"
    cheaper = [m for m in levels if m.cost.seconds < best_level.cost.seconds and m not in good]
    if cheaper:
        next_best = min(cheaper, key=lambda m: m.over_noise)
        reason += (
            f"; the best of the cheaper ones, {next_best.name}, has {next_best.over_noise:.2g}"
        )
    finest = min(levels, key=lambda m: m.over_noise)
    if finest is not best_level:
        factor = finest.cost.seconds / best_level.cost.seconds
        reason += f"; {finest.name} takes {factor:.3g} times as long for {finest.over_noise:.2g}"
    return Choice(best_level, True, reason)


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


def front(measurements: Sequence[LevelMeasurement]) -> list[LevelMeasurement]:
    """The Pareto front, by time: levels that no other beats in both time and error."""
    best: list[LevelMeasurement] = []
    for measurement in sorted(measurements, key=lambda m: (m.cost.seconds, m.over_noise)):
        if not best or measurement.over_noise < best[-1].over_noise:
            best.append(measurement)
    return best
