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


#: Of two decays' times, below which their difference is rounding: then they are taken as equal.
_ALIKE = 1e-4


class Acquisition(Strict):
    """Which patterns are shown, and for how long."""

    integration_time_s: Sourced[Duration]
    """Time for which one exposure collects light, at the end of its pattern's period."""
    pattern_period_s: Sourced[Duration]
    """From the beginning of one exposure to the next; not below the integration time."""
    n_patterns: Sourced[Count]
    """Patterns shown; as many as there are cells make a complete Hadamard set."""
    order: Sourced[Order | Literal["raster"]]
    """Which Hadamard patterns come first, see `hardware.patterns.orders`; does not count with
    `patterns`. `raster`: one cell after another, as a scanning LIDAR lights them, `plain` (gates in
    which no echo falls tell the background) or `differential` (an exposure in the dark after each
    lit one).
    """
    mode: Sourced[Mode]
    """How a row of +1 and -1 becomes light; in pairs alone a wrong count or a drift shows in the
    noise, in other modes it looks like detail. `differential`: each pattern is followed by its
    complement; `plain`: the lit pattern alone; `reference`: all cells lit and all dark once, then
    the lit patterns; `s-matrix`: the cells where the row is -1.
    """
    columns: Sourced[Count] | None = None
    """Columns to which the pixels of a line sensor are binned. Default: one per pixel."""
    patterns: Sourced[OwnPatternSource] | None = None
    """File of a user's own patterns in place of Hadamard rows (in Python an array), of as many rows
    and columns as the emitter, of which the first `n_patterns` are shown.
    """

    @model_validator(mode="after")
    def _fits(self) -> "Acquisition":
        time_s, period_s = self.integration_time_s.value, self.pattern_period_s.value
        if time_s > period_s:
            raise InputError(
                f"integration_time_s = {time_s:g}: expected at most pattern_period_s = {period_s:g}"
            )
        return self

    def residue(self, tau_s: float) -> float:
        """Share of an exposure that is still what was before it, where that decays with exp(-t/tau)
        from the switch on; integration begins when the dead time between patterns is over.
        """
        return self._decayed_s2(tau_s) / (tau_s * self.integration_time_s.value)

    def residue_of_two(self, tau_s: float, other_s: float) -> float:
        """The same behind two stages, one after the other, each of which decays so: the second one
        starts late, with what the first one leaves.
        """
        time, period = self.integration_time_s.value, self.pattern_period_s.value
        apart, middle = tau_s - other_s, (tau_s + other_s) / 2
        if abs(apart) > _ALIKE * middle:
            return (self._decayed_s2(tau_s) - self._decayed_s2(other_s)) / (apart * time)
        begin, end = ((2 * middle + t) * math.exp(-t / middle) for t in (period - time, period))
        return (begin - end) / time

    def kept_of_two(self, tau_s: float, other_s: float) -> float:
        """What the second of two such stages has at a period's end, of what was in the first one at
        its beginning.
        """
        period = self.pattern_period_s.value
        apart, middle = tau_s - other_s, (tau_s + other_s) / 2
        if abs(apart) > _ALIKE * middle:
            return tau_s / apart * (math.exp(-period / tau_s) - math.exp(-period / other_s))
        return period / middle * math.exp(-period / middle)

    def _decayed_s2(self, tau_s: float) -> float:
        """Integral of tau exp(-t / tau) over an exposure."""
        time = self.integration_time_s.value
        dead = self.pattern_period_s.value - time
        return tau_s**2 * math.exp(-dead / tau_s) * -math.expm1(-time / tau_s)


class TimeOfFlight(Strict):
    """Distance from the time that light takes; every pattern is shown once for each shutter.

    Indirect: the light's power is modulated and the detector sensitive in step, at several phases.
    Gated: the light comes in pulses, and the detector is open for a while after each.
    """

    alternatives: ClassVar = (
        ("modulation_hz", "phase_steps", "contrast"),
        ("pulse_width_s", "pulse_rate_hz", "gate_width_s", "gate_delays_s", "readout"),
    )

    modulation_hz: Sourced[Annotated[tuple[Positive, ...], Field(min_length=1)]] | None = None
    """Indirect: frequencies at which the light's power is modulated, one after another, while the
    detector is sensitive half of the time, in step.
    """
    phase_steps: Sourced[Annotated[int, Field(strict=True, ge=3, le=16)]] | None = None
    """Indirect: phases of the detector for each frequency. Default: 4."""
    contrast: Sourced[Fraction] | None = None
    """Indirect: contrast of the modulation and the detector together."""
    pulse_width_s: Sourced[Positive] | None = None
    """Gated: length of a pulse; the radiant intensity is that of the pulse."""
    pulse_rate_hz: Sourced[Positive] | None = None
    """Gated: pulses per second. Echoes that come back after the next pulse look nearer, by half the
    way of light from one pulse to the next.
    """
    gate_width_s: Sourced[Positive] | None = None
    """Gated: for how long the detector is open after each pulse."""
    gate_delays_s: Sourced[Annotated[tuple[NonNegative, ...], Field(min_length=1)]] | None = None
    """Gated: from the beginning of the pulse to the opening of each gate."""
    readout: Sourced[Literal["in turn", "waveform"]] | None = None
    """Gated. `in turn`: each gate has an exposure of its own, over all of which the amplifier
    integrates; `waveform`: a digitiser takes all gates of the same pulses, and the amplifier's
    noise and the dark current are those of the time that a gate is open. Default: in turn.
    """

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
        if self.modulation_hz is not None and self.readout is not None:
            raise InputError("readout: belongs to gates, expected none beside modulation_hz")
        for name in ("pulse_width_s", "gate_width_s"):
            width = getattr(self, name)
            if width and self.pulse_rate_hz and width.value * self.pulse_rate_hz.value > 1:
                raise InputError(
                    f"{name} = {width.value:g}: expected at most the time between pulses, "
                    f"{1 / self.pulse_rate_hz.value:g} s"
                )
        if self.gate_delays_s and self.gate_width_s and self.pulse_rate_hz:
            last = max(self.gate_delays_s.value) + self.gate_width_s.value
            if last * self.pulse_rate_hz.value > 1 + 1e-9:
                raise InputError(
                    f"gate_delays_s: the last gate closes after {last:g} s, when the next pulse is "
                    f"under way (pulse_rate_hz = {self.pulse_rate_hz.value:g})"
                )
        return self

    @property
    def at_once(self) -> bool:
        """Whether all gates are taken of the same pulses."""
        return self.readout is not None and self.readout.value == "waveform"

    @property
    def emitter_share(self) -> float:
        """Share of the time that the emitter is on: of pulses their length times their rate, of
        modulated light, whose radiant intensity is the mean, all of it.
        """
        if self.pulse_width_s is None or self.pulse_rate_hz is None:
            return 1.0
        return self.pulse_width_s.value * self.pulse_rate_hz.value

    @property
    def open_share(self) -> float:
        """Share of the time that the detector is open in one shutter."""
        if self.gate_width_s is None or self.pulse_rate_hz is None:
            return 0.5
        return self.gate_width_s.value * self.pulse_rate_hz.value

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
