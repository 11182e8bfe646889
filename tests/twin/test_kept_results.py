"""Light and echoes kept from one process to the next: the same bits, and never those of other
inputs.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin.camera.lit_frame
import twin.radar.propagation.kept
from tests.full_disk import files_up_to
from tests.physics.radar_worlds import RADAR, plate, world
from twin.accuracy import Decision
from twin.camera.acquisition import capture
from twin.fidelity import PRESETS, Fidelity
from twin.kept_results import KeptResults
from twin.radar import radar_capture
from twin.scene import Pose, Scene, Sun, Track, load_scene
from twin.scene.materials import Surface
from twin.system import load_system

DRAFT = PRESETS["draft"]


def _count_and_make(folder: Path) -> int:
    def make() -> int:
        with (folder / "made").open("a") as file:
            file.write("x")
        time.sleep(0.2)  # long enough for all to come
        return 7

    return KeptResults(folder / "store").get("number", ("key",), make)


def test_processes_at_once_make_it_once(tmp_path: Path) -> None:
    with ProcessPoolExecutor(4) as pool:
        assert list(pool.map(_count_and_make, [tmp_path] * 16)) == [7] * 16
    assert (tmp_path / "made").read_text() == "x"


def test_a_damaged_file_is_made_anew(tmp_path: Path) -> None:
    store = KeptResults(tmp_path)
    assert store.get("number", (), lambda: 1000) == 1000
    (file,) = tmp_path.glob("*.pickle")
    whole = file.read_bytes()
    for place in range(len(whole)):  # any bit, that of a number among them
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert store.get("number", (), lambda: 2000) == 2000
        file.write_bytes(whole)
    file.write_bytes(b"")
    assert store.get("number", (), lambda: 3000) == 3000
    assert store.found == []
    assert store.get("number", (), lambda: 4000) == 3000
    assert store.found == ["number"]


def test_the_oldest_go_first(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("twin.kept_results._MOST_BYTES", 2500)
    store = KeptResults(tmp_path)
    for number in range(3):
        store.get("bytes", (number,), lambda: b"." * 1000)
        time.sleep(0.01)  # of another age
        store.get("bytes", (0,), lambda: b"")  # read: it is the youngest again
        time.sleep(0.01)
    store.get("bytes", (3,), lambda: b"." * 3000)  # more than all together: not kept
    found = len(store.found)
    for number in (0, 2, 1):
        store.get("bytes", (number,), lambda: b"." * 1000)
    assert len(store.found) - found == 2


def test_ages_of_the_future_are_no_younger(tmp_path: Path, monkeypatch) -> None:
    """A clock was set back: new results were the first to go."""
    monkeypatch.setattr("twin.kept_results._MOST_BYTES", 2500)
    store = KeptResults(tmp_path)
    for number in range(2):
        store.get("bytes", (number,), lambda: b"." * 1000)
    for file in tmp_path.glob("*.pickle"):
        os.utime(file, (4e9, 4e9))
    store.get("bytes", (2,), lambda: b"." * 1000)
    store.get("bytes", (2,), lambda: b"")
    assert store.found == ["bytes"]


def test_a_result_under_another_name_is_none(tmp_path: Path) -> None:
    store = KeptResults(tmp_path)
    store.get("one", (), lambda: "one")
    (one,) = tmp_path.glob("one-*.pickle")
    store.get("other", (), lambda: "other")
    (other,) = tmp_path.glob("other-*.pickle")
    one.replace(other)
    assert store.get("other", (), lambda: "made anew") == "made anew"


def test_what_others_may_write_is_not_read(tmp_path: Path, monkeypatch) -> None:
    """A pickle that is read is run."""
    store = KeptResults(tmp_path / "kept")
    store.get("number", (), lambda: 1)
    (file,) = (tmp_path / "kept").glob("*.pickle")
    (tmp_path / "kept").chmod(0o777)
    assert store.get("number", (), lambda: 2) == 2
    (tmp_path / "kept").chmod(0o700)
    own = os.fstat
    foreign = lambda number: os.stat_result((*own(number)[:4], 12345, *own(number)[5:]))  # noqa: E731
    monkeypatch.setattr(os, "fstat", foreign)
    assert store.get("number", (), lambda: 3) == 3
    monkeypatch.undo()
    whole = file.read_bytes()
    file.unlink()
    (tmp_path / "elsewhere").write_bytes(whole)
    file.symlink_to(tmp_path / "elsewhere")
    assert store.get("number", (), lambda: 4) == 4
    file.unlink()
    os.mkfifo(file)
    assert store.get("number", (), lambda: 5) == 5


def test_what_cannot_be_pickled_is_made_and_not_kept(tmp_path: Path) -> None:
    store = KeptResults(tmp_path)
    made = store.get("function", (), lambda: lambda: 7)
    assert made() == 7
    assert not list(tmp_path.glob("*.pickle"))


def test_all_counts_to_the_last_bit(tmp_path: Path) -> None:
    store, numbers = KeptResults(tmp_path), np.array([1.0, 2.0])
    for content in (numbers, numbers + 1e-15, numbers.astype(np.float32), numbers[:, None]):
        store.get("array", (content,), lambda: 0)
    assert store.found == []
    store.get("array", (numbers.copy(),), lambda: 0)
    assert store.found == ["array"]


def test_waiting_is_told(tmp_path: Path, monkeypatch) -> None:
    told: list[str] = []
    monkeypatch.setattr("twin.progress.listeners", [lambda stage, _: told.append(stage)])
    with ProcessPoolExecutor(1) as pool:
        other = pool.submit(_count_and_make, tmp_path)
        while not (tmp_path / "made").exists():
            time.sleep(0.01)
        assert _count_and_make(tmp_path) == other.result() == 7
    assert told == ["waiting for another run"]


def test_where_nothing_can_be_kept_all_is_made(tmp_path: Path, monkeypatch) -> None:
    """And the store says why: of what is in its way nobody had heard."""
    file = tmp_path / "file"
    file.touch()
    for folder, why in ((file, "File exists"), (file / "below", "Not a directory")):
        store = KeptResults(folder)
        assert store.get("number", (), lambda: 1) == 1
        assert store.problem == f"{folder}: {why}"
    folder = KeptResults(tmp_path / "full")
    with files_up_to(100):
        assert folder.get("bytes", (), lambda: b"." * 1000) == b"." * 1000
    assert folder.problem.endswith(".pickle: File too large")
    assert not list((tmp_path / "full").glob("*.pickle"))
    folder.problem = ""
    assert folder.get("bytes", (), lambda: b"other") == b"other"
    assert folder.problem == ""
    monkeypatch.setattr(os, "getuid", lambda: 12345)  # the folder is somebody else's
    assert folder.get("bytes", (), lambda: b"mine") == b"mine"
    assert folder.problem == f"{tmp_path / 'full'}: is another user's, or others may write to it"


@pytest.mark.parametrize("kind", [".pickle", ".lock"])
def test_a_folder_in_the_place_of_a_file_is_told(tmp_path: Path, kind: str) -> None:
    """Each result is made all the same, and the others are kept."""
    KeptResults(tmp_path).get("one", (), lambda: 1)
    (file,) = tmp_path.glob(f"one-*{kind}")
    file.unlink()
    file.mkdir()
    store = KeptResults(tmp_path)
    assert store.get("one", (), lambda: 2) == 2
    assert store.problem == f"{file}: Is a directory"
    assert store.get("other", (), lambda: 3) == 3
    assert store.get("other", (), lambda: 4) == 3


def test_a_folder_among_the_results_stops_no_removal(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("twin.kept_results._MOST_BYTES", 2500)
    (tmp_path / "mine.pickle").mkdir()
    os.utime(tmp_path / "mine.pickle", (1.0, 1.0))
    store = KeptResults(tmp_path)
    for number in range(9):
        store.get("bytes", (number,), lambda: b"." * 1000)
    assert len(list(tmp_path.glob("bytes-*.pickle"))) == 2
    assert store.problem == ""


def test_what_making_raises_is_raised_and_nothing_kept(tmp_path: Path) -> None:
    store = KeptResults(tmp_path)
    for error in (OSError("no device"), KeyboardInterrupt()):

        def make(error: BaseException = error) -> int:
            raise error

        with pytest.raises(type(error)):
            store.get("number", (), make)
    assert store.get("number", (), lambda: 5) == 5


def _expect_kept_times(first: Sequence[Decision], again: Sequence[Decision]) -> None:
    """A time that another run took is told as such; all else of a decision is as it was."""
    assert any(one.cost for one in first)
    for made, kept in zip(first, again, strict=True):
        assert str(kept).replace(" of an earlier run)", ")") == str(made)
        assert kept.cost == (made.cost and f"{made.cost} of an earlier run")


@pytest.mark.thorough
def test_light_is_kept_bit_for_bit(tmp_path: Path, monkeypatch) -> None:
    scene, system = load_scene("crossing"), load_system("workable")
    first = capture(scene, system, seed=3, fidelity=DRAFT, kept=KeptResults(tmp_path))
    monkeypatch.setattr(twin.camera.lit_frame, "render", None)
    store = KeptResults(tmp_path)
    again = capture(scene, system, seed=3, fidelity=DRAFT, kept=store)
    assert store.found == ["light"]
    np.testing.assert_array_equal(first.record.counts, again.record.counts)
    np.testing.assert_array_equal(first.cells_e, again.cells_e)
    assert first.warnings == again.warnings
    _expect_kept_times(first.decisions, again.decisions)
    objects = tuple(replace(item, radar="obstacle") for item in scene.objects)
    rig = replace(scene.rig, radar=Pose((0.0, 0.0, 1.0)))
    unlike = replace(scene, objects=objects, rig=rig, targets=(), track=Track((1.0, 0.0, 0.0), 2))
    capture(unlike, system, seed=3, fidelity=DRAFT, kept=store)  # to a radar alone
    assert store.found == ["light"] * 2
    others = [
        (scene.with_({"rig.x_m": 1e-12}), system, 3, DRAFT),
        (scene, system.with_({"readout.read_noise_e": 100.0}), 3, DRAFT),
        (scene, system, 4, DRAFT),
        (scene, system, 3, DRAFT.with_(samples=9)),
    ]
    for world_, design, seed, knobs in others:
        with pytest.raises(TypeError):  # rendered
            capture(world_, design, seed=seed, fidelity=knobs, kept=store)


def _lit(scene: Scene) -> Scene:
    """The same to a radar, in another light."""
    objects = tuple(replace(item, reflectance=0.123) for item in scene.objects)
    rig = replace(scene.rig, detector=Pose((0.0, 1.0, 0.0)))
    return replace(scene, objects=objects, rig=rig, sun=Sun(10.0, 20.0, 30.0))


def test_echoes_are_kept_bit_for_bit(tmp_path: Path, monkeypatch) -> None:
    scene, knobs = world(plate("plate", [10.0, 0.0, 0.0])), Fidelity(radar="optics")
    first = radar_capture(scene, RADAR, seed=1, fidelity=knobs, kept=KeptResults(tmp_path))
    monkeypatch.setattr(twin.radar.propagation.kept, "traced_interval", None)
    store = KeptResults(tmp_path)
    again = radar_capture(scene, RADAR, seed=1, fidelity=knobs, kept=store)
    np.testing.assert_array_equal(first.record.iq, again.record.iq)
    assert first.propagation.bodies == again.propagation.bodies
    other_light = knobs.with_(samples=4)
    anonymous = RADAR.model_copy(update={"name": "another"})
    for seen, radar, given in (
        (_lit(scene), RADAR, knobs),
        (scene, anonymous, knobs),
        (scene, RADAR, other_light),
    ):
        radar_capture(seen, radar, seed=2, fidelity=given, kept=store)
    assert store.found == ["echoes"] * 4
    (item,) = scene.objects
    stone = replace(scene, objects=(replace(item, material="concrete"),))
    mounted = replace(scene, rig=replace(scene.rig, radar=Pose((0.0, 0.0, 1e-6))))
    row = scene.materials["rubber"]
    assert row.surface is not None
    height = row.surface.rms_height_m.model_copy(update={"assumed": "otherwise"})
    said = row.model_copy(update={"surface": Surface(rms_height_m=height)})
    unlike = replace(scene, materials={**scene.materials, "rubber": said})
    others = [
        (unlike, RADAR, knobs),  # what is assumed is told with the echoes
        (world(plate("plate", [10.0, 0.0, 1e-14])), RADAR, knobs),
        (world(replace(item, radar="declared")), RADAR, knobs),
        (world(replace(item, velocity_m_per_s=(1e-6, 0.0, 0.0))), RADAR, knobs),
        (stone, RADAR, knobs),
        (mounted, RADAR, knobs),
        (scene, RADAR.with_({"front_end.noise_figure_db": 11.0}), knobs),
        (scene, RADAR, knobs.with_(radar_tolerance=0.2)),
    ]
    for seen, radar, given in others:
        with pytest.raises(TypeError):  # traced
            radar_capture(seen, radar, seed=1, fidelity=given, kept=store)


def test_times_of_kept_echoes_are_of_an_earlier_run(tmp_path: Path) -> None:
    scene = world(plate("plate", [10.0, 0.0, 0.0]), plate("other", [12.0, 1.0, 0.0]))
    first, again = (
        radar_capture(scene, RADAR, seed=1, kept=KeptResults(tmp_path)) for _ in range(2)
    )
    _expect_kept_times(first.decisions, again.decisions)


def test_seeds_of_rays_count(tmp_path: Path) -> None:
    scene, knobs = world(plate("plate", [10.0, 0.0, 0.0])), Fidelity(radar="paths")
    store = KeptResults(tmp_path)
    for seed in (1, 2, 1):
        radar_capture(scene, RADAR, seed=seed, fidelity=knobs, kept=store)
    assert store.found == ["echoes"]


def test_of_a_users_own_models_nothing_is_kept(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "from twin.radar.synthesis import Contributions\n"
        "def solve(scene, radar, fidelity, seed):\n"
        "    return Contributions.ahead(np.array([1e-4 + 0j]), np.array([1e-7]), np.zeros(1))\n"
        "from twin.detector import FrontEnd\n"
        "def detector(system):\n"
        "    return FrontEnd.of(system)\n"
    )
    store = KeptResults(tmp_path / "store")
    own = Fidelity(radar=f"{tmp_path / 'mine.py'}:solve")
    scene = world(plate("plate", [10.0, 0.0, 0.0]))
    radar_capture(scene, RADAR, fidelity=own, kept=store)
    system = tmp_path / "own.toml"
    system.write_text('base = "workable"\n[detector]\nfunction = "mine.py:detector"\n')
    capture(load_scene("table1"), load_system(system), fidelity=DRAFT, kept=store)
    assert not (tmp_path / "store").exists()


@pytest.mark.thorough
def test_a_second_run_takes_both_from_the_first(tmp_path: Path) -> None:
    environment = os.environ | {"UGV_TWIN_CACHE": str(tmp_path / "kept")}
    told, records = [], []
    for name, more in (("first", ()), ("second", ()), ("third", ("--anew",))):
        out = tmp_path / name
        command = ["-m", "twin", "run", "table1", "--fidelity", "draft", "--out", str(out), *more]
        ran = subprocess.run(
            [sys.executable, *command], check=True, env=environment, capture_output=True, text=True
        )
        told.append([line for line in ran.stdout.splitlines() if "of an earlier run" in line])
        records.append([(out / file).read_bytes() for file in ("record.h5", "radar.h5")])
        assert ("Of an earlier run" in (out / "report.html").read_text()) is (name == "second")
    assert records[0] == records[1] == records[2]
    assert (told[0], told[2]) == ([], [])
    (line,) = told[1]
    assert "light" in line
    assert "echoes" in line
    assert "--anew" in line


@pytest.mark.thorough
def test_explain_tells_times_of_an_earlier_run(tmp_path: Path) -> None:
    """They had been told as if this run had taken them."""
    environment = os.environ | {"UGV_TWIN_CACHE": str(tmp_path / "kept"), "COLUMNS": "200"}
    out = tmp_path / "out"
    command = ["-m", "twin", "run", "table1", "--radar", "none", "--explain", "--out", str(out)]
    for is_second in (False, True):
        ran = subprocess.run(
            [sys.executable, *command], check=True, env=environment, capture_output=True, text=True
        )
        assert ("s of an earlier run" in ran.stdout) is is_second
        assert ("s of an earlier run" in (out / "report.html").read_text()) is is_second
        told = json.loads((out / "summary.json").read_text())["decisions"]
        assert {one["is_kept"] for one in told} == {is_second}


@pytest.mark.quick(1)
@pytest.mark.parametrize("cores", ["one process", "a helper"])
def test_a_run_that_can_keep_nothing_says_so_once(tmp_path: Path, cores: str) -> None:
    """The helper computes the camera, and the command itself the radar."""
    (tmp_path / "kept").touch()
    command = ["-m", "twin", "run", "table1", "--fidelity", "draft", "--out", str(tmp_path / "out")]
    if cores == "one process":
        command += ["--radar", "none"]
    ran = subprocess.run(
        [sys.executable, *command],
        check=True,
        env=os.environ | {"UGV_TWIN_CACHE": str(tmp_path / "kept")},
        capture_output=True,
        text=True,
    )
    told = f"not all light and echoes are kept for later runs: {tmp_path / 'kept'}: File exists; "
    assert ran.stderr.count(told) == 1
