"""The folder of a run: of one run, whole, and another one for another run."""

import json
from itertools import combinations
from pathlib import Path

import pytest

from twin.fidelity import DEFAULT, DEFAULT_SHARE, PRESETS, Fidelity
from twin.files import InputError
from twin.job import run
from twin.radar import load_radar
from twin.run_folder import default_folder, run_folder, settings_of
from twin.scene import Pose, Track, load_scene
from twin.system import load_system
from twin.trade.pareto import _folder as trade_folder

FAST = Fidelity(samples=1, max_depth=1, radar="targets")
RADAR = {"radar.h5", "detections.csv", "truth.csv"}


def settings(**changes):
    plain = {
        "scene": "yard",
        "systems": ["workable", "paper"],
        "radar": "hybrid-79",
        "seed": 0,
        "pose": None,
        "track": None,
        "fidelity": DEFAULT,
    }
    return settings_of(**{**plain, **changes})


def test_files_of_the_run_before_go_and_a_users_own_stay(tmp_path: Path) -> None:
    """On ee37b06 the second run left the first one's radar record beside its own report."""
    common = {"compare": None, "fidelity": FAST, "out": tmp_path / "out"}
    run("table1", **common, paths=True)
    (tmp_path / "out" / "notes.txt").write_text("mine")
    before = {path.name for path in (tmp_path / "out").iterdir()}
    assert before >= RADAR | {"paths.csv", "notes.txt"}
    run("table1", **common, radar=None)
    after = {path.name for path in (tmp_path / "out").iterdir()}
    assert after == before - RADAR - {"paths.csv"}
    index = json.loads((tmp_path / "out" / "run.json").read_text())
    assert {*index["files"], "run.json", "notes.txt"} == after
    assert index["radar"] is None
    assert index["fidelity"]["samples"] == 1


def test_the_radar_alone(tmp_path: Path) -> None:
    """The counterpart of ``--radar none``: the same echoes as with a camera beside it."""
    alone = run("table1", None, fidelity=FAST, out=tmp_path / "alone")
    both = run("table1", fidelity=FAST, compare=None, out=tmp_path / "both")
    assert (alone.view, alone.evaluations) == (None, ())
    assert {path.name for path in alone.out.iterdir()} == RADAR | {
        "report.html",
        "run.json",
        "summary.json",
    }
    assert (alone.out / "radar.h5").read_bytes() == (both.out / "radar.h5").read_bytes()
    page = (alone.out / "report.html").read_text()
    assert "<h1>table1, seen by a radar</h1>" in page
    assert "single pixel" not in page
    with pytest.raises(InputError, match="system, radar: both are none"):
        run("table1", None, radar=None, out=tmp_path / "neither")


def test_every_variant_has_a_folder_of_its_own() -> None:
    """The plain run keeps its short name; on ee37b06 all of these shared it."""
    assert default_folder(settings()) == Path("runs/yard-workable")
    assert default_folder(settings(systems=["paper", "workable"])) == Path("runs/yard-paper")
    draft, standard, usual = PRESETS["draft"], PRESETS["standard"], DEFAULT
    named = {
        "runs/yard-workable-seed_3": settings(seed=3),
        "runs/yard-workable-hybrid-79-slow": settings(radar="hybrid-79-slow"),
        "runs/yard-workable-no-radar": settings(radar=None),
        "runs/yard-workable-alone": settings(systems=["workable"]),
        "runs/yard-workable-beside_mine": settings(systems=["workable", "mine"]),
        "runs/yard-workable-pose_1,0,1.2,15": settings(pose=Pose((1, 0, 1.2), 15.0)),
        "runs/yard-workable-pose_1,0,1.2": settings(pose=Pose((1, 0, 1.2))),
        "runs/yard-workable-track_0,0.03,0,33": settings(track=Track((0, 0.03, 0), 33)),
        "runs/yard-workable-track_0,0.03,0,33,0.1": settings(track=Track((0, 0.03, 0), 33, 0.1)),
        "runs/yard-workable-draft": settings(fidelity=draft),
        "runs/yard-workable-standard": settings(fidelity=standard),
        "runs/yard-workable-standard-radar_paths": settings(fidelity=standard.with_(radar="paths")),
        "runs/yard-workable-radar_paths": settings(fidelity=usual.with_(radar="paths")),
        "runs/yard-workable-draft-radar_paths": settings(fidelity=draft.with_(radar="paths")),
        "runs/yard-hybrid-79": settings(systems=[]),
        "runs/yard-prototype": settings(systems=[], radar="prototype"),
    }
    for name, made in named.items():
        assert str(default_folder(made)) == name
    for a, b in combinations(named.values(), 2):
        assert default_folder(a) != default_folder(b)


def test_a_trade_has_one_too() -> None:
    """On ee37b06 radar, tolerance and seed shared a folder."""
    scene, system = load_scene("table1"), load_system("workable")

    def folder(
        radar: str | None = "hybrid-79",
        tolerance: float = DEFAULT_SHARE,
        within_s: float | None = None,
        seed: int = 0,
    ) -> str:
        design = None if radar is None else load_radar(radar)
        return str(trade_folder(scene, system, design, tolerance, within_s, seed))

    assert folder() == "runs/trade-table1-workable"
    assert folder(None) == "runs/trade-table1-workable-no-radar"
    assert folder("prototype") == "runs/trade-table1-workable-prototype"
    assert folder(within_s=0.5) == "runs/trade-table1-workable-within_0.5_s"
    assert folder(tolerance=0.1, seed=2) == "runs/trade-table1-workable-tolerance_0.1-seed_2"


