"""What all commands of `twin` share: version, help, completion, quiet, verbose, JSON."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from twin import cli
from twin.commands import catalogue

ROOT = Path(__file__).parents[2]
MESSAGES = "Digital twin of a vehicle's single-pixel camera and radar."


@pytest.fixture
def twin(monkeypatch, capsys):
    """The command, in this process: exit status, standard output, standard error."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["twin", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        told = capsys.readouterr()
        return ended.value.code or 0, told.out, told.err

    return call


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    corners = np.array([[0, -0.1, -0.1], [0, 0.1, -0.1], [0, 0.1, 0.1], [0, -0.1, 0.1]])
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "plate.ply")
    return tmp_path / "plate.ply"


def run(*arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_version_and_help(twin) -> None:
    from twin import __version__

    assert twin("--version") == (0, f"twin {__version__}\n", "")
    assert twin("-h") == twin("--help")
    assert MESSAGES in twin("-h")[1]
    assert twin("safety", "-h") == twin("safety", "--help")


@pytest.mark.quick(1)
@pytest.mark.parametrize("command", ["twin schema system", "twin --help", "hardware methods"])
def test_a_reader_that_leaves_is_no_fault(command: str) -> None:
    """Long output, and a short one that is flushed at the end: silent, as ended by SIGPIPE."""
    package, *arguments = command.split()
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", package, *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=write,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")


def test_help_loads_no_library_of_size() -> None:
    """What keeps `twin --help` below a tenth of a second."""
    heavy = "numpy", "scipy", "pydantic", "rich", "matplotlib", "mitsuba", "xarray", "trimesh"
    code = f"import sys, twin.cli; print([m for m in {heavy} if m in sys.modules])"
    assert run("-c", code).stdout == "[]\n"


@pytest.mark.parametrize(
    ("words", "found"), [("twin sa", "safety"), ("twin budget --dist", "--distances")]
)
def test_a_shell_completes_commands_and_options(words: str, found: str) -> None:
    code = "import sys; sys.argv = ['twin']; from twin.cli import main; main()"
    n = len(words.split()) - 1
    asked = {"_TWIN_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(n)}
    done = run("-c", code, **asked)
    assert (done.returncode, done.stderr) == (0, "")
    assert found in done.stdout.split()


DOCUMENTS = {
    "systems": ["systems"],
    "parts": ["parts"],
    "parts fb1550-12": ["values"],
    "budget": ["table1", "frame_rates", "verdict", "assumed"],
    "budget --system workable": ["walls", "verdict", "left_out"],
    "safety": ["hazards", "verdict", "ratio_1550_to_850"],
    "check table1": ["objects", "rig", "sun", "verdict"],
}


@pytest.mark.quick(2)
@pytest.mark.parametrize("command", list(DOCUMENTS))
def test_one_document_on_standard_output_and_all_else_beside_it(twin, command: str) -> None:
    """The lines are those that stand on standard output without the option."""
    words = command.split()
    code, lines, _ = twin(*words)
    assert code == 0
    code, document, told = twin(*words, "--json")
    content = json.loads(document)
    assert code == 0
    assert content["command"] == f"twin {words[0]}"
    assert told == lines
    for name in DOCUMENTS[command]:
        assert name in content
    assert twin(*words, "--json", "-q")[1:] == (document, "")


def test_numbers_that_are_none_are_null(twin, plate: Path) -> None:
    """Nothing comes back edge on: minus infinity in the table, null in JSON."""
    words = ("rcs", plate, "--carrier-hz", "10e9", "--azimuth", "0:90:90")
    code, document, told = twin(*words, "--json")
    rows = json.loads(document)["rows"]
    assert code == 0
    assert told.splitlines()[-1] == "90,0,-inf"
    assert [row["azimuth_deg"] for row in rows] == [0.0, 90.0]
    assert rows[1]["rcs_dbsm"] is None
    assert rows[0]["rcs_dbsm"] == pytest.approx(
        float(told.splitlines()[-2].split(",")[2]), abs=1e-4
    )


@pytest.mark.parametrize(
    ("command", "name"), [("safety", "safety.json"), ("budget --system workable", "budget.json")]
)
def test_the_document_holds_what_the_file_holds(twin, tmp_path, command: str, name: str) -> None:
    document = json.loads(twin(*command.split(), "--json", "--out", tmp_path / "out")[1])
    written = json.loads((tmp_path / "out" / name).read_text())
    assert (written.pop("format"), name in written.pop("files")) == (f"ugv-twin-{name[:-5]}", True)
    assert {key: document[key] for key in written} == written
    assert document["written"] == [str(tmp_path / "out" / name)]


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("budget", "budget.json"),
        ("budget --system workable", "budget.png"),
        ("safety", "safety.json"),
        ("trade yard", "trade.json"),
        ("trade yard", "trade.csv"),
        ("trade yard", "trade.md"),
        ("trade yard", "trade.png"),
    ],
)
def test_files_of_somebody_else_are_not_overwritten(
    twin, tmp_path: Path, command: str, name: str
) -> None:
    """They had been, without a word; refused before any work, `trade` would take minutes."""
    (tmp_path / name).write_text("{}")
    words = command.split()
    status, out, error = twin(*words, "-q", "--out", tmp_path)
    assert (status, out) == (2, "")
    assert f"holds {name}, of no earlier {words[0]}, which this one would overwrite" in error
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [(name, "{}")]


