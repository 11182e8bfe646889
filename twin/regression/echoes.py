"""Strong echoes of a scene: peaks of the map of its record without noise, of all that reflects."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar import Detection, OfdmWaveform, range_doppler
from hardware.radar.burst import DemodulatedBurst
from hardware.radar.windows import noise_gain
from twin.radar.truth import TrueTarget

Array = NDArray[np.float64]

_WINDOW = "blackmanharris"  # its side lobes are 92 dB down: every peak is an echo
_OVER_NOISE = 100.0  # power over the noise of the map, with which every detector finds an echo
_BELOW_STRONGEST = 1e-4  # of the strongest's power; below, phase noise and leakage may hide one
_BESIDE = 2  # cells, within which the highest is the peak
_FOLDS = 8  # of a target's rate, to each side
_CELLS = 2.0  # within which a detection is of an echo, as of a target


@dataclass(frozen=True, eq=False)
class StrongEchoes:
    """Range and range rate of each, (n_echoes,), as the waveform folds them."""

    range_m: Array
    range_rate_m_per_s: Array
    waveform: OfdmWaveform

    def without(self, targets: Iterable[TrueTarget]) -> "StrongEchoes":
        """Those that do not lie within two cells of a target's object."""
        wave = self.waveform
        folds = 2 * wave.max_velocity_m_per_s * np.arange(-_FOLDS, _FOLDS + 1)
        free = np.ones(len(self.range_m), dtype=bool)
        for target in targets:
            for i, (range_m, rate) in enumerate(
                zip(self.range_m, self.range_rate_m_per_s, strict=True)
            ):
                off_range, off_rate = target.beside(range_m, rate + folds)
                near = off_range <= _CELLS * wave.range_cell_m
                free[i] &= not (near and off_rate <= _CELLS * wave.velocity_cell_m_per_s)
        return StrongEchoes(self.range_m[free], self.range_rate_m_per_s[free], wave)

    def beside(self, range_m: float, range_rates_m_per_s: Iterable[float]) -> NDArray[np.bool_]:
        """Which of them lie within two cells of a range and one of these rates; NaN tells nothing
        against one.
        """
        wave = self.waveform
        near = _apart(self.range_m - range_m, wave.max_range_m) <= _CELLS * wave.range_cell_m
        rates = np.array(list(range_rates_m_per_s))
        off = _apart(self.range_rate_m_per_s[:, None] - rates, 2 * wave.max_velocity_m_per_s)
        return np.asarray(near & (off.min(axis=1) <= _CELLS * wave.velocity_cell_m_per_s))

    def n_lost(self, detections: Iterable[Detection]) -> int:
        """How many have no detection."""
        found = np.zeros(len(self.range_m), dtype=bool)
        for one in detections:
            rates = one.range_rate_m_per_s, *one.range_rate_alternatives_m_per_s
            found |= self.beside(one.range_m, rates)
        return int(np.count_nonzero(~found))


def strong_echoes(quiet: DemodulatedBurst, sample_noise_w: float) -> StrongEchoes:
    """Peaks of the map of a burst without noise that are 20 dB over the noise of ``sample_noise_w``
    on it, and no more than 40 dB below the strongest.
    """
    from scipy.ndimage import maximum_filter

    wave = quiet.waveform
    image = range_doppler(quiet.channel, wave, _WINDOW)
    power = image.power_w
    noise_w = sample_noise_w * noise_gain(_WINDOW, power.shape) / power.size
    highest = maximum_filter(power, 2 * _BESIDE + 1, mode="wrap") <= power
    strong = power > max(_OVER_NOISE * noise_w, _BELOW_STRONGEST * float(power.max()))
    rows, columns = np.nonzero(highest & strong)
    return StrongEchoes(image.range_m[rows], image.range_rate_m_per_s[columns], wave)


def _apart(off: Array, period: float) -> Array:
    """Distances of what repeats; 0 for NaN."""
    return np.abs(np.nan_to_num((off + period / 2) % period - period / 2))