@pytest.mark.parametrize("text", ["", "[]", '{"format": "another", "files": ["keep.txt"]}', "{"])
def test_a_list_that_is_none_of_a_run_is_kept_and_removes_nothing(
    text: str, tmp_path: Path
) -> None:
    (tmp_path / "run.json").write_text(text)
    (tmp_path / "keep.txt").write_text("mine")
    refused = pytest.raises(InputError, match=r"holds run\.json, of no earlier run")
    with refused, run_folder(tmp_path, {}):
        pytest.fail("works before it is refused")
    assert {p.name for p in tmp_path.iterdir()} == {"keep.txt", "run.json"}
    assert (tmp_path / "run.json").read_text() == text


def test_files_of_somebody_else_are_not_overwritten(tmp_path: Path) -> None:
    """Those of each run are told before any work, others when they are to be written."""
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(InputError, match=r"holds report\.html, of no earlier run"):
        run("table1", radar=None, compare=None, fidelity=FAST, out=tmp_path)
    (tmp_path / "report.html").unlink()
    (tmp_path / "record.h5").write_text("mine")
    refused = pytest.raises(InputError, match=r"holds record\.h5, of no earlier run")
    with refused, run_folder(tmp_path, {}) as partial:
        (partial / "record.h5").write_text("x")
    assert {p.name for p in tmp_path.iterdir()} == {"record.h5"}
    assert (tmp_path / "record.h5").read_text() == "mine"


def test_no_run_goes_to_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a path, which is what the command gets, an empty text is that folder."""
    monkeypatch.chdir(tmp_path)
    for out in (Path(""), Path("."), "", " "):
        with pytest.raises(InputError, match=r"^out: is empty"):
            run("table1", radar=None, compare=None, fidelity=FAST, out=out)
    assert not list(tmp_path.iterdir())


def test_a_list_reaches_into_no_other_folder(tmp_path: Path) -> None:
    (tmp_path / "outside").write_text("mine")
    out = tmp_path / "out"
    with run_folder(out, {}) as partial:
        (partial / "old").write_text("x")
    index = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps({**index, "files": ["old", "../outside"]}))
    with run_folder(out, {}) as partial:
        (partial / "new").write_text("x")
    assert {p.name for p in out.iterdir()} == {"new", "run.json"}
    assert (tmp_path / "outside").exists()


@pytest.mark.parametrize(
    "listed", ["a\\u0000b", "folder", "n" * 5000, "a/b", "\\ud800", None], ids=lambda x: str(x)[:9]
)
def test_what_cannot_be_removed_stays_and_the_new_run_is_kept(
    listed: str | None, tmp_path: Path
) -> None:
    """Names that no file can have, and a folder's. A list nested deeper than any parser goes is of
    no run: it is refused, and everything stays.
    """
    (tmp_path / "folder").mkdir()
    text = (
        f'{{"format": "ugv-twin-run", "files": ["old", "{listed}"]}}' if listed else "[" * 200_000
    )
    (tmp_path / "old").write_text("old")
    (tmp_path / "run.json").write_text(text)
    if listed is None:
        with pytest.raises(InputError, match="of no earlier run"), run_folder(tmp_path, {}):
            pass
        assert {p.name for p in tmp_path.iterdir()} == {"folder", "old", "run.json"}
        return
    with run_folder(tmp_path, settings()) as partial:
        (partial / "new").write_text("new")
    assert (tmp_path / "new").read_text() == "new"
    assert (tmp_path / "folder").is_dir()
    assert not (tmp_path / "old").exists()
    assert json.loads((tmp_path / "run.json").read_text())["files"] == ["new"]


def test_a_run_that_fails_leaves_the_one_before(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with run_folder(out, {"seed": 1}) as partial:
        (partial / "old").write_text("x")

    def failing() -> None:
        with run_folder(out, {"seed": 2}) as partial:
            (partial / "new").write_text("x")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        failing()
    assert {p.name for p in out.iterdir()} == {"old", "run.json"}
    assert json.loads((out / "run.json").read_text())["seed"] == 1


def test_notes_on_materials_stand_apart_from_assumptions(tmp_path: Path) -> None:
    folder = tmp_path / "wall"
    folder.mkdir()
    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="rectangle" id="wall"><transform name="to_world">'
        '<rotate y="1" angle="-90"/><translate x="3" z="1.2"/></transform>'
        '<bsdf type="diffuse" id="brick"/></shape></scene>'
    )
    (folder / "materials.toml").write_text(
        '[brick.optical]\nreflectance = { value = 0.125, source = "made up" }\n'
    )
    run(folder, radar=None, compare=None, fidelity=FAST, out=tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    _, _, notes = page.partition("of the scene's materials</h3>")
    assert page.count("takes the place of the rows brick") == 1
    assert "takes the place of the rows brick" in notes
