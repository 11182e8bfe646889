"""The range-Doppler map in received power.

A two-dimensional transform of the channel (Sturm and Wiesbeck, Proc. IEEE 99, 2011).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.windows import taper
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]
Power = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class RangeDopplerMap:
    """Received power by range and range rate.

    ``power_w`` (n_ranges, n_rates): a lone target at a cell's centre shows the power that one
    antenna received from it, the mean over ``n_channels``. ``range_m`` ascends from 0;
    ``range_rate_m_per_s`` ascends, positive when the target recedes. ``noise_w`` is the mean noise
    power of a cell. ``oversampling`` cells stand where one would do.
    """

    power_w: Power
    range_m: Array
    range_rate_m_per_s: Array
    noise_w: float
    n_channels: int = 1
    oversampling: int = 1


def range_doppler(
    channel: Complex,
    waveform: OfdmWaveform,
    window: str = "blackmanharris",
    *,
    oversampling: int = 1,
) -> RangeDopplerMap:
    """Range-Doppler map of a channel, or of several, their powers averaged.

    Parameters
    ----------
    channel : (n_subcarriers, n_slots) or (n_channels, n_subcarriers, n_slots) array
        In root watts. Single precision stays single.
    waveform
        Sets the axes.
    window
        Along both axes, by SciPy's name. ``boxcar`` resolves best; ``blackmanharris`` keeps side
        lobes 92 dB down, at twice the width and 3 dB of noise per axis.
    oversampling
        Cells per resolution cell along each axis. Bounds what a target between cells loses: with
        ``boxcar`` 3.9 dB per axis for 1, 0.9 for 2; with ``blackmanharris`` 0.8 for 1.

    Raises ValueError for a channel that is not the waveform's.
    """
    check_channel(channel, waveform)
    n, m = channel.shape[-2:]
    across, along = oversampling * n, oversampling * m
    parts = channel.reshape(-1, n, m)
    # ifft has the 1/N along range that makes a mean of the sum; the sign undoes exp(-j 2 pi f tau).
    by_range = (taper(window, n) * oversampling).astype(parts.real.dtype)
    by_slot = (taper(window, m) / m).astype(parts.real.dtype)
    powers = [_power(part, by_range, by_slot, across, along) for part in parts]
    power = powers[0] if len(parts) == 1 else np.mean(powers, axis=0)
    rates = (np.arange(along) - (along - 1) // 2) / (along * waveform.slot_period_s)
    return RangeDopplerMap(
        power_w=power,
        range_m=np.arange(across) * (waveform.range_cell_m / oversampling),
        range_rate_m_per_s=rates * waveform.wavelength_m / 2,
        noise_w=_noise(power, len(parts)),
        n_channels=len(parts),
        oversampling=oversampling,
    )


def check_channel(channel: Complex, waveform: OfdmWaveform) -> None:
    """Raise ValueError unless a channel has the waveform's subcarriers and slots."""
    expected = waveform.n_subcarriers, waveform.n_slots
    if channel.ndim not in (2, 3) or channel.shape[-2:] != expected:
        raise ValueError(
            f"channel: shape {channel.shape}, expected (..., {expected[0]}, {expected[1]}) "
            "subcarriers and slots of the waveform"
        )


def _power(part: Complex, by_range: Power, by_slot: Power, across: int, along: int) -> Power:
    """Power (across, along) of one channel; rates ascend.

    Range rates run against Doppler, so the transform over slots is the inverse one, without 1/M.
    """
    from scipy.fft import ifft

    # Slots first: the channel comes transposed, its subcarriers contiguous.
    slots = part.T * by_range
    slots *= by_slot[:, None]
    profiles = ifft(slots, across, axis=1, overwrite_x=True, workers=-1)
    image = ifft(profiles, along, axis=0, norm="forward", overwrite_x=True, workers=-1)
    power = np.empty(image.shape, dtype=image.real.dtype)
    negative = (along - 1) // 2  # rates below 0 come last
    for into, half in (
        (power[negative:], image[: along - negative]),
        (power[:negative], image[along - negative :]),
    ):
        np.multiply(half.real, half.real, out=into)
        into += half.imag**2
    return power.T


def _noise(power: Power, n_channels: int) -> float:
    """Mean of the noise, from the map's median: that of the mean of n exponential cells."""
    from scipy.special import gammaincinv

    middle = power.size // 2
    # Far quicker than np.median, which sorts with care for NaN.
    median = np.partition(power.ravel(order="K"), middle)[middle]
    return float(median / gammaincinv(n_channels, 0.5) * n_channels)
