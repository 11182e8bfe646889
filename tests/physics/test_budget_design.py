"""A system of one's own in closed form, against the rendered camera before the same wall."""

import json
import math
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hardware.formatting import si
from twin import cli
from twin.budget import wall_rows
from twin.budget.design import left_out
from twin.budget.report import design_verdict, print_design, write_design
from twin.camera import capture
from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.optics.radiometry import collection, wall_power_w
from twin.scene import Pose, Rig, Scene, SceneObject, Sun
from twin.system import load_system

Z, RHO = 5.0, 0.5


def wall(distance_m: float, reflectance: float) -> Scene:
    """A facing square as wide as its distance; sensors at one place, the sun behind them."""
    corners = np.array([[1, -0.5, -0.5], [1, 0.5, -0.5], [1, 0.5, 0.5], [1, -0.5, 0.5]])
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    item = SceneObject("wall", Geometry(corners * distance_m, faces), "stuff", reflectance)
    here = Pose((0.0, 0.0, 0.0))
    return Scene("wall", Path(), "", (item,), Rig(here, detector=here), Sun(180.0, 0.0, 0.0))


@pytest.mark.quick(5)
@pytest.mark.parametrize(
    ("base", "text", "within"),
    [
        ("workable", "", 2e-3),
        ("paper", "", 2e-3),
        ("workable", '[detector]\npart = "ingaas-apd-200"\n', 2e-3),
        ("workable", "[time_of_flight]\nmodulation_hz = [1e7]\ncontrast = 0.8\n", 2e-3),
        ("line-256x16", "", 2e-2),  # rendered with 1 % of error
        ("workable", "[optics]\nfield_of_view_deg = 40.0\n", 1e-2),  # sees more than is lit
        ("workable", "[optics]\nfield_of_view_deg = 10.0\n", 2e-2),  # cuts cells at its edge
        (
            "workable",
            '[optics]\nfield_of_view_deg = 26.0\nfield_stop = "detector"\n',  # a square in a disc
            1e-2,
        ),
    ],
)
def test_the_budget_is_that_of_the_rendered_camera(system, base, text, within) -> None:
    """Electrons of emitter and sun, noise and SNR per pixel of a wall that fills the field.

    The closed form takes the filter's mean over the field; the rendered camera cell by cell.
    """
    made = system(text, base)
    (row,) = wall_rows(made, [Z], [RHO])
    taken = capture(wall(Z, RHO), made, fidelity=Fidelity(16, 1))
    assert row.budget.signal_e == pytest.approx(taken.noise.signal_e, rel=within)
    assert row.budget.background_e == pytest.approx(taken.noise.background_e, rel=within)
    assert row.budget.total_noise_e == pytest.approx(taken.noise.total_noise_e, rel=within)
    assert row.snr_per_pixel == pytest.approx(taken.snr[taken.lit].mean(), rel=within)
    top = 2**taken.record.adc_bits - 1
    assert row.fill == pytest.approx(taken.record.counts.max() / top, rel=0.02)
    assert not row.saturates
    assert not taken.void


@pytest.mark.parametrize(
    ("lit_deg", "seen_deg", "n_seen"), [(40.0, 2.0, 4), (90.0, 20.0, 16), (10.0, 2.0, 16)]
)
def test_cells_that_the_edge_of_the_field_cuts_share_the_light(
    system, lit_deg: float, seen_deg: float, n_seen: int
) -> None:
    """A field of less than a cell, of 2.8 and of 3.2: as a share of the cells it had up to 7 times
    the SNR of the rendered cells. Mean over the cells within 3 %: those at the edge of a wide field
    have less light of the wall. And it is said that they are not alike.
    """
    made = system(
        "[emitter]\nrows = 16\ncolumns = 16\n[acquisition]\nn_patterns = 256\n"
        "[readout]\nadc_full_scale_v = 40.0\nadc_bits = 28\n"
    ).with_({"emitter.field_of_view_deg": lit_deg, "optics.field_of_view_deg": seen_deg})
    (row,) = wall_rows(made, [Z], [RHO])
    snr = capture(wall(Z, RHO), made, fidelity=Fidelity(64, 1)).snr
    assert np.count_nonzero(snr) == n_seen
    assert row.snr_per_pixel == pytest.approx(snr[snr > 0].mean(), rel=0.03)
    assert "edge within cells" in " ".join(left_out(made))


