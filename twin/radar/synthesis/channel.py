"""The channel at all slots, interpolated in time from transforms at a few times of every group.

A delay becomes a phase in `nonuniform_fft`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Complex, Contributions
from twin.radar.synthesis.groups import BLOCK, Group, groups_of
from twin.radar.synthesis.nonuniform_fft import phasor, transforms
from twin.radar.synthesis.threads import map_in_threads
from twin.radar.synthesis.times import interpolation

#: Own and wanted times in one matrix product with a block: so few multiplications, 32 768, that no
#: build of OpenBLAS shares them out among threads of its own, which would change their last bits;
#: from 65 536 on its kernels for some processors do.
_OWN, _WANTED = 32, 16


def synthesize(
    contributions: Contributions,
    waveform: OfdmWaveform,
    tolerance: float = 1e-6,
    out: Complex | None = None,
    times_s: Array | None = None,
) -> Complex:
    """Channel of all contributions, ``(n_subcarriers, n_times)``.

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
    times_s : (n_times,)
        When, from the interval's middle on. Default: the middles of the slots.
    """
    if times_s is None:
        times_s = waveform.slot_times_s
    if out is None:
        out = np.empty((len(times_s), waveform.n_subcarriers), dtype=np.complex128).T
    groups = groups_of(contributions, waveform, tolerance, times_s)
    channels = transforms(contributions, groups, waveform, tolerance)
    slots: Complex = out.T
    sampled = [k for k, group in enumerate(groups) if len(group.times_s) < len(times_s)]
    some = [groups[k] for k in sampled], [channels[k] for k in sampled]
    _interpolated(*some, waveform, times_s, slots)
    for k in set(range(len(groups))) - set(sampled):
        slots += channels[k]
    return out


def _interpolated(
    groups: Sequence[Group],
    at_times: Sequence[Complex],
    waveform: OfdmWaveform,
    times_s: Array,
    out: Complex,
) -> None:
    """Channel of groups at times, interpolated from the channel at their own, into ``out``
    (n_times, n_subcarriers).

    The common motion of a group rotates the phase fast. For each block of subcarriers this rotation
    is removed at the group's times, the slowly changing rest is interpolated, and the rotation is
    applied again at every time.
    """
    if not groups:
        out[:] = 0
        return
    stack, n = np.concatenate(at_times), waveform.n_subcarriers
    if len(stack) == 1 and not groups[0].moves:
        out[:] = stack
        return
    weights = [_weights(group, waveform, times_s) for group in groups]

    def of_block(number: int) -> None:
        block = slice(number * BLOCK, (number + 1) * BLOCK)
        block_weights = np.concatenate([weight.of_block(number) for weight in weights])
        for first in range(0, len(times_s), _WANTED):
            some = slice(first, first + _WANTED)
            np.matmul(block_weights[:_OWN, some].T, stack[:_OWN, block], out=out[some, block])
            for time in range(_OWN, len(stack), _OWN):
                times = slice(time, time + _OWN)
                out[some, block] += block_weights[times, some].T @ stack[times, block]

    for _ in map_in_threads(of_block, range(-(-n // BLOCK))):
        pass


@dataclass(frozen=True, eq=False)
class _Weights:
    """Weights with which a group's channel at its own times is summed at each time that is wanted.

    ``interpolation`` (n_own, n_times): of the channel without its common motion. ``remove``
    (n_blocks, n_own, 1) and ``restore`` (n_blocks, 1, n_times): phasors of that motion at the
    middle of each block of subcarriers; None where there is no motion.
    """

    interpolation: Array
    remove: Complex | None = None
    restore: Complex | None = None

    def of_block(self, number: int) -> Complex | Array:
        """Weights for a block of subcarriers, (n_own, n_times)."""
        if self.remove is None or self.restore is None:
            return self.interpolation
        weights: Complex = (self.remove[number] * self.interpolation) * self.restore[number]
        return weights


def _weights(group: Group, waveform: OfdmWaveform, times_s: Array) -> _Weights:
    between_times = interpolation(group.times_s, times_s)
    if not group.moves:
        return _Weights(between_times)
    starts = np.arange(0, waveform.n_subcarriers, BLOCK)
    counts = np.minimum(starts + BLOCK, waveform.n_subcarriers) - starts
    middle = starts + (counts - 1) / 2 - waveform.n_subcarriers // 2
    frequencies = waveform.carrier_hz + waveform.subcarrier_spacing_hz * middle
    remove = phasor(np.outer(frequencies, group.delays_at(group.times_s)))
    restore = phasor(-np.outer(frequencies, group.delays_at(times_s)))
    return _Weights(between_times, remove[:, :, None], restore[:, None])
