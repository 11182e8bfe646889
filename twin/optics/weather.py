"""Extinction and scattering of light by fog, rain, snow, smoke and clear air.

Empirical laws, accurate to a factor only: fogs of one visibility differ by 2 and more. The air is
homogeneous, and its particles scatter independently of each other.
"""

import math
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from twin.files import InputError
from twin.own_parts import made_by
from twin.system import System, Weather
from twin.system.environment import BACKWARD_ASYMMETRY, backward_phase, most_backward_share

Array = NDArray[np.float64]

#: Mulholland and Croarkin, Fire and Materials 24 (2000) 227: 8.7 m^2/g at 633 nm, flaming fires.
_SMOKE_M2_PER_KG = (8.7e3, 633e-9)
_PER_M_FROM_DB_PER_KM = math.log(10) / 10 / 1e3


@dataclass(frozen=True)
class Air:
    """Homogeneous air at one wavelength.

    ``extinction_per_m``, of which ``scattering_per_m`` is scattering, the rest absorption.
    ``asymmetry``: mean cosine of the scattering angle. ``backward_share``: part of the scattered
    light in a lobe towards the source (`BACKWARD_ASYMMETRY`); the rest follows Henyey and
    Greenstein (1941) with the asymmetry that preserves the mean cosine.
    Raises InputError for impossible values.
    """

    extinction_per_m: float
    scattering_per_m: float
    asymmetry: float
    backward_share: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.scattering_per_m <= self.extinction_per_m < math.inf:
            raise InputError(
                f"scattering_per_m: {self.scattering_per_m:g} is not between 0 and "
                f"extinction_per_m, {self.extinction_per_m:g}"
            )
        if not (0 <= self.backward_share < 1 and abs(self.forward_asymmetry) < 1):
            raise InputError(
                f"asymmetry: {self.asymmetry:g} with backward_share {self.backward_share:g}: "
                "no phase function has both"
            )

    @property
    def forward_asymmetry(self) -> float:
        """Mean cosine of the light outside the backward lobe."""
        lobe = self.backward_share * BACKWARD_ASYMMETRY
        return (self.asymmetry - lobe) / (1 - self.backward_share)

    @property
    def surface_extinction_per_m(self) -> float:
        """Extinction of light to and from surfaces where scattering is not traced: the extinction
        less the forward peak, scattering x g^2, which is treated as unscattered (delta scaling;
        Joseph, Wiscombe and Weinman, J. Atmos. Sci. 33, 1976).

        This preserves the mean level of an image, but not its contrast: forward scattered light
        stays in its own cell. The contrast of fine stripes, in fog at 10 m over a field of 20
        degrees, is 1.16 times too high at an optical depth of 0.20, 1.8 times at 0.78.
        """
        return self.extinction_per_m - self.scattering_per_m * self.asymmetry**2

    def phase(self, cosine: Any) -> Array:
        """Phase function, 1/sr, at the cosine of the scattering angle (1: straight on)."""
        share = self.backward_share
        value = (1 - share) * henyey_greenstein(self.forward_asymmetry, cosine)
        return value + share * henyey_greenstein(BACKWARD_ASYMMETRY, cosine) if share else value

    @property
    def backscatter_per_m_sr(self) -> float:
        """Backscatter coefficient, 1/(m sr)."""
        return self.scattering_per_m * float(self.phase(-1.0))

    def transmission(self, length_m: Any) -> Array:
        """Beer-Lambert transmission of a path of this length."""
        return np.exp(-self.extinction_per_m * np.asarray(length_m, dtype=np.float64))


@runtime_checkable
class OwnWeather(Protocol):
    """A user's own weather: what the air does to light, and to the radar's wave.

    >>> class Dust:
    ...     "Desert dust of so many grams a cubic metre."
    ...
    ...     def __init__(self, weather):
    ...         self.g_per_m3 = 0.1
    ...
    ...     def air(self, wavelength_m):
    ...         extinction = 0.3 * self.g_per_m3
    ...         return Air(extinction, 0.9 * extinction, asymmetry=0.7)
    ...
    ...     def db_per_m(self, carrier_hz):
    ...         return 1e-5 * self.g_per_m3 * (carrier_hz / 79e9)
    >>> from twin.system import load_system
    >>> dusty = load_system("workable").with_({"weather": {"function": Dust}})
    >>> f"{air_of_system(dusty).transmission(10.0):.2f}"
    '0.74'
    """

    def air(self, wavelength_m: float) -> Air:
        """Extinction, scattering and phase function of light."""

    def db_per_m(self, carrier_hz: float) -> float:
        """Attenuation of the radar's power per metre of way, one way, dB/m."""


def own_weather(weather: Weather) -> OwnWeather | None:
    """What a weather's ``function`` makes of it; None without one. Raises InputError."""
    if weather.function is None:
        return None
    own: OwnWeather = made_by("weather.function", weather.function.value, weather, OwnWeather)
    return own


def _own_air(own: OwnWeather, wavelength_m: float) -> Air:
    with np.errstate():  # what it may set ends with it, as of `OwnFunction`
        air = own.air(wavelength_m)
    if isinstance(air, Air):
        return air
    raise InputError(
        f"weather.function: {type(own).__name__}.air gave a {type(air).__name__}, expected a "
        "twin.Air"
    )


