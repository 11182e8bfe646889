"""The shutters of each pattern: always open, the phases of a lock-in measurement, or gates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from hardware.reconstruction.depth import common_range_m
from hardware.records import Shutter
from hardware.records.state import ALWAYS_OPEN
from twin.optics.time_of_flight import Response, gate, phase_shutter
from twin.system import System, TimeOfFlight

Array = NDArray[np.float64]
#: Evenly spaced lengths between two, of which the largest response is looked for.
_LENGTHS = 5


@dataclass(frozen=True, eq=False)
class ShutterResponse:
    """Response of one exposure to light by the length of its path.

    ``response``: share of the emitter's light that is collected, None for all of it;
    ``light_share``: share of the time that the emitter is on; ``open_share``: share that the
    detector is open. ``recorded`` and ``pulse_width_s``: the shutter as written to a record.
    """

    response: Response | None = None
    light_share: float = 1.0
    open_share: float = 1.0
    recorded: Shutter = ALWAYS_OPEN
    pulse_width_s: float = 0.0


def shutters(system: System) -> tuple[ShutterResponse, ...]:
    """Shutters of a system, in the order of their exposures of each pattern."""
    if system.time_of_flight is None:
        return (ShutterResponse(),)
    tof = system.time_of_flight
    return _phases(tof) if tof.modulation_hz is not None else _gates(tof)


def _phases(tof: TimeOfFlight) -> tuple[ShutterResponse, ...]:
    assert tof.modulation_hz is not None  # a TimeOfFlight without gates has frequencies
    assert tof.contrast is not None
    contrast = tof.contrast.value
    return tuple(
        ShutterResponse(
            response=phase_shutter(f, phase, contrast),
            open_share=0.5,
            recorded=Shutter(modulation_hz=f, phase_rad=float(phase)),
        )
        for f in tof.modulation_hz.value
        for phase in 2 * math.pi * np.arange(tof.n_phases) / tof.n_phases
    )


def _gates(tof: TimeOfFlight) -> tuple[ShutterResponse, ...]:
    assert tof.gate_delays_s is not None  # a TimeOfFlight without frequencies has all of these
    assert tof.gate_width_s is not None
    assert tof.pulse_width_s is not None
    assert tof.pulse_rate_hz is not None
    pulse, rate = tof.pulse_width_s.value, tof.pulse_rate_hz.value
    width = tof.gate_width_s.value
    return tuple(
        ShutterResponse(
            response=gate(pulse, delay, width, rate),
            light_share=pulse * rate,
            open_share=width * rate,
            recorded=Shutter(gate_delay_s=delay, gate_width_s=width),
            pulse_width_s=pulse,
        )
        for delay in tof.gate_delays_s.value
    )


def most_collected(
    shutters: Sequence[ShutterResponse], shortest_m: Array, longest_m: Array
) -> Array:
    """Largest share of the light of lengths from some to others, (n,), that shutters which weight
    light by its path collect, all together, averaged over the time.
    """
    lengths_m = np.linspace(shortest_m, longest_m, _LENGTHS, axis=1)
    # Of gates it is linear between where they see the end of an echo, or no longer its beginning.
    kinks_s = [
        one.recorded.gate_delay_s + width - pulse
        for one in shutters
        for width in (0.0, one.recorded.gate_width_s)
        for pulse in (0.0, one.pulse_width_s)
    ]
    kinks_m = np.clip(constants.c * np.array(kinks_s), shortest_m[:, None], longest_m[:, None])
    lengths_m = np.concatenate([lengths_m, kinks_m], axis=1)
    collected = sum(weight(one)(lengths_m) for one in shutters)
    return np.asarray(np.max(collected, axis=1, initial=0.0))


def weight(shutter: ShutterResponse) -> Response:
    """Share of the light that a shutter which weights light by its path collects, by length."""
    response = shutter.response
    assert response is not None  # only called with time of flight
    return lambda length_m: shutter.light_share * response(length_m)


def farthest_gate_m(system: System) -> float:
    """Distance from which on no gate is open for light that comes back; infinite without gates."""
    ends_s = [
        one.recorded.gate_delay_s + one.recorded.gate_width_s if one.recorded.gated else math.inf
        for one in shutters(system)
    ]
    return constants.c / 2 * max(ends_s)


def unambiguous_m(system: System) -> float:
    """Distance from which on echoes look nearer than they are: those of gates come back after the
    next pulse, the phases of all frequencies repeat. Infinite without time of flight.
    """
    if (tof := system.time_of_flight) is None:
        return math.inf
    if tof.modulation_hz is not None:
        return common_range_m(tof.modulation_hz.value)
    assert tof.pulse_rate_hz is not None  # a TimeOfFlight without frequencies has gates
    return constants.c / 2 / tof.pulse_rate_hz.value
