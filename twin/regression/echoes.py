"""Strong echoes of a scene: peaks of the map of its record, of all that reflects."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar import Detection, OfdmWaveform, range_doppler
from hardware.radar.burst import DemodulatedBurst
from hardware.radar.demodulation import Complex
from hardware.radar.range_doppler import RangeDopplerMap

Array = NDArray[np.float64]

_WINDOW = "blackmanharris"  # its side lobes are 92 dB down: every peak is an echo
_SIDE_LOBES = 1e-9  # of the strongest's power; below, one may be a side lobe after all
_OVER_NOISE = 100.0  # power over the noise beside it, with which every detector finds an echo
_NOISE_BESIDE = 3  # cells to each side, whose noise is averaged
_BESIDE = 2  # cells, within which the highest is the peak
_CELLS = 2.0  # within which a detection is of an echo, as of a target


@dataclass(frozen=True, eq=False)
class StrongEchoes:
    """Range and range rate of each, (n_echoes,), as the waveform folds them."""

    range_m: Array
    range_rate_m_per_s: Array
    waveform: OfdmWaveform

    def beside(self, range_m: float, range_rates_m_per_s: Iterable[float]) -> NDArray[np.bool_]:
        """Which of them lie within two cells of a range and one of these rates; NaN tells nothing
        against one.
        """
        wave = self.waveform
        near = _apart(self.range_m - range_m, wave.max_range_m) <= _CELLS * wave.range_cell_m
        rates = np.array(list(range_rates_m_per_s))
        off = _apart(self.range_rate_m_per_s[:, None] - rates, 2 * wave.max_velocity_m_per_s)
        return np.asarray(near & (off.min(axis=1) <= _CELLS * wave.velocity_cell_m_per_s))

    def n_undetected(self, detections: Iterable[Detection]) -> int:
        """How many have no detection."""
        found = np.zeros(len(self.range_m), dtype=bool)
        for one in detections:
            rates = one.range_rate_m_per_s, *one.range_rate_alternatives_m_per_s
            found |= self.beside(one.range_m, rates)
        return int(np.count_nonzero(~found))


def strong_echoes(bursts: Sequence[DemodulatedBurst]) -> StrongEchoes:
    """Peaks of the map of a burst that are 20 dB over the noise beside them.

    ``bursts``: it with a few draws of the noise, two at least. Echoes are what they share: without
    noise the converter's rounding is alike in all slots, and stands in the map as echoes would. The
    noise is what they differ by at each place of the map: the receiver's is the same everywhere,
    and the oscillator's lies round strong echoes, where it hides weaker ones however far they are
    over the receiver's.
    """
    from scipy.ndimage import maximum_filter, uniform_filter

    wave = bursts[0].waveform
    mean = np.mean([burst.channel for burst in bursts], axis=0)
    power, first = _of_channels(mean, wave)
    off_w = [_of_channels(burst.channel - mean, wave)[0] for burst in bursts]
    noise_w = np.sum(off_w, axis=0) / (len(bursts) - 1)
    beside_w = uniform_filter(noise_w, 2 * _NOISE_BESIDE + 1, mode="wrap")
    highest = maximum_filter(power, 2 * _BESIDE + 1, mode="wrap") <= power
    strong = power > np.maximum(_OVER_NOISE * beside_w, _SIDE_LOBES * power.max())
    rows, columns = np.nonzero(highest & strong)
    return StrongEchoes(first.range_m[rows], first.range_rate_m_per_s[columns], wave)


def _of_channels(channel: Complex, wave: OfdmWaveform) -> tuple[Array, RangeDopplerMap]:
    """Mean power of the channels' maps, and the first of these: one map of all would be whitened,
    which changes powers, and other than in a detector's where there is other noise.
    """
    maps = [
        range_doppler(each, wave, _WINDOW)
        for each in channel.reshape(-1, wave.n_subcarriers, wave.n_slots)
    ]
    return np.mean([one.power_w for one in maps], axis=0), maps[0]


def _apart(off: Array, period: float) -> Array:
    """Distances of what repeats; 0 for NaN."""
    return np.abs(np.nan_to_num((off + period / 2) % period - period / 2))
