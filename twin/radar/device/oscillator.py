"""Phase noise of the oscillators, as it is left after averaging the repeats of a slot.

Within a symbol the phase is split in two. Offsets below half a subcarrier turn it slowly: a mean
and a slope per symbol, wandering from symbol to symbol. The others are drawn on the subcarriers'
own raster, so they repeat with the symbol; averaging R repeats leaves 1 / R of their power. An echo
of delay tau then carries phi(t - tau) - phi(t) of a shared oscillator, whose spectrum is
4 sin^2(pi f tau) of phi's (range correlation: Budge and Burt, "Range correlation effects in
radars", IEEE National Radar Conference, 1993), or the difference of two of separate ones.

Left out: offsets beyond half the band, and the square of what is left on each repeat, so that
|phi|^2 / 2 should be small against 1 (`residual_rad` times the root of the repeats says how large
phi is).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform
from twin.radar.device.design import Oscillator

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Wander:
    """Phase of one oscillator.

    ``mean_rad`` and ``slope_hz`` (n_slots, repeats), of each symbol; ``within_rad``
    (n_slots, n_subcarriers), the rest, averaged over the repeats.
    """

    mean_rad: Array
    slope_hz: Array
    within_rad: Array


def draw(oscillator: Oscillator, wave: OfdmWaveform, rng: np.random.Generator) -> Wander:
    """Draw the phase of one oscillator for one step's slots."""
    symbols = _symbols(wave)
    offset = _slow_hz(wave)
    lines = _lines(oscillator, offset, 1 / (symbols * wave.symbol_s), rng)
    starts = np.rint(np.arange(wave.n_slots) * wave.slot_period_s / wave.symbol_s).astype(int)
    chosen = (starts[:, None] + np.arange(wave.repeats)) % symbols
    raster = _raster_hz(wave)
    width = wave.subcarrier_spacing_hz / wave.repeats
    within = _lines(oscillator, raster, width, rng, wave.n_slots)
    return Wander(
        mean_rad=_series(lines, symbols)[chosen],
        slope_hz=_series(1j * offset * lines, symbols)[chosen],
        within_rad=_series(within, wave.n_subcarriers),
    )


def apply(
    channel: Complex, sent: Complex, wave: OfdmWaveform, sending: Wander, receiving: Wander
) -> Complex:
    """What arrives, in time, ``(n_slots, n_receivers, n_subcarriers)``.

    ``channel`` has the same shape, along subcarriers; ``sent`` (n_slots, n_subcarriers) are the
    symbols. The sent symbol is turned, goes through the channel, and is turned back by the
    receiver; a slope of the phase turns each echo in proportion to its delay.
    """
    clean = np.fft.ifft(np.fft.ifftshift(sent, axes=-1), axis=-1)
    turned = np.fft.fft(clean * np.exp(1j * sending.within_rad), axis=-1)
    taps = np.fft.ifft(np.fft.ifftshift(channel, axes=-1), axis=-1)
    delays = np.arange(wave.n_subcarriers) / wave.bandwidth_hz
    slope = sending.slope_hz.mean(axis=1)
    taps *= np.exp(-2j * np.pi * slope[:, None] * delays)[:, None]
    arriving = np.fft.ifft(np.fft.fft(taps, axis=-1) * turned[:, None], axis=-1)
    arriving *= wave.n_subcarriers
    if sending is receiving:  # what both have in common cancels
        return np.asarray(arriving * np.exp(-1j * receiving.within_rad)[:, None])
    common = np.exp(1j * (sending.mean_rad - receiving.mean_rad)).mean(axis=1)
    drift = (sending.slope_hz - receiving.slope_hz).mean(axis=1)
    ramp = 2 * np.pi * drift[:, None] * (delays - delays.mean())
    back = common[:, None] * np.exp(1j * (ramp - receiving.within_rad))
    return np.asarray(arriving * back[:, None])


def residual_rad(oscillator: Oscillator, wave: OfdmWaveform, delay_s: float) -> float:
    """Phase noise of an echo, rms over the averaged samples, in closed form.

    Of separate oscillators, what is slower than a symbol turns echoes as a whole and is not
    counted.
    """
    fast, slow = _raster_hz(wave), _slow_hz(wave)
    within = 2 * oscillator.level(fast) * wave.subcarrier_spacing_hz / wave.repeats
    if not oscillator.shared.value:
        return float(np.sqrt(2 * np.sum(within)))
    between = 2 * oscillator.level(slow) * wave.slot_gain(slow) ** 2
    between /= _symbols(wave) * wave.symbol_s
    power = np.sum(within * 4 * np.sin(np.pi * fast * delay_s) ** 2)
    power += np.sum(between * 4 * np.sin(np.pi * slow * delay_s) ** 2)
    return float(np.sqrt(power))


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
