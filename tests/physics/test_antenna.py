"""Antenna patterns: files as vendors write them, directions, and the power they radiate."""

from pathlib import Path

import numpy as np
import pytest

from twin.files import InputError
from twin.radar import load_radar
from twin.radar.device.antenna import Antenna
from twin.radar.device.antenna_pattern_file import read_pattern

AHEAD, LEFT, UP = np.eye(3)


def lobe(x: np.ndarray, dbi: float = 12.0) -> np.ndarray:
    """G0 cos^q, the closed form, in dBi, with a floor."""
    peak = 10 ** (dbi / 10)
    return 10 * np.log10(np.maximum(peak * np.maximum(x, 0) ** (peak / 2 - 1), 1e-12))


def table(
    path: Path, axis: str, step: float = 2.0, header: str = "theta_deg,phi_deg,gain_dbi"
) -> Path:
    """A cos^q lobe on a grid, along the file's x or z axis."""
    lines = [header]
    for theta in np.arange(0, 180.001, step):
        for phi in np.arange(0, 360, step):
            t, p = np.radians(theta), np.radians(phi)
            cos = np.cos(t) if axis == "z" else np.sin(t) * np.cos(p)
            lines.append(f"{theta:g},{phi:g},{lobe(cos):.6f}")
    path.write_text("\n".join(lines) + "\n")
    return path


def antenna(path: Path, axis: str | None = None) -> Antenna:
    content: dict = {"pattern_file": {"value": str(path), "source": "declared"}}
    if axis:
        content["pattern_axis"] = {"value": axis, "source": "declared"}
    return Antenna.model_validate(content)


