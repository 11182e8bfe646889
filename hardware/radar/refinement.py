"""Range and rate of a lone target to a small part of a cell: maximum likelihood by Newton's method.

The model is exact: exp(-j 2 pi (fc + f) (tau + rate t)), with the migration through range cells
that a fast target makes within the interval. The channel is brought to the target's cell and summed
in blocks first, which leaves a small, slowly turning array. Of several channels the powers are
added: each has its own phase.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.windows import taper
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

_BLOCKS = 64  # along each axis; half a cell turns a block's ends by pi / 128


@dataclass(frozen=True, eq=False)
class Blocks:
    """A channel about one delay and rate, in sums over blocks.

    ``sums`` (n_channels, n_f, n_t) at mean frequencies ``f_hz`` and times ``t_s``; ``cell`` holds
    one cell of delay (s) and of delay rate (s/s). ``delay_s`` and ``delay_rate`` are the middle.
    ``share_f`` and ``share_t``: each block's share of all subcarriers and slots.
    """

    sums: NDArray[np.complex128]
    f_hz: Array
    t_s: Array
    share_f: Array
    share_t: Array
    carrier_hz: float
    delay_s: float
    delay_rate: float
    cell: Array

    @property
    def turns(self) -> tuple[Array, Array]:
        """Phase per cell of delay (n_f, 1) and of rate (n_f, n_t), in radians."""
        by_delay = 2 * np.pi * self.cell[0] * self.f_hz[:, None]
        by_rate = 2 * np.pi * self.cell[1] * (self.carrier_hz + self.f_hz[:, None]) * self.t_s
        return by_delay, by_rate


def blocks_about(
    channel: Complex, waveform: OfdmWaveform, window: str, range_m: Array, rate_m_per_s: Array
) -> list[Blocks]:
    """Blocks about each of several ranges and rates, (n,) each, from one pass over the channel.

    ``channel`` (..., n_subcarriers, n_slots) is not tapered yet. Sums are scaled so that an echo of
    power P at the middle has a total of sqrt(P). Ranges or rates that are not measured, NaN, are
    taken as 0.
    """
    if not len(range_m):
        return []
    n, m = channel.shape[-2:]
    delay = 2 / C_M_PER_S * np.nan_to_num(range_m)
    rate = 2 / C_M_PER_S * np.nan_to_num(rate_m_per_s)
    f, t = waveform.frequency_offsets_hz, waveform.slot_times_s
    along_f = np.exp(2j * np.pi * np.outer(delay, f)) * (taper(window, n) / n)
    along_t = np.exp(2j * np.pi * waveform.carrier_hz * np.outer(rate, t)) * (taper(window, m) / m)
    # Slots first: the channel comes transposed, its subcarriers contiguous.
    parts = channel.reshape(-1, n, m).swapaxes(1, 2)
    edges_f, f_mean = _edges(f)
    edges_t, t_mean = _edges(t)
    along_f = along_f.astype(channel.dtype)
    by_f = np.empty((len(parts), len(f_mean), len(delay), m), dtype=np.complex128)
    for i, (start, stop) in enumerate(pairwise(edges_f)):
        by_f[:, i] = (parts[..., start:stop] @ along_f[:, start:stop].T).swapaxes(1, 2)
    sums = np.add.reduceat(by_f * along_t, edges_t[:-1], axis=-1)
    # Migration through range cells, which couples frequency and time.
    sums *= np.exp(2j * np.pi * f_mean[:, None, None] * rate[:, None] * t_mean)
    cell = np.array([1 / waveform.bandwidth_hz, 2 * waveform.velocity_cell_m_per_s / C_M_PER_S])
    return [
        Blocks(
            sums[:, :, i],
            f_mean,
            t_mean,
            np.diff(edges_f) / n,
            np.diff(edges_t) / m,
            waveform.carrier_hz,
            delay[i],
            rate[i],
            cell,
        )
        for i in range(len(delay))
    ]


def _edges(axis: Array) -> tuple[NDArray[np.intp], Array]:
    """Bounds of up to `_BLOCKS` blocks (n_blocks + 1,), and the blocks' means."""
    edges = np.unique(np.linspace(0, len(axis), min(_BLOCKS, len(axis)) + 1).astype(np.intp))
    return edges, np.add.reduceat(axis, edges[:-1]) / np.diff(edges)


