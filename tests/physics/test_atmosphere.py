"""The radar's attenuation against the recommendations' printed figures."""

import numpy as np
import pytest

from twin.system import Weather, load_part

pytest.importorskip("itur")

from twin.radar.propagation.scene.atmosphere import Air, gas_db_per_km, rain_db_per_km

CLEAR, RAIN = load_part("clear-air").weather, load_part("rain-10").weather


def test_rain_is_p838s_table_at_80_ghz() -> None:
    """ITU-R P.838-3, Table 5: k 1.1704, alpha 0.7115 horizontal; 1.1668, 0.7021 vertical."""
    for polarization, k, alpha in (("horizontal", 1.1704, 0.7115), ("vertical", 1.1668, 0.7021)):
        found = rain_db_per_km(RAIN, 80e9, polarization)
        assert found == pytest.approx(k * 10**alpha, rel=1e-3)
    assert rain_db_per_km(CLEAR, 80e9, "vertical") == 0


def test_gases_have_p676s_peaks() -> None:
    """P.676, Fig. 1, standard atmosphere: about 15 dB/km at 60 GHz, 0.2 at 22.2 GHz, and a window
    of 0.3 to 0.4 dB/km between 75 and 85 GHz.
    """
    assert gas_db_per_km(CLEAR, 60e9) == pytest.approx(15, abs=1)
    assert gas_db_per_km(CLEAR, 22.235e9) == pytest.approx(0.2, abs=0.03)
    assert 0.3 < gas_db_per_km(CLEAR, 79e9) < 0.42


def test_an_echo_pays_twice() -> None:
    one_way = rain_db_per_km(RAIN, 79e9, "vertical") + gas_db_per_km(RAIN, 79e9)
    air, length = Air(RAIN), np.array(2 * 150.0)
    lost = -20 * np.log10(air.amplitude(length, 79e9))
    assert lost == pytest.approx(0.3 * one_way)
    assert -20 * np.log10(air.amplitude(length, 2.45e9)) < lost / 100
    assert Air().amplitude(length, 79e9) == 1


def test_dry_air_leaves_the_oxygen() -> None:
    values = {"single_scattering_albedo": 0.0, "asymmetry": 0.0}
    dry = Weather.model_validate(values | {"water_vapour_kg_per_m3": 0.0})
    assert 0.02 < gas_db_per_km(dry, 79e9) < gas_db_per_km(CLEAR, 79e9) / 2


def test_carriers_outside_the_recommendations_are_refused() -> None:
    with pytest.raises(ValueError, match="carrier_hz: 4e\\+11"):
        Air(CLEAR).db_per_m(4e11)
