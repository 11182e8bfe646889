"""Closed forms and spectra against published figures and brute-force integrals."""

import math

import numpy as np
import pytest
from designs import changed
from scipy import constants, integrate

from twin.budget.table1 import link_of
from twin.optics.radiometry import collection, mean_cos_power, wall_power_w
from twin.optics.solar_irradiance import sun_band_irradiance
from twin.optics.spectra import in_band_fraction
from twin.system import Part, load_system


def test_sun_in_the_band_is_that_of_the_standard() -> None:
    """ASTM G-173, direct and circumsolar: 3.250 W/m^2 in 1544-1556 nm at 100 klx (its global tilt,
    which holds the light of the sky as well, gives 2.967).
    """
    assert sun_band_irradiance(100e3, 1550e-9, 12e-9) == pytest.approx(3.250, rel=5e-4)


def test_sun_is_linear_in_illuminance_and_additive_in_bands() -> None:
    whole = sun_band_irradiance(5e4, 1550e-9, 30e-9)
    halves = sum(sun_band_irradiance(5e4, center, 15e-9) for center in (1542.5e-9, 1557.5e-9))
    assert halves == pytest.approx(whole, rel=1e-9)
    assert sun_band_irradiance(0.0, 1550e-9, 12e-9) == 0.0


def test_a_band_outside_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="outside the solar spectrum"):
        sun_band_irradiance(1e5, 5e-6, 1e-9)


def test_eleven_percent_of_the_led_line_pass_the_filter() -> None:
    """Against the numerical integral of the Gaussian line, for a shifted one as well."""
    paper = load_system("paper")
    assert in_band_fraction(paper.emitter, paper.filter) == pytest.approx(0.112, abs=5e-4)
    shifted = changed(paper, emitter__peak_wavelength_m=1570e-9)
    sigma = 100e-9 / math.sqrt(8 * math.log(2))
    share, _ = integrate.quad(
        lambda x: math.exp(-(((x - 1570) * 1e-9 / sigma) ** 2) / 2), 1544, 1556
    )
    expected = share * 1e-9 / (sigma * math.sqrt(2 * math.pi))
    assert in_band_fraction(shifted.emitter, shifted.filter) == pytest.approx(expected, rel=1e-9)


def test_detector_area_is_that_of_a_150_um_disc() -> None:
    """Not the 70 683 um^2 of the paper, which takes the diameter for the radius."""
    assert load_system("paper").detector.area_m2 == pytest.approx(17_671e-12, rel=1e-4)


@pytest.mark.parametrize("f_number", [0.7, 1.0, 4.0])
@pytest.mark.parametrize("stop", ["matched", "detector"])
def test_field_focal_length_and_pupil_are_one_choice(f_number: float, stop: str) -> None:
    """On axis: pupil x field = pi A / (4 N^2 + 1), whatever the field stop."""
    system = changed(load_system("paper"), optics__f_number=f_number, optics__field_stop=stop)
    lens = collection(system)
    etendue = lens.pupil_area_m2 * lens.field_area
    assert etendue == pytest.approx(
        math.pi * system.detector.area_m2 / (4 * f_number**2 + 1), rel=1e-12
    )
    assert lens.pupil_diameter_m == pytest.approx(lens.focal_length_m / f_number)


def test_a_150_um_disc_that_sees_20_deg_has_a_focal_length_of_0_425_mm() -> None:
    lens = collection(changed(load_system("paper"), optics__field_stop="detector"))
    assert lens.outline == "disc"
    assert lens.focal_length_m == pytest.approx(0.425e-3, rel=2e-3)


def test_mean_cosines_over_the_field() -> None:
    """Published: <cos^3> 0.96999, <cos^7> 0.93191 over a 20 deg square; disc by quadrature."""
    t = math.tan(math.radians(10))
    assert mean_cos_power(3, t, "square") == pytest.approx(0.96999, abs=1e-5)
    assert mean_cos_power(7, t, "square") == pytest.approx(0.93191, abs=1e-5)
    disc, _ = integrate.quad(lambda r: 2 * r / t**2 * (1 + r**2) ** -3.5, 0, t)
    assert mean_cos_power(7, t, "disc") == pytest.approx(disc, rel=1e-10)


