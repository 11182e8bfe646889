"""Non-uniform FFT of contributions along frequency at chosen times: here a delay becomes a phase.

The phase of subcarrier f is exp(-j 2 pi (fc + f) tau); tau follows delay, rate and acceleration.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Complex, Contributions
from twin.radar.synthesis.groups import Group, Indices
from twin.radar.synthesis.threads import map_in_threads

#: Contributions in one transform. What is added to what depends on nothing else: the same bits
#: whatever the number of threads.
_PIECE = 32_768


def transforms(
    contributions: Contributions,
    groups: Sequence[Group],
    waveform: OfdmWaveform,
    tolerance: float,
) -> list[Complex]:
    """Channel of each group at its own times, (n_times, n_subcarriers), exact in the motion."""
    pieces = list(_pieces(contributions, groups))
    channels = [np.zeros((len(g.times_s), waveform.n_subcarriers), np.complex128) for g in groups]
    factors = {power: _factor(power, waveform) for power in {power for _, power, _ in pieces}}

    def of_piece(piece: tuple[int, float, Indices]) -> Complex:
        number, power, members = piece
        times = groups[number].times_s
        return factors[power] * _at_times(contributions, members, times, waveform, tolerance)

    for (number, _, _), channel in zip(pieces, map_in_threads(of_piece, pieces), strict=True):
        channels[number] += channel
    return channels


def _pieces(
    contributions: Contributions, groups: Sequence[Group]
) -> Iterator[tuple[int, float, Indices]]:
    """Number of the group, power of the falloff, members."""
    for number, group in enumerate(groups):
        falloff = contributions.falloff[group.members]
        powers = np.unique(falloff)
        for power in powers:
            some = group.members if len(powers) == 1 else group.members[falloff == power]
            for start in range(0, len(some), _PIECE):
                yield number, float(power), some[start : start + _PIECE]


def _factor(power: float, waveform: OfdmWaveform) -> Array:
    """What falls off over the band, (n_subcarriers,)."""
    carrier = waveform.carrier_hz
    factor: Array = (carrier / (carrier + waveform.frequency_offsets_hz)) ** power
    return factor


def _at_times(
    contributions: Contributions,
    members: Indices,
    times_s: Array,
    waveform: OfdmWaveform,
    tolerance: float,
) -> Complex:
    """Channel of some contributions without their falloff, (n_times, n_subcarriers)."""
    import finufft

    plan = finufft.Plan(1, (waveform.n_subcarriers,), **_options(tolerance))
    delay, rate = contributions.delay_s[members], contributions.delay_rate[members]
    half = contributions.delay_acceleration_per_s[members] / 2
    middle = contributions.amplitude[members] * phasor(-(waveform.carrier_hz * delay % 1.0))
    x = 2 * np.pi * waveform.subcarrier_spacing_hz * delay
    channel = np.empty((len(times_s), waveform.n_subcarriers), dtype=np.complex128)
    for row, time in zip(channel, times_s, strict=True):
        if time == 0:
            plan.setpts(x)
            plan.execute(middle, row)
            continue
        moved = (half * time + rate) * time
        strengths = phasor(-waveform.carrier_hz * moved)
        strengths *= middle
        moved *= 2 * np.pi * waveform.subcarrier_spacing_hz
        moved += x
        plan.setpts(moved)
        plan.execute(strengths, row)
    return channel


def _options(tolerance: float) -> dict[str, Any]:
    """Of finufft: its tolerance, with room for the largest error of a bin. Its threads would add
    in any order.
    """
    return {"eps": tolerance / 20, "upsampfac": 2.0, "nthreads": 1, "isign": -1}


def phasor(cycles: Array) -> Complex:
    """exp(j 2 pi cycles)."""
    values = np.empty(np.shape(cycles), dtype=np.complex128)
    phase = 2 * np.pi * cycles
    np.cos(phase, out=values.real)
    np.sin(phase, out=values.imag)
    return values