def directions(n: int = 2000, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


@pytest.mark.parametrize("axis", ["x", "z"])
def test_a_table_gives_the_lobe_it_was_made_from(tmp_path: Path, axis: str) -> None:
    """2 deg apart, q = 6.9. Between points a straight line errs by h^2 / 8 of the second
    derivative: 0.02 dB within 37 deg of the boresight, 0.08 dB at 60 deg, 21 dB down.
    """
    found = antenna(table(tmp_path / "lobe.csv", axis), axis)
    towards = directions()
    for ahead, most in ((0.8, 0.02), (0.5, 0.09)):
        near = towards[towards[:, 0] > ahead]
        off = 10 * np.log10(found.gain(near)) - lobe(near[:, 0])
        assert np.abs(off).max() < most
    assert found.ahead_dbi == pytest.approx(12.0, abs=1e-5)


def test_a_lobe_off_to_the_left_is_on_the_left(tmp_path: Path) -> None:
    """Axis x: phi from ahead to the left, theta from above. Axis z: the file's x looks left."""
    rows = ["theta,phi,gain dBi"]
    for theta in range(0, 181, 10):
        for phi in range(0, 360, 10):
            rows.append(f"{theta},{phi},{5.0 if (theta, phi) == (90, 90) else -20.0}")
    path = tmp_path / "spot.csv"
    path.write_text("\n".join(rows))
    assert 10 * np.log10(antenna(path).gain(LEFT)) == pytest.approx(5.0)
    assert 10 * np.log10(
        antenna(path).gain(np.array([LEFT, -LEFT, UP, AHEAD]))[1:]
    ) == pytest.approx(-20)
    assert 10 * np.log10(antenna(path, "z").gain(UP)) == pytest.approx(5.0)


def test_a_table_radiates_what_it_is_fed(tmp_path: Path) -> None:
    """The closed form integrates to 4 pi; the table does to 0.1 %, and a spread sum agrees."""
    pattern = read_pattern(table(tmp_path / "lobe.csv", "z"))
    assert pattern.efficiency == pytest.approx(1.0, abs=1e-3)
    towards = directions(200_000)
    mean = antenna(tmp_path / "lobe.csv", "z").gain(towards).mean()
    # The lobe's standard deviation is 1.9 times its mean: 5 sigma of 2e5 draws are 2.2 %.
    assert mean == pytest.approx(pattern.efficiency, abs=0.022)


def test_an_isotropic_table_is_exactly_one(tmp_path: Path) -> None:
    path = tmp_path / "flat.csv"
    rows = [f"{t},{p},0" for t in (0, 70, 180) for p in (0, 90, 200, 270)]
    path.write_text("Theta[deg],Phi[deg],dB(GainTotal)[]\n" + "\n".join(rows))
    assert read_pattern(path).efficiency == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(antenna(path).gain(directions()), 1.0, rtol=1e-12)


def test_whole_circles_of_theta_are_understood(tmp_path: Path) -> None:
    """As HFSS sweeps: theta -180 to 180, phi 0 to 180, ends doubled."""
    path = tmp_path / "hfss.csv"
    rows = ['"Freq [GHz]","Phi[deg]","Theta[deg]","dB(GainTotal)[]"']
    for phi in range(0, 181, 5):
        for theta in range(-180, 181, 5):
            rows.append(f"79,{phi},{theta},{lobe(np.cos(np.radians(theta))):.6f}")
    path.write_text("\n".join(rows))
    found = antenna(path, "z")
    assert found.ahead_dbi == pytest.approx(12.0, abs=1e-5)
    assert found.pattern.efficiency == pytest.approx(1.0, abs=0.01)


def planet(path: Path, gain: str = "12.0 dBi", tilt: int = 0, bend: int = 0) -> Path:
    """cos^q cuts; ``bend`` degrees clockwise, ``tilt`` degrees down."""
    lines = ["NAME mine", "MAKE none", "FREQUENCY 2500", f"GAIN {gain}", "TILT MECHANICAL"]
    for name, at in (("HORIZONTAL", bend), ("VERTICAL", tilt)):
        lines.append(f"{name} 360")
        down = 12.0 - lobe(np.cos(np.radians(np.arange(360) - at)))
        lines += [f"{angle}.0 {min(loss, 60.0):.4f}" for angle, loss in enumerate(down)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_two_cuts_are_exact_on_the_cuts(tmp_path: Path) -> None:
    found = antenna(planet(tmp_path / "mine.msi"))
    angle = np.radians(np.arange(-60, 61, 7))
    flat, upright = (
        np.column_stack(rows)
        for rows in (
            (np.cos(angle), np.sin(angle), 0 * angle),
            (np.cos(angle), 0 * angle, np.sin(angle)),
        )
    )
    for cut in (flat, upright):
        np.testing.assert_allclose(10 * np.log10(found.gain(cut)), lobe(np.cos(angle)), atol=0.01)
    # The product of both cuts is nearly the lobe itself: cos(az) cos(el) is x.
    assert found.pattern.efficiency == pytest.approx(1.0, abs=0.05)


def test_cuts_turn_clockwise_and_downwards(tmp_path: Path) -> None:
    right = antenna(planet(tmp_path / "right.msi", bend=20))
    down = antenna(planet(tmp_path / "down.pln", tilt=20))
    c, s = np.cos(np.radians(20)), np.sin(np.radians(20))
    assert 10 * np.log10(right.gain(np.array([c, -s, 0]))) == pytest.approx(12.0, abs=0.01)
    assert 10 * np.log10(down.gain(np.array([c, 0, -s]))) == pytest.approx(12.0, abs=0.01)
    assert antenna(planet(tmp_path / "d.msi", "9.85 dBd")).ahead_dbi == pytest.approx(12.0)
    assert antenna(planet(tmp_path / "n.msi", "9.85")).ahead_dbi == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.csv", "theta,phi,gain dBi\n0,0,nan", "a.csv:2: 'nan'"),
        ("a.csv", "theta,phi,gain dBi\n0,0,1\n0,90", "a.csv:3: nothing"),
        ("a.csv", "theta,phi,gain dBi\n0,0,high", "a.csv:2: 'high'"),
        ("a.csv", "theta,gain dBi\n0,1", "a.csv:1: columns theta, gain dbi"),
        ("a.csv", "theta,phi,gain\n0,0,1", "a.csv:1: column 'gain'"),
        ("a.csv", "", "a.csv:1: columns none"),
        ("a.csv", "theta,phi,gain dBi\n200,0,1", "a.csv:2: theta 200"),
        ("a.csv", "theta,phi,gain dBi\n0,0,1\n9,0,1\n0,9,1", "theta 9, phi 9 is missing"),
        ("a.csv", "theta,phi,gain dBi\n0,0,1\n9,0,1\n0,9,1\n9,9,1", "expected a whole turn"),
        ("a.csv", "theta,phi,gain dBi\n9,0,1\n9,360,5", "a.csv:3: a second gain at theta 9"),
        ("a.msi", "GAIN nan dBi", "a.msi:1: 'nan'"),
        ("a.msi", "NAME x", "no GAIN line"),
        ("a.msi", "GAIN 3\nHORIZONTAL 360\n0 1\n2 1", "a.msi:4: angle 2: expected 1"),
        ("a.msi", "GAIN 3\nHORIZONTAL 360\n0 1", "HORIZONTAL: 1 points, expected 360"),
    ],
)
def test_broken_files_are_refused_by_line(
    tmp_path: Path, name: str, text: str, expected: str
) -> None:
    (tmp_path / name).write_text(text)
    path = tmp_path / "mine.toml"
    bundled = Path(__file__).parents[2] / "twin/catalog/radars/hybrid-79.toml"
    before, _, after = bundled.read_text().partition("[antenna]\n")
    mine = f'[antenna]\npattern_file = {{ value = "{name}", source = "mine" }}\n'
    path.write_text(before + mine + after[after.index("\n") :])
    with pytest.raises(InputError) as caught:
        load_radar(path)
    assert expected in str(caught.value)
    assert str(path) in str(caught.value)


