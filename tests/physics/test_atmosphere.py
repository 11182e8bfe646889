"""The radar's attenuation against the recommendations' printed figures."""

import numpy as np
import pytest

from hardware.waveform import C_M_PER_S
from twin.radar.propagation.scene import itu_r
from twin.radar.propagation.scene.atmosphere import Atmosphere, gas_db_per_km, rain_db_per_km
from twin.system import Weather, load_part

CLEAR, RAIN = load_part("clear-air").weather, load_part("rain-10").weather


def test_rain_is_p838s_table_at_80_ghz() -> None:
    """ITU-R P.838-3, Table 5: k 1.1704, alpha 0.7115 horizontal; 1.1668, 0.7021 vertical."""
    for polarization, k, alpha in (("horizontal", 1.1704, 0.7115), ("vertical", 1.1668, 0.7021)):
        found = rain_db_per_km(RAIN, 80e9, polarization)
        assert found == pytest.approx(k * 10**alpha, rel=1e-3)
    assert rain_db_per_km(CLEAR, 80e9, "vertical") == 0


@pytest.mark.parametrize(
    ("frequency_ghz", "oxygen", "water_vapour"),
    [
        (12, 0.00869826, 0.00953539),
        (20, 0.01188355, 0.09704730),
        (60, 14.62347480, 0.15484184),
        (90, 0.03886971, 0.34197339),
        (130, 0.04150908, 0.75184470),
    ],
)
def test_gases_are_the_validation_examples_of_study_group_3(
    frequency_ghz: float, oxygen: float, water_vapour: float
) -> None:
    """ITU-R, CG-3M3J-13-ValEx: dry air of 1013.25 hPa, 7.5 g/m^3 of vapour, 288.15 K."""
    found = itu_r.gas_db_per_km(frequency_ghz * 1e9, 1013.25, 7.5, 288.15)
    assert found == pytest.approx(oxygen + water_vapour, abs=1e-8)


@pytest.mark.parametrize(
    ("conditions", "expected"),
    [
        ((24e9, 1000.0, 12.0, 300.0), 0.2626376920596893),
        ((79e9, 900.0, 3.0, 270.0), 0.18293039192419092),
        ((325e9, 700.0, 1.0, 250.0), 7.2240158537292745),
    ],
)
def test_gases_are_iturs(conditions: tuple[float, ...], expected: float) -> None:
    """The package `itur`, 0.4.0: carrier, dry air in hPa, vapour in g/m^3, temperature."""
    assert itu_r.gas_db_per_km(*conditions) == pytest.approx(expected, rel=1e-14)


def test_gases_have_p676s_peaks() -> None:
    """P.676, Fig. 1, standard atmosphere: about 15 dB/km at 60 GHz, 0.2 at 22.2 GHz, and a window
    of 0.3 to 0.4 dB/km between 75 and 85 GHz.
    """
    assert gas_db_per_km(CLEAR, 60e9) == pytest.approx(15, abs=1)
    assert gas_db_per_km(CLEAR, 22.235e9) == pytest.approx(0.2, abs=0.03)
    assert 0.3 < gas_db_per_km(CLEAR, 79e9) < 0.42


def test_an_echo_pays_twice() -> None:
    one_way = rain_db_per_km(RAIN, 79e9, "vertical") + gas_db_per_km(RAIN, 79e9)
    air, delay_s = Atmosphere(RAIN), np.array(2 * 150.0 / C_M_PER_S)
    lost = -20 * np.log10(air.amplitude_transmission(delay_s, 79e9))
    assert lost == pytest.approx(0.3 * one_way)
    assert -20 * np.log10(air.amplitude_transmission(delay_s, 2.45e9)) < lost / 100
    assert Atmosphere().amplitude_transmission(delay_s, 79e9) == 1


def test_dry_air_leaves_the_oxygen() -> None:
    values = {"single_scattering_albedo": 0.0, "asymmetry": 0.0}
    dry = Weather.model_validate(values | {"water_vapour_kg_per_m3": 0.0})
    assert 0.02 < gas_db_per_km(dry, 79e9) < gas_db_per_km(CLEAR, 79e9) / 2


def test_carriers_outside_the_recommendations_are_refused() -> None:
    with pytest.raises(ValueError, match="carrier_hz: 4e\\+11"):
        Atmosphere(CLEAR).db_per_m(4e11)