def highest(blocks: Blocks) -> Array:
    """Cells of delay and rate (2,) from the middle to the highest power nearby."""
    # Migration smears a peak of the map over as many range cells as the target crosses.
    duration = 1 / (blocks.cell[1] * blocks.carrier_hz)
    crossed = abs(blocks.delay_rate) * duration / blocks.cell[0]
    return _climb(blocks, _best_of_grid(blocks, 1 + crossed))


def _best_of_grid(blocks: Blocks, reach: float) -> Array:
    """Best of a grid of quarter cells out to ``reach`` cells: a start from which Newton climbs."""
    steps = np.arange(-np.ceil(4 * reach), np.ceil(4 * reach) + 1) / 4
    by_delay, by_rate = blocks.turns
    across = np.exp(1j * np.outer(steps, by_delay))
    along = np.exp(1j * np.outer(by_rate[len(by_rate) // 2], steps))
    power = np.sum(np.abs(across @ blocks.sums @ along) ** 2, axis=0)
    row, column = np.unravel_index(np.argmax(power), power.shape)
    return np.array([steps[row], steps[column]])


def _climb(blocks: Blocks, step: Array) -> Array:
    """Newton's method on the log of the summed power."""
    a, b = blocks.turns
    for _ in range(12):
        turned = blocks.sums * np.exp(1j * (a * step[0] + b * step[1]))
        gradient, hessian = _slope(turned, a, b)
        change = -np.linalg.lstsq(hessian, gradient, rcond=None)[0]
        step = step + np.clip(change, -0.25, 0.25)
        if np.abs(change).max() < 1e-7:
            break
    return step


def _slope(turned: NDArray[np.complex128], a: Array, b: Array) -> tuple[Array, Array]:
    """Gradient and Hessian of log sum_channels |sum exp(j (a x + b y))|^2."""
    by_a, by_b = turned * a, turned * b
    s = turned.sum(axis=(1, 2))
    first = 1j * np.array([by_a.sum(axis=(1, 2)), by_b.sum(axis=(1, 2))])
    mixed = (by_a * b).sum(axis=(1, 2))
    second = -np.array([[(by_a * a).sum(axis=(1, 2)), mixed], [mixed, (by_b * b).sum(axis=(1, 2))]])
    power = np.sum(np.abs(s) ** 2)
    gradient = 2 * np.real(first @ s.conj()) / power
    curved = 2 * np.real(second @ s.conj() + first @ first.conj().T) / power
    return gradient, curved - np.outer(gradient, gradient)


def amplitudes(blocks: Blocks, step: Array) -> NDArray[np.complex128]:
    """Amplitude on every channel (n_channels,), in root watts, at cells from the middle."""
    a, b = blocks.turns
    turn = np.exp(1j * (a * step[0] + b * step[1]))
    return np.asarray(np.sum(blocks.sums * turn, axis=(1, 2)))


def unit_echoes(blocks: Blocks, steps: Array) -> NDArray[np.complex128]:
    """Block sums (n_targets, n_f, n_t) of targets of unit amplitude, without a window.

    ``steps`` (n_targets, 2): cells from the middle.
    """
    a, b = blocks.turns
    turn = a * steps[:, 0, None, None] + b * steps[:, 1, None, None]
    # What turning within a block leaves of its sum.
    along_f = blocks.share_f * np.sinc(steps[:, :1] * blocks.share_f)
    along_t = blocks.share_t * np.sinc(steps[:, 1:] * blocks.share_t)
    return np.asarray(np.exp(-1j * turn) * along_f[:, :, None] * along_t[:, None])


def left_over(blocks: Blocks, step: Array, reach: int = 3) -> float:
    """Mean power of the cells around a target once it is taken away: of noise, and of what else
    there is.

    ``blocks`` without a window; the mean is over ``reach`` cells to each side, and over channels.
    """
    atom = unit_echoes(blocks, step[None])[0]
    amplitude = np.sum(blocks.sums * atom.conj(), axis=(1, 2)) / np.sum(np.abs(atom) ** 2)
    rest = blocks.sums - amplitude[:, None, None] * atom
    by_delay, by_rate = blocks.turns
    cells = [
        np.arange(-min(reach, (n - 1) // 2), min(reach, (n - 1) // 2) + 1) for n in rest[0].shape
    ]
    across = np.exp(1j * np.outer(step[0] + cells[0], by_delay))
    along = np.exp(1j * np.outer(by_rate[len(by_rate) // 2], step[1] + cells[1]))
    return float(np.mean(np.abs(across @ rest @ along) ** 2))
