"""The range-Doppler map in received power.

A two-dimensional transform of the channel (Sturm and Wiesbeck, Proc. IEEE 99, 2011).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from hardware.errors import InputError, check_count, check_kind
from hardware.radar.demodulation import Complex
from hardware.radar.whitening import whiten
from hardware.radar.windows import check_window, normalised_window
from hardware.read_only import cached_read_only
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]
Power = NDArray[np.floating[Any]]

#: Cells per resolution cell along each axis, more than any use has.
MOST_OVERSAMPLING = 64


@dataclass(frozen=True, eq=False, repr=False)
class RangeDopplerMap(Described):
    """Received power by delay and delay rate, that is by range and range rate.

    ``power_w`` (n_ranges, n_rates): a single target at a cell's centre has the power that one
    antenna received from it, mean over ``n_channels``, fewer than the array's where some have no
    noise, see `whiten`. ``delay_s`` and ``range_m`` (n_ranges,) ascend from 0; ``delay_rate``, in
    s/s, and ``range_rate_m_per_s`` (n_rates,) ascend, positive when the target recedes.
    ``noise_w``: mean noise power of a cell, by the map's median: too high, and SNRs too low, where
    echoes fill much of the map (1.6 dB with clutter at two fifths of all delays in 4 slots, 0.2 dB
    in 64); ``noise_error_w``: its standard error, if the noise
    is white. ``oversampling``: cells per resolution cell along each axis.

    ``effective_looks``: number of independent channels with the same variance of the noise. Where
    it is less than ``n_channels``, the channels were whitened, see `whiten`: ``power_w`` of an
    echo is then correct in the mean over directions, and lower where the channels share the noise.
    ``relative_noise`` (n_ranges, n_rates) or (n_ranges, 1): mean noise of the cells where it is
    known to be uneven, normalised to a mean of about 1.
    """

    power_w: Power
    delay_s: Array
    delay_rate: Array
    noise_w: float
    n_channels: int = 1
    oversampling: int = 1
    effective_looks: float = 1.0
    relative_noise: Array | None = None
    noise_error_w: float = 0.0

    @cached_read_only
    def range_m(self) -> Array:
        """Range of each row (n_ranges,)."""
        return C_M_PER_S / 2 * self.delay_s

    @cached_read_only
    def range_rate_m_per_s(self) -> Array:
        """Range rate of each column (n_rates,)."""
        return C_M_PER_S / 2 * self.delay_rate


def range_doppler(
    channel: Complex,
    waveform: OfdmWaveform,
    window: str = "blackmanharris",
    *,
    oversampling: int = 1,
    relative_noise: Array | None = None,
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
        Cells per resolution cell along each axis. Limits the scalloping loss of a target between
        cells: with ``boxcar`` 3.9 dB per axis for 1, 0.9 for 2; with ``blackmanharris`` 0.8 for 1.

    relative_noise : (n_subcarriers, n_slots) or (n_subcarriers, 1)
        Mean noise of the cells without a window, where it is known, see `DemodulatedBurst`.

    Raises InputError for a channel that does not fit the waveform, or no whole ``oversampling``.
    """
    check_channel(channel, waveform)
    check_window(window)
    check_count("oversampling", oversampling, most=MOST_OVERSAMPLING)
    n, m = channel.shape[-2:]
    if relative_noise is not None and np.shape(relative_noise) not in ((n, m), (n, 1)):
        raise InputError(
            f"relative_noise: shape {np.shape(relative_noise)}, expected ({n}, {m}) or ({n}, 1)"
        )
    across, along = oversampling * n, oversampling * m
    parts = channel.reshape(-1, n, m)
    images, looks = whiten([complex_map(part, window, oversampling) for part in parts])
    power = mean_power(images)
    noise_w = noise_level(power, len(images))
    return RangeDopplerMap(
        power_w=power,
        delay_s=np.arange(across) * (waveform.delay_cell_s / oversampling),
        delay_rate=(np.arange(along) - (along - 1) // 2)
        * (waveform.delay_rate_cell / oversampling),
        noise_w=noise_w,
        n_channels=len(images),
        oversampling=oversampling,
        effective_looks=looks,
        relative_noise=_through_window(relative_noise, window, oversampling),
        noise_error_w=noise_w * _level_error((n, m), window, looks, oversampling),
    )


def _through_window(noise: Array | None, window: str, oversampling: int) -> Array | None:
    """Mean noise of a map's cells with a window, which averages it over neighbouring cells."""
    if noise is None:
        return None
    for axis, size in enumerate(noise.shape):
        if size == 1:
            continue
        fine = size * oversampling
        reach = np.abs(np.fft.fft(normalised_window(window, size), fine)) ** 2
        kernel = np.fft.rfft(reach / reach.sum()).reshape((-1, 1) if axis == 0 else (1, -1))
        spread = np.fft.rfft(np.repeat(noise, oversampling, axis), axis=axis) * kernel
        noise = np.maximum(np.fft.irfft(spread, fine, axis=axis), noise.min())
    return noise


def check_channel(channel: Complex, waveform: OfdmWaveform) -> None:
    """Raise InputError unless a channel has the waveform's subcarriers and slots."""
    check_kind("waveform", waveform, OfdmWaveform, "a record")
    if not isinstance(channel, np.ndarray) or channel.dtype.kind != "c" or not channel.size:
        raise InputError(f"channel: {channel!r:.60}, expected an array of complex numbers")
    expected = waveform.n_subcarriers, waveform.n_slots
    if channel.ndim not in (2, 3) or channel.shape[-2:] != expected:
        raise InputError(
            f"channel: shape {channel.shape}, expected (..., {expected[0]}, {expected[1]}) "
            "subcarriers and slots of the waveform"
        )


def complex_map(part: Complex, window: str, oversampling: int = 1) -> Complex:
    """Complex amplitude of one channel by rate and range, (n_rates, n_ranges), in root watts.

    Rates 0 and above come first, as the transform leaves them; `mean_power` sorts them.
    """
    from scipy.fft import ifft

    n, m = part.shape
    # Slots first: the channel comes transposed, its subcarriers contiguous.
    slots = part.T
    if window != "boxcar":
        slots = slots * normalised_window(window, n).astype(part.real.dtype)
        slots *= normalised_window(window, m).astype(part.real.dtype)[:, None]
    # The inverse transform makes a mean of the sum over subcarriers and undoes exp(-j 2 pi f tau);
    # range rates run against Doppler, so that the transform over slots is the inverse one as well.
    profiles = ifft(slots, oversampling * n, axis=1, overwrite_x=window != "boxcar", workers=-1)
    image = ifft(profiles, oversampling * m, axis=0, overwrite_x=True, workers=-1)
    if oversampling > 1:
        image *= oversampling**2  # the mean is that of the samples, not of the zeros beside them
    return np.asarray(image)


def mean_power(images: Iterable[Complex]) -> Power:
    """Power (n_ranges, n_rates) of `complex_map`, the mean over channels; rates ascend."""
    powers = [_power(image) for image in images]
    return powers[0] if len(powers) == 1 else np.asarray(np.mean(powers, axis=0))


def _power(image: Complex) -> Power:
    power = np.empty(image.shape, dtype=image.real.dtype)
    negative = (len(image) - 1) // 2  # rates below 0 come last
    for into, half in (
        (power[negative:], image[: len(image) - negative]),
        (power[:negative], image[len(image) - negative :]),
    ):
        np.multiply(half.real, half.real, out=into)
        into += half.imag**2
    return power.T


def noise_level(power: Power, n_channels: int) -> float:
    """Mean of the noise, from the map's median: that of the mean of n exponential cells."""
    from scipy.special import gammaincinv

    cells = power.ravel(order="K")[:: _stride(power.size)]
    middle = len(cells) // 2
    # Far quicker than np.median, which sorts with care for NaN.
    median = np.partition(cells, middle)[middle]
    return float(median / gammaincinv(n_channels, 0.5) * n_channels)


def _stride(n_cells: int) -> int:
    """Every seventh cell of a large map: 1.3e5 of them tell the median within 0.5 %."""
    return 7 if n_cells > 2**18 else 1


@lru_cache(maxsize=64)
def _level_error(shape: tuple[int, int], window: str, looks: float, oversampling: int) -> float:
    """Standard error of `noise_level` over the level: that of a median of gamma distributed cells,
    which the window and ``oversampling`` correlate.
    """
    from scipy.special import gammaincinv, gammaln

    n_cells = int(np.prod(shape)) * oversampling**2
    along, across = (_correlations(window, size, oversampling) for size in shape)
    alike = np.sum(_of_sides(np.outer(along, across), looks))
    median = gammaincinv(looks, 0.5)
    density = np.exp(looks * np.log(median) - median - gammaln(looks))  # times the median
    # Of every seventh cell alone, a seventh of the others that are like it is looked at.
    return float(0.5 / density * np.sqrt((alike + _stride(n_cells) - 1) / n_cells))


def _correlations(window: str, size: int, oversampling: int) -> Array:
    """Of the noise of a channel's cells with that of one of them, along an axis, squared."""
    weights = normalised_window(window, size) ** 2
    squared = np.abs(np.fft.fft(weights, size * oversampling) / weights.sum()) ** 2
    return np.asarray(squared[squared > 1e-4])


def _of_sides(correlation: Array, looks: float) -> Array:
    """Correlation of the sides of the median on which two gamma distributed cells lie, from the
    squared correlation of a channel's noise: Kibble's bivariate distribution, a series of products
    of Laguerre polynomials (Biometrika 1941).
    """
    from scipy.special import eval_genlaguerre, gammaincinv, gammaln

    median = gammaincinv(looks, 0.5)
    order = np.arange(1, 40)
    side = np.exp(looks * np.log(median) - median - gammaln(looks)) / order
    side *= eval_genlaguerre(order - 1, looks, median)
    share = 4 * side**2 * np.exp(gammaln(looks) + gammaln(order + 1) - gammaln(order + looks))
    summed = np.sum(share * correlation[..., None] ** order, axis=-1)
    return np.where(correlation > 0.999, 1.0, summed)
