"""Cost and error measured at each fidelity level."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

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


#: Reference of a body that is not sampled by brute force.
BY_SOLVER = "the solver itself"


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
    is at most the tolerance; ``reference``: name of the reference; ``synthesis``: what the
    synthesis of the channel adds at most, all of its error being in this echo.
    """

    body: str
    level_db: float
    error: float
    is_converged: bool
    reference: str
    synthesis: float = 0.0

    @property
    def is_against_solver(self) -> bool:
        """Whether the reference is the solver itself, at a closer tolerance."""
        return self.reference.startswith(BY_SOLVER)


@dataclass(frozen=True)
class LevelMeasurement:
    """Cost and error of one level, on one scene and one machine.

    ``error`` is in ``unit``, ``over_noise`` in units of the sensor's own noise; both contain the
    error of the reference itself. ``over_cells``: of light, relative to that of each cell, or to
    the cells' mean where that is more, root mean square over the cells; NaN of other models.
    ``detail`` holds further figures by name, ``bodies`` the errors of the radar's strongest bodies.
    A level without a ``fidelity`` is for comparison only: it is not one of the twin's, and never
    chosen. ``leaves_out``: what a level of the radar has no model of, in words.
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
    over_cells: float = math.nan

    @property
    def over_bodies(self) -> float:
        """The largest error of a body's echo with its synthesis; NaN where none was compared."""
        return max((math.hypot(e.error, e.synthesis) for e in self.bodies), default=math.nan)

    @property
    def knobs(self) -> dict[str, Any]:
        """Values of the settings that the model's levels vary."""
        if self.fidelity is None:
            return {}
        return {name: getattr(self.fidelity, name) for name in _KNOBS[self.model]}


def front(measurements: Sequence[LevelMeasurement]) -> list[LevelMeasurement]:
    """The Pareto front, by time: levels that no other beats in both time and error."""
    best: list[LevelMeasurement] = []
    for measurement in sorted(measurements, key=lambda m: (m.cost.seconds, m.over_noise)):
        if not best or measurement.over_noise < best[-1].over_noise:
            best.append(measurement)
    return best
