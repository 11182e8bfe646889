"""Demodulation and the range-Doppler map, in received power.

Element-wise division by the sent symbols, then a two-dimensional FFT (Sturm and Wiesbeck, Proc.
IEEE 99, 2011).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.radar.waveform import OfdmWaveform

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RangeDopplerMap:
    """Received power by range and range rate.

    ``power_w`` (n_ranges, n_rates): a lone target at a cell's centre shows the power that the
    antenna received from it. ``range_m`` ascends from 0; ``range_rate_m_per_s`` ascends, positive
    when the target recedes. ``noise_w`` is the mean noise power of a cell.
    """

    power_w: Array
    range_m: Array
    range_rate_m_per_s: Array
    noise_w: float


def channel(
    record: "RadarRecord", *, burst: int = 0, step: int = 0, receiver: int = 0
) -> NDArray[np.complex128]:
    """Channel times root transmit power, in root watts, ``(n_subcarriers, n_slots)``.

    One subcarrier carries 1/N of the power; the division by the sent symbols scales it back to the
    whole, so that an echo of power P has the modulus sqrt(P) everywhere.
    """
    n = record.waveform.n_subcarriers
    wave = record.wave[burst, step, :, receiver]
    received = np.fft.fftshift(np.fft.fft(wave, axis=-1), axes=-1) / n
    return (received * np.sqrt(n) / record.waveform.sent()).T


def taper(name: str, size: int) -> Array:
    """Window of mean 1: peaks keep their power, noise grows by the mean square.

    Raises ValueError for a name that SciPy does not know.
    """
    from scipy.signal import get_window

    window = get_window(name, size, fftbins=False)
    return np.asarray(window / window.mean(), dtype=np.float64)


def range_doppler(
    channel: NDArray[np.complex128], waveform: OfdmWaveform, window: str = "blackmanharris"
) -> RangeDopplerMap:
    """Range-Doppler map of a channel.

    Parameters
    ----------
    channel : (n_subcarriers, n_slots) array
        In root watts, from `channel`.
    waveform
        Sets the axes.
    window
        Along both axes, by SciPy's name. ``boxcar`` resolves best; ``blackmanharris`` keeps side
        lobes 92 dB down, at twice the width and 3 dB of noise per axis.
    """
    n, m = channel.shape
    tapered = channel * taper(window, n)[:, None] * taper(window, m)
    # ifft has the 1/N along range that makes a mean of the sum; the sign undoes exp(-j 2 pi f tau).
    image = np.fft.fftshift(np.fft.fft(np.fft.ifft(tapered, axis=0), axis=1), axes=1) / m
    power = np.abs(image) ** 2
    doppler = (np.arange(m) - m // 2) / (m * waveform.slot_period_s)
    return RangeDopplerMap(
        power_w=power[:, ::-1],
        range_m=np.arange(n, dtype=np.float64) * waveform.range_cell_m,
        range_rate_m_per_s=(-doppler * waveform.wavelength_m / 2)[::-1],
        # The median of an exponential distribution is its mean times log 2.
        noise_w=float(np.median(power) / np.log(2)),
    )
