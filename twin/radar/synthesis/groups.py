"""Groups of contributions that move nearly alike, as wide as is cheapest."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Contributions
from twin.radar.synthesis.times import times_of

Indices = NDArray[np.intp]

#: Subcarriers over which a group's common motion turns by the phase at their middle.
BLOCK = 64

#: Phase that rates in one group leave at the interval's end, at most: the candidates.
_SPREADS_RAD = (0.25, 1.0, 4.0, 16.0, np.inf)
_MOST_GROUPS = 256
#: Cells of a matrix product, and of a sum, that take as long as one contribution at one time.
_CELLS, _SUMMED_CELLS = 50, 16


@dataclass(frozen=True, eq=False)
class Group:
    """``members`` by index, the middle of their rates and accelerations, and the times (n_times,)
    that tell what is left of their motion.
    """

    members: Indices
    rate: float
    acceleration_per_s: float
    times_s: Array

    @property
    def moves(self) -> bool:
        """Whether there is a common motion."""
        return bool(self.rate or self.acceleration_per_s)

    def delays_at(self, times_s: Array) -> Array:
        """By how much the common motion lengthens delays from the interval's middle on."""
        moved: Array = (self.rate + self.acceleration_per_s / 2 * times_s) * times_s
        return moved


def groups_of(
    contributions: Contributions, waveform: OfdmWaveform, tolerance: float
) -> list[Group]:
    """What is at rest, and what moves, divided so that the whole takes least work."""
    moving = contributions.moving
    all_groups, movers = [], np.flatnonzero(moving)
    if len(movers) < len(moving):
        all_groups.append(Group(np.flatnonzero(~moving), 0.0, 0.0, np.zeros(1)))
    if len(movers):
        divisions = _divisions(contributions, movers, waveform, tolerance)
        all_groups += min(divisions, key=lambda groups: _work(groups, waveform))
    return all_groups


def _work(groups: Iterable[Group], waveform: OfdmWaveform) -> float:
    """In contributions at one time."""
    n, cells = waveform.n_subcarriers, waveform.n_subcarriers * waveform.n_slots
    work = 0.0
    for group in groups:
        count = len(group.times_s)
        work += count * (len(group.members) + n)
        work += count * cells / _CELLS if count < waveform.n_slots else cells / _SUMMED_CELLS
    return work


def _divisions(
    contributions: Contributions, movers: Indices, waveform: OfdmWaveform, tolerance: float
) -> Iterator[list[Group]]:
    """By rate into groups of every spread, the widest being all in one."""
    order = movers[np.argsort(contributions.delay_rate[movers], kind="stable")]
    rates = contributions.delay_rate[order]
    accelerations = contributions.delay_acceleration_per_s[order]
    latest = float(np.abs(waveform.slot_times_s).max())
    top = waveform.carrier_hz + waveform.bandwidth_hz / 2
    beside = BLOCK / 2 * waveform.subcarrier_spacing_hz
    for spread in _SPREADS_RAD:
        with np.errstate(divide="ignore"):
            starts = _starts(rates, float(spread / (np.pi * top * np.float64(latest))))
        if len(starts) > _MOST_GROUPS:
            continue
        stops = [*starts[1:], len(order)]
        slowest = np.minimum.reduceat(accelerations, starts)
        fastest = np.maximum.reduceat(accelerations, starts)
        groups = []
        for start, stop, low, high in zip(starts, stops, slowest, fastest, strict=True):
            rate, half_rate = _middle(rates[start], rates[stop - 1])
            acceleration, half = _middle(low, high)
            linear = 2 * np.pi * latest * (top * half_rate + beside * abs(rate))
            square = np.pi * latest**2 * (top * half + beside * abs(acceleration))
            times = times_of(linear, square, waveform, tolerance)
            groups.append(Group(order[start:stop], rate, acceleration, times))
        yield groups


def _starts(rates: Array, width: float) -> list[int]:
    """Where groups begin that are no wider, of sorted rates; breaks off beyond the most groups."""
    starts = [0]
    while len(starts) <= _MOST_GROUPS:
        stop = int(np.searchsorted(rates, rates[starts[-1]] + width, side="right"))
        if stop == len(rates):
            break
        starts.append(stop)
    return starts


def _middle(low: float, high: float) -> tuple[float, float]:
    """And half of what lies between."""
    return float(low + high) / 2, float(high - low) / 2