def air_of(weather: Weather, wavelength_m: float) -> Air:
    """Air of a weather at a wavelength; with a ``function``, what that says."""
    if (own := own_weather(weather)) is not None:
        return _own_air(own, wavelength_m)
    extinction = extinction_per_m(weather, wavelength_m)
    albedo, asymmetry = weather.single_scattering_albedo.value, weather.asymmetry.value
    ratio = weather.lidar_ratio_sr
    share = 0.0
    if ratio is not None and albedo > 0:
        share = _backward_share(1 / (ratio.value * albedo), asymmetry)
    return Air(extinction, albedo * extinction, asymmetry, share)


def air_of_system(system: System) -> Air | None:
    """Air at the peak of the system's emitter; None without a weather."""
    if system.weather is None:
        return None
    return air_of(system.weather, system.emitter.peak_wavelength_m.value)


def extinction_per_m(weather: Weather, wavelength_m: float) -> float:
    """Extinction coefficient, 1/m: the sum over all particles of the weather."""
    total = 0.0
    if weather.visibility_m is not None:
        model = weather.visibility_model.value if weather.visibility_model else "kim"
        exponent = kim_exponent if model == "kim" else kruse_exponent
        visibility = weather.visibility_m.value
        total += float(fog_extinction_per_m(visibility, wavelength_m, exponent(visibility)))
    if weather.rain_mm_per_h is not None:
        total += float(rain_extinction_per_m(weather.rain_mm_per_h.value))
    if weather.snow_mm_per_h is not None and weather.snow_kind is not None:
        wet = weather.snow_kind.value == "wet"
        rate = weather.snow_mm_per_h.value
        total += float(snow_extinction_per_m(rate, wavelength_m, wet=wet))
    if weather.smoke_kg_per_m3 is not None:
        total += float(smoke_extinction_per_m(weather.smoke_kg_per_m3.value, wavelength_m))
    return total


def fog_extinction_per_m(visibility_m: Any, wavelength_m: Any, exponent: Any) -> Array:
    """Koschmieder with 2 % contrast at 550 nm: (3.91 / V) (wavelength / 550 nm)^-q, 1/m.

    V counts the molecules too. Alone they scatter 2e-7 per m at 1550 nm, 0.4 % of clear air's.
    """
    visibility = np.asarray(visibility_m, dtype=np.float64)
    ratio = np.asarray(wavelength_m, dtype=np.float64) / 550e-9
    return np.asarray(3.91 / visibility * ratio ** -np.asarray(exponent))


def kim_exponent(visibility_m: Any) -> Array:
    """Exponent q of Kim, McArthur and Korevaar, Proc. SPIE 4214 (2001): 0 in dense fog."""
    v = np.asarray(visibility_m, dtype=np.float64) / 1e3
    steps = [v > 50, v > 6, v > 1, v > 0.5]
    return np.asarray(np.select(steps, [1.6, 1.3, 0.16 * v + 0.34, v - 0.5], 0.0))


def kruse_exponent(visibility_m: Any) -> Array:
    """Exponent q of Kruse, McGlauchlin and McQuistan (1962): 0.585 V^(1/3) below 6 km."""
    v = np.asarray(visibility_m, dtype=np.float64) / 1e3
    return np.asarray(np.select([v > 50, v > 6], [1.6, 1.3], 0.585 * np.cbrt(v)))


def rain_extinction_per_m(rate_mm_per_h: Any) -> Array:
    """1.076 R^0.67 dB/km (Carbonneau and Wisely 1998, in ITU-R P.1814), 1/m; at any wavelength."""
    rate = np.asarray(rate_mm_per_h, dtype=np.float64)
    return _PER_M_FROM_DB_PER_KM * 1.076 * rate**0.67


def snow_extinction_per_m(rate_mm_per_h: Any, wavelength_m: float, *, wet: bool) -> Array:
    """ITU-R P.1814: a S^b dB/km, wet or dry, with S the melted rate; 1/m."""
    nm = wavelength_m * 1e9
    a, b = (1.023e-4 * nm + 3.7855466, 0.72) if wet else (5.42e-5 * nm + 5.4958776, 1.38)
    return _PER_M_FROM_DB_PER_KM * a * np.asarray(rate_mm_per_h, dtype=np.float64) ** b


def smoke_extinction_per_m(density_kg_per_m3: Any, wavelength_m: float) -> Array:
    """Soot of flaming fires by mass; falls as 1/wavelength (assumed: small absorbers), 1/m."""
    specific, at = _SMOKE_M2_PER_KG
    return np.asarray(density_kg_per_m3, dtype=np.float64) * specific * at / wavelength_m


def henyey_greenstein(asymmetry: float, cosine: Any) -> Array:
    """(1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5), 1/sr."""
    g = asymmetry
    base = 1 + g * g - 2 * g * np.asarray(cosine, dtype=np.float64)
    return (1 - g * g) / (4 * math.pi * base**1.5)


def _backward_share(backscatter: float, asymmetry: float) -> float:
    """Share of the backward lobe for this value of the phase function at 180 degrees, 1/sr, which
    `Weather` has checked; where rounding leaves none, the nearest.
    """

    def excess(share: float) -> float:
        return backward_phase(asymmetry, share) - backscatter

    most = most_backward_share(asymmetry)
    if excess(0.0) >= 0:
        return 0.0
    if excess(most) <= 0:
        return most
    from scipy.optimize import brentq  # takes 0.2 s to import

    return float(brentq(excess, 0.0, most, xtol=1e-15))
