"""Delay and delay rate of one target to a fraction of a cell: maximum likelihood, Newton's method.

The model is exact: exp(-j 2 pi (fc + f) (tau + rate t)), with the range migration of a fast target
within the interval. The phase of the target's cell is first removed from the channel, which is then
summed in blocks to a small array of slowly varying phase. Powers of several channels are added:
each has its own phase.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_BLOCKS = 64  # along each axis; half a cell turns a block's ends by pi / 128
_SERIES = 5.0  # radians, up to which a series takes less time than exponentials
_TERMS = 38  # of it
_ROUNDING = 1e-17  # its first term that is left out
#: Cells between places of which the differences tell how an echo changes.
APART = 0.01
_CLOSE = 1e-6  # cells: the square of this is left of an error in the next step


@dataclass(frozen=True, eq=False)
class BlockGrid:
    """Blocks of subcarriers and slots: mean frequencies ``f_hz`` (n_f,), mean times ``t_s`` (n_t,),
    by the window's weights; ``middle_t_s`` (n_t,): mean times without them.

    ``count_f``, ``count_t``: number of subcarriers and slots of each block; ``taper_f``,
    ``taper_t``: mean of the window over it. ``cell``: of delay (s) and of delay rate (s/s).
    """

    f_hz: Array
    t_s: Array
    middle_t_s: Array
    count_f: NDArray[np.intp]
    count_t: NDArray[np.intp]
    taper_f: Array
    taper_t: Array
    carrier_hz: float
    cell: Array

    @cached_property
    def by_delay(self) -> Array:
        """Phase per cell of delay (n_f,), in radians."""
        return np.asarray(2 * np.pi * self.cell[0] * self.f_hz)

    @cached_property
    def by_rate(self) -> Array:
        """Phase per cell of rate (n_t,), in radians, in the middle of the band."""
        middle_hz = self.carrier_hz + self.f_hz[len(self.f_hz) // 2]
        return np.asarray(2 * np.pi * self.cell[1] * middle_hz * self.t_s)

    def phasor(self, steps: Array) -> NDArray[np.complex128]:
        """exp(j phase) (..., n_f, n_t) of offsets in cells of delay and rate (..., 2)."""
        along_f = np.exp(1j * steps[..., :1] * self.by_delay)
        # Whole turns per slot are the same for all slots of a block, whatever their weights.
        n_slots = self.count_t.sum()
        folded = n_slots * np.rint(steps[..., 1:] / n_slots)
        moved_s = folded * self.middle_t_s + (steps[..., 1:] - folded) * self.t_s
        along_t = np.exp(2j * np.pi * self.carrier_hz * self.cell[1] * moved_s)
        return self.migration(steps[..., 1] * self.cell[1], along_f, along_t)

    def migration(
        self,
        rates: Array,
        along_f: NDArray[np.complex128] | None = None,
        along_t: NDArray[np.complex128] | None = None,
    ) -> NDArray[np.complex128]:
        """exp(2 pi j f rate t) (..., n_f, n_t): phasors of the migration at delay rates (...),
        times the phasors along_f (..., n_f) and along_t (..., n_t).

        By a power series to rounding error; for the fastest rates by exponentials, since the series
        would need more terms.
        """
        scale, by_f, by_t = self._powers
        phases = np.asarray(rates) * scale
        most = float(np.abs(phases).max(initial=0.0))
        if most > _SERIES:
            phasor = np.exp(2j * np.pi * np.multiply.outer(rates, np.outer(self.f_hz, self.t_s)))
            phasor = phasor if along_f is None else phasor * along_f[..., None]
            return np.asarray(phasor if along_t is None else phasor * along_t[..., None, :])
        numbers = np.arange(1, by_f.shape[1])
        size = 1 + int(np.count_nonzero(np.cumprod(most / numbers) > _ROUNDING))
        weights = np.ones((*phases.shape, size), dtype=np.complex128)
        np.cumprod(1j * phases[..., None] / numbers[: size - 1], axis=-1, out=weights[..., 1:])
        left, right = by_f[:, :size] * weights[..., None, :], by_t[:size]
        left = left if along_f is None else left * along_f[..., None]
        return np.asarray(left @ (right if along_t is None else right * along_t[..., None, :]))

    @cached_property
    def _powers(self) -> tuple[float, NDArray[np.complex128], NDArray[np.complex128]]:
        """Largest phase of `migration` per delay rate; powers of f (n_f, n) and t (n, n_t), of
        which a series up to that phase consists.
        """
        most = [float(np.abs(axis).max()) or 1.0 for axis in (self.f_hz, self.t_s)]
        along = [
            np.vander(axis / size, _TERMS, increasing=True).astype(np.complex128)
            for axis, size in zip((self.f_hz, self.t_s), most, strict=True)
        ]
        return 2 * np.pi * most[0] * most[1], along[0], np.ascontiguousarray(along[1].T)

    @cached_property
    def derivatives(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128], Array]:
        """Powers 0 to 2 of the phases u (3, n_f) per cell of delay and v (n_t, 3) per cell of rate
        of the carrier; and (6, 9): which sums of u^p v^q make those of 1, u, w, u^2, u w and w^2,
        where w = v (1 + r u) is 2 pi (fc + f) t per cell of rate.
        """
        by_rate = 2 * np.pi * self.cell[1] * self.carrier_hz * self.t_s
        r = 1 / (2 * np.pi * self.cell[0] * self.carrier_hz)
        #             1  v  v^2   u  uv  uv^2   u2 u2v u2v^2
        combined = [
            [1, 0, 0, 0, 0, 0, 0, 0, 0],
            [0, 0, 0, 1, 0, 0, 0, 0, 0],
            [0, 1, 0, 0, r, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0, 1, 0, 0],
            [0, 0, 0, 0, 1, 0, 0, r, 0],
            [0, 0, 1, 0, 0, 2 * r, 0, 0, r * r],
        ]
        return (
            np.vander(self.by_delay, 3, increasing=True).T.astype(np.complex128),
            np.vander(by_rate, 3, increasing=True).astype(np.complex128),
            np.array(combined),
        )


@dataclass(frozen=True, eq=False)
class Blocks:
    """A channel relative to the delay ``delay_s`` and its rate ``delay_rate``, in sums (n_channels,
    n_f, n_t) over the blocks of a grid.
    """

    sums: NDArray[np.complex128]
    grid: BlockGrid
    delay_s: float
    delay_rate: float


def blocks_about(
    channel: Complex,
    waveform: OfdmWaveform,
    window: str,
    delay_s: Array,
    delay_rate: Array,
    at_most: int = _BLOCKS,
) -> list[Blocks]:
    """Blocks about each of several delays and rates, (n,) each, from one pass over the channel.

    ``channel`` (..., n_subcarriers, n_slots) has no window. Sums are scaled so that an echo of
    power P at the middle has a total of sqrt(P). Delays or rates that are not measured (NaN) count
    as 0. ``at_most``: blocks along each axis; an echo at half as many cells from the middle loses
    3.9 dB.
    """
    if not len(delay_s):
        return []
    n, m = channel.shape[-2:]
    delay, rate = np.nan_to_num(delay_s), np.nan_to_num(delay_rate)
    f, t = waveform.frequency_offsets_hz, waveform.slot_times_s
    windows = normalised_window(window, n), normalised_window(window, m)
    along_f = _phasors(delay, f) * (windows[0] / n)
    along_t = _phasors(waveform.carrier_hz * rate, t) * (windows[1] / m)
    # Slots first: the channel comes transposed, its subcarriers contiguous.
    parts = channel.reshape(-1, n, m).swapaxes(1, 2)
    edges_f, edges_t = _edges(n, at_most), _edges(m, at_most)
    along_f = along_f.astype(channel.dtype)
    shape = len(parts), len(edges_f) - 1, len(edges_t) - 1, len(delay)
    sums = np.empty(shape, dtype=np.complex128)
    for i, (start, stop) in enumerate(pairwise(edges_f)):
        by_slot = (parts[..., start:stop] @ along_f[:, start:stop].T) * along_t.T
        sums[:, i] = np.add.reduceat(by_slot, edges_t[:-1], axis=1)
    grid = BlockGrid(
        _means(f, edges_f, windows[0]),
        _means(t, edges_t, windows[1]),
        _means(t, edges_t, np.ones(m)),
        np.diff(edges_f),
        np.diff(edges_t),
        np.add.reduceat(windows[0], edges_f[:-1]) / np.diff(edges_f),
        np.add.reduceat(windows[1], edges_t[:-1]) / np.diff(edges_t),
        waveform.carrier_hz,
        np.array([waveform.delay_cell_s, waveform.delay_rate_cell]),
    )
    return [
        # Migration through range cells couples frequency and time.
        Blocks(sums[..., i] * grid.migration(rate[i]), grid, delay[i], rate[i])
        for i in range(len(delay))
    ]


def _phasors(cycles: Array, axis: Array) -> NDArray[np.complex128]:
    """exp(2 pi j cycles axis) (n, len(axis)) along an evenly spaced axis, by products of fewer."""
    coarse = np.exp(2j * np.pi * np.outer(cycles, axis[::_BLOCKS]))
    fine = np.exp(2j * np.pi * np.outer(cycles, axis[:_BLOCKS] - axis[0]))
    return (coarse[:, :, None] * fine[:, None]).reshape(len(cycles), -1)[:, : len(axis)]


def _edges(n: int, at_most: int) -> NDArray[np.intp]:
    """Bounds of at most ``at_most`` blocks of n samples, (n_blocks + 1,)."""
    return np.unique(np.linspace(0, n, min(at_most, n) + 1).astype(np.intp))


def _means(axis: Array, edges: NDArray[np.intp], window: Array) -> Array:
    """Mean of each block by the weights of its samples: that at which its sum has no phase."""
    weight = np.add.reduceat(window, edges[:-1])
    mean = np.add.reduceat(axis * window, edges[:-1]) / np.where(weight, weight, 1.0)
    return np.asarray(np.clip(mean, axis[edges[:-1]], axis[edges[1:] - 1]))


def peak_offsets(about: Sequence[Blocks]) -> Array:
    """Cells of delay and rate (n, 2) from the middle of blocks of one grid to the highest power
    near it.
    """
    steps = np.zeros((len(about), 2))
    for i, blocks in enumerate(about):
        # Migration smears a peak of the map over as many range cells as the target crosses.
        duration = 1 / (blocks.grid.cell[1] * blocks.grid.carrier_hz)
        crossed = abs(blocks.delay_rate) * duration / blocks.grid.cell[0]
        steps[i] = _best_of_grid(blocks, 1 + crossed)
    return _climb(about, steps)


def _best_of_grid(blocks: Blocks, reach: float) -> Array:
    """Highest of a grid of quarter cells up to ``reach`` cells: a start for Newton's method."""
    steps = np.arange(-np.ceil(4 * reach), np.ceil(4 * reach) + 1) / 4
    across = np.exp(1j * np.outer(steps, blocks.grid.by_delay))
    along = np.exp(1j * np.outer(blocks.grid.by_rate, steps))
    power = np.sum(np.abs(across @ blocks.sums @ along) ** 2, axis=0)
    row, column = np.unravel_index(np.argmax(power), power.shape)
    between = np.array([_vertex(power[:, column], int(row)), _vertex(power[row], int(column))])
    return np.array([steps[row], steps[column]]) + between / 4


