"""What is static in a burst, as the mean over its slots shows it, at any delay."""

import numpy as np
from numpy.typing import NDArray

from hardware.radar.burst import DemodulatedBurst
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.measurement import EchoMeasurement
from hardware.radar.windows import normalised_window

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_WINDOW = "blackmanharris"


def static_amplitudes(burst: DemodulatedBurst, delay_s: Array, window: str = _WINDOW) -> Complex:
    """Amplitudes (n, n_channels), in root watts, at rest at delays (n,)."""
    wave = burst.waveform
    taper = normalised_window(window, wave.n_subcarriers) / wave.n_subcarriers
    at_delay = np.exp(2j * np.pi * np.outer(np.nan_to_num(delay_s), wave.frequency_offsets_hz))
    return np.asarray((at_delay * taper) @ burst.channel.mean(axis=-1).T)


def static_power(burst: DemodulatedBurst, delay_s: Array) -> Array:
    """Mean power (n,) over channels at rest at delays (n,): with a window or without one, of which
    one shows what the other hides.
    """
    by_window = [static_amplitudes(burst, delay_s, window) for window in (_WINDOW, "boxcar")]
    return np.asarray(np.max([np.mean(np.abs(one) ** 2, axis=1) for one in by_window], axis=0))


def strongest_static(burst: DemodulatedBurst) -> EchoMeasurement:
    """The strongest static echo, as if it were exactly at rest and without noise."""
    wave = burst.waveform
    delay_s = np.arange(2 * wave.n_subcarriers) / 2 * wave.delay_cell_s
    amplitudes = static_amplitudes(burst, delay_s)
    power_w = np.mean(np.abs(amplitudes) ** 2, axis=1)
    highest = int(np.argmax(power_w))
    return EchoMeasurement(
        delay_s=float(delay_s[highest]),
        delay_rate=0.0,
        power_w=float(power_w[highest]),
        snr_db=np.inf,
        delay_error_s=0.0,
        delay_rate_error=0.0,
        power_error_w=0.0,
        amplitude=amplitudes[highest],
        noise=ChannelNoise.white(len(burst.channel), 0.0),
    )
