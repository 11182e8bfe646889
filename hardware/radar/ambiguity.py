"""Range rates beyond the Doppler ambiguity, told apart by the target's walk through range cells.

Slots a period T apart know the Doppler shift modulo 1 / T: range rates a span of lambda / (2 T)
apart look alike in phase. They differ in migration: within the interval of M slots one span moves a
target by M B / fc range cells (B the bandwidth, fc the carrier). So every rate that folds to the
measured one is tried on the channel itself. With the right one an echo stands in one cell; with
another it is smeared over as many cells of range and of rate as the two differ in migration, and a
detection stands on a fragment of it. So each rate is tried over all cells to which its echo may
have been smeared. (Keystone and hypothesis tests: Perry, DiPietro and Fante, IEEE Trans. Aerosp.
Electron. Syst. 35, 1999.)

A strong echo is smeared by a wrong rate, too, over the weak ones beside it: echoes are taken in the
order of their strength, and each is taken away before the next is weighed.

Two bodies a whole span apart share a cell of the map. Taken with its own rate, the stronger one
leaves the other to be seen with its own.

Where the migration of a span is less than about a cell the rates cannot be told apart so; of an
array with time-division multiplexing, the phases across them may (`hardware.radar.angles`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.detection import Detection, Measured, distinct, measurement
from hardware.radar.refinement import (
    Blocks,
    amplitudes,
    blocks_about,
    highest,
    left_over,
    unit_echoes,
    within_blocks,
)
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

#: Log-likelihood ratio from which a rate is taken for certain: an error in a thousand.
CERTAIN = float(np.log(1e3))
_USUAL_M_PER_S = 10.0  # standard deviation of range rates before anything is measured
_MODEL = 0.1  # of the likeliest rate's level: what an echo of several points may add to a wrong one
_FARTHEST = 9  # cells to each side that are searched: a quarter of the blocks' own reach
_COARSE = 32  # blocks along each axis of the search; a target at its edge loses 1.2 dB
_SEARCHED = (2 * _FARTHEST + 1) ** 2  # cells
_LEFT = 1.3  # see `_more_than_its_smear`
_WEAKEST = 0.05  # of the power of a body, for another in the same cell of the map to be looked for
_TOLD_APART = 1.5  # cells that a span must move a target by for two bodies to be told apart
_FELT = 0.1  # of a cell's noise: what others leave at an echo and need not be taken away


@dataclass(frozen=True, eq=False)
class RateEvidence:
    """What speaks for each of the range rates that fold to the measured one.

    ``range_rate_m_per_s`` (n_rates,). ``log_likelihood`` (n_rates,): of a point target in white
    noise anywhere in the cells that were searched, up to a constant. ``level`` (n_rates,): signal
    over noise that stands in the best row of one rate, which is largest for the true rate of an
    extended target, too. ``step`` (n_rates, 2): cells of delay and rate to the highest power.
    """

    range_rate_m_per_s: Array
    log_likelihood: Array
    level: Array
    step: Array

    @property
    def left_open(self) -> NDArray[np.intp]:
        """Rates (n,) by number that the data cannot exclude, likeliest first: where the data hardly
        tell, that is the slowest.
        """
        rates, likelihood = self.range_rate_m_per_s, self.log_likelihood
        likeliest = np.argsort((rates / _USUAL_M_PER_S) ** 2 / 2 - likelihood, kind="stable")
        return np.asarray(likeliest[self.possible[likeliest]])

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
        The channel about the detection without a window, see `blocks_about`, at one of the rates.
    rates_m_per_s : (n_rates,)
        Range rates a multiple of the Doppler ambiguity's span from the blocks' own.
    noise_w
        Mean noise power of a cell.
    """
    sums, f_hz, t_s = blocks.sums, blocks.grid.f_hz, blocks.grid.t_s
    extra = 2 / C_M_PER_S * rates_m_per_s - blocks.delay_rate
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
    # The carrier's own turn folds to none over whole slots; the band's is the migration.
    still = near * blocks.grid.migration(extra).astype(single)[:, None]
    cells = across @ still @ along  # by rate that is tried, channel, delay and rate
    power = np.asarray(np.sum(cells.real**2 + cells.imag**2, axis=1, dtype=np.float64))
    flat = power.reshape(len(power), -1)
    # What stronger echoes leave over all these cells is no echo.
    middle = flat.shape[1] // 2
    least = max(noise_w, np.finfo(float).tiny)
    noise = np.maximum(np.partition(flat, middle, axis=1)[:, middle] / len(sums), least)[:, None]
    at = flat.argmax(axis=1)
    highest_w = flat.max(axis=1, keepdims=True)
    spread = np.log(np.sum(np.exp((flat - highest_w) / noise), axis=1))
    rows = np.maximum(power / noise[..., None] - len(sums), 0).sum(axis=1)
    step = steps[np.stack(np.divmod(at, len(steps)), axis=-1)]
    return RateEvidence(rates_m_per_s, (highest_w / noise)[:, 0] + spread, rows.max(axis=1), step)


