"""Contributions to the channel, and the channel by its definition.

H[n, m] = sum_i a_i (fc / (fc + f_n))^p_i exp(-j 2 pi (fc + f_n) (tau_i + rate_i t_m
+ acceleration_i t_m^2 / 2))
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Contributions:
    """Echoes, each (n,): amplitude, delay in s, its rate in s/s (positive: receding) and the rate's
    rate in 1/s: a target that crosses at v in R has 2 v^2 / (R c).

    The amplitude is that of the wave relative to the sent one, without the phase of the delay; of a
    radar that steps its carrier it may be (n_steps, n).
    Delays belong to the middle of the interval and to the antenna's origin. ``departure`` and
    ``arrival`` (n, 3) are unit vectors from the antenna towards where a path begins and whence it
    comes back, in its own frame: x ahead, y left, z up; zero where the way does not depend on where
    the antennas stand. ``departure_per_s`` and ``arrival_per_s`` (n, 3) are their derivatives in
    time, 1/s: where a target crosses, elements of an array do not hear the same rate; default: 0.
    ``falloff`` (n,): over the band the amplitude goes as the carrier over the frequency to this
    power, one of few; default: 0.
    """

    amplitude: Complex
    delay_s: Array
    delay_rate: Array
    delay_acceleration_per_s: Array
    departure: Array
    arrival: Array
    departure_per_s: Array = None  # type: ignore[assignment]
    arrival_per_s: Array = None  # type: ignore[assignment]
    falloff: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        n = len(self.delay_s)
        for name, shape in (("departure_per_s", (n, 3)), ("arrival_per_s", (n, 3)), ("falloff", n)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(shape))

    @staticmethod
    def ahead(
        amplitude: Complex,
        delay_s: Array,
        delay_rate: Array,
        delay_acceleration_per_s: Array | None = None,
    ) -> "Contributions":
        """Echoes from straight ahead; without acceleration by default."""
        forward = np.tile([1.0, 0.0, 0.0], (len(delay_s), 1)).reshape(-1, 3)
        faster = np.zeros(len(delay_s))
        if delay_acceleration_per_s is not None:
            faster = delay_acceleration_per_s
        return Contributions(amplitude, delay_s, delay_rate, faster, forward, forward)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether the delay of each changes at all, (n,)."""
        found: NDArray[np.bool_] = (self.delay_rate != 0) | (self.delay_acceleration_per_s != 0)
        return found

    def delays_at(self, time_s: float) -> Array:
        """Delays at a time, (n,)."""
        if time_s == 0:
            return self.delay_s
        moved = (time_s / 2) * self.delay_acceleration_per_s
        moved += self.delay_rate
        moved *= time_s
        moved += self.delay_s
        return moved

    @staticmethod
    def none() -> "Contributions":
        """No echo at all."""
        empty = np.zeros(0)
        return Contributions.ahead(empty.astype(np.complex128), empty, empty)

    @staticmethod
    def joined(parts: Sequence["Contributions"]) -> "Contributions":
        """Echoes of all parts together."""
        if len(some := [part for part in parts if len(part.delay_s)]) == 1:
            return some[0]
        amplitude = np.concatenate([part.amplitude for part in parts], axis=-1)
        others = (f.name for f in fields(Contributions) if f.name != "amplitude")
        return Contributions(
            amplitude, *(np.concatenate([getattr(p, name) for p in parts]) for name in others)
        )


def direct_sum(
    contributions: Contributions, frequencies_hz: Array, times_s: Array, carrier_hz: float
) -> Complex:
    """The definition, in float64, for chosen frequencies and times: the reference."""
    channel = np.zeros((len(frequencies_hz), len(times_s)), dtype=np.complex128)
    for start in range(0, len(contributions.delay_s), 4096):
        some = slice(start, start + 4096)
        part = Contributions(*(getattr(contributions, f.name)[some] for f in fields(Contributions)))
        moved = np.stack([part.delays_at(time) for time in times_s], axis=1)
        for row, frequency in enumerate(frequencies_hz):
            cycles = (carrier_hz + frequency) * moved
            amplitude = part.amplitude * (carrier_hz / (carrier_hz + frequency)) ** part.falloff
            channel[row] += amplitude @ np.exp(-2j * np.pi * (cycles % 1.0))
    return channel
