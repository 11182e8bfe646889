"""Phase noise of the oscillators, as it is left after averaging the repeats of a slot.

The phase is split in two. Offsets below half a subcarrier change it slowly: each symbol has a mean
phase and a slope, which vary from symbol to symbol. The others are drawn on the subcarriers' own
raster, so they repeat with the symbol; averaging R repeats leaves 1 / R of their power. An echo
of delay tau then carries phi(t - tau) - phi(t) of a shared oscillator, whose spectrum is
4 sin^2(pi f tau) of phi's (range correlation: Budge and Burt, "Range correlation effects in
radars", IEEE National Radar Conference, 1993), or the difference of two of separate ones.

That spectrum is seen through the finite time of the averaging, R symbols T: subcarrier k holds

    integral of L(f) 4 sin^2(pi f tau) |W(f - k / T)|^2 df,   |W(x)| ~ sinc(R T x),

so that its nulls are filled: at 2 L tau / (R T)^2 where L is flat, and higher where close-in noise
leaks in. In the time domain: an echo is late by tau, so the averaging window holds the last part,
tau long, of the symbol before the first repeat, and lacks that part of the last repeat. The phase
noise of that earlier symbol is drawn independently; only its mean and slope are continuous with the
next symbol. Therefore nulls of steep spectra come out up to 1.5 times too high.

The receiver's filter passes the band that is sent: what phase noise moves out of it is lost, which
is a share k / N of the noise at an offset of k of N subcarriers. Products are formed on samples so
fine that nothing aliases into the band (Orszag, J. Atmos. Sci. 28, 1971).

Left out: offsets beyond half the band, and second-order terms of the residual phase phi of each
repeat, so that |phi|^2 / 2 should be small against 1 (phi is `residual_rad` times the root of the
number of repeats).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform
from twin.radar.device.electronics import Oscillator

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_BEFORE = 32  # one tap in so many, at the channel's end, counts as a negative delay


@dataclass(frozen=True, eq=False)
class PhaseNoise:
    """One realisation of an oscillator's phase noise.

    mean_rad, slope_hz : (n_slots, repeats)
        Mean phase of each symbol, and its slope.
    within_rad : (n_slots, n_samples)
        The rest of the phase, averaged over the repeats, on the samples of `_fine`.
    earlier_window_rad : (n_slots, n_samples)
        Phase averaged over a window one symbol earlier, less that averaged over the repeats,
        without the part that is due to the mean slope.
    """

    mean_rad: Array
    slope_hz: Array
    within_rad: Array
    earlier_window_rad: Array


def draw_phase_noise(
    oscillator: Oscillator, wave: OfdmWaveform, rng: np.random.Generator
) -> PhaseNoise:
    """Draw the phase noise of one oscillator for one step's slots."""
    symbols, repeats = _symbols(wave), wave.repeats
    offset = _slow_hz(wave)
    lines = _lines(oscillator, offset, 1 / (symbols * wave.symbol_s), rng)
    starts = np.rint(np.arange(wave.n_slots) * wave.slot_period_s / wave.symbol_s).astype(int)
    # The symbol before the repeats comes first.
    rows = (starts[:, None] + np.arange(-1, repeats)) % symbols
    mean, slope = (_series(part, symbols)[rows] for part in (lines, 1j * offset * lines))
    raster = _raster_hz(wave)
    width = wave.subcarrier_spacing_hz / repeats
    n = _fine(wave)
    within, other = (
        _series(_lines(oscillator, raster, width, rng, wave.n_slots), n) for _ in range(2)
    )
    # Phase of the symbol before the repeats less that of the last repeat, over their number: first
    # of independent symbols, given their average, then of the change of mean and slope.
    earlier = np.sqrt((2 - 1 / repeats) / repeats) * other - within / repeats
    place = (np.arange(n) / n - 0.5) * wave.symbol_s
    change = mean[:, 0] - mean[:, -1], slope[:, 0] - slope[:, -1]
    earlier += (change[0][:, None] + 2 * np.pi * change[1][:, None] * place) / repeats
    earlier += 2 * np.pi * slope[:, 1:].mean(axis=1)[:, None] * wave.symbol_s
    return PhaseNoise(mean[:, 1:], slope[:, 1:], within, earlier)