def test_noise_that_drifts_over_the_frame_is_in_the_budget_too(system) -> None:
    """Root mean square over the cells, as of the rendered camera; more than pairs leave of it."""
    text = '[acquisition]\nmode = "{}"\n[readout]\nflicker_corner_hz = 3e3\n'
    totals = []
    for mode in ("plain", "differential"):
        made = system(text.format(mode))
        (row,) = wall_rows(made, [Z], [RHO])
        taken = capture(wall(Z, RHO), made, fidelity=Fidelity(16, 1))
        assert row.budget.total_noise_e == pytest.approx(taken.noise.total_noise_e, rel=2e-3)
        totals.append(row.budget.total_noise_e)
    assert totals[0] > 1.2 * totals[1]


def test_time_and_distance_are_where_the_snr_is_one(system) -> None:
    made = system()
    (row,) = wall_rows(made, [Z], [RHO])
    (far,) = wall_rows(made, [row.maximum_distance_m], [RHO])
    assert far.snr_per_pixel == pytest.approx(1, rel=1e-9)
    short = system(f"[acquisition]\nintegration_time_s = {row.minimum_time_s!r}\n")
    assert wall_rows(short, [Z], [RHO])[0].snr_per_pixel == pytest.approx(1, rel=1e-9)


def test_no_budget_within_the_pupil() -> None:
    """Nearer than the pupil is wide there is no closed form: an error that names the distance, not
    gigawatts. From there on no more comes back than is sent, and where the pupil's area begins to
    count, at 100 radii, nothing jumps.
    """
    system = load_system("workable")
    with pytest.raises(InputError, match=r"distances: 1e-09 m: expected at least 0.00754 m"):
        wall_rows(system, [1e-9], [0.5])
    tangent = math.tan(math.radians(system.emitter.field_of_view_deg.value / 2))
    sent = system.emitter.radiant_intensity_w_per_sr.value * 4 * tangent**2
    lens = collection(system)
    assert wall_power_w(system, 1.0, lens.pupil_diameter_m) < 0.25 * sent * lens.transmission
    near, far = (wall_power_w(system, 1.0, z) for z in (0.376, 0.378))
    assert near / far == pytest.approx((0.378 / 0.376) ** 2, rel=2e-4)


def test_saturation_is_void_here_too(system, tmp_path: Path) -> None:
    """The same wall too bright for the amplifier: no SNR, and so says the rendered camera."""
    made = system("[readout]\ntransimpedance_ohm = 1e9\n")
    (row,) = wall_rows(made, [Z], [RHO])
    assert row.saturates
    assert math.isnan(row.snr_per_pixel)
    assert capture(wall(Z, RHO), made, fidelity=Fidelity(1, 1)).void
    write_design(made, [row], tmp_path)
    (written,) = json.loads((tmp_path / "budget.json").read_text())["walls"]
    assert written["snr_per_pixel"] is None
    # A shorter exposure does not help: behind an amplifier that averages, volts follow power.
    assert row.minimum_time_s == math.inf
    printed = StringIO()
    print_design(made, [row], Console(file=printed, width=250))
    assert "none" in printed.getvalue()
    assert "inf" not in printed.getvalue()


def test_where_every_wall_saturates_words_say_so(monkeypatch, capsys, tmp_path: Path) -> None:
    """In full sun no wall is measured: "at up to nan m" said nothing. Whichever reflectance comes
    first, one that is measured has a distance.
    """
    (tmp_path / "sun.toml").write_text('base = "workable"\n[sky]\nilluminance_lx = 100e3\n')
    asked = ("--system", str(tmp_path / "sun.toml"))
    words = "sun: saturates at every distance at which the SNR per pixel would reach 1"
    code, printed, _ = budget(*asked, monkeypatch=monkeypatch, capsys=capsys)
    assert code == 0
    assert words in printed
    _, printed, _ = budget(*asked, "--json", monkeypatch=monkeypatch, capsys=capsys)
    content = json.loads(printed, parse_constant=pytest.fail)  # NaN, Infinity
    assert content["verdict"] == words
    assert {row["maximum_distance_m"] for row in content["walls"]} == {None}
    (tmp_path / "sun.toml").write_text('base = "workable"\n[sky]\nilluminance_lx = 30e3\n')
    made = load_system(tmp_path / "sun.toml")
    rows = wall_rows(made, [5.0], [0.9, 0.1])
    far = [row.maximum_distance_m for row in rows]
    assert math.isnan(far[0])
    assert math.isfinite(far[1])
    assert design_verdict(made, rows) == f"sun: SNR 1 per pixel at up to {si(far[1], 'm')}"