def _vertex(power: Array, at: int) -> float:
    """Position of a maximum relative to the highest sample, by a parabola through three logs."""
    if not 0 < at < len(power) - 1 or not power[at - 1 : at + 2].all():
        return 0.0
    before, middle, after = np.log(power[at - 1 : at + 2])
    bend = 2 * middle - before - after
    return float((after - before) / bend / 2) if bend > 0 else 0.0


def _climb(about: Sequence[Blocks], steps: Array) -> Array:
    """Newton's method on the log of the summed power, all at once."""
    moving = np.arange(len(about))
    sums = np.array([blocks.sums for blocks in about])
    for _ in range(12):
        if not moving.size:
            break
        change = _newton(about[0].grid, sums[moving], steps[moving])
        steps[moving] += np.clip(change, -0.25, 0.25)
        moving = moving[np.abs(change).max(axis=1) >= _CLOSE]
    return steps


def _newton(grid: BlockGrid, sums: NDArray[np.complex128], steps: Array) -> Array:
    """Newton's steps (n, 2) towards extrema of log sum_channels |sum exp(j (u x + w y))|^2.

    ``sums`` (n, n_channels, n_f, n_t). The shortest step where an axis has one sample only.
    """
    by_u, by_v, combined = grid.derivatives
    moments = by_u @ (sums * grid.phasor(steps)[:, None]) @ by_v
    # Sums of 1, u, w, u^2, u w, w^2 by channel, and their products with those of 1, u, w.
    by_channel = moments.reshape(*moments.shape[:2], 9) @ combined.T
    p = by_channel.swapaxes(1, 2) @ by_channel[..., :3].conj()
    p /= p[:, :1, :1].real
    x, y = -2 * p[:, 1, 0].imag, -2 * p[:, 2, 0].imag
    xx = 2 * (p[:, 1, 1] - p[:, 3, 0]).real - x * x
    xy = 2 * (p[:, 1, 2] - p[:, 4, 0]).real - x * y
    yy = 2 * (p[:, 2, 2] - p[:, 5, 0]).real - y * y
    determinant, trace = xx * yy - xy * xy, xx + yy
    solvable = np.abs(determinant) > np.finfo(float).eps * trace**2
    solved = np.stack([xy * y - yy * x, xy * x - xx * y], axis=1)
    shortest = -np.stack([xx * x + xy * y, xy * x + yy * y], axis=1)
    divisor = np.where(solvable, determinant, np.where(trace, trace**2, 1.0))
    return np.where(solvable[:, None], solved, shortest) / divisor[:, None]


