"""Phases that differ from slot to slot beyond noise, seen on the strongest echo of a burst.

Oscillators turn all paths of a slot by the same phase, in every receiver. It spreads each echo over
all rates at its own delay, and transmitters that send by turns do not share it: it enters the
phases between them, by which directions are measured. Noise and other echoes change an echo's
amplitude as much as its phase, oscillators its phase alone: the difference is theirs. Slow changes,
which a target's own motion may make and which turns share, do not count.

The errors of rates and directions hold it. Peaks that it may be are no echoes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.burst import DemodulatedBurst
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.measurement import EchoMeasurement, cells_apart, standard_errors, with_noise
from hardware.radar.sensitivity import side_lobe
from hardware.radar.slot_scatter import white_variance
from hardware.radar.static_echoes import static_amplitudes, static_power, strongest_static
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NEAR_CELLS = 4.0  # of range, within which the window of `_over_the_echo` keeps echoes
_STRONG = 0.01  # of the strongest echo's power
_STEADY = 0.1  # variance of log amplitudes; of an echo 0.45 of another's amplitude it is as much


def phase_variance(
    echoes: Sequence[EchoMeasurement], burst: DemodulatedBurst, *, beside_static: bool = False
) -> float:
    """Variance in rad^2 of the phases of single slots, if white, beyond noise, as the first of the
    echoes, the strongest, shows them; 0 where what is seen may be noise. ``beside_static``: the
    echoes are what moves alone, beside what is static in the burst; where that is stronger, it
    shows the phases.

    Phases of more than half a radian spread enough of an echo that peaks of it pass for others at
    its delay, whose sum explains them. Such a sum changes amplitude as much as phase: where the
    amplitude is steady there is one echo alone, the strongest of the sum.
    """
    if not echoes:
        return 0.0
    if beside_static and (still := strongest_static(burst)).power_w > echoes[0].power_w:
        echoes, beside_static = [still, *echoes], False
    turn, *static = _over_the_echo(echoes[0], burst, beside_static=beside_static)
    parts = _of_echoes(turn, echoes, burst.waveform, static)
    fitted = parts.sum(axis=0)
    beside_sum = turn / np.where(fitted == 0, 1.0, fitted)
    of_sum = white_variance(beside_sum) if _is_steady(beside_sum) else 0.0
    if of_sum or not _is_steady(turn):
        return of_sum
    strongest = parts[np.argmax(np.sum(np.abs(parts) ** 2, axis=(1, 2)))]
    return white_variance(turn * strongest.conj())


def _is_steady(turn: Complex) -> bool:
    """Whether slots (n_rounds, n_turns) differ little in amplitude: else noise of a slot, or other
    echoes, turn phases more than they change logarithms of amplitudes.
    """
    size = np.maximum(np.abs(turn), np.finfo(float).tiny)
    return bool(np.log(size).var(axis=0).mean() < _STEADY)


def _of_echoes(
    turn: Complex, echoes: Sequence[EchoMeasurement], wave: OfdmWaveform, static: Sequence[Complex]
) -> Complex:
    """What the first echo, ``static`` and strong echoes at its delay make of slots (n_lines,
    n_rounds, n_turns), by least squares: a sum of echoes is turned as a whole.

    Peaks below a hundredth of the strongest may be its own spread, and leave few lines.
    """
    first, *others = echoes
    near = cells_apart([first], others, wave)[0, :, 0] < _NEAR_CELLS
    strongest = max([1.0, *(float(np.mean(np.abs(still) ** 2)) for still in static)])
    least_w = _STRONG * strongest * first.power_w
    strong = np.array([other.power_w > least_w for other in others], dtype=bool)
    rates = np.array([0.0, *(other.delay_rate - first.delay_rate for other in others)])
    rates = np.nan_to_num(rates[np.append(True, near & strong)])
    if 2 * (len(rates) + len(static)) > len(turn):
        rates = rates[:1]
    moving = np.exp(-2j * np.pi * wave.carrier_hz * np.multiply.outer(rates, wave.slot_times_s))
    own = [np.vstack([moving, *(still[:, i] for still in static)]) for i in range(turn.shape[1])]
    fitted = [
        np.linalg.lstsq(lines.T, slots, rcond=None)[0][:, None] * lines
        for lines, slots in zip(own, turn.T, strict=True)
    ]
    return np.stack(fitted, axis=-1)


def _over_the_echo(
    echo: EchoMeasurement, burst: DemodulatedBurst, *, beside_static: bool
) -> list[Complex]:
    """What an echo's delay and rate hold in each slot, of all receivers together, over the echo,
    (n_rounds, n_turns) in the order of time; ``beside_static``: and what is static there, past
    which a fast echo migrates. A window excludes echoes a few range cells away.
    """
    wave = burst.waveform
    delay_s, rate = np.nan_to_num([echo.delay_s, echo.delay_rate])
    f, t = wave.frequency_offsets_hz[:, None], wave.slot_times_s
    taper = normalised_window("blackmanharris", wave.n_subcarriers)[:, None]
    cycles = f * (delay_s + rate * t) + wave.carrier_hz * rate * t
    undone = (taper * np.exp(2j * np.pi * cycles)).astype(burst.channel.dtype)
    by_slot = [np.einsum("cfm,fm->cm", burst.channel, undone)]
    if beside_static:
        by_slot.append(np.einsum("cf,fm->cm", burst.channel.mean(axis=-1), undone))
    level = by_slot[0].mean(axis=1).conj()
    groups = [burst.tdm_offset_s == turn for turn in np.unique(burst.tdm_offset_s)]
    power = [max(float(np.vdot(level[own], level[own]).real), 1e-300) for own in groups]
    return [
        np.stack(
            [level[own] @ part[own] / of_one for own, of_one in zip(groups, power, strict=True)],
            axis=1,
        ).astype(np.complex128)
        for part in by_slot
    ]


def with_rate_error(
    echo: EchoMeasurement, burst: DemodulatedBurst, variance: float
) -> EchoMeasurement:
    """An echo whose rate's standard error holds the phases of slots, as if they were white."""
    if not variance or np.isnan(echo.delay_rate):
        return echo
    n_slots = burst.waveform.n_slots * len(np.unique(burst.tdm_offset_s))
    _, of_phases = standard_errors(burst.waveform, echo.window, n_slots / (2 * variance))
    return replace(echo, delay_rate_error=float(np.hypot(echo.delay_rate_error, of_phases)))


