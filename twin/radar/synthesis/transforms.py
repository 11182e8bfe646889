"""Contributions at chosen times, transformed along frequency."""

from collections.abc import Iterator, Sequence

import numpy as np

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Complex, Contributions
from twin.radar.synthesis.groups import Group, Indices
from twin.radar.synthesis.side_by_side import side_by_side
from twin.radar.synthesis.spreading import kernel_of, spectra

#: Contributions in one transform. What is added to what depends on nothing else: the same bits
#: whatever the number of threads.
_PIECE = 32_768


def transforms(
    contributions: Contributions,
    groups: Sequence[Group],
    waveform: OfdmWaveform,
    tolerance: float,
) -> list[Complex]:
    """Of every group at its times, (n_times, n_subcarriers), exact in the motion."""
    pieces = list(_pieces(contributions, groups))
    found = [np.zeros((len(g.times_s), waveform.n_subcarriers), np.complex128) for g in groups]
    factors = {power: _factor(power, waveform) for power in {power for _, power, _ in pieces}}

    def of_piece(piece: tuple[int, float, Indices]) -> Complex:
        number, power, members = piece
        times = groups[number].times_s
        return factors[power] * _at_times(contributions, members, times, waveform, tolerance)

    for (number, _, _), channel in zip(pieces, side_by_side(of_piece, pieces), strict=True):
        found[number] += channel
    return found


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
    """Without falloff, (n_times, n_subcarriers)."""
    spacing = waveform.subcarrier_spacing_hz
    return spectra(
        contributions.amplitude[members],
        spacing * contributions.delay_s[members],
        spacing * contributions.delay_rate[members],
        spacing * contributions.delay_acceleration_per_s[members],
        times_s,
        waveform.carrier_hz / spacing,
        kernel_of(waveform.n_subcarriers, tolerance),
    )
