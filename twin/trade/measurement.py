"""What was measured of each rung, and which rung one would take."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from twin.errors import InputError
from twin.fidelity import Fidelity

#: Light of emitter and sun; shot noise of an exposure; the radar's channel.
Ladder = Literal["light", "noise", "radar"]

#: What each ladder moves.
_KNOBS: dict[Ladder, tuple[str, ...]] = {
    "light": ("samples", "max_depth", "indirect_samples", "start"),
    "noise": ("noise",),
    "radar": ("radar", "radar_tolerance", "nufft_tolerance"),
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

    ``level_db``: of the echo, over that of the strongest body; ``is_converged``: off by no more
    than the rung's tolerance; ``reference``: what it was compared with.
    """

    body: str
    level_db: float
    error: float
    is_converged: bool
    reference: str


@dataclass(frozen=True)
class Measurement:
    """Cost and error of one rung, on one scene and one machine.

    ``error`` is in ``unit``, ``over_noise`` in units of the sensor's own noise; both contain the
    error of the reference itself. ``detail`` holds further figures by name, ``bodies`` the errors
    of the radar's strongest bodies. A rung without a ``fidelity`` is for comparison: it is none of
    the twin's, and never taken.
    """

    ladder: Ladder
    name: str
    fidelity: Fidelity | None
    cost: Cost
    error: float
    unit: str
    over_noise: float
    detail: dict[str, float] = field(default_factory=dict)
    note: str = ""
    bodies: tuple[BodyError, ...] = ()

    @property
    def knobs(self) -> dict[str, Any]:
        """The rung's values of the knobs that its ladder moves."""
        if self.fidelity is None:
            return {}
        return {name: getattr(self.fidelity, name) for name in _KNOBS[self.ladder]}


@dataclass(frozen=True)
class Choice:
    """The rung to take; ``within``: its error is below the tolerance."""

    taken: Measurement
    within: bool
    reason: str


def cheapest(measurements: Iterable[Measurement], tolerance: float) -> Choice:
    """The cheapest rung whose measured error over the sensor's noise is below the tolerance; of
    those that the quartiles of their times don't tell apart from it, the most accurate.

    Where none is below, the most accurate of all. Raises InputError where there is no rung at all.
    """
    rungs = sorted((m for m in measurements if m.fidelity), key=lambda m: m.cost.seconds)
    if not rungs:
        raise InputError("measurements: no rung of the twin among them")
    good = [m for m in rungs if m.over_noise < tolerance]
    if not good:
        # A rung whose error is not a number is no candidate as long as there is another.
        best = min(rungs, key=lambda m: (m.over_noise != m.over_noise, m.over_noise))
        reason = (
            f"no rung stays below {tolerance:g} of the sensor's noise; the most accurate has "
            f"{best.over_noise:.2g}"
        )
        return Choice(best, False, reason)
    alike = [m for m in good if m.cost.low_s <= good[0].cost.high_s]
    taken = min(alike, key=lambda m: m.over_noise)
    reason = f"cheapest below {tolerance:g} of the sensor's noise: {taken.over_noise:.2g}"
    if taken is not good[0]:
        reason += f"; as fast as {good[0].name} within the spread of the runs, and more accurate"
    cheaper = [m for m in rungs if m.cost.seconds < taken.cost.seconds and m not in good]
    if cheaper:
        next_best = min(cheaper, key=lambda m: m.over_noise)
        reason += (
            f"; the best of the cheaper ones, {next_best.name}, has {next_best.over_noise:.2g}"
        )
    finest = min(rungs, key=lambda m: m.over_noise)
    if finest is not taken:
        factor = finest.cost.seconds / taken.cost.seconds
        reason += f"; {finest.name} takes {factor:.3g} times as long for {finest.over_noise:.2g}"
    return Choice(taken, True, reason)


def front(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Those that no other beats in both time and error, by time."""
    kept: list[Measurement] = []
    for found in sorted(measurements, key=lambda m: (m.cost.seconds, m.over_noise)):
        if not kept or found.over_noise < kept[-1].over_noise:
            kept.append(found)
    return kept
