"""Attenuation of the radar's wave by rain (ITU-R P.838) and gases (ITU-R P.676)."""

from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.errors import InputError
from twin.optics.weather import OwnWeather, own_weather
from twin.radar.propagation.scene import itu_r
from twin.radar.propagation.scene.itu_r import Polarization
from twin.system import Weather

#: Of the ground-level standard atmosphere, ITU-R P.835.
STANDARD_TEMPERATURE_K = 288.15
STANDARD_PRESSURE_PA = 101325.0
STANDARD_WATER_VAPOUR_KG_PER_M3 = 7.5e-3


@dataclass(frozen=True)
class Atmosphere:
    """The air of some weather, the same everywhere, on level paths; None: it does not attenuate.

    Fog and snow are left out: fog of 0.1 g/m^3 costs some 0.3 dB/km one way at 79 GHz (P.840),
    dry snow less; wet snow may cost as much as rain. The backscatter of rain is left out too.
    """

    weather: Weather | None = None
    polarization: Polarization = "vertical"

    def db_per_m(self, carrier_hz: float) -> float:
        """Attenuation of power per metre of path.

        Raises InputError outside 1 to 350 GHz, where P.676 line by line and P.838 both hold.
        """
        if self.weather is None:
            return 0.0
        if (own := own_weather(self.weather)) is not None:
            return _own_db_per_m(own, carrier_hz)
        if not 1e9 <= carrier_hz <= 350e9:
            raise InputError(
                f"carrier_hz: {carrier_hz:g} is not between 1e9 and 350e9, where the attenuation "
                "of air and rain is known"
            )
        rain = rain_db_per_km(self.weather, carrier_hz, self.polarization)
        return (rain + gas_db_per_km(self.weather, carrier_hz)) / 1e3

    def amplitude_transmission(
        self, delay_s: NDArray[np.float64], carrier_hz: float
    ) -> NDArray[np.float64]:
        """Amplitude over that without air, of a wave after a delay: both ways, for an echo."""
        db_per_s = C_M_PER_S * self.db_per_m(carrier_hz)
        return np.asarray(10 ** (-db_per_s * delay_s / 20), dtype=np.float64)

    def describe(self, carrier_hz: float) -> str:
        """What the air does, in words."""
        if self.weather is None:
            return "air is clear and does not attenuate"
        if (own := own_weather(self.weather)) is not None:
            decibel = 1e3 * _own_db_per_m(own, carrier_hz)
            return f"{type(own).__name__} attenuates by {decibel:.3g} dB/km one way"
        rate = self.weather.rain_mm_per_h
        rain = f"rain of {rate.value:g} mm/h (ITU-R P.838) and " if rate and rate.value else ""
        return (
            f"{rain}gases (ITU-R P.676) attenuate by {1e3 * self.db_per_m(carrier_hz):.3g} dB/km "
            "one way; fog, snow and the rain's own echo are left out"
        )


def _own_db_per_m(own: OwnWeather, carrier_hz: float) -> float:
    with np.errstate():  # what it may set ends with it, as of `OwnFunction`
        db_per_m: object = own.db_per_m(carrier_hz)
    if isinstance(db_per_m, Real) and 0 <= (value := float(db_per_m)) < np.inf:
        return value
    raise InputError(
        f"weather.function: db_per_m gave {db_per_m!r:.60}, expected a number from 0 on"
    )


def rain_db_per_km(weather: Weather, carrier_hz: float, polarization: Polarization) -> float:
    """Specific attenuation k R^alpha of ITU-R P.838-3, one way, dB/km."""
    if weather.rain_mm_per_h is None or weather.rain_mm_per_h.value == 0:
        return 0.0
    return itu_r.rain_db_per_km(weather.rain_mm_per_h.value, carrier_hz, polarization)


def gas_db_per_km(weather: Weather, carrier_hz: float) -> float:
    """Specific attenuation of oxygen and water vapour, ITU-R P.676, one way, dB/km."""
    temperature = weather.temperature_k.value if weather.temperature_k else STANDARD_TEMPERATURE_K
    pressure = weather.pressure_pa.value if weather.pressure_pa else STANDARD_PRESSURE_PA
    vapour = (
        weather.water_vapour_kg_per_m3.value
        if weather.water_vapour_kg_per_m3
        else STANDARD_WATER_VAPOUR_KG_PER_M3
    )
    vapour_hpa = vapour * 1e3 * temperature / 216.7
    dry_air_hpa = pressure / 100 - vapour_hpa
    return itu_r.gas_db_per_km(carrier_hz, dry_air_hpa, vapour * 1e3, temperature)
