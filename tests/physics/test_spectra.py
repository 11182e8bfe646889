"""Spectra against closed forms, standards and brute-force integrals."""

import math
from pathlib import Path

import numpy as np
import pytest

from twin.files import InputError
from twin.optics.solar_irradiance import sun_band_irradiance, sun_in_band
from twin.optics.spectra import angle_shift, filter_shape, in_band_fraction, responsivity_a_per_w
from twin.scene.clear_sky import air_mass, clear_sun, g173
from twin.system import Sky, load_part, load_system
from twin.system.curves import read_curve
from twin.toml import Sourced

PAPER = load_system("paper")
FB12 = load_part("fb1550-12").filter


def assumed(value):
    return Sourced(value=value, assumed="for this test")


@pytest.mark.parametrize(
    ("elevation", "expected"),
    [(90.0, 1.0), (60.0, 1.154), (30.0, 1.994), (10.0, 5.60), (5.0, 10.3), (0.0, 38.0)],
)
def test_air_mass_is_kasten_and_youngs_table(elevation: float, expected: float) -> None:
    assert air_mass(elevation) == pytest.approx(expected, rel=5e-3)


def test_clear_sun_is_the_standard_at_its_own_air_mass() -> None:
    """At 41.8 degrees (air mass 1.5) ASTM G-173's direct spectrum comes back: 900 W/m^2 in all."""
    nm, spectrum = clear_sun(41.76)
    assert air_mass(41.76) == pytest.approx(1.5, abs=2e-3)
    assert np.trapezoid(spectrum, nm) == pytest.approx(900.1, rel=2e-3)


def test_the_table_is_the_one_that_colour_science_has() -> None:
    """Number by number: the spectra of ASTM G-173, and V between its nanometres."""
    import colour
    from colour.plotting.datasets import astm_g_173

    nm, outside, direct, v = g173()
    np.testing.assert_array_equal(nm, astm_g_173.SD_ASTMG173_ETR.wavelengths)
    np.testing.assert_array_equal(outside, astm_g_173.SD_ASTMG173_ETR.values)
    np.testing.assert_array_equal(direct, astm_g_173.SD_ASTMG173_DIRECT_CIRCUMSOLAR.values)
    eye = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    np.testing.assert_array_equal(v, np.interp(nm, eye.wavelengths, eye.values, left=0, right=0))


def test_the_sun_grows_dimmer_and_redder_as_it_sinks() -> None:
    """Illuminance falls faster than the band at 1550 nm: less Rayleigh scattering there."""
    skies = [
        sun_in_band(Sky(sun_elevation_deg=assumed(e)), PAPER.filter) for e in (90.0, 30.0, 5.0)
    ]
    lux = [s.illuminance_lx for s in skies]
    assert lux[0] > lux[1] > lux[2] > 0
    assert 90e3 < lux[0] < 120e3  # direct sun at the zenith, clear sky
    per_lux = [s.irradiance_w_per_m2 / s.illuminance_lx for s in skies]
    assert per_lux[0] < per_lux[1] < per_lux[2]
    below = sun_in_band(Sky(sun_elevation_deg=assumed(-3.0)), PAPER.filter)
    assert below.illuminance_lx == below.irradiance_w_per_m2 == 0


def test_direct_sun_in_the_band_is_the_audited_one() -> None:
    """3.250 W/m^2 in 1544-1556 nm at 100 klx of direct sun."""
    direct = sun_in_band(Sky(sun_elevation_deg=assumed(41.76)), PAPER.filter)
    at_100_klx = direct.irradiance_w_per_m2 / direct.illuminance_lx * 1e5
    assert at_100_klx == pytest.approx(3.250, rel=5e-3)


@pytest.mark.parametrize("width_nm", [12, 20, 30])
def test_one_sun_is_the_same_by_elevation_and_by_illuminance(width_nm: int) -> None:
    """At 1.5 air masses both are ASTM G-173's direct spectrum: 5.26 W/m^2 in 20 nm, either way.

    Within 3e-4, what 41.76 deg is off 1.5 air masses. The global tilt gives 9 % less.
    """
    band = PAPER.filter.model_copy(update={"width_m": assumed(width_nm * 1e-9)})
    high = sun_in_band(Sky(sun_elevation_deg=assumed(41.76)), band)
    same = sun_in_band(Sky(illuminance_lx=assumed(high.illuminance_lx)), band)
    assert same.irradiance_w_per_m2 == pytest.approx(high.irradiance_w_per_m2, rel=3e-4)


@pytest.mark.parametrize(("index", "shift_nm"), [(1.45, 11.2), (2.0, 5.9)])
def test_a_filter_shifts_6_to_11_nm_at_10_degrees(index: float, shift_nm: float) -> None:
    band = FB12.model_copy(update={"effective_index": assumed(index)})
    assert 1550 * (1 - angle_shift(band, 10.0)) == pytest.approx(shift_nm, abs=0.06)
    nm = np.linspace(1520, 1580, 60_001)
    inside = nm[filter_shape(band, nm, 10.0) > 0]
    assert inside.mean() == pytest.approx(1550 - shift_nm, abs=0.1)


def test_no_index_no_shift() -> None:
    bare = PAPER.filter.model_copy(update={"effective_index": None})
    assert angle_shift(bare, 10.0) == 1.0


def test_line_share_at_an_angle_by_brute_force() -> None:
    emitter = PAPER.emitter
    nm = np.linspace(1300, 1800, 500_001)
    sigma = 100 / math.sqrt(8 * math.log(2))
    line = np.exp(-(((nm - 1550) / sigma) ** 2) / 2)
    expected = np.trapezoid(line * filter_shape(FB12, nm, 14.0), nm) / np.trapezoid(line, nm)
    assert in_band_fraction(emitter, FB12, 14.0) == pytest.approx(expected, rel=1e-4)