def echo_amplitudes(blocks: Blocks, step: Array) -> NDArray[np.complex128]:
    """Amplitude on every channel (n_channels,), in root watts, at cells from the middle."""
    along_f, along_t = block_responses(blocks, step[None])
    whole = np.sum(blocks.sums * blocks.grid.phasor(step), axis=(1, 2))
    return np.asarray(whole / (along_f.sum() * along_t.sum()))


def block_responses(blocks: Blocks, steps: Array) -> tuple[Array, Array]:
    """Response of each block to targets of unit amplitude, with the loss by phase change within the
    block: (n_targets, n_f) and (n_targets, n_t); their product is the response to a target.

    The phase changes by what a target is away from the blocks' middle, and by its migration: over a
    block's slots in proportion to frequency, over its subcarriers in proportion to time.
    """
    grid = blocks.grid
    rates = blocks.delay_rate + steps[:, 1:] * grid.cell[1]
    spacing_hz = 1 / (grid.count_f.sum() * grid.cell[0])
    period_s = 1 / (grid.count_t.sum() * grid.cell[1] * grid.carrier_hz)
    along_f = grid.taper_f * _block_mean(grid.count_f, steps[:, :1])
    along_t = grid.taper_t * _block_mean(grid.count_t, steps[:, 1:])
    along_f = along_f * _mean_of_tone(grid.count_t.mean(), rates * grid.f_hz * period_s)
    along_t = along_t * _mean_of_tone(grid.count_f.mean(), rates * grid.t_s * spacing_hz)
    return along_f, along_t


