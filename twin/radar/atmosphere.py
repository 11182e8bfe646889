"""Attenuation of the radar's wave by rain (ITU-R P.838) and gases (ITU-R P.676)."""

from typing import Literal

from twin.system import Weather

Polarization = Literal["horizontal", "vertical"]

#: Of the ground-level standard atmosphere, ITU-R P.835.
STANDARD_TEMPERATURE_K = 288.15
STANDARD_PRESSURE_PA = 101325.0
STANDARD_WATER_VAPOUR_KG_PER_M3 = 7.5e-3


def two_way_attenuation_db_per_m(
    weather: Weather, carrier_hz: float, polarization: Polarization = "vertical"
) -> float:
    """Loss of an echo per metre of range, there and back, dB/m, on a level path.

    Fog and snow are left out: fog of 0.1 g/m^3 costs some 0.3 dB/km one way at 79 GHz (P.840),
    dry snow less; wet snow may cost as much as rain. The backscatter of rain is left out too.
    Raises ValueError outside 1 to 350 GHz, where P.676 line by line and P.838 both hold.
    """
    if not 1e9 <= carrier_hz <= 350e9:
        raise ValueError(f"carrier_hz: {carrier_hz:g} is not between 1e9 and 350e9")
    one_way_db_per_km = rain_db_per_km(weather, carrier_hz, polarization)
    one_way_db_per_km += gas_db_per_km(weather, carrier_hz)
    return 2 * one_way_db_per_km / 1e3


def rain_db_per_km(weather: Weather, carrier_hz: float, polarization: Polarization) -> float:
    """Specific attenuation k R^alpha of ITU-R P.838-3, one way, dB/km."""
    if weather.rain_mm_per_h is None or weather.rain_mm_per_h.value == 0:
        return 0.0
    from itur.models.itu838 import rain_specific_attenuation

    tilt = 0.0 if polarization == "horizontal" else 90.0
    rate = weather.rain_mm_per_h.value
    return float(rain_specific_attenuation(rate, carrier_hz / 1e9, 0.0, tilt).value)


def gas_db_per_km(weather: Weather, carrier_hz: float) -> float:
    """Specific attenuation of oxygen and water vapour, ITU-R P.676, one way, dB/km."""
    from itur.models.itu676 import gamma0_exact, gammaw_exact

    temperature = weather.temperature_k.value if weather.temperature_k else STANDARD_TEMPERATURE_K
    pressure = weather.pressure_pa.value if weather.pressure_pa else STANDARD_PRESSURE_PA
    vapour = (
        weather.water_vapour_kg_per_m3.value
        if weather.water_vapour_kg_per_m3
        else STANDARD_WATER_VAPOUR_KG_PER_M3
    )
    # itur asks for the pressure of dry air, hPa: what is left without the vapour's own.
    vapour_hpa = vapour * 1e3 * temperature / 216.7
    arguments = (carrier_hz / 1e9, pressure / 100 - vapour_hpa, vapour * 1e3, temperature)
    return float(gamma0_exact(*arguments).value) + float(gammaw_exact(*arguments).value)
