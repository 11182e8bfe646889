"""Micro-Doppler: how the spectrum of range rates at one range changes within an interval.

The short-time Fourier transform over slots of one range's channel (Chen, The Micro-Doppler Effect
in Radar, 2nd ed., 2019, ch. 2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.demodulation import Complex
from hardware.radar.windows import normalised_window
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

_PER_INTERVAL = 8  # windows side by side in an interval, by default
_FINER = 4  # rates per resolution cell of a window


@dataclass(frozen=True, eq=False)
class Spectrogram:
    """Received power by range rate and time at one range.

    ``power_w`` (n_rates, n_times): a single target of that rate has the power that one antenna
    received from it. ``range_rate_m_per_s`` (n_rates,) ascends, positive when the target recedes,
    within what slots can tell apart. ``time_s`` (n_times,): middles of windows, from the interval's
    middle on. ``range_m`` is that at which it was taken.
    """

    power_w: Array
    range_rate_m_per_s: Array
    time_s: Array
    range_m: float


def spectrogram(
    channel: Complex, waveform: OfdmWaveform, range_m: float, window_slots: int | None = None
) -> Spectrogram:
    """Spectrogram of a channel at one range.

    Parameters
    ----------
    channel : (n_subcarriers, n_slots)
        Received over sent wave of one transmitter and receiver.
    waveform
        Of that channel.
    range_m
        Echoes within two range cells of it are heard; one that walks farther fades.
    window_slots
        Slots in a window, 2 or more; default: an eighth of the interval. Longer ones tell rates
        apart more finely, by lambda / (2 window), and times less.

    Raises InputError for a window that does not fit in the interval, a range beyond what
    subcarriers can tell, or a channel of another shape.
    """
    from scipy.signal import ShortTimeFFT

    n, slots = waveform.n_subcarriers, waveform.n_slots
    if np.shape(channel) != (n, slots):
        raise InputError(f"channel: shape {np.shape(channel)}, expected ({n}, {slots})")
    if not 0 <= range_m <= waveform.max_range_m:
        raise InputError(
            f"spectrogram: range_m = {range_m:g}, expected 0 to {waveform.max_range_m:g}"
        )
    length = max(2, slots // _PER_INTERVAL) if window_slots is None else window_slots
    if not 2 <= length <= slots:
        raise InputError(f"spectrogram: window_slots = {length}, expected 2 to {slots}")
    taper = normalised_window("hann", n)
    delay = 2 * range_m / C_M_PER_S
    steering = taper * np.exp(2j * np.pi * (waveform.frequency_offsets_hz * delay % 1.0))
    at_range = steering @ channel / n
    window = normalised_window("hann" if length > 3 else "boxcar", length)
    transform = ShortTimeFFT(
        window,
        hop=1,
        fs=1 / waveform.slot_period_s,
        fft_mode="twosided",
        mfft=_FINER * length,
    )
    first, last = length // 2, slots - (length - 1) // 2  # windows that lie within the interval
    spectra = transform.stft(at_range, p0=first, p1=last) / length
    doppler_hz = np.fft.fftshift(np.fft.fftfreq(_FINER * length, waveform.slot_period_s))
    rate = -doppler_hz * waveform.wavelength_m / 2
    power = np.abs(np.fft.fftshift(spectra, axes=0)) ** 2
    middle: Array = np.arange(first, last, dtype=np.float64) + (length - 1) / 2 - length // 2
    time_s: Array = (middle - (slots - 1) / 2) * waveform.slot_period_s
    return Spectrogram(power[::-1], rate[::-1], time_s, range_m)
