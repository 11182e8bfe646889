"""Link budget of one pixel in closed form, for arrays of designs at once.

Rates in electrons per second; the formula of the paper, whose numbers are those on the axis
(`link_of`) or means over the field (`field_link`).
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
    detector's field, what the emitter lights; over a field with its cosines.
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


@dataclass(frozen=True)
class LongerNoise:
    """Noise beside shot and read noise, which grows with the exposure; every field may be an array.

    ``e2_per_s``: variance that grows as time does, j (an amplifier that averages has Johnson noise
    so). ``fluctuation``: of the emitter, relative, f. ``e_per_s``: what grows as the signal does, g
    (behind an amplifier that averages, the converter's rounding).
    """

    e2_per_s: Number = 0.0
    fluctuation: Number = 0.0
    e_per_s: Number = 0.0


NONE = LongerNoise()


def noise_e(
    signal: Number,
    background: Number,
    time_s: Number,
    read_e: Number,
    shot_variance: Number = 1.0,
    longer: LongerNoise = NONE,
) -> Number:
    """Shot noise of all collected electrons, with the read noise, and with noise that grows with
    the exposure.
    """
    shot = (shot_variance * (signal + background) + longer.e2_per_s) * time_s
    steady = np.square(longer.fluctuation * signal) + np.square(longer.e_per_s)
    return np.sqrt(shot + np.square(read_e) + steady * np.square(time_s))


def minimum_time_s(
    signal: Number,
    background: Number,
    read_e: Number,
    snr: Number = 1.0,
    shot_variance: Number = 1.0,
    longer: LongerNoise = NONE,
) -> Number:
    """Shortest integration whose signal is ``snr`` times its noise.

    s T = k sqrt((v (s + b) + j) T + r^2 + (f^2 s^2 + g^2) T^2) with k = snr, solved for T; infinite
    where no time is long enough.
    """
    half = np.square(snr) * (shot_variance * (signal + background) + longer.e2_per_s) / 2
    steady = np.square(longer.fluctuation * signal) + np.square(longer.e_per_s)
    net = np.square(signal) - np.square(snr) * steady
    root = np.sqrt(half**2 + np.maximum(net, 0) * np.square(snr * read_e))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((signal > 0) & (net > 0), (half + root) / net, np.inf)


def maximum_distance_m(
    signal_at_1_m: Number,
    background: Number,
    time_s: Number,
    read_e: Number,
    snr: Number = 1.0,
    shot_variance: Number = 1.0,
    longer: LongerNoise = NONE,
) -> Number:
    """Farthest distance at which the signal is ``snr`` times the noise after ``time_s``; 0 where it
    is at none.

    It needs s = k (k v + sqrt(k^2 v^2 + 4 u ((v b + j) T + r^2 + g^2 T^2))) / (2 u T) with
    k = snr, v the shot variance, u = 1 - k^2 f^2, and s falls with 1/z^2.
    """
    own = snr * shot_variance
    rest = (shot_variance * background + longer.e2_per_s) * time_s + np.square(read_e)
    rest = rest + np.square(longer.e_per_s * time_s)
    net = np.maximum(1 - np.square(snr * longer.fluctuation), 0)
    needed = snr * (own + np.sqrt(np.square(own) + 4 * net * rest)) / (2 * time_s)
    return np.sqrt(signal_at_1_m * net / needed)


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
