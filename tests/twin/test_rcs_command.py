"""``twin rcs``, as a user runs it."""

import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.constants import speed_of_light

from twin import cli
from twin.files import InputError
from twin.rcs import parse_range


def twin(*arguments: str, monkeypatch, capsys) -> tuple[int, str, str]:
    """Exit code, output and errors of the command in this process."""
    monkeypatch.setattr(sys, "argv", ["twin", "rcs", *arguments])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    streams = capsys.readouterr()
    return stopped.value.code or 0, streams.out, streams.err


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    """0.2 m (y) by 0.1 m (z), written in millimetres."""
    corners = np.array([[0, -100, -50], [0, 100, -50], [0, 100, 50], [0, -100, 50]], dtype=float)
    path = tmp_path / "plate.ply"
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(path)
    return path


def test_table_and_plot_are_written(plate: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """Columns as documented, both ends of the range, broadside as in the closed form."""
    out = tmp_path / "new" / "plate.csv"
    code, printed, errors = twin(
        str(plate), "--carrier-hz", "10e9", "--azimuth", "-10:10:0.5", "--elevation", "2",
        "--scale", "1e-3", "--edges", "--out", str(out), monkeypatch=monkeypatch, capsys=capsys,
    )  # fmt: skip
    assert (code, errors) == (0, "")
    assert f"written: {out}" in printed
    assert out.read_text().splitlines()[0] == "azimuth_deg,elevation_deg,rcs_dbsm"
    azimuth, elevation, rcs = np.loadtxt(out, delimiter=",", skiprows=1, unpack=True)
    np.testing.assert_allclose(azimuth, np.linspace(-10, 10, 41))
    assert (elevation == 2).all()
    tilt = np.sinc(0.2 * 10e9 / speed_of_light * math.sin(math.radians(2)))
    broadside = 4 * np.pi * (0.02 * 10e9 / speed_of_light * tilt) ** 2
    assert rcs[20] == pytest.approx(10 * math.log10(broadside), abs=0.1)
    np.testing.assert_allclose(rcs, rcs[::-1], atol=0.05)
    assert (tmp_path / "new" / "plate.png").read_bytes()[1:4] == b"PNG"
    assert len(list((tmp_path / "new").iterdir())) == 2


def test_without_out_the_table_is_printed(plate: Path, monkeypatch, capsys) -> None:
    """Warnings go to the other stream; nothing at all comes back edge on, and -inf says so."""
    arguments = (str(plate), "--carrier-hz", "3e9", "--scale", "1e-3", "--azimuth")
    code, printed, errors = twin(*arguments, "0:90:90", monkeypatch=monkeypatch, capsys=capsys)
    assert code == 0
    header, first, last = printed.splitlines()
    assert header == "azimuth_deg,elevation_deg,rcs_dbsm"
    assert last == "90,0,-inf"
    assert "warning: the target measures 2 wavelengths" in errors
    _, crossed, _ = twin(
        *arguments, "0", "--polarization", "VH", monkeypatch=monkeypatch, capsys=capsys
    )
    assert float(crossed.split(",")[-1]) < float(first.split(",")[-1]) - 100


def test_near_field_and_dielectric_reach_the_computation(plate: Path, monkeypatch, capsys) -> None:
    """At 0.5 m the echo is below the far field's; a half-space of permittivity 4 reflects 1/9."""

    def broadside(*options: str) -> float:
        arguments = (str(plate), "--carrier-hz", "30e9", "--scale", "1e-3", "--azimuth", "0")
        code, printed, _ = twin(*arguments, *options, monkeypatch=monkeypatch, capsys=capsys)
        assert code == 0
        return float(printed.split(",")[-1])

    metal = broadside()
    assert broadside("--distance", "0.5") < metal - 3
    assert broadside("--permittivity", "4") == pytest.approx(metal - 20 * math.log10(3), abs=0.01)
    half_wave = repr(speed_of_light / 30e9 / 4)
    assert broadside("--permittivity", "4", "--thickness", half_wave) < metal - 60
    quarter = repr(speed_of_light / 30e9 / 8)
    expected = metal + 20 * math.log10(3 / 5)  # (4 - 1) / (4 + 1): two reflections in phase
    assert broadside("--permittivity", "4", "--thickness", quarter) == pytest.approx(
        expected, abs=0.01
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("30", [30]),
        ("0:2:0.5", [0, 0.5, 1, 1.5, 2]),
        ("0:1:0.3", [0, 0.3, 0.6, 0.9]),
        ("5:-5:-5", [5, 0, -5]),
        ("-180:180:90", [-180, -90, 0, 90, 180]),
        ("0:0:1", [0]),
        ("0:0.3:0.1", [0, 0.1, 0.2, 0.3]),  # 0.3 / 0.1 is less than 3
    ],
)
def test_ranges_include_both_ends(text: str, expected: list[float]) -> None:
    np.testing.assert_allclose(parse_range(text, "azimuth"), expected, atol=1e-12)


@pytest.mark.parametrize("step", [0.1, 0.01, 1 / 3, 0.007])
def test_the_end_is_not_lost_to_rounding(step: float) -> None:
    found = parse_range(f"0:{1000 * step!r}:{step!r}", "azimuth")
    assert len(found) == 1001


