"""The main job, as a user runs it: what it writes, what it refuses, and that it repeats."""

import csv
import filecmp
import html
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from hardware import read_record, reconstruct
from hardware.radar.process import process
from hardware.records import read_radar_record
from tests.full_disk import files_up_to
from tests.still import still_yard
from twin import cli
from twin.accuracy import Interval
from twin.camera.acquisition import capture, measure
from twin.camera.evaluation import evaluate
from twin.camera.light import render
from twin.camera.score import score
from twin.engine import exr_threads, mitsuba
from twin.fidelity import Fidelity
from twin.files import InputError, locked, whole_folder
from twin.job import run, stage_names
from twin.radar import load_radar
from twin.scene import load_scene, parse_pose
from twin.system import load_system

FAST = Fidelity(samples=4, max_depth=2)
FILES = {
    "report.html",
    "run.json",
    "summary.json",
    "record.h5",
    "truth.exr",
    "radar.h5",
    "detections.csv",
    "truth.csv",
}
PICTURES = {
    *(f"{n}.png" for n in ("headline", "scene", "truth", "reconstruction", "snr", "signal")),
    *(f"{n}.png" for n in ("range_doppler", "radar_cuts")),
}


def twin(*arguments: str, monkeypatch, capsys) -> tuple[int, str, str]:
    """Exit code, output and errors of the command in this process."""
    monkeypatch.setattr(sys, "argv", ["twin", *arguments])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    streams = capsys.readouterr()
    return stopped.value.code or 0, streams.out, streams.err


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "yard"
    subprocess.run(
        [sys.executable, "-m", "twin", "run", "yard", "--seed", "7", "--out", str(out)], check=True
    )
    return out


def test_a_run_writes_everything_and_nothing_else(finished: Path) -> None:
    assert {path.name for path in finished.iterdir()} == FILES
    assert list(finished.parent.iterdir()) == [finished]


def test_the_report_is_self_contained(finished: Path) -> None:
    """No link, script or style that a browser would fetch; all is inside, within 5 MB.

    Scripts are left out of the search: that they fetch nothing is tested in a browser.
    """
    page = (finished / "report.html").read_text()
    assert len(page.encode()) < 5e6
    markup = re.sub(r"(?s)<script>.*?</script>", "", page)
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", markup)
    assert "url(" not in markup
    parts = set(re.findall(r'href="#([a-z]+)"', markup))
    assert len(parts) > 8
    assert parts <= set(re.findall(r'id="([a-z]+)"', markup))


def page_data(folder: Path) -> dict:
    """What the report's charts show."""
    page = (folder / "report.html").read_text()
    return json.loads(re.search(r'id="page-data">(.*?)</script>', page, re.S)[1])


def test_every_chart_of_the_report_has_data_and_words(finished: Path) -> None:
    """Each canvas says what it shows, and each line of a legend what its marks are."""
    page = (finished / "report.html").read_text()
    data = page_data(finished)
    assert set(re.findall(r'data-chart="([^"]+)"', page)) == set(data["charts"])
    assert page.count("<canvas") == page.count("<canvas tabindex") + 1  # of the scene
    for chart in data["charts"].values():
        assert chart["title"]
        assert all(layer["name"] for layer in chart["layers"])
    names = {item["name"] for item in data["scene"]["objects"]}
    assert {"car", "person", "wall"} <= names
    assert {t["name"] for t in data["scene"]["targets"]} >= {"trihedral", "car"}
    run = json.loads((finished / "run.json").read_text())
    assert run["command"] == f"twin run yard --seed 7 --out {finished}"
    assert run["command"] in page
    assert run["versions"]["ugv-twin"]


def test_the_summary_says_what_the_verdicts_say(finished: Path) -> None:
    page = html.unescape((finished / "report.html").read_text())
    found = json.loads((finished / "summary.json").read_text())["findings"]
    assert [f["sensor"] for f in found] == ["workable", "paper", "hybrid-79"]
    for finding in found:
        assert finding["result"] in page
        assert all(answer in page for answer in finding["answers"].values())


