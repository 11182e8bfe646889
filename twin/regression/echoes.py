"""Strong echoes of a scene: peaks of the map of its record without noise, of all that reflects."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar import Detection, OfdmWaveform, range_doppler
from hardware.radar.burst import DemodulatedBurst

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


def strong_echoes(quiet: DemodulatedBurst, noisy: Iterable[DemodulatedBurst]) -> StrongEchoes:
    """Peaks of the map of a burst without noise that are 20 dB over the noise beside them.

    ``noisy``: the same burst with a few draws of the noise. They differ by the noise at each
    place of the map: the receiver's is the same everywhere, and the oscillator's lies round strong
    echoes, where it hides weaker ones however far they are over the receiver's.
    """
    from scipy.ndimage import maximum_filter, uniform_filter

    wave = quiet.waveform
    image = range_doppler(quiet.channel, wave, _WINDOW)
    power = image.power_w
    off = (burst.channel - quiet.channel for burst in noisy)
    noise_w = np.mean([range_doppler(each, wave, _WINDOW).power_w for each in off], axis=0)
    beside_w = uniform_filter(noise_w, 2 * _NOISE_BESIDE + 1, mode="wrap")
    highest = maximum_filter(power, 2 * _BESIDE + 1, mode="wrap") <= power
    strong = power > np.maximum(_OVER_NOISE * beside_w, _SIDE_LOBES * power.max())
    rows, columns = np.nonzero(highest & strong)
    return StrongEchoes(image.range_m[rows], image.range_rate_m_per_s[columns], wave)


def _apart(off: Array, period: float) -> Array:
    """Distances of what repeats; 0 for NaN."""
    return np.abs(np.nan_to_num((off + period / 2) % period - period / 2))