@pytest.mark.parametrize("command", ["budget", "safety"])
def test_files_of_the_same_command_are_replaced(twin, tmp_path: Path, command: str) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    for _ in range(2):
        assert twin(command, "-q", "--out", tmp_path)[0] == 0
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_quiet_leaves_the_verdict(twin) -> None:
    assert twin("safety", "-q")[1] == (
        "workable: within the limits of the eye, least margin 3.69 (laser, continuous, 100 s)\n"
    )
    assert len(twin("budget", "--system", "paper", "--quiet")[1].splitlines()) == 1
    assert "expected one of them" in twin("safety", "-q", "-v")[2]


def test_a_verbose_sweep_tells_its_points_and_their_times(
    twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(
        'scene = "table1"\nmodel = "closed-form"\nmetrics = ["snr"]\n'
        '[grid]\n"link.distance_m" = [2, 5, 10]\n'
    )
    status, _, told = twin("sweep", "study.toml", "--workers", "0", "-v")
    assert status == 0
    assert "3 of 3 points: " in told


def test_verbose_tells_stages_and_times(twin, plate: Path) -> None:
    words = ("rcs", plate, "--carrier-hz", "10e9", "--azimuth", "0:4:1")
    _, printed, told = twin(*words)
    _, again, more = twin(*words, "-v")
    assert again == printed
    steps = [line for line in more.splitlines() if line not in told.splitlines()]
    assert steps
    assert all(" s  " in line and line.endswith("s") for line in steps)


def test_every_command_has_the_options(twin) -> None:
    """But `schema`, whose only output is a document, and `serve`, which prints no verdict."""
    for command in cli.app.registered_commands:
        name = command.name or command.callback.__name__
        if command.callback is not catalogue.schema:
            shown = twin(name, "--help")[1]
            assert "--quiet" in shown
            assert ("--json" in shown) == (name != "serve")


@pytest.mark.parametrize(
    ("row", "told"), [("metl", "radio.itu = 'metl' is none of"), ("metal", "")]
)
def test_check_tells_what_the_radar_has_no_values_of(twin, plate, tmp_path, row, told) -> None:
    """The run ends there, minutes later perhaps."""
    (tmp_path / "materials.toml").write_text(
        "[mine.optical]\nreflectance = { value = 0.5, assumed = 'x' }\n"
        f"[mine.radio]\nitu = '{row}'\n"
    )
    assert twin("import", plate, tmp_path / "scene", "--material", "mine")[0] == 0
    code, out, err = twin("check", tmp_path / "scene")
    assert code == 0
    assert ("hybrid-79: material 'mine': " + told in err) == bool(told)
    assert f"{len(told) and 1} warning" in out


def test_check_tells_whose_radio_properties_are_generic(twin, plate, tmp_path) -> None:
    assert twin("import", plate, tmp_path / "scene")[0] == 0
    xml = tmp_path / "scene" / "scene.xml"
    xml.write_text(xml.read_text().replace('"generic"', '"unobtainium"'))
    told = "hybrid-79: materials not in the table, radio properties taken from generic: unobtainium"
    assert f"{told} (plate_ply)" in twin("check", tmp_path / "scene")[2]
    assert told not in twin("check", tmp_path / "scene", "--radar", "none")[2]
