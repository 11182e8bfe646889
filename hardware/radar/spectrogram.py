"""Micro-Doppler: how the spectrum of range rates at one range changes, within an interval or over
several.

The short-time Fourier transform over slots of one range's channel (Chen, The Micro-Doppler Effect
in Radar, 2nd ed., 2019, ch. 2).
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.demodulation import Complex
from hardware.radar.range_doppler import range_doppler
from hardware.radar.windows import noise_gain, normalised_window
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

_PER_INTERVAL = 8  # windows side by side in an interval, by default
_OF_MEDIAN = np.log(2) ** 2  # variance of exponential values' mean over that of their median
_FINER = 4  # rates per resolution cell of a window
#: Share of spectrograms of noise alone that seem to show an echo, at most.
FALSE_ALARM = 0.01


@dataclass(frozen=True, eq=False)
class Spectrogram:
    """Received power by range rate and time at one range.

    ``power_w`` (n_rates, n_times): a single target of that rate has the power that one antenna
    received from it. ``range_rate_m_per_s`` (n_rates,) ascends, positive when the target recedes,
    within what slots can tell apart. ``time_s`` (n_times,): middles of windows, from the interval's
    middle on, or from the first interval's. ``range_m`` is that at which it was taken, first.
    ``noise_w`` (n_times,): mean noise of a cell, by the median of the interval's range-Doppler map;
    ``n_ranges`` of which a cell has the strongest; ``noise_cells``: independent cells by which that
    noise is known, one number or (n_times,).
    """

    power_w: Array
    range_rate_m_per_s: Array
    time_s: Array
    range_m: float
    noise_w: Array
    n_ranges: int = 1
    noise_cells: float | Array = np.inf

    @property
    def threshold_w(self) -> Array:
        """What white noise alone exceeds anywhere in `FALSE_ALARM` of all spectrograms at most,
        (n_times,): the chances of all cells added up, of which each is exponential, over a mean
        that is known by K cells: (1 + t / K)^-K.
        """
        fewest = np.log(self.power_w.size * self.n_ranges / FALSE_ALARM)
        over_mean = fewest
        if np.isfinite(self.noise_cells).all():
            over_mean = self.noise_cells * np.expm1(fewest / self.noise_cells)
        return np.asarray(over_mean * self.noise_w)

    @property
    def ridge_m_per_s(self) -> Array:
        """The strongest range rate of each window, NaN where it shows no echo, (n_times,)."""
        strongest = self.power_w.argmax(axis=0)
        shows = self.power_w.max(axis=0) > self.threshold_w
        return np.where(shows, self.range_rate_m_per_s[strongest], np.nan)

    @property
    def shows_echo(self) -> bool:
        """Whether any cell is above the `threshold_w`."""
        return bool((self.power_w > self.threshold_w).any())


def spectrogram(
    channel: Complex,
    waveform: OfdmWaveform,
    range_m: float,
    window_slots: int | None = None,
    *,
    span_m: float = 0.0,
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
    span_m
        Of ranges about that one, for bodies whose parts differ in it: power is that of the
        strongest of them.

    Raises InputError for a window that does not fit in the interval, a range beyond what
    subcarriers can tell, a span that is no length, or a channel of another shape.
    """
    slots = waveform.n_slots
    length = max(2, slots // _PER_INTERVAL) if window_slots is None else window_slots
    return _transformed(channel, waveform, range_m, length, span_m, _FINER * length)


def _transformed(
    channel: Complex,
    waveform: OfdmWaveform,
    range_m: float,
    length: int,
    span_m: float,
    n_rates: int,
) -> Spectrogram:
    """`spectrogram` with windows of ``length`` slots, at so many rates."""
    from scipy.signal import ShortTimeFFT

    n, slots = waveform.n_subcarriers, waveform.n_slots
    if np.shape(channel) != (n, slots):
        raise InputError(f"channel: shape {np.shape(channel)}, expected ({n}, {slots})")
    if not 0 <= range_m <= waveform.max_range_m:
        raise InputError(
            f"spectrogram: range_m = {range_m:g}, expected 0 to {waveform.max_range_m:g}"
        )
    if not 2 <= length <= slots:
        raise InputError(f"spectrogram: window_slots = {length}, expected 2 to {slots}")
    if not 0 <= span_m <= waveform.max_range_m:
        raise InputError(
            f"spectrogram: span_m = {span_m:g}, expected 0 to {waveform.max_range_m:g}"
        )
    taper = normalised_window("hann", n)
    delay = 2 * _ranges(range_m, span_m, waveform)[:, None] / C_M_PER_S
    steering = taper * np.exp(2j * np.pi * (waveform.frequency_offsets_hz * delay % 1.0))
    at_ranges = steering @ channel / n
    window = normalised_window("hann" if length > 3 else "boxcar", length)
    transform = ShortTimeFFT(
        window,
        hop=1,
        fs=1 / waveform.slot_period_s,
        fft_mode="twosided",
        mfft=n_rates,
    )
    first, last = length // 2, slots - (length - 1) // 2  # windows that lie within the interval
    strongest = np.max([abs(transform.stft(one, p0=first, p1=last)) for one in at_ranges], axis=0)
    doppler_hz = np.fft.fftshift(np.fft.fftfreq(n_rates, waveform.slot_period_s))
    rate = -doppler_hz * waveform.wavelength_m / 2
    power = (np.fft.fftshift(strongest, axes=0) / length) ** 2
    middle: Array = np.arange(first, last, dtype=np.float64) + (length - 1) / 2 - length // 2
    time_s: Array = (middle - (slots - 1) / 2) * waveform.slot_period_s
    noise_w, cells = _noise_w(channel, waveform, taper, window)
    noise = np.full(len(time_s), noise_w)
    return Spectrogram(power[::-1], rate[::-1], time_s, range_m, noise, len(at_ranges), cells)


def _noise_w(
    channel: Complex, waveform: OfdmWaveform, taper: Array, window: Array
) -> tuple[float, float]:
    """Mean noise of a cell at one range: that of a range-Doppler map, by both windows' gains; and
    by how many cells it is known: a median is as sure as the mean of `_OF_MEDIAN` as many.
    """
    name, shape = "blackmanharris", channel.shape
    gain = noise_gain(name, shape)
    white_w = range_doppler(channel, waveform, name).noise_w / gain
    shorter = shape[1] / len(window)
    noise_w = float(white_w * np.mean(taper**2) * np.mean(window**2) * shorter)
    return noise_w, _OF_MEDIAN * channel.size / gain


def _ranges(range_m: float, span_m: float, waveform: OfdmWaveform) -> Array:
    """Of a span, half a range cell or less apart, none below 0."""
    many = 1 + int(np.ceil(2 * span_m / waveform.range_cell_m))
    return np.maximum(np.linspace(range_m - span_m / 2, range_m + span_m / 2, many), 0.0)


def spectrogram_of_intervals(
    intervals: Iterable[tuple[float, Complex, OfdmWaveform]],
    range_m: float,
    *,
    range_rate_m_per_s: float = 0.0,
    span_m: float = 0.0,
) -> Spectrogram:
    """Spectrogram over several intervals, one spectrum of each: for what changes more slowly than
    an interval lasts, such as a walk.

    Parameters
    ----------
    intervals
        Time of its middle, s, channel (n_subcarriers, n_slots) and waveform of each; in order. A
        channel may hold fewer slots than the waveform, one after another, where others are lost:
        its spectrum resolves rates the less.
    range_m, range_rate_m_per_s
        At the first interval, and by how much it recedes: where the body is that is looked at.
    span_m
        As of `spectrogram`.

    Raises InputError as `spectrogram`, for times that do not ascend, for waveforms that differ, and
    for no interval.
    """
    times: list[float] = []
    spectra: list[Spectrogram] = []
    first: OfdmWaveform | None = None
    for time_s, channel, waveform in intervals:
        first = first or waveform
        if waveform != first:
            raise InputError(
                f"spectrogram: interval {len(times)} has another waveform than the first"
            )
        times.append(time_s)
        at = range_m + range_rate_m_per_s * (time_s - times[0])
        own = replace(waveform, n_slots=min(np.shape(channel)[-1], waveform.n_slots))
        n_rates = _FINER * waveform.n_slots
        spectra.append(_transformed(channel, own, at, own.n_slots, span_m, n_rates))
    if not times:
        raise InputError("spectrogram: no interval")
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise InputError("spectrogram: times of intervals do not ascend")
    power: Array = np.concatenate([seen.power_w for seen in spectra], axis=1)
    since_first: Array = np.array(times) - times[0]
    return replace(
        spectra[0],
        power_w=power,
        time_s=since_first,
        range_m=range_m,
        noise_w=np.concatenate([seen.noise_w for seen in spectra]),
        noise_cells=np.array([seen.noise_cells for seen in spectra]),
    )