def test_the_report_names_every_setting_and_assumption(finished: Path) -> None:
    from markupsafe import escape

    page = (finished / "report.html").read_text()
    for design in (load_system("workable"), load_system("paper"), load_radar("hybrid-79")):
        for field, value in design.values():
            assert field in page
            if value.assumed:
                assert str(escape(value.assumed)) in page


def test_page_and_summary_repeat_all_warnings(finished: Path) -> None:
    """Also of the vehicle's radar processing, of the record that is beside them."""
    said = json.loads((finished / "summary.json").read_text())["warnings"]
    processed = process(read_radar_record(finished / "radar.h5")).warnings
    assert processed
    assert {("hybrid-79", warning) for warning in processed} < {(w["of"], w["text"]) for w in said}
    page = html.unescape((finished / "report.html").read_text())
    assert all(f"{w['of']}: {w['text']}" in page for w in said)


def test_the_summary_has_every_figure_with_its_error(finished: Path) -> None:
    """What the page says of a score stands in the summary, its parts apart."""
    summary = json.loads((finished / "summary.json").read_text())
    assert (summary["format"], summary["version"]) == ("ugv-twin-summary", 1)
    figures = {(*f["of"], f["name"]): f for f in summary["figures"]}
    page = (finished / "report.html").read_text()
    for name, unit in (("PSNR", "dB"), ("SSIM", "")):
        found = figures["workable", "lmmse", name]
        assert found["unit"] == unit
        interval = Interval(
            found["value"], found["standard_error"], found["systematic"], found["noise"]
        )
        assert found["standard_error"] > 0
        assert found["noise"] > 0
        assert f"{name} {interval}" in page
    assert figures["workable", "SNR per pixel, median of the lit cells"]["systematic"] > 0
    assert figures["workable", "frame time"]["standard_error"] == 0
    page = html.unescape((finished / "report.html").read_text())
    moved = figures["workable", "share of the converter's range that patterns move"]["value"]
    assert f"patterns move {moved:.2%} of" in page
    emitted = figures["workable", "emitter's share of the light in the band"]["value"]
    assert f"emitter, all cells lit: {emitted:.1%} of" in page
    measured = figures["workable", "noise per exposure as found in the record"]
    assert f"{Interval(measured['value'], noise=measured['noise'])} e- found in" in page
    with (finished / "detections.csv").open() as file:
        rows = list(csv.DictReader(file))
    for index, row in enumerate(rows):
        level = next(
            f for f in summary["figures"] if _of_detection(f["of"], index) and f["name"] == "level"
        )
        error = float(row["model_level_dbm_standard_error"])
        assert level["standard_error"] == (error if np.isfinite(error) else None)


def _of_detection(of: list[str], number: int) -> bool:
    return of[:2] == ["hybrid-79", f"detection {number}"]


def test_truth_has_named_channels_in_metres(finished: Path) -> None:
    """Against the scene file: the chart stands 5 m ahead, the wall at 12.3 m, above is nothing."""
    mi = mitsuba()
    with exr_threads():
        bitmap = mi.Bitmap(str(finished / "truth.exr"))
    names = [field.name for field in bitmap.struct_()]
    assert names == ["albedo", "depth"]
    albedo, depth = np.moveaxis(np.array(bitmap), -1, 0)
    assert albedo.shape == (64, 64)
    assert depth[15, 10] == pytest.approx(5.0, abs=1e-3)
    assert depth[10, 50] == pytest.approx(12.3, abs=1e-3)
    assert albedo[10, 50] == pytest.approx(0.34, abs=1e-3)
    assert np.isinf(depth[0, 50])
    assert albedo[0, 50] == 0


