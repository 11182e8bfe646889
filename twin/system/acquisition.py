"""What is shown, for how long, and when the detector is sensitive."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from hardware.patterns import Order
from twin.errors import InputError
from twin.system.own_patterns import OwnPatternSource
from twin.toml import Count, Fraction, NonNegative, Positive, Sourced, Strict

#: Of `hardware.patterns.Mode` what one detector can measure: complementary takes two.
Mode = Literal["differential", "plain", "reference", "s-matrix"]
#: The record's clock counts ns.
Duration = Annotated[Positive, Field(ge=1e-9, le=1e3)]


class Acquisition(Strict):
    """Which patterns are shown, and for how long.

    ``columns``: of a line sensor, whose pixels are binned to them; default one per pixel.
    ``patterns``: a user's own in place of Hadamard rows, the first ``n_patterns`` of a file (in
    Python of an array) of as many rows and columns as the emitter, see `hardware.own_patterns`;
    ``order`` does not count then.
    """

    integration_time_s: Sourced[Duration]
    pattern_period_s: Sourced[Duration]
    n_patterns: Sourced[Count]
    order: Sourced[Order]
    mode: Sourced[Mode]
    columns: Sourced[Count] | None = None
    patterns: Sourced[OwnPatternSource] | None = None

    @model_validator(mode="after")
    def _fits(self) -> "Acquisition":
        if self.integration_time_s.value > self.pattern_period_s.value:
            raise InputError("integration_time_s is longer than pattern_period_s")
        return self

    def residue(self, tau_s: float) -> float:
        """Share of an exposure that is still what was before it, where that decays with exp(-t/tau)
        from the switch on; integration begins when the dead time between patterns is over.
        """
        time = self.integration_time_s.value
        dead = self.pattern_period_s.value - time
        return tau_s / time * math.exp(-dead / tau_s) * -math.expm1(-time / tau_s)


class TimeOfFlight(Strict):
    """Distance from the time that light takes; every pattern is shown once for each shutter.

    Indirect: power modulated at each of ``modulation_hz``, the detector sensitive half of the time,
    in step, at ``phase_steps`` phases; ``contrast`` of the modulation and the detector together.
    Gated: pulses of ``pulse_width_s``, ``pulse_rate_hz`` of them a second, the detector open for
    ``gate_width_s`` after each of ``gate_delays_s``; radiant intensity is that of the pulse.
    """

    alternatives: ClassVar = (
        ("modulation_hz", "phase_steps", "contrast"),
        ("pulse_width_s", "pulse_rate_hz", "gate_width_s", "gate_delays_s"),
    )

    modulation_hz: Sourced[Annotated[tuple[Positive, ...], Field(min_length=1)]] | None = None
    phase_steps: Sourced[Annotated[int, Field(strict=True, ge=3, le=16)]] | None = None
    contrast: Sourced[Fraction] | None = None
    pulse_width_s: Sourced[Positive] | None = None
    pulse_rate_hz: Sourced[Positive] | None = None
    gate_width_s: Sourced[Positive] | None = None
    gate_delays_s: Sourced[Annotated[tuple[NonNegative, ...], Field(min_length=1)]] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "TimeOfFlight":
        gated = [self.pulse_width_s, self.pulse_rate_hz, self.gate_width_s, self.gate_delays_s]
        indirect = [self.modulation_hz, self.contrast]
        if not (
            (None not in gated and not any(indirect)) or (None not in indirect and not any(gated))
        ):
            raise InputError(
                "needs either modulation_hz and contrast, or pulse_width_s, pulse_rate_hz, "
                "gate_width_s and gate_delays_s"
            )
        for name in ("pulse_width_s", "gate_width_s"):
            width = getattr(self, name)
            if width and self.pulse_rate_hz and width.value * self.pulse_rate_hz.value > 1:
                raise InputError(f"{name} is longer than the time between pulses")
        if self.gate_delays_s and self.gate_width_s and self.pulse_rate_hz:
            last = max(self.gate_delays_s.value) + self.gate_width_s.value
            if last * self.pulse_rate_hz.value > 1 + 1e-9:
                raise InputError(
                    f"gate_delays_s: the last gate closes after {last:g} s, when the next pulse is "
                    f"under way (pulse_rate_hz = {self.pulse_rate_hz.value:g})"
                )
        return self

    @property
    def n_phases(self) -> int:
        """Phase shutters per modulation frequency."""
        return self.phase_steps.value if self.phase_steps else 4

    @property
    def n_shutters(self) -> int:
        """Exposures of each pattern."""
        if self.modulation_hz is not None:
            return len(self.modulation_hz.value) * self.n_phases
        return len(self.gate_delays_s.value) if self.gate_delays_s else 1
