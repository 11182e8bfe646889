"""The channel in all slots, from transforms at the times of every group."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Complex, Contributions
from twin.radar.synthesis.groups import BLOCK, Group, groups_of
from twin.radar.synthesis.side_by_side import side_by_side
from twin.radar.synthesis.times import interpolation
from twin.radar.synthesis.transforms import transforms, turned

#: Times and slots in one matrix product with a block: so few multiplications that BLAS does not
#: share them out among threads of its own, which would change their last bits.
_TIMES, _SLOTS = 128, 32


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
    channels = transforms(contributions, groups, waveform, tolerance)
    slots: Complex = out.T
    told = [k for k, group in enumerate(groups) if len(group.times_s) < waveform.n_slots]
    _interpolated([groups[k] for k in told], [channels[k] for k in told], waveform, slots)
    for k in set(range(len(groups))) - set(told):
        slots += channels[k]
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
    weights = [_weights(group, waveform) for group in groups]

    def of_block(number: int) -> None:
        block = slice(number * BLOCK, (number + 1) * BLOCK)
        both = np.concatenate([weight.of_block(number) for weight in weights])
        for first in range(0, waveform.n_slots, _SLOTS):
            some = slice(first, first + _SLOTS)
            np.matmul(both[:_TIMES, some].T, stack[:_TIMES, block], out=out[some, block])
            for time in range(_TIMES, len(stack), _TIMES):
                times = slice(time, time + _TIMES)
                out[some, block] += both[times, some].T @ stack[times, block]

    for _ in side_by_side(of_block, range(-(-n // BLOCK))):
        pass


@dataclass(frozen=True, eq=False)
class _Weights:
    """What a group's times count for in the slots.

    ``between`` (n_times, n_slots) without its common motion; ``before`` (n_blocks, n_times, 1) and
    ``after`` (n_blocks, 1, n_slots): that motion of every few subcarriers, out of the times and
    into the slots; None where there is none.
    """

    between: Array
    before: Complex | None = None
    after: Complex | None = None

    def of_block(self, number: int) -> Complex | Array:
        """Of a few subcarriers, (n_times, n_slots)."""
        if self.before is None or self.after is None:
            return self.between
        weights: Complex = (self.before[number] * self.between) * self.after[number]
        return weights


def _weights(group: Group, waveform: OfdmWaveform) -> _Weights:
    times = waveform.slot_times_s
    between = interpolation(group.times_s, times)
    if not group.moves:
        return _Weights(between)
    starts = np.arange(0, waveform.n_subcarriers, BLOCK)
    counts = np.minimum(starts + BLOCK, waveform.n_subcarriers) - starts
    middle = starts + (counts - 1) / 2 - waveform.n_subcarriers // 2
    frequencies = waveform.carrier_hz + waveform.subcarrier_spacing_hz * middle
    before = turned(np.outer(frequencies, group.delays_at(group.times_s)))
    after = turned(-np.outer(frequencies, group.delays_at(times)))
    return _Weights(between, before[:, :, None], after[:, None])
