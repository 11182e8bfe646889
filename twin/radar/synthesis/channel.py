"""The channel in all slots, from transforms at the times of every group."""

from collections.abc import Sequence

import numpy as np

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Complex, Contributions
from twin.radar.synthesis.groups import BLOCK, Group, groups_of
from twin.radar.synthesis.side_by_side import side_by_side
from twin.radar.synthesis.times import interpolation
from twin.radar.synthesis.transforms import transforms, turned

#: Multiplications that BLAS does not share out among threads of its own.
_SMALL = 2**18


def synthesize(
    contributions: Contributions,
    waveform: OfdmWaveform,
    tolerance: float = 1e-6,
    out: Complex | None = None,
) -> Complex:
    """Channel of all contributions, ``(n_subcarriers, n_slots)``.

    Parameters
    ----------
    contributions
        Amplitudes already hold what a slot's averaging leaves (`OfdmWaveform.slot_gain`).
    waveform
        Frequencies and times.
    tolerance
        Bounds the error relative to the channel's root mean square, of transforms along frequency
        and of the slots in between.
    out
        Where to write it, of the same shape; fastest where subcarriers lie side by side.
    """
    if out is None:
        out = np.empty((waveform.n_slots, waveform.n_subcarriers), dtype=np.complex128).T
    groups = groups_of(contributions, waveform, tolerance)
    found = transforms(contributions, groups, waveform, tolerance)
    slots: Complex = out.T
    told = [k for k, group in enumerate(groups) if len(group.times_s) < waveform.n_slots]
    _interpolated([groups[k] for k in told], [found[k] for k in told], waveform, slots)
    for k in set(range(len(groups))) - set(told):
        slots += found[k]
    return out


def _interpolated(
    groups: Sequence[Group], at_times: Sequence[Complex], waveform: OfdmWaveform, out: Complex
) -> None:
    """All slots of groups from what they are at their times, into ``out`` (n_slots,
    n_subcarriers).

    Of every few subcarriers the common motion is taken out of the times and put into the slots;
    what is left is slow.
    """
    if not groups:
        out[:] = 0
        return
    stack, n = np.concatenate(at_times), waveform.n_subcarriers
    if len(stack) == 1 and not groups[0].moves:
        out[:] = stack
        return
    times = waveform.slot_times_s
    between = [interpolation(group.times_s, times) for group in groups]
    step = max(_SMALL // (BLOCK * len(stack)), 1)

    def of_block(start: int) -> None:
        block = slice(start, start + BLOCK)
        frequency = waveform.carrier_hz + waveform.frequency_offsets_hz[block].mean()
        weights = np.concatenate(
            [
                _weights(group, share, times, float(frequency))
                for group, share in zip(groups, between, strict=True)
            ]
        )
        for first in range(0, waveform.n_slots, step):
            some = slice(first, first + step)
            np.matmul(weights[:, some].T, stack[:, block], out=out[some, block])

    for _ in side_by_side(of_block, range(0, n, BLOCK)):
        pass


def _weights(group: Group, between: Array, times: Array, frequency_hz: float) -> Complex:
    """Of every time in every slot, (n_times, n_slots), at a frequency."""
    if not group.moves:
        return between.astype(np.complex128)
    before = turned(frequency_hz * group.delays_at(group.times_s))
    after = turned(-frequency_hz * group.delays_at(times))
    found: Complex = before[:, None] * between * after
    return found
