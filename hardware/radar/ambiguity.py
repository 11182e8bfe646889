"""Doppler ambiguity of delay rates, resolved by the migration of the target's delay.

Slots with the period T determine the Doppler shift modulo 1 / T: delay rates that differ by the
unambiguous span 1 / (fc T) have the same phase. They differ in migration: within the interval
of M slots one span moves a target by M B / fc range cells (B the bandwidth, fc the carrier). So
every rate that folds to the measured one is tested as a hypothesis on the channel itself. With the
true rate the echo is focused in one cell. With another rate it is smeared over as many cells of
delay and rate as the two differ in migration, and a detection is one fragment of the smear. So each
rate is tested over all cells over which its echo may be smeared. (Keystone and hypothesis tests:
Perry, DiPietro and Fante, IEEE Trans. Aerosp. Electron. Syst. 35, 1999.)

What is found so with another rate must be the echo that was detected: its smear has about that
power there. Else it is what a stronger body of many parts leaves beside a weak echo.

With a wrong rate a strong echo is also smeared over weak ones beside it. So echoes are processed in
the order of their power, and each is subtracted before the next is tested.

Two bodies whose rates differ by a whole span share a cell of the map. Once the stronger one is
subtracted with its own rate, the other one is detected with its own.

Where one span migrates by less than about a cell, this cannot resolve the ambiguity; the phases
across an array with time-division multiplexing may (`hardware.radar.angles`).

Where a rate would move a target through more range cells than there are blocks, the blocks smear
its echo, and it cannot be tested: `fastest_resolved`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.demodulation import Complex
from hardware.radar.measurement import EchoMeasurement, echo_measurement, without_duplicates
from hardware.radar.rate_evidence import (
    CERTAIN,
    SEARCHED,
    RateEvidence,
    ambiguous_rates,
    fastest_resolved,
    rate_evidence,
)
from hardware.radar.refinement import (
    Blocks,
    block_responses,
    blocks_about,
    echo_amplitudes,
    peak_offsets,
    unit_echoes,
)
from hardware.radar.residue import residual_cells
from hardware.radar.within_symbols import leakage_of
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_COARSE = 32  # blocks along each axis of the search; a target at its edge loses 1.2 dB
_SMEAR_FACTOR = 1.3  # see `_may_hide_another`
_WEAKEST = 0.05  # of the power of a body: the weakest second body searched in the same cell
_OF_FRAGMENT = 10.0  # either way: power of an echo's smear over that of the detection it explains
_ERRORS = 4.0  # standard errors of a rate, by which it may be measured beyond the fastest
_OF_REST = 10.0  # power of what is taken for another echo over that of a stronger one's side lobe
_LEAST_MIGRATION = 1.5  # cells of migration per span needed to separate two bodies of one cell
_NEGLIGIBLE = 0.1  # of a cell's noise: contributions of other echoes that need no subtraction


def resolve_delay_rates(
    channel: Complex,
    waveform: OfdmWaveform,
    echoes: Sequence[EchoMeasurement],
    noise_w: float,
    fastest: float,
) -> list[EchoMeasurement]:
    """Echoes with the likeliest of the delay rates that fold to theirs, strongest first; other
    rates that the channel leaves open stand with them as alternatives.

    Parameters
    ----------
    channel, waveform, echoes
        Input and result of `detect_echoes`.
    noise_w
        Mean noise power of a cell without a window.
    fastest
        Largest delay rate, in s/s, of approaching or receding targets; see `fastest_resolved`.
    """
    from scipy.special import gammainccinv

    if waveform.n_slots == 1:  # no rate is measured
        return list(echoes)
    several = [len(possible_rates(echo, waveform, fastest)) > 1 for echo in echoes]
    if not any(several):
        return [_folded(echo, waveform) for echo in echoes]
    delay_s = np.array([echo.delay_s for echo in echoes])
    delay_rate = np.array([echo.delay_rate for echo in echoes])
    about = blocks_about(channel, waveform, "boxcar", delay_s, delay_rate, _COARSE)
    looks = len(echoes[0].amplitude)
    least_w = noise_w * float(gammainccinv(looks, np.exp(-CERTAIN) / SEARCHED)) / looks
    resolved: list[EchoMeasurement] = []
    unfolded: list[EchoMeasurement] = []  # at another rate than the one that was measured
    for echo, blocks, has_several in zip(echoes, about, several, strict=True):
        if unfolded and _is_explained(blocks, echo, unfolded):
            continue  # a fragment of an echo that is focused elsewhere with its own rate
        if not has_several:
            resolved.append(_folded(echo, waveform))
            continue
        remainder = _subtract_echoes(blocks, resolved, noise_w)
        likeliest, evidence = _with_likeliest_of(
            channel, waveform, echo, remainder, resolved, noise_w, fastest
        )
        if _is_other_fold(likeliest.delay_rate, echo, waveform):
            if likeliest.power_w < least_w:
                continue  # not an echo but a remainder of the preceding ones
            unfolded.append(likeliest)
        if _may_hide_another(evidence, waveform):
            second = _second_body(
                channel,
                waveform,
                echo,
                likeliest,
                blocks,
                resolved,
                noise_w=noise_w,
                evidence=evidence,
            )
            if second and second.power_w >= least_w:
                unfolded.append(second)
                resolved.append(second)
                remainder = _subtract_echoes(blocks, resolved, noise_w)
                likeliest, _ = _with_likeliest_of(
                    channel, waveform, echo, remainder, resolved, noise_w, fastest
                )
        resolved.append(likeliest)
    return without_duplicates(resolved, waveform, folded=False)


def possible_rates(echo: EchoMeasurement, waveform: OfdmWaveform, fastest: float) -> Array:
    """`ambiguous_rates` of an echo, up to `fastest_resolved`: one as fast as that may be measured
    beyond it, by its error; and where another one is measured, by what Doppler shifts of that
    difference spread over the band, as the echo's peak may be at either of its ends.
    """
    fastest = fastest_resolved(waveform, fastest)
    beyond = float(np.fmin(_ERRORS * echo.delay_rate_error, waveform.delay_rate_cell))
    spread = waveform.bandwidth_hz / waveform.carrier_hz / 2
    reach = fastest + beyond + spread * (fastest + abs(echo.delay_rate)) / (1 - spread)
    rates = ambiguous_rates(waveform, echo.delay_rate, reach)
    off = spread * np.abs(rates - echo.delay_rate)
    return rates[(np.abs(rates) <= fastest + beyond + off) | (np.arange(len(rates)) == 0)]


def _folded(echo: EchoMeasurement, waveform: OfdmWaveform) -> EchoMeasurement:
    """An echo with the slowest of the rates of its Doppler shift: near the edge of the ambiguity it
    may have been measured beyond it.
    """
    slowest, *_ = ambiguous_rates(waveform, echo.delay_rate, 0.0)
    return replace(echo, delay_rate=float(slowest))


def _with_likeliest_of(
    channel: Complex,
    waveform: OfdmWaveform,
    echo: EchoMeasurement,
    blocks: Blocks,
    others: Sequence[EchoMeasurement],
    noise_w: float,
    fastest: float,
) -> tuple[EchoMeasurement, RateEvidence]:
    """`with_likeliest_rate` of an echo measured by itself; the ``others`` are already subtracted
    from ``blocks``.
    """
    rates = possible_rates(echo, waveform, fastest)
    evidence = rate_evidence(blocks, rates, noise_w)

    def measured(number: int) -> EchoMeasurement:
        return _measure_at(channel, waveform, echo, evidence, number, others, noise_w)

    return with_likeliest_rate(echo, evidence, others, channel, waveform, measured), evidence


def with_likeliest_rate(
    echo: EchoMeasurement,
    evidence: RateEvidence,
    others: Sequence[EchoMeasurement],
    channel: Complex,
    waveform: OfdmWaveform,
    measured: Callable[[int], EchoMeasurement],
) -> EchoMeasurement:
    """An echo with the likeliest of the rates of ``evidence``; others that it leaves open are its
    alternatives. ``measured``: the echo at another of these, by its index.
    """
    rates = evidence.delay_rate
    best, *rest = evidence.candidates.tolist()
    if _is_other_fold(float(rates[best]), echo, waveform):
        found = measured(best)
        if _is_left_by(found, others, waveform) and not _explains(found, echo, channel, waveform):
            own = int(np.argmin(np.abs(rates - echo.delay_rate)))
            best, rest = own, [best, *(number for number in rest if number != own)]
        else:
            echo = found
    alternatives = echo.delay_rate + (rates[rest] - rates[best])
    return replace(echo, delay_rate_alternatives=tuple(alternatives.tolist()))


def _measure_at(
    channel: Complex,
    waveform: OfdmWaveform,
    echo: EchoMeasurement,
    evidence: RateEvidence,
    number: int,
    others: Sequence[EchoMeasurement],
    noise_w: float,
) -> EchoMeasurement:
    """The echo near another one with one of the rates, given by its index."""
    cells_of_delay, cells_of_rate = evidence.step[number]
    (blocks,) = blocks_about(
        channel,
        waveform,
        "boxcar",
        np.array([echo.delay_s + cells_of_delay * waveform.delay_cell_s]),
        np.array([evidence.delay_rate[number] + cells_of_rate * waveform.delay_rate_cell]),
    )
    blocks = _subtract_echoes(blocks, others, noise_w)
    (step,) = peak_offsets([blocks])
    around = residual_cells(blocks, step, leakage=leakage_of(blocks, step, waveform, noise_w))
    return echo_measurement(
        blocks,
        step,
        echo_amplitudes(blocks, step),
        waveform,
        noise_w,
        "boxcar",
        ChannelNoise.of_cells(around, noise_w),
    )


def _may_hide_another(evidence: RateEvidence, waveform: OfdmWaveform) -> bool:
    """Whether another rate has more power than the smear of the likeliest one's echo explains: in
    one cell 1.3 of the echo's power over the square of the number of cells of the smear.
    """
    span = 2 * waveform.max_delay_rate
    crossed = span * waveform.n_slots * waveform.slot_period_s / waveform.delay_cell_s
    likelihood = np.sort(evidence.log_likelihood)
    left = max(_SMEAR_FACTOR / crossed**2, _WEAKEST)
    return bool(crossed > _LEAST_MIGRATION and likelihood[-2] > left * likelihood[-1])


def _second_body(
    channel: Complex,
    waveform: OfdmWaveform,
    echo: EchoMeasurement,
    likeliest: EchoMeasurement,
    blocks: Blocks,
    others: Sequence[EchoMeasurement],
    *,
    noise_w: float,
    evidence: RateEvidence,
) -> EchoMeasurement | None:
    """A second body in the same cell of the map, whose rate differs by whole spans: the strongest
    echo after subtraction of the first, unless the rate of the first explains it.
    """
    rates = evidence.delay_rate
    both = [*others, likeliest]
    left = rate_evidence(_subtract_echoes(blocks, both, noise_w), rates, noise_w)
    own = int(np.argmin(np.abs(rates - likeliest.delay_rate)))
    best = int(left.candidates[0])
    if best == own or left.possible[own]:
        return None
    second = _measure_at(channel, waveform, echo, left, best, both, noise_w)
    weakest = 1.0 if _is_left_by(second, others, waveform) else _WEAKEST
    is_other = _is_other_fold(second.delay_rate, likeliest, waveform)
    return second if is_other and _explains(second, echo, channel, waveform, weakest) else None


def _is_left_by(
    found: EchoMeasurement, others: Sequence[EchoMeasurement], waveform: OfdmWaveform
) -> bool:
    """Whether echoes of other folds may leave so much: of bodies of many parts not all is
    subtracted, and without a window the rest has side lobes beyond its smear.
    """
    duration_s = waveform.n_slots * waveform.slot_period_s
    for other in others:
        apart = abs(other.delay_rate - found.delay_rate)
        beside_s = abs(other.delay_s - found.delay_s) - apart * duration_s / 2
        lobe = 1 / max(np.pi * beside_s / waveform.delay_cell_s, 1.0) ** 2
        if apart > waveform.max_delay_rate and other.power_w * lobe > found.power_w / _OF_REST:
            return True
    return False


def _explains(
    found: EchoMeasurement,
    echo: EchoMeasurement,
    channel: Complex,
    waveform: OfdmWaveform,
    weakest: float = 1.0,
) -> bool:
    """Whether the smear of an echo ``found`` at another rate has about the power of the detected
    ``echo`` there, or down to ``weakest`` of it.
    """
    at = np.array([echo.delay_s]), np.array([echo.delay_rate])
    (blocks,) = blocks_about(channel, waveform, echo.window, *at)
    smear = unit_echoes(blocks, np.array([_steps(found, blocks)])).sum()
    share = abs(smear) ** 2 * found.power_w / echo.power_w
    return bool(weakest / _OF_FRAGMENT <= share <= _OF_FRAGMENT)


def _is_other_fold(delay_rate: float, echo: EchoMeasurement, waveform: OfdmWaveform) -> bool:
    """Whether a rate differs from an echo's by more than half a span."""
    return abs(delay_rate - echo.delay_rate) > waveform.max_delay_rate


