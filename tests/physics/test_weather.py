"""Weather's extinction and phase functions against published tables, and its parts."""

import math
from pathlib import Path

import pytest
from scipy import integrate

from twin.files import InputError
from twin.optics.weather import (
    Air,
    air_of,
    air_of_system,
    extinction_per_m,
    fog_extinction_per_m,
    kim_exponent,
    kruse_exponent,
    rain_extinction_per_m,
    snow_extinction_per_m,
)
from twin.system import Weather, load_part, load_system, part_names
from twin.system.environment import backward_phase, most_backward_share

DB_PER_KM = 1e4 / math.log(10)
WEATHERS = [name for name in part_names() if load_part(name).weather is not None]


# Extinction.


@pytest.mark.parametrize(
    ("visibility_m", "kruse", "kim"),
    [(50, 272, 340), (200, 60, 85), (500, 21, 34), (1000, 9, 10), (2000, 4, 4)],
)
def test_fog_is_the_printed_table_at_1550_nm(visibility_m, kruse, kim) -> None:
    """Tables of Kim, McArthur and Korevaar (2001), dB/km, as printed: whole numbers."""
    for exponent, printed in ((kruse_exponent, kruse), (kim_exponent, kim)):
        found = fog_extinction_per_m(visibility_m, 1550e-9, exponent(visibility_m))
        assert round(float(found) * DB_PER_KM) == printed


def test_fog_in_the_visible_is_what_visibility_means() -> None:
    """2 % are left at 550 nm, in whatever model."""
    weather = load_part("haze").weather
    assert math.exp(-extinction_per_m(weather, 550e-9) * 4e3) == pytest.approx(0.02, rel=5e-3)


def test_rain_and_snow_are_the_recommendations_figures() -> None:
    """ITU-R P.1814 at 1550 nm, dB/km at 1 mm/h: 1.08 of rain, 3.94 of wet and 5.58 of dry snow."""
    assert float(rain_extinction_per_m(1.0)) * DB_PER_KM == pytest.approx(1.076)
    assert float(rain_extinction_per_m(25.0)) * DB_PER_KM == pytest.approx(9.3, abs=0.05)
    assert float(snow_extinction_per_m(1.0, 1550e-9, wet=True)) * DB_PER_KM == pytest.approx(
        3.944, abs=1e-3
    )
    assert float(snow_extinction_per_m(1.0, 1550e-9, wet=False)) * DB_PER_KM == pytest.approx(
        5.580, abs=1e-3
    )


def test_what_a_weather_names_adds_up() -> None:
    haze, rain = load_part("haze").weather, load_part("rain-10").weather
    both = haze.model_copy(update={"rain_mm_per_h": rain.rain_mm_per_h})
    parts = extinction_per_m(haze, 1550e-9) + extinction_per_m(rain, 1550e-9)
    assert extinction_per_m(both, 1550e-9) == pytest.approx(parts)


def test_smoke_stops_short_waves_more() -> None:
    """8.7 m^2/g at 633 nm (Mulholland and Croarkin 2000), as 1 / wavelength."""
    smoke = load_part("smoke").weather
    assert extinction_per_m(smoke, 633e-9) == pytest.approx(50e-6 * 8.7e3)
    assert extinction_per_m(smoke, 1266e-9) == pytest.approx(50e-6 * 8.7e3 / 2)


# Phase function.


@pytest.mark.parametrize("name", WEATHERS)
def test_bundled_air_scatters_what_its_numbers_say(name: str) -> None:
    """Phase function of integral 1 and the stated mean cosine; backscatter by the lidar ratio."""
    weather = load_part(name).weather
    air = air_of(weather, 1550e-9)
    whole, mean = (
        integrate.quad(lambda c, k=k: 2 * math.pi * c**k * float(air.phase(c)), -1, 1)[0]
        for k in (0, 1)
    )
    assert whole == pytest.approx(1, abs=1e-7)
    assert mean == pytest.approx(weather.asymmetry.value, abs=1e-7)
    ratio = air.extinction_per_m / air.backscatter_per_m_sr
    assert ratio == pytest.approx(weather.lidar_ratio_sr.value, rel=1e-9)


def test_without_a_lidar_ratio_it_is_henyey_greenstein() -> None:
    weather = Weather.model_validate(
        {"visibility_m": 200.0, "single_scattering_albedo": 1.0, "asymmetry": 0.5}
    )
    air = air_of(weather, 1550e-9)
    assert float(air.phase(-1.0)) == pytest.approx(0.5 / (4 * math.pi * 1.5**2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("visibility_m = -1.0", r"weather\.visibility_m\.value = -1\.0"),
        ("snow_mm_per_h = 1.0", "both snow_mm_per_h and snow_kind"),
        ("single_scattering_albedo = 1.5", r"weather\.single_scattering_albedo\.value = 1\.5"),
        ("visibility_model = 'mie'", r"weather\.visibility_model"),
    ],
)
def test_a_wrong_weather_names_its_field(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "paper"\n[weather]\npart = "fog-200m"\n{text}\n')
    with pytest.raises(InputError, match=expected):
        load_system(path)


def test_a_system_has_the_air_of_its_part(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('base = "paper"\n[weather]\npart = "fog-200m"\n')
    assert air_of_system(load_system(path)) == air_of(load_part("fog-200m").weather, 1550e-9)
    assert air_of_system(load_system("paper")) is None


def test_an_impossible_lidar_ratio_says_what_is_possible() -> None:
    fog = load_part("fog-200m").weather
    for wrong in (0.1, 1e5):
        ratio = type(fog.lidar_ratio_sr)(value=wrong, source="test")
        with pytest.raises(InputError, match=r"lidar_ratio_sr = .*expected .* to "):
            fog.model_copy(update={"lidar_ratio_sr": ratio})
    for asymmetry in (-0.85, -0.8, 0.999):
        with pytest.raises(InputError, match=r"weather: lidar_ratio_sr = 18.8: expected"):
            load_system("workable").with_(
                {"weather.part": "fog-200m", "weather.asymmetry": asymmetry}
            )


@pytest.mark.parametrize("asymmetry", [-0.9, -0.5, 0.0, 0.85, 0.99])
def test_every_lidar_ratio_that_is_taken_has_a_phase_function(asymmetry: float) -> None:
    """Both ends of what the error says, and between: the air scatters back what the ratio says."""
    fog = load_part("fog-200m").weather
    low, high = (
        1 / backward_phase(asymmetry, share) / fog.single_scattering_albedo.value
        for share in (most_backward_share(asymmetry), 0.0)
    )
    low, high = min(low, high), max(low, high)
    for ratio in (1.01 * low, (low * high) ** 0.5, high * (1 - 1e-9)):
        given = {"asymmetry": asymmetry, "lidar_ratio_sr": ratio}
        air = air_of(fog.model_copy(update=given), 1550e-9)
        assert air.extinction_per_m / air.backscatter_per_m_sr == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize("values", [(1.0, 2.0, 0.0), (-1.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
def test_air_refuses_what_no_air_has(values) -> None:
    with pytest.raises(ValueError, match=r"scattering_per_m|asymmetry"):
        Air(*values)
