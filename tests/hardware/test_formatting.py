"""Figures as text: two digits of the error, SI prefixes, the same number read back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.formatting import number, quantity_text, setting_text, si, with_error
from hardware.units import quantity

FINITE = st.floats(1e-12, 1e9)


@pytest.mark.parametrize(
    ("figure", "text"),
    [
        ((10.0000036, 3.6e-6, "m"), "10.0000036 m ± 3.6 um"),
        ((140.0, 208e-6, "m"), "140.00000 m ± 210 um"),
        ((5.6373, 0.0002, "m"), "5.63730 m ± 200 um"),
        ((0.0, 0.005, "m/s"), "0.0000 ± 0.0050 m/s"),
        ((-1e-5, 0.013, "m/s"), "0.000 ± 0.013 m/s"),
        ((-3.21, 0.2, "dB"), "-3.21 ± 0.20 dB"),
        ((37.58, 0.0996, "dB"), "37.58 ± 0.10 dB"),
        ((0.9992934, 5.9e-7, ""), "0.99929340 ± 5.9e-7"),
        ((0.5, 0.0, ""), "0.5"),
        ((2.5e6, 2e4, "e-"), "2.500e6 ± 2.0e4 e-"),
        ((-3.21, math.inf, "dB"), "-3.21 dB, error not bounded"),
        ((math.nan, 1.0, "m"), "nan m"),
        ((-math.inf, math.nan, "dB"), "-inf dB"),
    ],
)
def test_a_figure_has_two_digits_of_its_error(figure: tuple[float, float, str], text: str) -> None:
    assert with_error(*figure) == text


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e5), st.sampled_from(["m", "dB", "s", ""]))
def test_what_is_printed_is_the_figure_to_its_error(value: float, error: float, unit: str) -> None:
    """Read back, the value is off by at most a twentieth of the error, and so is the error."""
    if error <= 1e-12 * abs(value):
        return
    shown, _, off = with_error(value, error, unit).partition(" ± ")
    prefixed = off.partition(" ")[2]
    value_text = shown if " " in shown or not prefixed else f"{shown} {prefixed}"
    read = _read(value_text, unit), _read(off, unit)
    assert read[1] == pytest.approx(error, rel=0.051)
    assert read[0] == pytest.approx(value, abs=0.051 * error + 1e-9 * abs(value))


def _read(text: str, unit: str) -> float:
    return quantity(text, unit) if unit in ("m", "s") else float(text.removesuffix(" dB"))


@given(FINITE)
def test_a_setting_reads_back_as_it_is_printed(value: float) -> None:
    """To 7 digits, in every unit that takes a prefix and in one that does not."""
    for name, unit in (("width_m", "m"), ("carrier_hz", "Hz"), ("field_deg", "deg")):
        assert quantity(setting_text(name, value), unit) == pytest.approx(value, rel=6e-7)


def test_settings_are_no_raw_values() -> None:
    assert setting_text("detector.width_m", np.float64(5e-5)) == "50 um"
    assert setting_text("a.gate_delays_s", [1e-8, 1e-8 / 3]) == "10 ns, 3.333333 ns"
    assert setting_text("a.curve", tuple(range(12))) == "0, 1, 2, 3, 4, 5, 6, 7, ... (12)"
    assert setting_text("a.levels_v", {"low": 0.1, "high": 5}) == "low 0.1, high 5"
    assert setting_text("sky.illuminance_lx", 100000.0) == "100 klx"
    assert setting_text("a.order", "sequency") == "sequency"
    assert setting_text("a.is_upload", np.bool_(True)) == "true"
    assert setting_text("a.adc_bits", 18) == "18"


def test_prefixes_end_where_digits_would_be_wrong() -> None:
    """Rounding up to the next prefix, and beyond the last prefixes."""
    assert si(0.99996, "m") == "1.00 m"
    assert si(999.96e-6, "s") == "1.00 ms"
    assert si(3.2e15, "Hz") == "3200 THz"
    assert si(-2e-9, "W", 2) == "-2.0 nW"
    assert number(999_999.9) == "1e6"
    assert number(-0.00012345) == "-0.000123"
    assert number(12345678.0, 4) == "1.235e7"
    assert quantity_text(math.inf, "m") == "inf m"
