"""Phase noise of the leakage: estimated on the leakage itself and subtracted in every receiver.

The leakage from transmitter to receiver is a strong path of known delay, on which the oscillator's
phase noise is measured slot by slot and sample by sample. Relative to the leakage's waveform l(t) a
receiver's signal is 1 + j d(t) + echoes: the phase noise d is real and the same for all receivers
of one slot. Its Fourier transform over samples and slots has the symmetry
N(-k, -v) = -conj N(k, v) (k: range cells from the leakage, v: cells of rate), which neither an echo
nor thermal noise has. Half the difference of a cell and its mirror image contains the phase noise,
half the sum is free of it.

An echo is in both halves, and subtracting one half would leave half of the echo and its mirror
image about the leakage. So where the half without phase noise exceeds thermal noise, the powers of
the cell and its mirror image decide which of them has the echo, and the phase noise is estimated
from the other one, with its thermal noise; the remaining noise is returned with the result.

The phase noise has the leakage's ratios between the receivers. Combinations of receivers in which
the leakage cancels are free of it: they show echoes that phase noise hides in the leakage's own
combination. If those were not kept, a part of them would go in that combination alone, which bends
their directions away from the one that the leakage seems to come from.

A static echo below the phase noise in its own cell cannot be distinguished from its mirror image:
half of its amplitude remains on either side.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.slot_scatter import scatter_more, white_variance
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]
Power = NDArray[np.floating]

_RARE = 1e-9  # probability per cell that thermal noise alone counts as an echo
_BEYOND = 8.0  # times the expected power, above which a cell contains an echo
_LOW = 0.16  # quantile used to estimate the spread of noise
_MANY = 9  # cells above which the sum of noise is far from exponential
_MANY_SAMPLES = 2**18  # enough to decide whether there is leakage
_SMOOTHED = 33  # range cells over which the noise level changes little
_FAINT = 0.3  # of thermal noise: side lobes below it need no care on the mirrored side
# Rates and ranges that are averaged: an echo's cell, its side lobes along either axis.
_POOLED = ((1, 1), (1, 33), (9, 1))


def leakage_snr(steps: Sequence[Complex], waveform: OfdmWaveform, delay_s: float) -> float:
    """Energy of the path at ``delay_s`` in a slot over that of the noise, sum over receivers.

    ``steps``: samples (n_slots, n_receivers, n_subcarriers) of every carrier step. The noise is
    the median over delays. With several steps, which a retune may delay, the highest delay counts.
    """
    n = waveform.n_subcarriers
    ahead = np.exp(2j * np.pi * waveform.frequency_offsets_hz * delay_s)
    undone = np.fft.ifftshift(
        waveform.sent().conj() * ahead * normalised_window("blackmanharris", n)
    )
    snr = []
    for step in steps:
        some = step[:: max(1, step.size // _MANY_SAMPLES)]
        by_delay = np.fft.ifft(np.fft.fft(some) * undone.astype(step.dtype))
        energy: Array = np.asarray(np.mean(np.abs(by_delay) ** 2, axis=(0, 1)), dtype=np.float64)
        leakage = energy.max() if len(steps) > 1 else energy[0]
        snr.append(step.shape[1] * (leakage / max(float(np.median(energy)), 1e-300) - 1))
    return float(np.mean(snr))


def with_steady_phase(
    samples: Complex, waveform: OfdmWaveform, delay_s: float, schedule: NDArray[np.intp]
) -> tuple[Complex, float]:
    """Samples (n_slots, n_receivers, n_subcarriers) of a schedule's slots (n_transmitters,
    n_rounds) after removal of each slot's common phase, and of its slope within the slot, each
    where it is more than noise and echoes make of it; and the variance in rad^2 of the phases
    removed, if white, by which transmitters still differ in the mean of their slots.

    Separate oscillators of transmitter and receiver rotate all paths of a slot by the same phase.
    It is measured on the path at ``delay_s``, with a relative error of one over the root of its
    SNR. Noise and moving echoes change the path's amplitude as much as its phase, oscillators its
    phase alone: where the phases of slots scatter no more than the amplitudes, there is nothing to
    remove. A window excludes echoes a few range cells away from the phase. The part that all slots
    of a transmitter have in common is not removed: the phase of its own leakage is unknown.
    """
    n, samples = waveform.n_subcarriers, samples[: schedule.size]
    if schedule.shape[1] == 1:  # against no other slot
        return samples, 0.0
    path = (
        _leak(waveform, delay_s, normalised_window("blackmanharris", n))
        .conj()
        .astype(samples.dtype)
    )
    share = np.einsum("mrt,t->mr", samples, path)
    level = np.empty_like(share)
    for slots in schedule:
        level[slots] = share[slots].mean(axis=0).conj()
    level /= np.maximum(np.sum(np.abs(level) ** 2, axis=1, keepdims=True), 1e-300)
    turn = np.sum(share * level, axis=1)
    if not np.all(turn):
        return samples, 0.0
    size = np.abs(turn)
    is_turned = _scatters_more(np.angle(turn), size)
    in_time = schedule[np.argsort(schedule[:, 0])].T
    removed = white_variance(turn[in_time].astype(np.complex128)) if is_turned else 0.0
    turn = turn.conj() / size if is_turned else np.ones_like(turn)
    path = _leak(waveform, delay_s, np.ones(n)).conj().astype(samples.dtype)
    path *= turn.dtype.type(n)
    relative = np.einsum("mrt,mr->mt", samples, level.astype(samples.dtype)) * path * turn[:, None]
    time = np.linspace(-0.5, 0.5, n)
    slope, of_amplitude = _slopes(relative - relative.mean(axis=0), time)
    if _scatters_more(slope, of_amplitude):
        turn = turn[:, None] * np.exp(-1j * np.outer(slope, time))
    elif is_turned:
        turn = turn[:, None]
    else:
        return samples, 0.0
    return np.asarray(samples * turn.astype(samples.dtype)[:, None]), removed


def _scatters_more(phase: Array, amplitude: Array) -> bool:
    """Whether phases of slots scatter more than amplitudes do."""
    return scatter_more(float(np.var(phase)), float(np.var(amplitude)), len(phase) - 1)


def _slopes(relative: Complex, time: Array) -> tuple[Array, Array]:
    """Slope of each slot's phase and amplitude over time (n_slots, n_samples) by generalised least
    squares: the weight of a frequency is the inverse of the phases' power over all slots.
    """
    ramp = np.fft.rfft(time)[1:]
    phase, amplitude = (np.fft.rfft(part)[:, 1:] for part in (relative.imag, relative.real))
    power = np.mean(np.abs(phase) ** 2, axis=0)
    weight = ramp.conj() / np.maximum(power, 1e-300)
    scale = np.real(ramp @ weight)
    return np.real(phase @ weight) / scale, np.real(amplitude @ weight) / scale


def without_phase_noise(
    samples: Complex, waveform: OfdmWaveform, delay_s: float, schedule: NDArray[np.intp]
) -> tuple[Complex, Array | None, Complex]:
    """Samples (n_slots, n_receivers, n_subcarriers) after subtraction of the leakage's phase noise
    within slots; the noise (n_subcarriers, n_rounds) of every cell of range and rate over that of
    others at its range, None where it is uniform; and the leakage (n_transmitters, n_receivers).

    Beside an echo the phase noise is estimated from the mirror image alone, with its thermal
    noise.

    Parameters
    ----------
    samples
        Of one carrier, in any unit.
    waveform, delay_s
        Waveform sent, and delay of the leakage.
    schedule : (n_transmitters, n_rounds)
        Slots of each transmitter.
    """
    from scipy.fft import fft2, ifft2

    leak = _leak(waveform, delay_s, np.ones(waveform.n_subcarriers))
    modulus = np.abs(leak)
    unit = (leak / np.where(modulus > 0, modulus, 1.0)).astype(samples.dtype)
    cleaned = samples.copy()
    spectra, levels, beside = [], [], []
    for slots in schedule:
        sent = samples[slots]
        level = np.einsum("mrt,t->r", sent, leak.conj().astype(samples.dtype))
        level /= len(slots) * np.sum(modulus**2)
        weight = level.conj() / max(float(np.sum(np.abs(level) ** 2)), 1e-300)
        relative = np.einsum("mrt,r->mt", sent, weight.astype(samples.dtype)) * unit.conj()
        relative -= modulus.astype(relative.real.dtype)
        spectra.append(fft2(relative, norm="ortho", workers=-1))
        levels.append(level)
        # Rows that cancel the leakage, with as much thermal noise as its own combination.
        others = np.linalg.svd(level.conj()[None])[2][1:] * np.linalg.norm(weight)
        for other in others.astype(samples.dtype):
            without = np.einsum("mrt,r->mt", sent, other) * unit.conj()
            beside.append(np.abs(fft2(without, norm="ortho", workers=-1)) ** 2)
    noise, more = phase_noise(np.stack(spectra), np.stack(beside) if beside else None)
    for slots, level, part in zip(schedule, levels, noise, strict=True):
        within = 1j * ifft2(part, norm="ortho", workers=-1).imag * unit
        cleaned[slots] -= within[:, None] * level[:, None].astype(samples.dtype)
    leakage = np.stack(levels)
    if more is None:
        return cleaned, None, leakage
    # By range and rate, which run against the transform; the other receivers have none of it.
    ranges = -np.arange(more.shape[1]) + round(delay_s * waveform.bandwidth_hz)
    rates = (more.shape[0] - 1) // 2 - np.arange(more.shape[0])
    n_receivers = samples.shape[1]
    more = more[rates][:, ranges % more.shape[1]].T
    return cleaned, (n_receivers - 1 + more) / n_receivers, leakage


def phase_noise(spectra: Complex, beside_w: Power | None = None) -> tuple[Complex, Array | None]:
    """Least-squares phase noise of spectra (n_transmitters, n_rates, n_ranges), the leakage at
    the origin; the result has N(-k, -v) = -conj N(k, v).

    ``beside_w`` (n, n_rates, n_ranges): power of combinations of receivers without leakage, whose
    thermal noise is that of the spectra; None of one receiver.

    Also the remaining noise of every cell (n_rates, n_ranges), over that of cells at its range
    without an echo; None where there is no echo.
    """
    from scipy.ndimage import median_filter, uniform_filter

    mirrored = -np.roll(spectra[:, ::-1, ::-1], (1, 1), (1, 2)).conj()
    odd, even = (spectra + mirrored) / 2, (spectra - mirrored) / 2

    def level(power: Power) -> Array:
        """Mean noise power (n_ranges,), by medians: echoes occupy few rates, strong ones few
        ranges.
        """
        median = np.median(power, axis=(0, 1)) / np.log(2)
        smooth = median_filter(median, min(_SMOOTHED, len(median)), mode="wrap")
        return np.asarray((smooth + np.roll(smooth[::-1], 1)) / 2, dtype=np.float64)

    thermal = 2 * level(np.abs(even) ** 2)
    excess = np.maximum(level(np.abs(odd) ** 2) - thermal / 2, 0.0)
    thermal = np.maximum(thermal, 1e-300)
    estimate = odd * (excess / (excess + thermal / 2)).astype(odd.real.dtype)
    n = len(spectra)
    here, there, both = (
        np.mean(np.abs(part) ** 2, axis=0, dtype=np.float64) for part in (spectra, mirrored, even)
    )
    expected = excess + thermal
    # Phase noise alone, however high, leaves nothing in the half that is free of it, an echo 1/4.
    certain = np.where((here > _BEYOND * expected) & (both > here / 8), here, 0.0)
    if beside_w is not None:
        # Of directions at random an echo has as much power there as in the leakage's combination.
        usual = np.maximum(level(beside_w), 1e-300)
        mean = np.mean(beside_w, axis=0, dtype=np.float64)
        seen = mean > usual * _rare(mean / usual, float(len(beside_w)))
        certain = np.maximum(certain, np.where(seen, mean - usual, 0.0))
    lobes = _side_lobes(certain)
    opposite = np.roll(lobes[::-1, ::-1], (1, 1), (0, 1))
    suspect = np.maximum(lobes, opposite) > _FAINT * thermal
    strength, odds = np.zeros(here.shape), np.zeros(here.shape)
    for size in _POOLED:
        looks = n * np.prod(size)
        a, b, c = (uniform_filter(part, size, mode="wrap") for part in (here, there, both))
        seen = c > thermal / 2 * _rare(c / thermal, float(looks))
        suspect |= seen
        # Chance is no echo: taken for one, where side lobes may be, it would keep phase noise in.
        strength = np.maximum(strength, np.where(seen, 4 * c - 2 * thermal, 0.0))
        more = np.where(seen, looks * (a - b) / expected, 0.0)
        odds = np.where(np.abs(more) > np.abs(odds), more, odds)
    share = 1 / (1 + np.exp(-np.clip(odds, -60, 60)))
    at = np.nonzero(suspect)
    if not len(at[0]):
        return np.asarray(estimate), None
    # Cell and mirror image show the same phase noise, each with its own echo and thermal noise:
    # the mean of both is weighted by what else they hold.
    weights = [
        1 / (np.maximum(part * strength, other)[at] + thermal[at[1]])
        for part, other in ((share, np.maximum(certain, lobes)), (1 - share, opposite))
    ]
    total = 1 / np.maximum(excess[at[1]], 1e-300) + weights[0] + weights[1]
    own, other = weights[0] / total, weights[1] / total
    for i in range(n):
        estimate[i][at] = own * spectra[i][at] + other * mirrored[i][at]
    left = excess[at[1]] * (1 - own - other) ** 2 + thermal[at[1]] * ((1 - own) ** 2 + other**2)
    usual = thermal / 2 * (1 + thermal / 2 / (excess + thermal / 2))
    more = np.ones(here.shape)
    more[at] = left / usual[at[1]]
    return np.asarray(estimate), more


def _rare(pooled: Array, looks: float) -> Array:
    """Level over the mean that noise exceeds with the probability `_RARE` at every range,
    (n_ranges,).

    Noise in a part of the band only is correlated over neighbouring ranges: its mean varies as that
    of fewer cells. Their number is estimated from the lower half of the distribution over the
    ranges around, which contains no echoes.
    """
    from scipy.ndimage import uniform_filter1d
    from scipy.special import gammainccinv, gammaincinv

    if looks < _MANY:
        return np.full(pooled.shape[1], gammainccinv(looks, _RARE) / looks)
    low, middle = np.quantile(pooled, (_LOW, 0.5), axis=0)
    low, middle = (uniform_filter1d(q, _SMOOTHED, mode="wrap") for q in (low, middle))
    of_looks = np.geomspace(1, looks, 100)
    spread = gammaincinv(of_looks, _LOW) / gammaincinv(of_looks, 0.5)
    alike = np.interp(low / np.maximum(middle, 1e-300), spread, of_looks)
    return np.asarray(gammainccinv(alike, _RARE) / alike)


def _side_lobes(power: Array) -> Array:
    """Upper bound of the side lobes (n_rates, n_ranges) of echoes along both axes."""
    total = power.copy()
    for axis, size in enumerate(power.shape):
        away = np.minimum(np.arange(size), size - np.arange(size))
        fall = 1 / np.maximum(size * np.sin(np.pi * away / size), 1.0) ** 2
        fall[0] = 0
        kernel = np.fft.rfft(fall).reshape((-1, 1) if axis == 0 else (1, -1))
        spread = np.fft.irfft(np.fft.rfft(power, axis=axis) * kernel, size, axis=axis)
        total += np.maximum(spread, 0)
    return total


def _leak(waveform: OfdmWaveform, delay_s: float, weight: Array) -> Complex:
    """Samples (n_subcarriers,) of the sent symbol after a delay; the root mean square is that of
    the subcarriers' weights.
    """
    turn = np.exp(-2j * np.pi * waveform.frequency_offsets_hz * delay_s)
    spectrum = np.fft.ifftshift(waveform.sent() * turn * weight)
    return np.asarray(np.fft.ifft(spectrum) * np.sqrt(waveform.n_subcarriers))
