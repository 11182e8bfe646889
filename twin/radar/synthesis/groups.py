"""Groups of contributions of nearly equal motion, divided so that the synthesis is cheapest."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Contributions
from twin.radar.synthesis.times import chebyshev_times

Indices = NDArray[np.intp]

#: Subcarriers in a block, whose common motion is removed with the phase at its middle frequency.
BLOCK = 64

#: Candidates of the phase that differences of rates within a group make by the interval's end.
_SPREADS_RAD = (0.25, 1.0, 4.0, 16.0, np.inf)
_MOST_GROUPS = 256
#: Cells of a matrix product, and of a sum, that cost as much as one contribution at one time.
_CELLS, _SUMMED_CELLS = 50, 16


@dataclass(frozen=True, eq=False)
class Group:
    """Indices of ``members``, their common motion (middle of their rates and accelerations), and
    the times (n_times,) from which the rest of their motion is interpolated.
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
        """Change of delay by the common motion since the interval's middle, in s."""
        moved: Array = (self.rate + self.acceleration_per_s / 2 * times_s) * times_s
        return moved


def groups_of(
    contributions: Contributions, waveform: OfdmWaveform, tolerance: float, times_s: Array
) -> list[Group]:
    """One group at rest, and groups of what moves, divided so that the whole costs least."""
    moving = contributions.moving
    all_groups, in_motion = [], np.flatnonzero(moving)
    if len(in_motion) < len(moving):
        all_groups.append(Group(np.flatnonzero(~moving), 0.0, 0.0, np.zeros(1)))
    if len(in_motion):
        divisions = _divisions(contributions, in_motion, waveform, tolerance, times_s)
        size = waveform.n_subcarriers, len(times_s)
        all_groups += min(divisions, key=lambda groups: _work(groups, *size))
    return all_groups


def _work(groups: Iterable[Group], n_subcarriers: int, n_times: int) -> float:
    """Cost of groups, in units of one contribution at one time."""
    cells = n_subcarriers * n_times
    work = 0.0
    for group in groups:
        count = len(group.times_s)
        work += count * (len(group.members) + n_subcarriers)
        work += count * cells / _CELLS if count < n_times else cells / _SUMMED_CELLS
    return work


def _divisions(
    contributions: Contributions,
    in_motion: Indices,
    waveform: OfdmWaveform,
    tolerance: float,
    times_s: Array,
) -> Iterator[list[Group]]:
    """Divisions by rate into groups, one for each candidate spread; the widest is a single
    group.
    """
    order = in_motion[np.argsort(contributions.delay_rate[in_motion], kind="stable")]
    rates = contributions.delay_rate[order]
    accelerations = contributions.delay_acceleration_per_s[order]
    latest = float(np.abs(times_s).max())
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
            times = chebyshev_times(linear, square, latest, tolerance, len(times_s))
            if len(times) == len(times_s):
                times = times_s  # nothing is left to interpolate
            groups.append(Group(order[start:stop], rate, acceleration, times))
        yield groups


def _starts(rates: Array, width: float) -> list[int]:
    """First indices of groups at most ``width`` wide, of sorted rates; stops above the most
    groups.
    """
    starts = [0]
    while len(starts) <= _MOST_GROUPS:
        stop = int(np.searchsorted(rates, rates[starts[-1]] + width, side="right"))
        if stop == len(rates):
            break
        starts.append(stop)
    return starts


def _middle(low: float, high: float) -> tuple[float, float]:
    """Middle of two values, and half their difference."""
    return float(low + high) / 2, float(high - low) / 2