def test_gain_or_file_never_both(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="either gain_dbi or pattern_file"):
        Antenna.model_validate({})
    both = {"gain_dbi": 10.0, "pattern_file": str(table(tmp_path / "a.csv", "x", 30.0))}
    with pytest.raises(ValueError, match="either gain_dbi or pattern_file"):
        Antenna.model_validate(both)


@pytest.mark.parametrize("value", ['"mine.csv"', '{ value = "mine.csv", source = "chamber" }'])
def test_a_pattern_file_replaces_the_gain_of_a_bundled_radar(tmp_path: Path, value: str) -> None:
    """The file lies beside the radar's, whatever the working directory; gain as in its table."""
    table(tmp_path / "mine.csv", "x", 30.0)
    mine, flat = tmp_path / "mine.toml", tmp_path / "flat.toml"
    mine.write_text(f'base = "hybrid-79"\n[antenna]\npattern_file = {value}\n')
    flat.write_text('base = "mine.toml"\n[antenna]\ngain_dbi = 6.0\n')
    radar = load_radar(mine)
    assert radar.antenna.gain_dbi is None
    ahead = Antenna.model_validate({"pattern_file": str(tmp_path / "mine.csv")}).ahead_dbi
    assert radar.antenna.ahead_dbi == ahead != load_radar("hybrid-79").antenna.ahead_dbi
    assert load_radar(flat).antenna.ahead_dbi == 6.0  # and back again
    both = tmp_path / "both.toml"
    both.write_text(f'base = "hybrid-79"\n[antenna]\npattern_file = {value}\ngain_dbi = 6.0\n')
    with pytest.raises(InputError, match="either gain_dbi or pattern_file"):
        load_radar(both)


def test_a_pattern_that_radiates_more_than_it_is_fed_is_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "hot.csv"
    rows = [f"{t},{p},3" for t in (0, 90, 180) for p in (0, 120, 240)]
    path.write_text("theta,phi,gain_dbi\n" + "\n".join(rows))
    content = load_radar("hybrid-79").model_dump()
    content["antenna"] = {"pattern_file": str(path)}
    radar = type(load_radar("hybrid-79")).model_validate(content)
    assert "200 % of what it is fed" in radar.warnings()[0]
