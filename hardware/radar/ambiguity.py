"""Range rates beyond the Doppler ambiguity, told apart by the target's walk through range cells.

Slots a period T apart know the Doppler shift modulo 1 / T: range rates a span of lambda / (2 T)
apart look alike in phase. They differ in migration: within the interval of M slots one span moves a
target by M B / fc range cells (B the bandwidth, fc the carrier). So every rate that folds to the
measured one is tried on the channel itself. With the right one an echo stays in its range cell;
with another it is smeared over the cells between, and only part of it remains at that Doppler.
(Keystone and hypothesis tests: Perry, DiPietro and Fante, IEEE Trans. Aerosp. Electron. Syst. 35,
1999.)

Where the migration of a span is less than about a cell the rates cannot be told apart so; of an
array whose transmitters take turns, the phases across them may (`hardware.radar.angles`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar.refinement import Blocks
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

#: Log-likelihood ratio from which a rate is taken for certain: an error in a thousand.
CERTAIN = float(np.log(1e3))
_USUAL_M_PER_S = 10.0  # standard deviation of range rates before anything is measured
_MODEL = 0.1  # of the likeliest rate's level: what an echo of several points may add to a wrong one


@dataclass(frozen=True, eq=False)
class RateEvidence:
    """What speaks for each of the range rates that fold to the measured one.

    ``range_rate_m_per_s`` (n_rates,), nearest to standstill first. ``log_likelihood`` (n_rates,):
    of a point target in white noise, up to a constant. ``level`` (n_rates,): signal that remains
    within a few range cells at that Doppler, over noise, which is largest for the true rate of an
    extended target, too.
    """

    range_rate_m_per_s: Array
    log_likelihood: Array
    level: Array

    @property
    def rates_left_open(self) -> Array:
        """Range rates (n,) that the data cannot exclude, likeliest first: where the data hardly
        tell, that is the slowest.
        """
        rates, likelihood = self.range_rate_m_per_s, self.log_likelihood
        likeliest = np.argsort((rates / _USUAL_M_PER_S) ** 2 / 2 - likelihood, kind="stable")
        return np.asarray(rates[likeliest[self.possible[likeliest]]])

    @property
    def possible(self) -> NDArray[np.bool_]:
        """Rates (n_rates,) that the data cannot exclude against the likeliest."""
        unlikely = self.log_likelihood < self.log_likelihood.max() - CERTAIN
        # A smear of neighbours may look like a point; the level around it says otherwise.
        weak = self.level < (1 - _MODEL) * self.level.max()
        return np.asarray(~(unlikely & weak))


def folded_rates(
    waveform: OfdmWaveform, range_rate_m_per_s: float, fastest_m_per_s: float
) -> Array:
    """Range rates (n_rates,) that look alike in Doppler, nearest to standstill first.

    Those up to ``fastest_m_per_s`` either way; at least the nearest.
    """
    span = 2 * waveform.max_velocity_m_per_s
    nearest = range_rate_m_per_s - span * np.rint(range_rate_m_per_s / span)
    reach = int(np.ceil(fastest_m_per_s / span)) + 1
    rates = nearest + span * np.arange(-reach, reach + 1)
    rates = rates[(np.abs(rates) <= fastest_m_per_s) | (rates == nearest)]
    return np.asarray(rates[np.argsort(np.abs(rates), kind="stable")])


def rate_evidence(blocks: Blocks, rates_m_per_s: Array, noise_w: float) -> RateEvidence:
    """Weigh range rates by the migration that each would have made.

    Parameters
    ----------
    blocks
        The channel about the detection, see `blocks_about`, at one of the rates.
    rates_m_per_s : (n_rates,)
        Range rates a multiple of the Doppler ambiguity's span from the blocks' own.
    noise_w
        Mean noise power of a cell, of the blocks' window.
    """
    extra = 2 / C_M_PER_S * rates_m_per_s - blocks.delay_rate
    duration = 1 / (blocks.cell[1] * blocks.carrier_hz)
    between = np.abs(np.diff(np.sort(extra))).min(initial=np.inf)
    crossed = between * duration / blocks.cell[0] if len(extra) > 1 else 0.0
    reach = int(np.clip(np.ceil(crossed), 1, len(blocks.f_hz) // 8 + 1))
    # Half cells, so that a target between two cells loses little.
    steps = np.arange(-2 * reach, 2 * reach + 1) / 2
    across = np.exp(1j * np.outer(steps, blocks.turns[0]))
    powers = np.empty((len(extra), len(steps)))
    for i, more in enumerate(extra):
        # The carrier's own turn folds to none over whole slots; the band's is the migration.
        still = np.exp(2j * np.pi * np.outer(blocks.f_hz, blocks.t_s) * more)
        profiles = np.einsum("cft,ft->cf", blocks.sums, still) @ across.T
        powers[i] = np.sum(np.abs(profiles) ** 2, axis=0)
    floor = max(noise_w, np.finfo(float).tiny)
    level = np.maximum(powers.sum(axis=1) / floor - len(blocks.sums) * len(steps), 0.0)
    return RateEvidence(rates_m_per_s, powers.max(axis=1) / floor, level)
