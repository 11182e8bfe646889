"""What walking the rungs found."""

from dataclasses import dataclass
from typing import Any

from twin.fidelity import Fidelity
from twin.trade.brute_force import Agreement
from twin.trade.measurement import Choice, Ladder, Measurement


@dataclass(frozen=True, eq=False)
class Trade:
    """Every rung's cost and error, and the choice by ladder.

    ``pixel_noise_e``: the sensor's noise of a pixel, median over the detectors, electrons.
    ``fft_s``: one complex FFT of 2^20 points in NumPy on this machine, to compare machines by.
    """

    scene: str
    system: str
    radar: str | None
    tolerance: float
    seed: int
    measurements: tuple[Measurement, ...]
    choices: dict[Ladder, Choice]
    agreement: Agreement | None
    pixel_noise_e: float
    fft_s: float
    warnings: tuple[str, ...]

    @property
    def fidelity(self) -> Fidelity:
        """The choices of all ladders in one."""
        knobs: dict[str, Any] = {}
        for choice in self.choices.values():
            knobs |= choice.taken.knobs
        return Fidelity(**knobs)

    def of(self, ladder: Ladder) -> list[Measurement]:
        """Measurements of one ladder."""
        return [m for m in self.measurements if m.ladder == ladder]
