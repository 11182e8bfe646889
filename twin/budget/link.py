"""Link budget of one pixel in closed form, for arrays of designs at once.

Rates in electrons per second; the on-axis formula, as in the paper, without the cosines of the
field (their mean is 0.93 over 20 degrees, see `mean_cos_power`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from twin.errors import InputError

Number = float | NDArray[np.float64]


@dataclass(frozen=True)
class OpticalLink:
    """Parameters of a link; every field may be an array, and all arrays broadcast.

    ``in_band``: share of the emitter's line inside the filter. ``sun_w_per_m2``: irradiance of the
    sun in the band, at normal incidence on the object. ``shot_variance``: variance over mean of the
    electrons at the detector's terminals, M F of an avalanche photodiode. ``lit_share``: of the
    detector's field, what the emitter lights.
    """

    radiant_intensity_w_per_sr: Number
    in_band: Number
    transmission: Number
    f_number: Number
    pixel_area_m2: Number
    responsivity_a_per_w: Number
    dark_current_a: Number
    sun_w_per_m2: Number
    shot_variance: Number = 1.0
    lit_share: Number = 1.0

    def signal_e_per_s(self, reflectance: Number, distance_m: Number) -> Number:
        """Photo-electrons per second from the emitter, all cells lit. Raises InputError for a
        reflectance outside 0 to 1, and for a distance that is not above 0.
        """
        if not np.all(np.asarray(distance_m) > 0):
            raise InputError(f"distance_m: {np.min(distance_m):g} m, expected above 0")
        irradiance = self.radiant_intensity_w_per_sr * self.in_band / np.square(distance_m)
        return self._electrons(self.lit_share * irradiance, reflectance)

    def background_e_per_s(self, reflectance: Number) -> Number:
        """Photo-electrons per second from the sun, and thermal ones. Raises InputError for a
        reflectance outside 0 to 1.
        """
        return self._electrons(self.sun_w_per_m2, reflectance) + self.dark_current_a / constants.e

    def _electrons(self, irradiance: Number, reflectance: Number) -> Number:
        """Rho E tau A / (4 N^2 + 1) through the responsivity."""
        if not np.all((np.asarray(reflectance) >= 0) & (np.asarray(reflectance) <= 1)):
            worst = np.max(reflectance) if np.max(reflectance) > 1 else np.min(reflectance)
            raise InputError(f"reflectance: {worst:g}, expected 0 to 1")
        collected = self.transmission * self.pixel_area_m2 / (4 * np.square(self.f_number) + 1)
        return reflectance * irradiance * collected * self.responsivity_a_per_w / constants.e


def noise_e(
    signal: Number, background: Number, time_s: Number, read_e: Number, shot_variance: Number = 1.0
) -> Number:
    """Shot noise of all collected electrons, with the read noise."""
    return np.sqrt(shot_variance * (signal + background) * time_s + np.square(read_e))


def minimum_time_s(
    signal: Number,
    background: Number,
    read_e: Number,
    snr: Number = 1.0,
    shot_variance: Number = 1.0,
) -> Number:
    """Shortest integration whose signal is ``snr`` times its noise.

    s T = snr sqrt(v (s + b) T + r^2), solved for T; infinite without signal.
    """
    half = np.square(snr) * shot_variance * (signal + background) / 2
    root = np.sqrt(half**2 + np.square(snr * signal * read_e))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(signal > 0, (half + root) / np.square(signal), np.inf)


def maximum_distance_m(
    signal_at_1_m: Number,
    background: Number,
    time_s: Number,
    read_e: Number,
    snr: Number = 1.0,
    shot_variance: Number = 1.0,
) -> Number:
    """Farthest distance at which the signal is ``snr`` times the noise after ``time_s``.

    It needs s = k (k v + sqrt(k^2 v^2 + 4 (v b T + r^2))) / (2 T) with k = snr, v the shot
    variance, and s falls with 1/z^2.
    """
    own = snr * shot_variance
    rest = shot_variance * background * time_s + np.square(read_e)
    needed = snr * (own + np.sqrt(np.square(own) + 4 * rest)) / (2 * time_s)
    return np.sqrt(signal_at_1_m / needed)


def implied_read_noise_e(
    signal: Number, background: Number, time_s: Number, shot_variance: Number = 1.0
) -> Number:
    """Read noise with which ``time_s`` gives SNR 1; 0 where shot noise alone is too high."""
    excess = np.square(signal * time_s) - shot_variance * (signal + background) * time_s
    return np.sqrt(np.maximum(excess, 0.0))


def distance_sigma_m(snr: Number, modulation_hz: Number, depth: Number = 1.0) -> Number:
    """Standard deviation of a distance from the phase of continuous-wave modulation.

    c / (4 pi f) x sqrt(2) / (m SNR), SNR that of the whole integration (Lange and Seitz, IEEE J.
    Quantum Electron. 37, 2001, for shot noise alone).
    """
    return constants.c / (4 * np.pi * modulation_hz) * np.sqrt(2) / (depth * snr)
