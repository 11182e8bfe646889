"""Text with a unit: the double nearest to the exact value, of the right dimension, or an error."""

import math
import sys
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.drivers.settings import read_settings
from hardware.errors import InputError
from hardware.units import quantity, unit_of


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("200 um", "m", 200e-6),
        ("200 µm", "m", 200e-6),  # micro sign
        ("200 μm", "m", 200e-6),  # Greek mu
        ("12nm", "m", 12e-9),
        ("315 us", "s", 315e-6),
        ("2 min", "s", 120.0),
        ("20 klx", "lx", 20e3),
        ("79 GHz", "Hz", 79e9),
        ("4 1/ms", "Hz", 4e3),
        ("0.95 A/W", "A/W", 0.95),
        ("36 km/h", "m/s", 10.0),
        ("1 g/m³", "kg/m^3", 1e-3),
        ("5 cm^2", "m^2", 5e-4),
        ("4 mm2", "m^2", 4e-6),
        ("1013.25 hPa", "Pa", 101325.0),
        ("1 kΩ", "ohm", 1e3),
        ("3 pF", "F", 3e-12),
        ("1 mW/sr", "W/sr", 1e-3),
        ("1 kg m2 s-3", "W", 1.0),
        ("-7 deg", "deg", -7.0),
        ("30 arcmin", "deg", 0.5),
        ("3.141592653589793 rad", "deg", 180.0),
        ("20 degC", "K", 293.15),
        ("-20 °C", "K", 253.15),
        ("10 dBm", "W", 0.01),
        ("-3 dBW", "W", 10**-0.3),
        ("10 dBsm", "m^2", 10.0),
        ("3 dB", "dB", 3.0),
        ("20 dBi", "dBi", 20.0),
        ("-90 dBc/Hz", "dBc/Hz", -90.0),
        ("85 %", None, 0.85),
        ("20 ppm", None, 20e-6),
    ],
)
def test_quantities_are_exact(text: str, unit: str | None, value: float) -> None:
    """But for rad and levels, whose factors are no decimal fractions."""
    found = quantity(text, unit)
    assert found == (pytest.approx(value, rel=1e-14) if "rad" in text or "dB" in text else value)


def test_no_digit_beyond_ascii_is_read_as_one_of_a_number() -> None:
    """Of every numeral of Unicode, in and behind a number and, but for superscripts, in a unit:
    "10³ Hz" is neither 103 Hz nor anything else. A number behind the number is no unit.
    """
    numerals = [c for c in map(chr, range(128, sys.maxunicode + 1)) if c.isnumeric()]
    assert len(numerals) > 1000
    for c in numerals:
        texts = [f"10{c} Hz", f"1{c}0 Hz", f"{c} Hz", f"1e3{c} Hz", f"10 {c} Hz", f"10.{c} Hz"]
        for text in texts + ([] if c in "¹²³⁴⁵⁶⁷⁸⁹" else [f"10 Hz{c}"]):
            with pytest.raises(InputError, match="expected a number"):
                quantity(text, "Hz", bare=True)
        with pytest.raises(InputError, match="expected a number"):
            quantity(f"1{c} %", None, bare=True)
        with pytest.raises(InputError, match="expected a number"):
            quantity(f"1{c}", "Hz", bare=True)
    for text in ("10 12 Hz", "10 1^3 Hz", "10 2 Hz"):
        with pytest.raises(InputError, match="no known unit"):
            quantity(text, "Hz")


@pytest.mark.parametrize(
    ("text", "unit", "told"),
    [
        ("20 klx", "m", "in m; 'klx' is of another dimension"),
        ("3 m", "deg", "another dimension"),
        ("3 kg", "kg/m^3", "another dimension"),
        ("10 dB", "dBi", "another dimension|known unit"),
        ("10 dBm", "m", "'dBm' is of another dimension"),
        ("2", "dB", "the unit is missing"),
        ("12", "m", "the unit is missing"),
        ("3 furlong", "m", "'furlong' is no known unit"),
        ("3 m/", "m", "'m/' is no known unit"),
        ("3 //m", "m", "no known unit"),
        ("3 kdeg", "deg", "no known unit"),
        ("m", "m", "expected a number or a quantity in m"),
        ("nan m", "m", "expected a number or a quantity in m"),
        ("1e400 m", "m", "too large"),
        ("1e999999999 m", "m", "expected a number or a quantity in m"),
        ("9" * 10_000 + " m", "m", "expected a number or a quantity in m"),
        ("85", None, "expected a number, or per cent"),
        ("85 m", None, "expected a number, or per cent"),
    ],
)
def test_other_text_says_what_was_expected(text: str, unit: str | None, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        quantity(text, unit)


@given(st.floats(-1e30, 1e30), st.sampled_from(["m", "W/sr", "dB", "K", "dBc/Hz"]))
def test_numbers_in_their_own_unit_stay_as_they_are(value: float, unit: str) -> None:
    assert quantity(f"{value!r} {unit}", unit) == value
    assert quantity(repr(value), unit, bare=True) == value


@given(st.text(max_size=20))
def test_any_text_is_a_number_or_a_value_error(text: str) -> None:
    with suppress(ValueError):
        assert math.isfinite(quantity(f"1{text}", "m"))


def test_names_say_their_unit_by_the_longest_end_that_fits() -> None:
    assert unit_of("velocity_m_per_s") == "m/s"
    assert unit_of("conductivity_s_per_m") == "S/m"
    assert unit_of("phase_noise_dbc_per_hz") == "dBc/Hz"
    assert unit_of("n_slots") is None


def test_settings_of_a_camera_say_their_units(tmp_path) -> None:
    path = tmp_path / "camera.toml"
    text = 'integration_time_s = "315 us"\n[patterns]\nrows = 8\ncolumns = 8\ncount = 64\n'
    path.write_text(text)
    assert read_settings(path).integration_time_s == 315e-6
    path.write_text(text.replace("us", "um"))
    with pytest.raises(ValueError, match=r"camera\.toml: integration_time_s = '315 um': .* in s;"):
        read_settings(path)
