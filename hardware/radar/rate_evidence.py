"""Likelihood of the delay rates that fold to a measured one, by the migration each would cause.

A body whose parts move against each other fits no rate to within the noise, and what it leaves
favours one rate or another by chance. So what the best rate leaves counts as noise, for all rates
(overdispersion: McCullagh and Nelder, Generalized Linear Models, 1989).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.refinement import BlockGrid, Blocks
from hardware.radar.residue import AROUND
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

#: Log-likelihood ratio above which a rate counts as certain: one error in a thousand.
CERTAIN = float(np.log(1e3))
#: Standard deviation of rates before anything is measured: of 10 m/s.
USUAL_RATE = 2 * 10.0 / C_M_PER_S
_MODEL = 0.1  # of the likeliest rate's level: what an extended target may add to a wrong rate
_FAR_WEAKER = 0.5  # of the likeliest rate's level: less, parts that move otherwise do not explain
_BESIDE = 0.5  # cells of rate from the best of the half cells, within which a body's rate is
_FINE = 33  # rates tried there: what is left of one between two of them is 1e-3 of its power
_FARTHEST = 9  # cells to each side that are searched: a quarter of the blocks' own reach
#: Cells that are searched.
SEARCHED = (2 * _FARTHEST + 1) ** 2
_FARTHEST_MOVED = 64  # range cells within a burst: as many as blocks along an axis at most
_MOST_SPANS = 256  # either way: of more the map tells nothing, and the list has no reader


@dataclass(frozen=True, eq=False)
class RateEvidence:
    """Likelihood of each of the delay rates that fold to the measured one.

    ``delay_rate`` (n_rates,), in s/s. ``log_likelihood`` (n_rates,): of a point target anywhere in
    the cells searched, in white noise and what the best rate leaves, up to a constant. ``level``
    (n_rates,): signal over noise in the best row of one rate, which is largest for the true rate
    also of an extended target. ``step`` (n_rates, 2): cells of delay and rate to the highest power.
    ``misfit``: noise with what the best rate leaves, over noise alone.
    """

    delay_rate: Array
    log_likelihood: Array
    level: Array
    step: Array
    misfit: float

    @property
    def candidates(self) -> NDArray[np.intp]:
        """Indices (n,) of the rates that the data cannot exclude, likeliest first; where the data
        hardly distinguish them, that is the slowest.
        """
        rates, likelihood = self.delay_rate, self.log_likelihood
        likeliest = np.argsort((rates / USUAL_RATE) ** 2 / 2 - likelihood, kind="stable")
        return np.asarray(likeliest[self.possible[likeliest]])

    @property
    def possible(self) -> NDArray[np.bool_]:
        """Rates (n_rates,) that the data cannot exclude against the likeliest."""
        behind = self.log_likelihood.max() - self.log_likelihood
        # A smear of neighbours may look like a point; the level around it says otherwise.
        weak = self.level < (1 - _MODEL) * self.level.max()
        # Half of the level no chance of what is left makes up for, only noise.
        far_weaker = self.level < _FAR_WEAKER * self.level.max()
        unlikely = (weak & (behind > CERTAIN)) | (far_weaker & (self.misfit * behind > CERTAIN))
        return np.asarray(~unlikely)


def ambiguous_rates(waveform: OfdmWaveform, delay_rate: float, fastest: float) -> Array:
    """Delay rates (n_rates,) of the same folded Doppler shift, slowest first.

    Those up to ``fastest``, in s/s, either way; at least the nearest.
    """
    span = 2 * waveform.max_delay_rate
    nearest = delay_rate - span * np.rint(delay_rate / span)
    reach = int(np.ceil(fastest / span)) + 1
    rates = nearest + span * np.arange(-reach, reach + 1)
    rates = rates[(np.abs(rates) <= fastest) | (rates == nearest)]
    return np.asarray(rates[np.argsort(np.abs(rates), kind="stable")])


def fastest_resolved(waveform: OfdmWaveform, fastest: float) -> float:
    """Up to which delay rate others are tested: ``fastest``, or less where targets would cross too
    many range cells within a burst, or too many rates fold to one.
    """
    migration = (
        _FARTHEST_MOVED * waveform.delay_cell_s / (waveform.n_slots * waveform.slot_period_s)
    )
    return min(fastest, migration, 2 * _MOST_SPANS * waveform.max_delay_rate)


def rate_evidence(blocks: Blocks, delay_rates: Array, noise_w: float) -> RateEvidence:
    """Likelihood of delay rates from the migration that each would cause.

    Parameters
    ----------
    blocks
        The channel about the echo without a window, see `blocks_about`, at one of the rates.
    delay_rates : (n_rates,)
        Rates a multiple of the Doppler ambiguity's span from the blocks' own.
    noise_w
        Mean noise power of a cell.
    """
    sums, f_hz, t_s = blocks.sums, blocks.grid.f_hz, blocks.grid.t_s
    extra = delay_rates - blocks.delay_rate
    duration = 1 / (blocks.grid.cell[1] * blocks.grid.carrier_hz)
    smeared = np.abs(extra).max() * duration / blocks.grid.cell[0] / 2
    reach = int(min(np.ceil(smeared) + 1, _FARTHEST))
    steps = (
        np.arange(-2 * reach, 2 * reach + 1) / 2
    )  # half cells: between two a target loses 0.9 dB
    across = np.exp(2j * np.pi * blocks.grid.cell[0] * np.outer(steps, f_hz))
    along = np.exp(2j * np.pi * blocks.grid.cell[1] * blocks.grid.carrier_hz * np.outer(t_s, steps))
    single = np.complex64
    across, along, near = across.astype(single), along.astype(single), sums.astype(single)
    # The carrier's phase is the same for all rates, modulo whole cycles per slot; the rest of the
    # band gives the migration.
    still = near * blocks.grid.migration(extra).astype(single)[:, None]
    cells = across @ still @ along  # by rate that is tried, channel, delay and rate
    power = np.asarray(np.sum(cells.real**2 + cells.imag**2, axis=1, dtype=np.float64))
    flat = power.reshape(len(power), -1)
    # Remains of stronger echoes over all these cells count as noise: that of the rate which leaves
    # the least of them, for all rates, since a few cells tell it to some 10 % alone.
    middle = flat.shape[1] // 2
    least = max(noise_w, np.finfo(float).tiny)
    noise = max(least, float(np.partition(flat, middle, axis=1)[:, middle].min()) / len(sums))
    at = flat.argmax(axis=1)
    highest_w = flat.max(axis=1, keepdims=True)
    step = steps[np.stack(np.divmod(at, len(steps)), axis=-1)]
    rows = np.maximum(power / noise - len(sums), 0).sum(axis=1)
    best = int(rows.max(axis=1).argmax())
    amplitude = cells[best].reshape(len(sums), -1)[:, at[best]]
    rest = _without_one_rate(still[best], blocks.grid, steps[rows[best].argmax()])
    around = [np.abs(steps - place) <= AROUND for place in step[best]]
    rest = across[around[0]][::2] @ rest @ along[:, around[1]][:, ::2]
    with_misfit = noise + _misfit_w(rest, amplitude, noise)
    spread = np.log(np.sum(np.exp((flat - highest_w) / with_misfit), axis=1))
    likelihood = (highest_w / with_misfit)[:, 0] + spread
    return RateEvidence(delay_rates, likelihood, rows.max(axis=1), step, with_misfit / noise)


def _without_one_rate(sums: Complex, grid: BlockGrid, step: float) -> Complex:
    """Sums (n_channels, n_f, n_t) without what a body of one rate, near a step in cells, explains
    whatever its shape along the delay.
    """
    steps = step + np.linspace(-_BESIDE, _BESIDE, _FINE)
    one_rate = np.exp(2j * np.pi * grid.cell[1] * grid.carrier_hz * np.outer(grid.t_s, steps))
    one_rate = one_rate.astype(sums.dtype) / np.sqrt(len(grid.t_s))
    by_delay = sums @ one_rate
    best = int(np.sum(np.abs(by_delay) ** 2, axis=(0, 1)).argmax())
    return np.asarray(sums - by_delay[..., best, None] * one_rate[:, best].conj())


def _misfit_w(cells: Complex, amplitude: Complex, noise_w: float) -> float:
    """Power beyond noise in cells (n_channels, n_delays, n_rates) of what the likeliest rate
    leaves, where it is: the mean by that power itself, twice the mean for noise.

    Along the echo's amplitudes (n_channels,), since the channels share what bodies leave.
    """
    along = np.tensordot(amplitude.conj(), cells, 1)
    power = np.abs(along) ** 2 / max(float(np.vdot(amplitude, amplitude).real), 1e-300)
    where_it_is = float(np.vdot(power, power) / max(float(power.sum()), 1e-300))
    return max(where_it_is - 2 * noise_w, 0.0)