def unfolded(
    channel: Complex,
    waveform: OfdmWaveform,
    found: Sequence[Measured],
    noise_w: float,
    fastest_m_per_s: float,
) -> list[Measured]:
    """Detections with the likeliest of the range rates that fold to theirs, strongest first; other
    rates that the channel leaves open stand with them as alternatives.

    Parameters
    ----------
    channel, waveform, found
        As `detected` took and gave them.
    noise_w
        Mean noise power of a cell without a window.
    fastest_m_per_s
        Up to which targets may approach or recede.
    """
    from scipy.special import gammainccinv

    one_rate = len(folded_rates(waveform, 0.0, fastest_m_per_s)) == 1
    if waveform.n_slots == 1 or one_rate or not found:
        return list(found)
    range_m = np.array([one.range_m for one, _ in found])
    rate_m_per_s = np.array([one.range_rate_m_per_s for one, _ in found])
    about = blocks_about(channel, waveform, "boxcar", range_m, rate_m_per_s, _COARSE)
    looks = len(found[0][1])
    least_w = noise_w * float(gammainccinv(looks, np.exp(-CERTAIN) / _SEARCHED)) / looks
    kept: list[Measured] = []
    moved: list[Measured] = []
    for one, blocks in zip(found, about, strict=True):
        if moved and _explained(blocks, one, moved):
            continue  # a fragment of what stands elsewhere with its own rate
        free = _without(blocks, kept, noise_w)
        solved, evidence = _solved(channel, waveform, one, free, kept, noise_w, fastest_m_per_s)
        if _other_fold(solved[0].range_rate_m_per_s, one[0], waveform):
            if solved[0].power_w < least_w:
                continue  # no echo, but what is left of those before it
            moved.append(solved)
        if _more_than_its_smear(evidence, waveform):
            beneath = _beneath(
                channel, waveform, one, solved, blocks, kept, noise_w=noise_w, evidence=evidence
            )
            if beneath and beneath[0].power_w >= least_w:
                moved.append(beneath)
                kept.append(beneath)
                free = _without(blocks, kept, noise_w)
                solved, _ = _solved(channel, waveform, one, free, kept, noise_w, fastest_m_per_s)
        kept.append(solved)
    return distinct(kept, waveform, folded=False)


def _solved(
    channel: Complex,
    waveform: OfdmWaveform,
    one: Measured,
    blocks: Blocks,
    others: Sequence[Measured],
    noise_w: float,
    fastest_m_per_s: float,
) -> tuple[Measured, RateEvidence]:
    """A detection with its likeliest range rate, measured again where that is another, and what
    speaks for each rate; ``blocks`` about it are free of the ``others``.
    """
    rates = folded_rates(waveform, one[0].range_rate_m_per_s, fastest_m_per_s)
    evidence = rate_evidence(blocks, rates, noise_w)
    best, *rest = evidence.left_open
    detection, amplitude = one
    if _other_fold(float(rates[best]), detection, waveform):
        detection, amplitude = _measured_at(
            channel, waveform, one[0], evidence, int(best), others, noise_w
        )
    alternatives = detection.range_rate_m_per_s + (rates[rest] - rates[best])
    told = tuple(float(rate) for rate in alternatives)
    return (replace(detection, range_rate_alternatives_m_per_s=told), amplitude), evidence