# Vendors' curves.


def curve(folder: Path, text: str, name: str = "c.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_curves_as_vendors_publish_them(tmp_path: Path) -> None:
    """Header lines, micrometres, per cent, descending order."""
    text = "Thing X\nWavelength (um),Transmission (%)\n1.6,10\n1.55,50\n1.5,0\n"
    nm, values = read_curve(curve(tmp_path, text))
    np.testing.assert_allclose(nm, [1500, 1550, 1600])
    np.testing.assert_allclose(values, [0, 0.5, 0.1])


def test_a_flat_curve_is_the_flat_band(tmp_path: Path) -> None:
    """The same band as numbers and as a curve: share of the line and sun agree within 0.1 %."""
    path = curve(tmp_path, "nm,T\n1543.999,0\n1544,1\n1556,1\n1556.001,0\n")
    band = PAPER.filter.model_copy(update={"transmission_csv": assumed(str(path))})
    assert in_band_fraction(PAPER.emitter, band) == pytest.approx(0.1124, rel=1e-3)
    sky = Sky(illuminance_lx=assumed(1e5))
    expected = sun_band_irradiance(1e5, 1550e-9, 12e-9)
    assert sun_in_band(sky, band).irradiance_w_per_m2 == pytest.approx(expected, rel=1e-3)


def test_responsivity_is_weighted_by_what_arrives(tmp_path: Path) -> None:
    """A curve that rises by 1e-3 A/W per nm: its value at the centre of the symmetric band."""
    path = curve(tmp_path, "nm,A/W\n1450,0.85\n1650,1.05\n")
    detector = PAPER.detector.model_copy(update={"responsivity_csv": assumed(str(path))})
    found = responsivity_a_per_w(detector, PAPER.emitter, PAPER.filter)
    assert found == pytest.approx(0.95, abs=1e-5)
    assert responsivity_a_per_w(PAPER.detector, PAPER.emitter, PAPER.filter) == 0.95


def test_a_measured_line_replaces_the_gaussian(tmp_path: Path) -> None:
    path = curve(tmp_path, "nm,I\n1500,0\n1550,1\n1600,0\n")
    emitter = PAPER.emitter.model_copy(update={"spectrum_csv": assumed(str(path))})
    triangle = 1 - (44 / 50) ** 2  # area within 6 nm of the peak
    assert in_band_fraction(emitter, PAPER.filter) == pytest.approx(triangle, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "two columns"),
        ("a,b\nc,d\n", "two columns"),
        ("1500,1\n1500,2\n", "stands twice"),
        ("1500,1\n1600,-2\n", "negative"),
        ("1500,1\n1600,nan\n", "no number"),
        ("1500,0\n1600,0\n", "every value is zero"),
        ("1.54e-6,1\n1.56e-6,1\n", "expected nm or um"),
    ],
)
def test_bad_curves_name_the_file(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError, match=rf"c\.csv: .*{expected}"):
        read_curve(curve(tmp_path, text))
    with pytest.raises(InputError, match=r"missing\.csv"):
        read_curve(tmp_path / "missing.csv")


def test_per_cent_without_a_header_is_caught(tmp_path: Path) -> None:
    path = curve(tmp_path, "1540,50\n1560,50\n")
    band = PAPER.filter.model_copy(update={"transmission_csv": assumed(str(path))})
    with pytest.raises(InputError, match=r"c\.csv: transmission 50: expected at most 1"):
        in_band_fraction(PAPER.emitter, band)


def test_a_systems_curves_lie_beside_its_file(tmp_path: Path, monkeypatch) -> None:
    curve(tmp_path, "nm,T\n1500,0.2\n1600,0.2\n", "t.csv")
    (tmp_path / "mine.toml").write_text(
        'base = "paper"\n[filter]\ntransmission_csv = { value = "t.csv", source = "vendor" }\n'
    )
    monkeypatch.chdir("/")
    mine = load_system(tmp_path / "mine.toml")
    nm = np.array([1550.0])
    assert filter_shape(mine.filter, nm)[0] == pytest.approx(0.2)


def test_plots_of_parts(tmp_path: Path) -> None:
    from twin.report.part_figure import plot_part

    for name in ("fga015", "fb1550-12", "eold-1550-525-16x16", "clear-10"):
        plot_part(load_part(name)).savefig(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 5_000
    with pytest.raises(InputError, match="no spectral curve"):
        plot_part(load_part("tia-100m"))


def test_a_band_outside_the_solar_table_is_an_error(tmp_path) -> None:
    """Of a curve, where it passes more than a hundredth of its peak; and of a flat band that the
    angle moves out.
    """
    sky, band = Sky(illuminance_lx=1e4), load_part("fb1550-30").filter
    curve = tmp_path / "curve.csv"
    curve.write_text("wavelength nm,transmission\n4100,0\n4200,0.9\n4300,0\n")
    far = band.model_copy(update={"transmission_csv": str(curve)})
    with pytest.raises(InputError, match=r"filter\.transmission_csv: its band.* ASTM G-173"):
        sun_in_band(sky, far)
    curve.write_text("wavelength nm,transmission\n200,0.001\n1500,0.001\n1550,0.9\n5000,0.001\n")
    assert sun_in_band(sky, far).irradiance_w_per_m2 > 0
    low = {"center_wavelength_m": 300e-9, "width_m": 30e-9, "effective_index": 1.5}
    edge = band.model_copy(update=low)
    assert sun_in_band(sky, edge).irradiance_w_per_m2 > 0
    with pytest.raises(InputError, match="filter: its band, at some angles 27"):
        sun_in_band(sky, edge, 20.0)