def test_gates_have_no_farthest_distance(system) -> None:
    gates = "pulse_width_s = 2e-8\npulse_rate_hz = 1e5\ngate_width_s = 2e-8\ngate_delays_s = [1e-8]"
    made = system(f"[time_of_flight]\n{gates}\n")
    told = design_verdict(made, wall_rows(made, [Z], [RHO]))
    assert told.endswith(": no farthest distance for SNR 1: gates are open at some alone")


def budget(*arguments: str, monkeypatch, capsys) -> tuple[int, str, str]:
    monkeypatch.setattr("sys.argv", ["twin", "budget", *arguments])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    streams = capsys.readouterr()
    return stopped.value.code or 0, streams.out, streams.err


def test_the_users_own_detector_is_what_is_computed(monkeypatch, capsys, tmp_path: Path) -> None:
    """Ten times the diameter: a hundred times the light. On ee37b06 nothing changed."""
    signals = []
    for width in ("150e-6", "1.5e-3"):
        mine = tmp_path / "mine.toml"
        mine.write_text(f'base = "paper"\n[detector]\nwidth_m = {width}\n')
        asked = ("--system", str(mine), "--distances", "3", "--reflectances", "0.4")
        done = budget(*asked, "--out", str(tmp_path / "b"), monkeypatch=monkeypatch, capsys=capsys)
        assert done[0] == 0
        assert "mine: a wall square to the rig" in done[1]
        shown = {"150e-6": "150 um", "1.5e-3": "1.5 mm"}[width]
        assert f"assumed: detector.width_m = {shown}: given without a source" in done[1]
        content = json.loads((tmp_path / "b" / "budget.json").read_text())
        (found,) = content["walls"]
        assert (content["system"], found["distance_m"], found["reflectance"]) == ("mine", 3.0, 0.4)
        signals.append(found["signal_w"])
    assert signals[1] / signals[0] == pytest.approx(100)


def test_the_papers_table_is_another_view(monkeypatch, capsys) -> None:
    def shown(*arguments: str) -> tuple[int, str, str]:
        return budget(*arguments, monkeypatch=monkeypatch, capsys=capsys)

    assert shown() == shown("--system", "paper", "--table-1")
    code, printed, _ = shown("--system", "workable", "--table-1")
    assert code == 0
    assert "Table 1: shortest T for SNR 1" in printed
    for arguments, expected in (
        (("--system", "workable", "--whole-line"), "--table-1"),
        (("--distances", "2"), "--distances, --reflectances: the paper's table has none"),
        (("--table-1", "--reflectances", "0.5"), "the paper's table has none"),
        (("--system", "workable", "--distances", "1,x"), "distances: '1,x': expected a number"),
        (("--system", "workable", "--reflectances", "1.2"), "expected numbers up to 1"),
    ):
        code, _, errors = shown(*arguments)
        assert code == 2
        assert len(errors.splitlines()) == 1
        assert expected in errors


def test_what_the_closed_form_leaves_out_is_said(tmp_path) -> None:
    """Each of these makes the camera's record another than the budget's."""
    text = (
        'base = "workable"\n[optics]\nfield_stop = "detector"\nedge_illumination = 0.4\n'
        "[emitter]\nswitching_time_s = 1e-6\n[readout]\nbandwidth_hz = 1e6\n"
        '[weather]\npart = "fog-50m"\n'
    )
    (tmp_path / "much.toml").write_text(text)
    said = "; ".join(left_out(load_system(tmp_path / "much.toml")))
    for what in ("outline", "vignetting", "switching", "settling", "the air"):
        assert what in said
    assert not left_out(load_system("workable"))