def apply_phase_noise(
    channel: Complex, sent: Complex, wave: OfdmWaveform, sending: PhaseNoise, receiving: PhaseNoise
) -> Complex:
    """Received samples in time, ``(n_slots, n_receivers, n_subcarriers)``.

    ``channel`` has the same shape, along subcarriers; ``sent`` (n_slots, n_subcarriers) are the
    symbols. The symbol and the one before it are multiplied by the transmitter's phasor, convolved
    with the channel, multiplied by the receiver's conjugate phasor, and filtered to the band. The
    slope of the phase rotates each echo in proportion to its delay.
    The channel's last taps count as negative delays: they are sidelobes of near echoes between two
    taps, not echoes from the end of the symbol.
    """
    from scipy.fft import fft, ifft

    n, fine = wave.n_subcarriers, _fine(wave)
    band = (np.arange(n) - n // 2) % fine
    clean = np.zeros((*sent.shape[:-1], fine), dtype=np.complex128)
    clean[..., band] = sent
    symbol = ifft(clean, workers=-1) * np.exp(1j * sending.within_rad)
    stream = np.concatenate([symbol * np.exp(1j * sending.earlier_window_rad), symbol], axis=-1)
    spectrum = fft(stream, workers=-1, overwrite_x=True)
    back = np.exp(-1j * receiving.within_rad)
    if sending is not receiving:  # what both have in common cancels
        common = np.exp(1j * (sending.mean_rad - receiving.mean_rad)).mean(axis=1)
        drift = (sending.slope_hz - receiving.slope_hz).mean(axis=1)
        place = ((np.arange(fine) + 0.5) / fine - 0.5) * wave.symbol_s
        back *= common[:, None] * np.exp(2j * np.pi * drift[:, None] * place)
    late_taps = np.arange(n) - n * (np.arange(n) >= n - n // _BEFORE)
    slope = sending.slope_hz.mean(axis=1)
    late = np.exp(-2j * np.pi * slope[:, None] * late_taps / wave.bandwidth_hz)
    arriving = np.empty_like(channel)
    for receiver in range(channel.shape[1]):
        taps = ifft(np.fft.ifftshift(channel[:, receiver], axes=-1), workers=-1, overwrite_x=True)
        longer = np.zeros((len(taps), 2 * n), dtype=taps.dtype)
        longer[:, late_taps] = taps * late
        response = fft(longer, workers=-1, overwrite_x=True)
        # What leaves the band in the channel comes back by second-order terms only.
        beyond = np.repeat(response[:, [n - 1, n]], fine - n, axis=1)
        both = np.concatenate([response[:, :n], beyond, response[:, n:]], axis=1)
        both *= spectrum
        mixed = ifft(both, workers=-1, overwrite_x=True)[:, fine:]
        received = fft(mixed * back, workers=-1, overwrite_x=True)[:, band]
        arriving[:, receiver] = ifft(np.fft.ifftshift(received, axes=-1), workers=-1) * n
    return arriving


def residual_rad(oscillator: Oscillator, wave: OfdmWaveform, delay_s: float) -> float:
    """Phase noise of an echo, rms over the averaged samples, in closed form.

    With separate oscillators, noise slower than a symbol rotates all echoes alike and is not
    counted.
    """
    fast, slow = _raster_hz(wave), _slow_hz(wave)
    within = 2 * oscillator.level(fast) * wave.subcarrier_spacing_hz / wave.repeats
    within *= 1 - fast / wave.bandwidth_hz  # what stays in the band
    if not oscillator.shared.value:
        return float(np.sqrt(2 * np.sum(within)))
    between = 2 * oscillator.level(slow) * wave.slot_gain(slow) ** 2
    between /= _symbols(wave) * wave.symbol_s
    overlap = max(1 - delay_s / (wave.repeats * wave.symbol_s), 0.0)
    power = np.sum(within * 2 * (1 - overlap * np.cos(2 * np.pi * fast * delay_s)))
    power += np.sum(between * 4 * np.sin(np.pi * slow * delay_s) ** 2)
    return float(np.sqrt(power))


def _fine(wave: OfdmWaveform) -> int:
    """Samples of a symbol on which the product of a signal that fills the band and a phasor of
    offsets up to half of it does not alias into the band.
    """
    return wave.n_subcarriers + (wave.n_subcarriers + 1) // 2


def _symbols(wave: OfdmWaveform) -> int:
    """Symbols that fit in one step's slots, pauses included."""
    return max(round(wave.n_slots * wave.slot_period_s / wave.symbol_s), 1)


def _slow_hz(wave: OfdmWaveform) -> Array:
    """Offsets from one turn per step to just below half a subcarrier."""
    symbols = _symbols(wave)
    offset = np.arange(1, (symbols + 1) // 2) / (symbols * wave.symbol_s)
    return np.asarray(offset, dtype=np.float64)


def _raster_hz(wave: OfdmWaveform) -> Array:
    """Offsets from one subcarrier to just below half the band."""
    offset = wave.subcarrier_spacing_hz * np.arange(1, (wave.n_subcarriers + 1) // 2)
    return np.asarray(offset, dtype=np.float64)


def _lines(
    oscillator: Oscillator,
    offset_hz: Array,
    width_hz: float,
    rng: np.random.Generator,
    n: int | None = None,
) -> Complex:
    """Complex lines c with E|c|^2 = L(f) df, so that 2 Re sum c exp(j 2 pi f t) has the power of
    both sidebands; (n_offsets,) or (n, n_offsets).
    """
    shape = (len(offset_hz),) if n is None else (n, len(offset_hz))
    drawn = rng.normal(size=(*shape, 2))
    deviation = np.sqrt(oscillator.level(offset_hz) * width_hz / 2)
    return np.asarray((drawn[..., 0] + 1j * drawn[..., 1]) * deviation)


def _series(lines: Complex, size: int) -> Array:
    """2 Re sum_k lines[k - 1] exp(j 2 pi k i / size), along the last axis."""
    spectrum = np.zeros((*lines.shape[:-1], size // 2 + 1), dtype=np.complex128)
    spectrum[..., 1 : lines.shape[-1] + 1] = lines
    return np.asarray(np.fft.irfft(spectrum, size, axis=-1) * size)
