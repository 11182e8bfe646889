"""From the channel to counts: retuned carriers, phase noise, thermal noise, mixer, converter."""

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.samples import highest_level, spectrum, symbol
from hardware.records import Flag
from twin.radar.device.design import RadarDesign
from twin.radar.device.phase_noise import apply_phase_noise, draw_phase_noise

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_BITS = 16  # of a record's counts
_MANY = 12  # repeats from which the mean of uniform errors is normal
_SIGMAS = 7.0  # of noise that must fit below a converter's rails


def digitize(
    channel: Complex,
    radar: RadarDesign,
    *,
    rng: np.random.Generator,
    noisy: bool = True,
    sent: Complex | None = None,
) -> tuple[NDArray[np.int16], NDArray[np.uint8], float]:
    """One burst's counts, with its flags and the root watts of one count.

    Parameters
    ----------
    channel : (n_steps, n_slots, n_receivers, n_subcarriers)
        Received over sent wave, leakage included.
    radar
        Power, noise and faults.
    rng
        Thermal noise comes from it, everything else from a child of it: what is switched on does
        not change the noise.
    noisy
        Without it there is neither thermal nor phase noise; retunes keep their random phases.
    sent : (n_steps, n_slots, n_subcarriers)
        Subcarriers that really go out; default: the waveform's, as a radio sends them, rounded to
        complex64 samples.

    Returns
    -------
    counts : (n_steps, n_slots, n_receivers, n_subcarriers, 2) int16
    flags : (n_steps, n_slots) uint8
    scale : float
    """
    received = arriving(channel, radar, rng=rng.spawn(1)[0], noisy=noisy, sent=sent)
    scale = float(np.sqrt(radar.sample_noise_w) / radar.front_end.noise_counts.value)
    if radar.front_end.adc_bits is None:
        exact = _mixed(_noisy(received, radar.sample_noise_w, rng, noisy) / scale, radar)
        counts, outside = _coded(exact, _BITS)
    else:
        counts, outside = _converted(received, radar, scale, rng, noisy)
    flags = np.where(outside.any(axis=(2, 3, 4)), np.uint8(Flag.SATURATED), np.uint8(0))
    return counts.astype(np.int16), flags, scale


def arriving(
    channel: Complex,
    radar: RadarDesign,
    *,
    rng: np.random.Generator,
    noisy: bool = True,
    sent: Complex | None = None,
) -> Complex:
    """The wave at the receivers' ports in time, in root watts, of the channel's shape.

    The sent power is shared by the subcarriers; each slot becomes one symbol.
    """
    wave = radar.ofdm
    if sent is None:
        level = highest_level(wave)
        sent = spectrum(symbol(wave, level), level)
    share = np.sqrt(radar.front_end.transmit_power_w.value / wave.n_subcarriers)
    sent = np.broadcast_to(sent * share, (*channel.shape[:2], wave.n_subcarriers))
    if radar.steps:
        channel = channel * _retuned(radar, rng)[:, None, None]
    if not (radar.oscillator and noisy):
        received = np.fft.ifft(np.fft.ifftshift(channel * sent[:, :, None], axes=-1), axis=-1)
        received *= wave.n_subcarriers
        return received
    received = np.empty_like(channel)
    for step, there in enumerate(channel):
        sending = draw_phase_noise(radar.oscillator, wave, rng)
        shared = radar.oscillator.shared.value
        receiving = sending if shared else draw_phase_noise(radar.oscillator, wave, rng)
        received[step] = apply_phase_noise(there, sent[step], wave, sending, receiving)
    return received


def image_rejection_db(radar: RadarDesign) -> float:
    """Power of a tone over that of its mirror image, (1 + 2 g cos a + g^2)/(1 - 2 g cos a + g^2).

    Infinite where the branches are alike.
    """
    g, angle = _branches(radar)
    image = 1 - 2 * g * np.cos(angle) + g * g
    return float(10 * np.log10((1 + 2 * g * np.cos(angle) + g * g) / image)) if image else np.inf


def full_scale_w(radar: RadarDesign) -> float:
    """Power of the strongest tone that does not clip, at the receivers' ports."""
    per_count = radar.sample_noise_w / radar.front_end.noise_counts.value**2
    return float(per_count * 2.0 ** (2 * (_BITS - 1)))


