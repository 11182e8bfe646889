"""Result of measuring all fidelity levels."""

from dataclasses import dataclass
from typing import Any

from twin.fidelity import Fidelity, Tolerance
from twin.trade.brute_force import Agreement
from twin.trade.choice import Choice
from twin.trade.criterion import Criterion
from twin.trade.measurement import LevelMeasurement, Model


@dataclass(frozen=True, eq=False)
class Trade:
    """Cost and error of every fidelity level, and the choice by model.

    Levels are chosen by ``tolerance``, or by ``within_s``, the time of a frame, where it is given.
    ``criteria``: the errors by which levels are judged, and what the tolerance permits of them.
    ``pixel_noise_e``: the sensor's noise of a pixel, median over the detectors, electrons.
    ``fft_s``: time of one complex FFT of 2^20 points in NumPy, for comparison between machines.
    """

    scene: str
    system: str
    radar: str | None
    tolerance: Tolerance | float
    criteria: dict[Model, Criterion]
    within_s: float | None
    seed: int
    measurements: tuple[LevelMeasurement, ...]
    choices: dict[Model, Choice]
    agreement: Agreement | None
    pixel_noise_e: float
    fft_s: float
    warnings: tuple[str, ...]

    @property
    def fidelity(self) -> Fidelity:
        """The choices of all models in one fidelity."""
        knobs: dict[str, Any] = {}
        for choice in self.choices.values():
            knobs |= choice.measurement.knobs
        return Fidelity(**knobs)

    def of(self, model: Model) -> list[LevelMeasurement]:
        """Measurements of one model."""
        return [m for m in self.measurements if m.model == model]