def test_the_radar_record_alone_gives_the_detections(finished: Path) -> None:
    """The vehicle's software on the file gives what stands in ``detections.csv``."""
    found = process(read_radar_record(finished / "radar.h5")).detections
    with (finished / "detections.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["range_m"]) for row in rows] == [d.range_m for d in found]
    # One antenna tells no angle: the cell is empty, not a word.
    assert {row["azimuth_rad"] for row in rows} == {""}
    with (finished / "truth.csv").open() as file:
        truth = {row["name"] for row in csv.DictReader(file)}
    assert truth == {row["target"] for row in rows} - {""}


@pytest.mark.thorough
def test_paths_and_sigmf_come_on_request_figures_and_the_radar_can_stay_away(
    tmp_path: Path,
) -> None:
    common = {"compare": None, "fidelity": FAST}
    result = run("table1", out=tmp_path / "a", paths=True, sigmf=True, figures=True, **common)
    run("table1", out=tmp_path / "b", radar=None, **common)
    extra = {"paths.csv", "radar.sigmf-data", "radar.sigmf-meta"}
    radar = {"radar.h5", "detections.csv", "truth.csv"}
    assert {path.name for path in (tmp_path / "a").iterdir()} == FILES | PICTURES | extra
    assert {path.name for path in (tmp_path / "b").iterdir()} == FILES - radar
    # The progress bar counts the stages that there are.
    systems = [one.system for one in result.evaluations]
    names = stage_names(systems, load_radar("hybrid-79"), figures=True)
    assert set(names) == set(result.seconds)


def test_an_empty_scene_runs_to_its_report(tmp_path: Path) -> None:
    """Nothing to see: noise in both records, warnings, no crash."""
    (tmp_path / "void.xml").write_text('<scene version="3.0.0"></scene>')
    result = run(tmp_path / "void.xml", out=tmp_path / "out", fidelity=FAST)
    assert "the scene has no shapes" in result.scene.warnings
    assert any("noise only" in w for w in result.radar.capture.warnings)
    assert not result.evaluations[0].capture.cells_e.any()


def test_the_record_alone_gives_the_image(finished: Path) -> None:
    """What the vehicle does with the file, without the twin: recognisably the scene."""
    image = reconstruct(read_record(finished / "record.h5")).image[0]
    expected = capture(still_yard(), load_system("workable"), fidelity=FAST).cells_e
    assert np.corrcoef(image.ravel(), expected.ravel())[0, 1] > 0.95


@pytest.mark.whole
def test_same_seed_same_bytes_in_another_process(finished: Path, tmp_path: Path) -> None:
    """With another number of threads: nothing depends on how the work is shared."""
    code = OTHER_THREADS.format(out=tmp_path / "again")
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"  # none of the libraries that take long to load
    for name in ("record.h5", "radar.h5", "truth.exr", "detections.csv"):
        assert filecmp.cmp(finished / name, tmp_path / "again" / name, shallow=False), name
    assert page_data(finished) == page_data(tmp_path / "again")


OTHER_THREADS = """
from twin.engine import ensure_llvm
ensure_llvm()
import drjit as dr
dr.set_thread_count(5)
import twin
twin.run("yard", seed=7, out=r"{out}")
import sys
print([name for name in ("matplotlib", "scipy.interpolate") if name in sys.modules])
"""


def test_another_seed_is_another_noise_of_the_same_scene() -> None:
    scene, system = load_scene("table1"), load_system("workable")
    a, b = (capture(scene, system, seed=s, fidelity=FAST) for s in (1, 2))
    assert (a.record.counts != b.record.counts).any()
    np.testing.assert_allclose(a.cells_e.sum(), b.cells_e.sum(), rtol=0.02)


def test_one_render_serves_every_detector_and_sky() -> None:
    """Measured from the light of another system's render: the same counts as rendered anew."""
    scene = load_scene("table1")
    paper, workable = load_system("paper"), load_system("workable")
    seed = np.random.SeedSequence(5)
    light = render(scene, paper, fidelity=FAST, seed=seed)
    anew = render(scene, workable, fidelity=FAST, seed=np.random.SeedSequence(5))
    a, b = (
        measure(scene, workable, rendered, rng=np.random.default_rng(1)).record.counts
        for rendered in (light, anew)
    )
    np.testing.assert_array_equal(a, b)


def test_paper_is_noise_and_workable_works() -> None:
    """The finding of the headline: no pixel of the paper's full-sun yard stands above its noise."""
    scene = still_yard()
    snr = {n: capture(scene, load_system(n), fidelity=FAST).snr for n in ("paper", "workable")}
    assert snr["paper"].max() < 1
    assert np.median(snr["workable"]) > 3


def test_predicted_noise_is_found_in_the_record() -> None:
    """Twin's budget against the scatter of the record's own pairs: 4095 of them, 5 sigma."""
    for name in ("paper", "workable"):
        taken = capture(still_yard(), load_system(name), seed=3, fidelity=FAST)
        found = reconstruct(taken.record, "zero-fill").noise_electrons[0] / np.sqrt(2)
        sigma = np.sqrt(3 / (4 * 4095))
        # The first pattern's exposures carry more light than the mean: 1 % allowance.
        assert abs(found / taken.noise.total_noise_e - 1) < 5 * sigma + 0.01


def test_rendering_error_is_a_fifth_of_the_sensors_noise() -> None:
    """By default Monte-Carlo noise must not be what an image shows, and no more paths than that."""
    system = load_system("workable")
    taken = capture(still_yard(), system)
    rms = np.sqrt(np.mean(taken.cells_error_e**2)) / taken.noise.pixel_noise_e(system.patterns)
    assert 0.1 < rms < 0.2


def test_saturation_and_darkness_are_warned_of() -> None:
    content = load_system("workable").model_dump()
    content["readout"]["transimpedance_ohm"] = 1e12
    bright = type(load_system("paper")).model_validate(content)
    taken = capture(still_yard(), bright, fidelity=FAST)
    assert any("exposures saturate" in w for w in taken.warnings)
    sky = load_scene("yard", parse_pose("0,0,1.2,0,-80"))
    dark = capture(sky, load_system("workable"), fidelity=FAST)
    assert any("nothing in the field of view" in w for w in dark.warnings)
    assert np.isfinite(evaluate(load_system("workable"), dark).reconstructions[0].image).all()


def test_score_is_skimages() -> None:
    from skimage.metrics import peak_signal_noise_ratio

    rng = np.random.default_rng(0)
    truth = rng.random((32, 32))
    image = truth + rng.normal(size=(32, 32)) * 0.1
    expected = peak_signal_noise_ratio(truth, image, data_range=truth.max())
    assert score(truth, image).psnr_db == pytest.approx(expected)
    assert score(truth, truth).ssim == 1.0
    assert score(np.zeros((4, 4)), np.ones((4, 4))).psnr_db == -np.inf


# What is refused, each with one line and exit code 2, and nothing written.


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run", "nope"], "nope: no such scene"),
        (["run", "yard", "--system", "nope"], "system: 'nope'"),
        (["run", "yard", "--compare", "nope"], "system: 'nope'"),
        (["run", "yard", "--radar", "nope"], "radar: 'nope'"),
        (["run", "yard", "--pose", "1,2"], "expected x,y,z"),
        (["run", "yard", "--seed", "-1"], "--seed"),
        (["run", "yard", "--speed", "1"], "--speed"),
        (["run"], "scene"),
        (["fly"], "fly"),
        (["check", "nope"], "nope: no such scene"),
        (["import", "nope.glb", "x"], "nope.glb: no such file"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments, expected, monkeypatch, capsys, tmp_path
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, errors = twin(*arguments, monkeypatch=monkeypatch, capsys=capsys)
    assert code == 2
    assert len(errors.splitlines()) == 1
    assert expected in errors
    assert list(tmp_path.iterdir()) == []


@pytest.mark.quick(1)
@pytest.mark.parametrize("out", ["file", "file/below", "/proc/nowhere/out"])
def test_an_unwritable_folder_is_refused_before_the_work(
    out, monkeypatch, capsys, tmp_path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    start = time.process_time()
    code, _, errors = twin("run", "yard", "--out", out, monkeypatch=monkeypatch, capsys=capsys)
    assert code == 2
    assert len(errors.splitlines()) == 1
    assert out.split("/")[-1] in errors
    assert time.process_time() - start < 3
    assert (tmp_path / "file").read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_whole_folder_is_all_or_nothing(tmp_path: Path) -> None:
    out = tmp_path / "a" / "b"

    def interrupted() -> None:
        with whole_folder(out) as partial:
            (partial / "half").write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []
    with whole_folder(out) as partial:
        (partial / "new").write_text("x")
    (out / "kept").write_text("y")
    with whole_folder(out) as partial:
        (partial / "new").write_text("z")
    assert {p.name: p.read_text() for p in out.iterdir()} == {"new": "z", "kept": "y"}


def test_a_lock_that_does_not_fit_names_its_folder_and_leaves_nothing(tmp_path: Path) -> None:
    """As on a full disk: the file is there before anything can be written to it."""
    out = tmp_path / "sweep"
    with (
        files_up_to(0),
        pytest.raises(OSError, match="File too large") as caught,
        locked(out, "sweep"),
    ):
        pytest.fail("nobody may work there")
    assert caught.value.filename == str(out)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "after_s", [1.0, *(pytest.param(t, marks=pytest.mark.thorough) for t in (0.2, 4.0))]
)
def test_ctrl_c_leaves_nothing_behind(after_s: float, tmp_path: Path) -> None:
    """After as much processor time."""
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", "run", "yard", "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
    )
    taken = psutil.Process(process.pid).cpu_times
    while sum(taken()[:2]) < after_s:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


@pytest.mark.quick(1)
@pytest.mark.parametrize("library", ["drjit", "mitsuba"])
def test_ctrl_c_while_a_library_registers_its_types(library: str, tmp_path: Path) -> None:
    """An exception that passes through compiled code which can't let it pass aborts the process."""
    interrupted = (
        "import enum, os, signal, sys\n"
        "plain = enum.EnumType.__setattr__\n"
        "def interrupting(*args):\n"
        f"    if {library!r} in sys.modules:\n"
        "        enum.EnumType.__setattr__ = plain\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    plain(*args)\n"
        "enum.EnumType.__setattr__ = interrupting\n"
        "from twin.cli import main\n"
        "main()\n"
    )
    _ends_interrupted(interrupted, tmp_path)


@pytest.mark.thorough
def test_a_second_signal_at_the_end_changes_nothing(tmp_path: Path) -> None:
    """One when there is something to remove, one while it is removed, one while that is said."""
    interrupted = (
        "import os, signal, sys\n"
        "from hardware import files\n"
        "from twin.cli import main\n"
        "from twin.progress import interrupts\n"
        "mkdir, plain = os.mkdir, files._remove\n"
        "def making(path, *args):\n"
        "    mkdir(path, *args)\n"
        "    if str(path).endswith('.partial'):\n"
        "        interrupts.append(signal.SIGINT)\n"
        "os.mkdir = making\n"
        "def interrupting(path):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    plain(path)\n"
        "    assert not os.path.exists(path)\n"
        "files._remove = interrupting\n"
        "class Stderr:\n"
        "    def write(self, text):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        return sys.__stderr__.write(text)\n"
        "    def __getattr__(self, name):\n"
        "        return getattr(sys.__stderr__, name)\n"
        "sys.stderr = Stderr()\n"
        "main()\n"
    )
    _ends_interrupted(interrupted, tmp_path)


def _ends_interrupted(script: str, tmp_path: Path) -> None:
    """A run that a script interrupts ends in one line, and leaves nothing."""
    done = subprocess.run(
        [sys.executable, "-c", script, "run", "yard", "--out", str(tmp_path / "out")],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert done.stderr.endswith("twin: interrupted, nothing half-written is left\n")
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_is_quick() -> None:
    """At most three times the processor time of the command line's library, in turns: no renderer,
    no plots, no NumPy behind it.
    """

    def took_s(*arguments: str) -> float:
        before = os.times()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        after = os.times()
        user = after.children_user - before.children_user
        return user + after.children_system - before.children_system

    commands = ("-c", "import typer"), ("-m", "twin", "--help"), ("-c", "import hardware")
    turns = np.array([[took_s(*command) for command in commands] for _ in range(5)])
    library_s, help_s, vehicle_s = turns.min(axis=0)  # 0.2 s on a slow machine, 0.25, and 0.05
    assert help_s < 3 * library_s
    assert vehicle_s < library_s


def test_wrong_grids_are_not_compared() -> None:
    with pytest.raises(ValueError, match="the truth has"):
        score(np.zeros((4, 4)), np.zeros((8, 8)))


def test_input_error_is_a_value_error() -> None:
    assert issubclass(InputError, ValueError)
    assert os.EX_OK == 0
