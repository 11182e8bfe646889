"""Echoes that a radar does not tell apart, joined: behind hundreds of obstacles there are millions.

Echoes of almost the same delay, directions and rates become one. Each is divided between the two
delays beside its own one, so that the sum is right to first order all over the band: to 1 % at its
ends. Directions and rates are means: at the elements farthest from the middle, and at the ends of a
burst, a sum of independent echoes is off by 4 % by each of these, by less elsewhere.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.radar.device.design import RadarDesign
from twin.radar.rows import alike, first_rows, phasors
from twin.radar.synthesis.contributions import Contributions

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_OF_BAND_RAD, _APART_RAD = 0.3, 0.15  # of phase, at the ends
_MOST_APART = 0.01  # directions
_LEAST_WEIGHT = 1e-9
_AT_ONCE = 2**19  # echoes, for memory: some 0.3 GB
_COMMON = (
    "object",
    "first",
    "source",
    "receiver",
    "bounces",
    "wavefront",
    "falloff",
    "wavelength_power",
)
_CONTINUOUS = (
    "departure",
    "arrival",
    "delay_rate",
    "delay_acceleration_per_s",
    "departure_per_s",
    "arrival_per_s",
)


@dataclass(frozen=True)
class Resolution:
    """Differences that turn phases by `_OF_BAND_RAD`, in delay, at the ends of the band; and by
    `_APART_RAD`, in direction, at the elements farthest from the middle, and in rates and
    accelerations, at the ends of a burst. ``carrier_hz``: at which delays are right.
    """

    carrier_hz: float
    delay_s: float
    direction: float
    delay_rate: float
    acceleration_per_s: float
    direction_per_s: float

    @staticmethod
    def of(radar: RadarDesign) -> "Resolution":
        """Of all steps of its carrier."""
        wave, burst = radar.ofdm, radar.burst
        farthest_hz = np.ptp(burst.carriers_hz) + wave.bandwidth_hz / 2
        places_m = np.concatenate([burst.transmitters_m, burst.receivers_m])
        cycles = _APART_RAD / (2 * np.pi)
        highest_hz = float(burst.carriers_hz[-1]) + wave.bandwidth_hz / 2
        elements = highest_hz / C_M_PER_S * float(np.linalg.norm(places_m, axis=1).max())
        half_s = radar.burst_s / 2
        direction = min(cycles / max(elements, cycles), _MOST_APART)
        return Resolution(
            wave.carrier_hz,
            _OF_BAND_RAD / (2 * np.pi * farthest_hz),
            direction,
            cycles / (highest_hz * half_s),
            2 * cycles / (highest_hz * half_s**2),
            direction / half_s,
        )


def joined(
    echoes: Contributions, resolution: Resolution, gain: Callable[[Array], Array], many: int
) -> Contributions:
    """Echoes, if they are more than ``many``, as fewer, unless there were no fewer; ``gain`` of
    directions (n, 3), in amplitude there and back, which amplitudes are without.
    """
    if len(echoes) <= many or echoes.amplitude.ndim > 1:
        return echoes
    if len(echoes) > _AT_ONCE:  # some at a time, then what these have become: the same delays
        starts = range(0, len(echoes), _AT_ONCE)
        blocks = [echoes.take(slice(start, start + _AT_ONCE)) for start in starts]
        echoes = Contributions.concatenate([_joined(one, resolution, gain) for one in blocks])
    return _joined(echoes, resolution, gain)


def _joined(
    echoes: Contributions, resolution: Resolution, gain: Callable[[Array], Array]
) -> Contributions:
    """Echoes as fewer, unless there were no fewer."""
    k = 2 * np.pi * resolution.carrier_hz
    steps = echoes.delay_s / resolution.delay_s
    lower = np.floor(steps).astype(np.int64)
    received = echoes.amplitude * np.sqrt(gain(echoes.departure) * gain(echoes.arrival))
    parts = []
    for number, share in ((lower, 1 + lower - steps), (lower + 1, steps - lower)):
        delay_s: Array = (number * resolution.delay_s).astype(np.float64)
        wave = received * share * phasors(k * (delay_s - echoes.delay_s) % (2 * np.pi))
        parts.append(replace(echoes, amplitude=wave, delay_s=delay_s))
    both = Contributions.concatenate(parts)
    group = alike([*_numbers(echoes), *_in_steps(echoes, resolution)])
    number = np.concatenate([lower, lower + 1])
    weight = np.abs(both.amplitude)
    weight += _LEAST_WEIGHT * (weight.max() or 1.0)  # directions of silent ones have a mean, too
    sums = _Sums(alike([np.tile(group, 2), number]), weight)
    one = both.take(sums.first)
    means: dict[str, Any] = {name: sums.mean(getattr(both, name)) for name in _CONTINUOUS}
    for name in ("departure", "arrival"):
        means[name] /= np.linalg.norm(means[name], axis=1)[:, None]
    level = np.sqrt(gain(means["departure"]) * gain(means["arrival"]))
    wave = sums.total(both.amplitude) / np.where(level > 0, level, np.inf)
    return replace(one, amplitude=wave, **means) if len(one) < len(echoes) else echoes


class _Sums:
    """Sums and means with weights (n,) over each ``owner`` (n,), numbered from 0; ``first``: one of
    the rows of each.
    """

    def __init__(self, owner: Indices, weight: Array) -> None:
        self.owner, self.weight, self.count = owner, weight, int(owner.max()) + 1
        self.first = first_rows(owner)
        self.weights = np.bincount(owner, weight, self.count)

    def total(self, wave: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Sums of waves (n,)."""
        parts = (np.bincount(self.owner, part, self.count) for part in (wave.real, wave.imag))
        real, imag = parts
        return np.asarray(real + 1j * imag)

    def mean(self, values: Array) -> Array:
        """Of values (n,) or vectors (n, 3)."""
        if values.ndim > 1:
            return np.stack([self.mean(column) for column in values.T], axis=1)
        if not np.ptp(values):
            return values[self.first]
        mean: Array = np.bincount(self.owner, self.weight * values, self.count) / self.weights
        return mean


def _numbers(echoes: Contributions) -> list[Indices]:
    """What echoes that become one have in common, (n,) each."""
    return [np.unique(getattr(echoes, name), return_inverse=True)[1] for name in _COMMON]


def _in_steps(echoes: Contributions, resolution: Resolution) -> list[Indices]:
    """In how many steps of a resolution each is at what it may differ by, (n,) each."""
    sizes = (
        resolution.direction,
        resolution.direction,
        resolution.delay_rate,
        resolution.acceleration_per_s,
        resolution.direction_per_s,
        resolution.direction_per_s,
    )
    columns = []
    for name, size in zip(_CONTINUOUS, sizes, strict=True):
        values = getattr(echoes, name)
        columns += [np.floor(row / size).astype(np.int64) for row in np.atleast_2d(values.T)]
    return columns