def _retuned(radar: RadarDesign, rng: np.random.Generator) -> Complex:
    """Phasor of each step's retune at every subcarrier, (n_steps, n_subcarriers)."""
    assert radar.steps is not None
    n = radar.steps.count.value
    phase, late = rng.uniform(0, 2 * np.pi, n), rng.normal(size=n) * radar.steps.timing_rms_s.value
    if not radar.steps.random_phase.value:
        phase[:] = 0
    phase_rad = phase[:, None] - 2 * np.pi * late[:, None] * radar.ofdm.frequency_offsets_hz
    return np.asarray(np.exp(1j * phase_rad))


def _noisy(received: Complex, noise_w: float, rng: np.random.Generator, noisy: bool) -> Array:
    """In-phase and quadrature parts, (..., 2), with thermal noise."""
    parts = np.stack([received.real, received.imag], axis=-1)
    if noisy:
        parts += rng.normal(size=parts.shape) * np.sqrt(noise_w / 2)
    return parts


def _mixed(parts: Array, radar: RadarDesign) -> Array:
    """In-phase and quadrature parts behind unequal branches of the mixer."""
    g, angle = _branches(radar)
    if g == 1 and angle == 0:
        return parts
    quadrature = g * (np.cos(angle) * parts[..., 1] + np.sin(angle) * parts[..., 0])
    return np.stack([parts[..., 0], quadrature], axis=-1)


def _branches(radar: RadarDesign) -> tuple[float, float]:
    """Amplitude and angle in rad of the quadrature branch against the in-phase one."""
    end = radar.front_end
    gain = end.iq_gain_db.value if end.iq_gain_db else 0.0
    angle = end.iq_phase_deg.value if end.iq_phase_deg else 0.0
    return 10 ** (gain / 20), float(np.radians(angle))


def _converted(
    received: Complex, radar: RadarDesign, scale: float, rng: np.random.Generator, noisy: bool
) -> tuple[Array, NDArray[np.bool_]]:
    """Mean of the repeats, each with its own noise and through the converter by itself.

    Noise of a whole code and more makes the converter's errors uniform and independent of what it
    converts, to 3e-9 (Widrow and Kollar, "Quantization Noise", 2008): where nothing comes near the
    rails, either, their mean over the repeats is drawn at once.
    """
    assert radar.front_end.adc_bits is not None
    bits, repeats = radar.front_end.adc_bits.value, radar.ofdm.repeats if noisy else 1
    step = 2.0 ** (_BITS - bits)  # counts per code
    codes = scale * step  # root watts per code
    deviation = np.sqrt(radar.sample_noise_w * repeats / 2) / codes
    dithered = noisy and deviation * min(1.0, _branches(radar)[0]) >= 1
    if dithered and repeats >= _MANY and _far_from_rails(received, radar, codes, deviation):
        mean = _mixed(_noisy(received, radar.sample_noise_w, rng, noisy) / scale, radar)
        mean += rng.normal(size=mean.shape) * (step / np.sqrt(12 * repeats))
        return _coded(mean, _BITS)
    total, outside = np.zeros(()), np.zeros((), dtype=np.bool_)
    for _ in range(repeats):
        parts = _noisy(received, radar.sample_noise_w * repeats, rng, noisy)
        coded, clipped = _coded(_mixed(parts / codes, radar), bits)
        total, outside = total + coded, outside | clipped
    return _coded(total * (step / repeats), _BITS)[0], outside


def _far_from_rails(received: Complex, radar: RadarDesign, codes: float, deviation: float) -> bool:
    """Whether noise on top of the wave leaves the converter's range less than once in 1e12."""
    assert radar.front_end.adc_bits is not None
    highest = float(np.abs(received).max(initial=0.0)) / codes + _SIGMAS * deviation
    rail = 2.0 ** (radar.front_end.adc_bits.value - 1) - 1
    return max(1.0, _branches(radar)[0]) * highest < rail


def _coded(exact: Array, bits: int) -> tuple[Array, NDArray[np.bool_]]:
    """Nearest codes of a converter, and where it clips."""
    half = 2.0 ** (bits - 1)
    return np.clip(np.rint(exact), -half, half - 1), np.abs(exact) > half - 1