def _mean_of_tone(count: float, cycles: Array) -> Array:
    """Mean over ``count`` samples of a tone of so many cycles per sample, far fewer than a half."""
    return np.asarray(np.sinc(count * cycles) / np.sinc(cycles))


def _block_mean(counts: NDArray[np.intp], steps: Array) -> Array:
    """Sums of a tone over blocks of ``counts`` samples, over the number of all samples, relative to
    the phase of each block's middle, (n_steps, n_blocks): a Dirichlet kernel. The tone has
    ``steps`` (n_steps, 1) cycles over all samples; whole cycles per sample cause no loss.
    """
    samples = counts.sum()
    half = np.pi * steps / samples
    once = np.sin(half)
    whole = np.abs(once) < 1e-7
    if whole.any():
        once = np.where(whole, 1.0, once)
        still = counts * np.cos(counts * half) / np.cos(half)
        return np.asarray(np.where(whole, still, np.sin(counts * half) / once) / samples)
    return np.asarray(np.sin(counts * half) / (once * samples))


def unit_echoes(blocks: Blocks, steps: Array) -> NDArray[np.complex128]:
    """Block sums (n_targets, n_f, n_t) of targets of unit amplitude, with the blocks' window.

    ``steps`` (n_targets, 2): cells from the middle.
    """
    along_f, along_t = block_responses(blocks, steps)
    return blocks.grid.phasor(-steps) * (along_f[:, :, None] * along_t[:, None])