def _measured_at(
    channel: Complex,
    waveform: OfdmWaveform,
    detection: Detection,
    evidence: RateEvidence,
    number: int,
    others: Sequence[Measured],
    noise_w: float,
) -> Measured:
    """The echo that stands near a detection with one of the rates, by its number."""
    delays, rates = evidence.step[number] * [waveform.range_cell_m, waveform.velocity_cell_m_per_s]
    (blocks,) = blocks_about(
        channel,
        waveform,
        "boxcar",
        np.array([detection.range_m + delays]),
        np.array([evidence.range_rate_m_per_s[number] + rates]),
    )
    blocks = _without(blocks, others, noise_w)
    (step,) = highest([blocks])
    return measurement(
        blocks,
        step,
        amplitudes(blocks, step),
        waveform,
        noise_w,
        "boxcar",
        left_over(blocks, step),
    )


def _more_than_its_smear(evidence: RateEvidence, waveform: OfdmWaveform) -> bool:
    """Whether another rate has more than a wrong rate leaves of the likeliest one's echo: of its
    power in one cell 1.3 over the square of the cells that the wrong rate smears it over.
    """
    span = 2 * waveform.max_velocity_m_per_s
    crossed = span * waveform.n_slots * waveform.slot_period_s / waveform.range_cell_m
    likelihood = np.sort(evidence.log_likelihood)
    left = max(_LEFT / crossed**2, _WEAKEST)
    return bool(crossed > _TOLD_APART and likelihood[-2] > left * likelihood[-1])


def _beneath(
    channel: Complex,
    waveform: OfdmWaveform,
    one: Measured,
    solved: Measured,
    blocks: Blocks,
    others: Sequence[Measured],
    *,
    noise_w: float,
    evidence: RateEvidence,
) -> Measured | None:
    """A second body with another of the rates that fold to a detection's, in the same cell of the
    map: what is left without the first, if the first one's own rate does not explain it.
    """
    rates = evidence.range_rate_m_per_s
    others = [*others, solved]
    left = rate_evidence(_without(blocks, others, noise_w), rates, noise_w)
    own = int(np.argmin(np.abs(rates - solved[0].range_rate_m_per_s)))
    best = int(left.left_open[0])
    if best == own or left.possible[own]:
        return None
    found = _measured_at(channel, waveform, one[0], left, best, others, noise_w)
    return found if _other_fold(found[0].range_rate_m_per_s, solved[0], waveform) else None


def _other_fold(rate_m_per_s: float, detection: Detection, waveform: OfdmWaveform) -> bool:
    """Whether a rate is another than a detection's by at least half a span."""
    return abs(rate_m_per_s - detection.range_rate_m_per_s) > waveform.max_velocity_m_per_s


def _without(blocks: Blocks, others: Sequence[Measured], noise_w: float) -> Blocks:
    """Blocks less what other echoes leave in them."""
    if not others:
        return blocks
    steps = np.array([_steps(one, blocks) for one, _ in others])
    along_f, along_t = within_blocks(blocks, steps)
    amplitude = np.array([amplitude for _, amplitude in others])
    most = np.abs(along_f).sum(axis=1) * np.abs(along_t).sum(axis=1)
    felt = np.mean(np.abs(amplitude) ** 2, axis=1) * most**2 > _FELT * noise_w
    echoes = unit_echoes(blocks, steps[felt])
    return replace(blocks, sums=blocks.sums - np.tensordot(amplitude[felt].T, echoes, 1))


def _explained(blocks: Blocks, one: Measured, moved: Sequence[Measured]) -> bool:
    """Whether most of an echo is gone once echoes that moved elsewhere are taken away."""
    left = amplitudes(_without(blocks, moved, 0.0), np.array(_steps(one[0], blocks)))
    return bool(np.mean(np.abs(left) ** 2) < 0.25 * one[0].power_w)


def _steps(one: Detection, blocks: Blocks) -> tuple[float, float]:
    """Cells of delay and rate from the middle of blocks to an echo."""
    delay = 2 / C_M_PER_S * one.range_m - blocks.delay_s
    rate = 2 / C_M_PER_S * one.range_rate_m_per_s - blocks.delay_rate
    return delay / blocks.grid.cell[0], rate / blocks.grid.cell[1]