def test_baseline_closed_form_against_brute_force() -> None:
    """Sum over 2000 x 2000 directions of the emitter, each followed to the detector's pupil."""
    system = load_system("paper")
    lens = collection(system)
    z, b, n = 2.0, 0.1, 2000
    x = (np.arange(n) + 0.5) / n * 2 - 1
    u, v = np.meshgrid(x * lens.tan_half_field, x * lens.tan_half_field)
    emitter_r = z * np.sqrt(1 + u**2 + v**2)
    dx, dy = u * z - b, v * z
    detector_r = np.sqrt(dx**2 + dy**2 + z**2)
    cos = z / detector_r
    seen = (np.abs(dx / z) <= lens.tan_half_field) & (np.abs(dy / z) <= lens.tan_half_field)
    solid_angle = (2 * lens.tan_half_field / n) ** 2 * (z / emitter_r) ** 3
    per_steradian = 0.5 / np.pi * cos * cos / detector_r**2
    intensity = system.emitter.radiant_intensity_w_per_sr.value
    watts = intensity * lens.transmission * lens.pupil_area_m2
    brute = watts * np.sum(np.where(seen, solid_angle * per_steradian, 0))
    assert wall_power_w(system, 0.5, z, b) == pytest.approx(brute, rel=1e-3)


@pytest.mark.parametrize(("outline", "lit_deg"), [("disc", 8.0), ("disc", 16.0), ("square", 8.0)])
def test_a_field_that_is_lit_in_part_against_brute_force(outline: str, lit_deg: float) -> None:
    """A field of 20 degrees, whose disc cuts the corners of a lit square of 16 degrees."""
    stop = {"disc": "detector", "square": "matched"}[outline]
    made = changed(
        load_system("paper"), optics__field_stop=stop, emitter__field_of_view_deg=lit_deg
    )
    lens, half, n = collection(made), math.tan(math.radians(lit_deg) / 2), 2000
    x = ((np.arange(n) + 0.5) / n * 2 - 1) * half
    u, v = np.meshgrid(x, x)
    seen = (outline == "square") | (np.hypot(u, v) <= lens.tan_half_field)
    mean = np.mean(seen * (1 + u**2 + v**2) ** -3.5)
    watts = made.emitter.radiant_intensity_w_per_sr.value * lens.transmission * lens.pupil_area_m2
    due = watts * 0.5 / np.pi * mean * 4 * half**2 / 4.0
    assert wall_power_w(made, 0.5, 2.0) == pytest.approx(due, rel=1e-3)
    share = link_of(made, Part(name="own", detector=made.detector)).lit_share
    assert share == pytest.approx(np.mean(seen) * 4 * half**2 / lens.field_area, rel=1e-3)


def test_ten_centimetres_of_baseline_lose_28_percent_at_1_m() -> None:
    """What geometry gives: 1 - b / (2 z tan 10 deg), 28.4 % at 1 m and 2.8 % at 10 m."""
    paper = load_system("paper")
    for z, share in ((1.0, 0.284), (10.0, 0.0284)):
        loss = 1 - wall_power_w(paper, 0.5, z, 0.1) / wall_power_w(paper, 0.5, z)
        assert loss == pytest.approx(share, abs=0.02 * share + 0.006)
    assert wall_power_w(paper, 0.5, 0.2, 0.1) == 0.0  # fields no longer overlap


@pytest.mark.parametrize(
    ("z", "rho", "t", "unfiltered", "filtered"),
    [
        (10.0, 0.8, 315e-6, 0.38, 0.042),
        (4.5, 0.5, 150e-6, 0.99, 0.11),
        (2.0, 0.2, 50e-6, 1.65, 0.19),
    ],
)
def test_the_papers_full_sun_image_is_noise(z, rho, t, unfiltered, filtered) -> None:
    """Signal over noise per pixel of the paper's design in full sun, as audited.

    Shot and dark noise only, 4096 differential pairs, bare on-axis formula (no cosines), which
    the audited figures use: so the wall's power is divided by <cos^7>; and the sun of ASTM G-173's
    global tilt, 2.967 W/m^2 in the band.
    """
    system = changed(
        load_system("paper"), acquisition__integration_time_s=t, acquisition__pattern_period_s=t
    )
    per_watt = system.detector.responsivity_a_per_w.value * t / constants.e
    signal_w = wall_power_w(system, rho, z) / 0.93191
    lens = collection(system)
    sun = 2.967 * rho / math.pi
    sun_w = sun * lens.transmission * lens.pupil_area_m2 * lens.field_area
    dark_e = system.detector.dark_current_a.value * t / constants.e
    share = in_band_fraction(system.emitter, system.filter)
    for fraction, expected in ((1.0, unfiltered), (share, filtered)):
        signal_e = fraction * signal_w * per_watt
        noise = math.sqrt(2 * (signal_e / 2 + sun_w * per_watt + dark_e)) / math.sqrt(4096)
        assert signal_e / 4096 / noise == pytest.approx(expected, rel=0.03)