def with_phases_of_turns(
    noise: ChannelNoise, amplitude: Complex, burst: DemodulatedBurst, variance: float
) -> ChannelNoise:
    """Noise of an echo's amplitudes for directions: with the phase that each transmitter's slots
    have by themselves in the mean: those that remain, and those that the leakage told.

    Noise is taken as half in phase and half in amplitude: of what is in phase alone, twice counts.
    """
    apart = burst.tdm_offset_s[:, None] == burst.tdm_offset_s
    of_slots = variance + burst.removed_variance
    if not of_slots or apart.all():
        return noise
    of_mean = 2 * of_slots / burst.waveform.n_slots
    more = of_mean * apart * amplitude[:, None] * amplitude.conj()
    return replace(noise, covariance_w=noise.covariance_w + more)


def with_spread_of_others(
    echoes: Sequence[EchoMeasurement],
    burst: DemodulatedBurst,
    variance: float,
    *,
    beside_static: bool = False,
) -> list[EchoMeasurement]:
    """Echoes whose noise holds what phases of slots spread of stronger ones over the rates;
    ``beside_static``: of what is static as well.

    Receivers share it, transmitters do not. The noise measured around an echo holds a part of it,
    which then counts twice: without this term errors of power are 1.5 to 1.9 times too small, with
    it 1.0 to 1.3 times.
    """
    if not variance or not echoes:
        return list(echoes)
    same_turn = burst.tdm_offset_s[:, None] == burst.tdm_offset_s
    delay_s, power_w = _delays_and_powers(echoes)
    share = _spread(delay_s, echoes, burst, variance) * (power_w > power_w[:, None])
    spreading = np.array([echo.amplitude for echo in echoes])
    if beside_static:
        spreading = np.vstack([spreading, static_amplitudes(burst, delay_s)])
        of_static = np.eye(len(echoes)) * _at_any_rate(burst, variance)
        share = np.hstack([share, of_static])
    return [
        with_noise(echo, replace(echo.noise, covariance_w=echo.noise.covariance_w + more))
        for echo, more in zip(
            echoes,
            same_turn * np.einsum("ej,jc,jd->ecd", share, spreading, spreading.conj()),
            strict=True,
        )
    ]