def _subtract_echoes(blocks: Blocks, others: Sequence[EchoMeasurement], noise_w: float) -> Blocks:
    """Blocks after subtraction of other echoes."""
    if not others:
        return blocks
    steps = np.array([_steps(other, blocks) for other in others])
    along_f, along_t = block_responses(blocks, steps)
    amplitude = np.array([other.amplitude for other in others])
    most = np.abs(along_f).sum(axis=1) * np.abs(along_t).sum(axis=1)
    felt = np.mean(np.abs(amplitude) ** 2, axis=1) * most**2 > _NEGLIGIBLE * noise_w
    echoes = unit_echoes(blocks, steps[felt])
    return replace(blocks, sums=blocks.sums - np.tensordot(amplitude[felt].T, echoes, 1))


def _is_explained(blocks: Blocks, echo: EchoMeasurement, others: Sequence[EchoMeasurement]) -> bool:
    """Whether most of an echo disappears when others are subtracted.

    Compared with what the blocks hold of it: measured with a window, a smeared echo has more power.
    """
    step = np.array(_steps(echo, blocks))
    whole, left = (
        np.mean(np.abs(echo_amplitudes(some, step)) ** 2)
        for some in (blocks, _subtract_echoes(blocks, others, 0.0))
    )
    return bool(left < 0.25 * whole)


def _steps(echo: EchoMeasurement, blocks: Blocks) -> tuple[float, float]:
    """Cells of delay and rate from the middle of blocks to an echo."""
    delay_s, delay_rate = echo.delay_s - blocks.delay_s, echo.delay_rate - blocks.delay_rate
    return delay_s / blocks.grid.cell[0], delay_rate / blocks.grid.cell[1]