@pytest.mark.parametrize(
    "text", ["", "a", "0:1", "0:1:2:3", "0:10:0", "0:10:-1", "nan", "0:inf:1", "0:1e9:1e-3"]
)
def test_a_bad_range_is_named(text: str) -> None:
    with pytest.raises(InputError, match="azimuth: "):
        parse_range(text, "azimuth")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--azimuth", "0:10:0"], "azimuth: '0:10:0'"),
        (["--elevation", "91"], "elevation: 91"),
        (["--elevation", "nan"], "'--elevation': 'nan': expected a number or a quantity in deg"),
        (["--polarization", "X"], "polarization: 'X'"),
        (["--distance", "0"], "distance: 0"),
        (["--distance", "inf"], "'--distance': 'inf': expected a number or a quantity in m"),
        (["--scale", "-1"], "scale: -1"),
        (["--scale", "1e12"], "is --scale right?"),
        (["--scale", "1e-200"], "plate.ply: no face has an area"),
        (["--carrier-hz", "0"], "carrier-hz: 0"),
        (["--permittivity", "4+1j"], "permittivity: (4+1j)"),
        (["--permittivity", "0.5"], "permittivity: '0.5': expected a real part from 1"),
        (["--permittivity", "glass"], "permittivity: 'glass'"),
        (["--thickness", "0.1"], "thickness: expected together"),
        (["--permittivity", "4", "--thickness", "-1"], "thickness_m: -1"),
        (["--tolerance", "0"], "tolerance: 0.0: expected 0.001 to 1"),
        (["--tolerance", "nan"], "'--tolerance': 'nan': expected a number, or per cent"),
        (["--out", "plate.txt"], "out: 'plate.txt'"),
        (["--out", "plate.ply/x.csv"], "expected a folder that can be written to"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    options, expected, plate: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(plate.parent)
    code, printed, errors = twin(
        str(plate), "--carrier-hz", "10e9", "--azimuth", "0", *options,
        monkeypatch=monkeypatch, capsys=capsys,
    )  # fmt: skip
    assert (code, printed) == (2, "")
    assert len(errors.splitlines()) == 1
    assert expected in errors
    assert [p.name for p in plate.parent.iterdir()] == ["plate.ply"]


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("none.stl", None, "no such mesh file"),
        ("mesh.txt", "x", "'.txt' is none of"),
        ("empty.obj", "v 0 0 0\n", "empty.obj"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no face has an area"),
        ("far.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "far.obj"),
        ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "index.obj"),
        ("broken.stl", "solid broken", "broken.stl"),
    ],
)
def test_a_bad_mesh_is_named(name, content, expected, tmp_path, monkeypatch, capsys) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    code, _, errors = twin(
        str(tmp_path / name), "--carrier-hz", "10e9", "--azimuth", "0",
        monkeypatch=monkeypatch, capsys=capsys,
    )  # fmt: skip
    assert code == 2
    assert len(errors.splitlines()) == 1
    assert expected in errors


def test_zero_area_faces_and_inverted_normals_are_no_obstacle(
    tmp_path, monkeypatch, capsys
) -> None:
    vertices = "v 0 -1 -1\nv 0 1 -1\nv 0 1 1\nv 0 -1 1\n"
    (tmp_path / "a.obj").write_text(vertices + "f 1 2 3\nf 1 3 4\n")
    (tmp_path / "b.obj").write_text(vertices + "f 3 2 1\nf 1 3 4\nf 1 1 2\nf 1 2 3\n")
    printed = [
        twin(
            str(tmp_path / name), "--carrier-hz", "1e9", "--azimuth", "0:40:20", "--edges",
            monkeypatch=monkeypatch, capsys=capsys,
        )[1]
        for name in ("a.obj", "b.obj")
    ]  # fmt: skip
    assert printed[0] == printed[1]
    assert len(printed[0].splitlines()) == 4


def test_ctrl_c_leaves_nothing_behind(plate: Path) -> None:
    out = plate.parent / "out" / "x.csv"
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", "rcs", str(plate), "--carrier-hz", "79e9", "--scale", "1e-3",
         "--azimuth", "0:90:0.001", "--edges", "--out", str(out)],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    time.sleep(4)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130, errors
    assert [p.name for p in plate.parent.iterdir()] == ["plate.ply"]


def test_the_up_axis_is_that_of_import(tmp_path: Path, monkeypatch, capsys) -> None:
    """A plate in glTF's axes is the same plate in a scene's: its broadside is at azimuth 0, as in
    the closed form. With z up it lies flat, and shows its edge.
    """
    corners = np.array([[-0.1, -0.05, 0], [0.1, -0.05, 0], [0.1, 0.05, 0], [-0.1, 0.05, 0]])
    path = tmp_path / "plate.glb"
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(path)
    broadside = 10 * math.log10(4 * np.pi * (0.02 * 79e9 / speed_of_light) ** 2)
    asked = str(path), "--carrier-hz", "79e9", "--azimuth", "0"
    code, printed, errors = twin(*asked, monkeypatch=monkeypatch, capsys=capsys)
    assert code == 0
    assert float(printed.splitlines()[1].split(",")[2]) == pytest.approx(broadside, abs=0.05)
    assert "y is up" in errors
    _, printed, errors = twin(*asked, "--up", "z", monkeypatch=monkeypatch, capsys=capsys)
    assert float(printed.splitlines()[1].split(",")[2]) < broadside - 60
    assert "is up" not in errors
    code, _, errors = twin(*asked, "--up", "x", monkeypatch=monkeypatch, capsys=capsys)
    assert code == 2
    assert "up: 'x': expected y or z" in errors