def most_of_spread(
    echoes: Sequence[EchoMeasurement],
    burst: DemodulatedBurst,
    variance: float,
    false_alarm: float,
    beside_static: bool,
    delay_s: Array,
) -> Array:
    """Mean power (n,) that what phases of slots spread of all echoes to other rates at delays (n,)
    exceeds with the probability ``false_alarm``; ``beside_static``: of what is static as well.
    """
    _, power_w = _delays_and_powers(echoes)
    spread_w = _spread(delay_s, echoes, burst, variance) @ power_w
    if beside_static:
        spread_w += _at_any_rate(burst, variance) * static_power(burst, delay_s)
    return np.asarray(_highest(burst, false_alarm) * spread_w)


def _at_any_rate(burst: DemodulatedBurst, variance: float) -> float:
    """Power that phases of slots spread of an echo to any other rate, over its own."""
    return float(np.expm1(variance)) / burst.waveform.n_slots


def _spread(
    delay_s: Array, echoes: Sequence[EchoMeasurement], burst: DemodulatedBurst, variance: float
) -> Array:
    """Power that phases of slots spread from echoes to delays (n,), at most, over that of the
    echo spread, (n, n_echoes).
    """
    wave = burst.waveform
    cells = np.nan_to_num(delay_s[:, None] - _delays_and_powers(echoes)[0]) / wave.delay_cell_s
    apart = np.abs(cells - wave.n_subcarriers * np.rint(cells / wave.n_subcarriers))
    return np.asarray(_at_any_rate(burst, variance) * side_lobe(apart, wave.n_subcarriers))


def _delays_and_powers(echoes: Sequence[EchoMeasurement]) -> tuple[Array, Array]:
    """Of echoes, (n_echoes,) each."""
    both = np.array([(echo.delay_s, echo.power_w) for echo in echoes]).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _highest(burst: DemodulatedBurst, chance: float) -> float:
    """Power of what phases of slots spread to a cell, over its mean, that it exceeds with this
    probability: channels of one transmitter share it.
    """
    from scipy.special import gammainccinv

    looks = len(np.unique(burst.tdm_offset_s))
    return float(gammainccinv(looks, chance)) / looks


def without_spread(
    echoes: Sequence[EchoMeasurement],
    burst: DemodulatedBurst,
    variance: float,
    false_alarm: float,
    *,
    beside_static: bool = False,
) -> list[EchoMeasurement]:
    """Echoes without those that stronger ones may be, spread over the rates by phases of slots;
    ``beside_static``: or what is static.

    ``echoes``: the strongest first. ``false_alarm``: probability that one is kept.
    """
    if not variance or not echoes:
        return list(echoes)
    delay_s, power_w = _delays_and_powers(echoes)
    spread_w = np.tril(_spread(delay_s, echoes, burst, variance), -1) @ power_w
    if beside_static:
        spread_w += _at_any_rate(burst, variance) * static_power(burst, delay_s)
    least_w = _highest(burst, false_alarm) * spread_w
    return [echo for echo, least in zip(echoes, least_w, strict=True) if echo.power_w > least]


def beyond_phases(
    echoes: Sequence[EchoMeasurement],
    burst: DemodulatedBurst,
    false_alarm: float,
    *,
    beside_static: bool = False,
) -> tuple[list[EchoMeasurement], float]:
    """Echoes that phases of slots do not make, and the variance of these phases, in rad^2: measured
    anew beside the echoes that are left, until it makes none of them.
    """
    left, variance = list(echoes), 0.0
    while left:
        seen = phase_variance(left, burst, beside_static=beside_static)
        if seen <= variance:
            break
        variance, before = seen, len(left)
        left = without_spread(left, burst, variance, false_alarm, beside_static=beside_static)
        if len(left) == before:
            break
    return left, variance
