"""The regression plugin: what a user sees of it, and the baselines that it keeps.

Inner test sessions run in this process (pytester), on scenes/yard with 32 x 32 cells.
"""

import hashlib
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from yard_32x32 import SYSTEM

from twin.accuracy import Interval
from twin.fidelity import Fidelity, LightFidelity
from twin.files import InputError, scenes_folder
from twin.regression.baseline import Baseline, read_baseline, write_baseline
from twin.regression.checker import Regression
from twin.regression.setup import differences, setup_of
from twin.regression.truth import Truths
from twin.scene import Scene, load_scene
from twin.system import System, load_system

pytest_plugins = ["pytester"]


@pytest.fixture
def project(pytester, twin_truth, monkeypatch):
    """A user's project with one test; ``run(code, *options)`` gives its result.

    An inner session would forget the modules that it loaded, and compiled ones can't be loaded
    twice: so it keeps all but the test itself. It shares this session's truth.
    """
    keep = "_pytest.pytester.SysModulesSnapshot.restore"
    monkeypatch.setattr(keep, lambda _: sys.modules.pop("test_mine", None))
    pytester.plugins.append(_Cached(twin_truth))

    def run(method: str, *options: str):
        pytester.makepyfile(test_mine=USER.format(system=str(SYSTEM), method=method))
        return pytester.runpytest_inprocess("-p", "no:cacheprovider", *options)

    return run


class _Cached:
    def __init__(self, truths: Truths) -> None:
        self.truths = truths

    @pytest.fixture(scope="session")
    def twin_truth(self) -> Truths:
        return self.truths


USER = """
import numpy as np
from hardware import reconstruct

def mine(record):
    image = reconstruct(record, "lmmse").picture
    return {method}

def test_mine(twin_regression):
    twin_regression.camera("yard", {system!r}, method=mine)
"""
# The error of LMMSE on this yard is 209 electrons; 0.2 dB more is 10^0.02 of its square.
NOISE_E = 209 * np.sqrt(10**0.02 - 1)
ITSELF = "image"
WORSE = f"image + np.random.default_rng(record.counts[0, 0]).normal(size=image.shape) * {NOISE_E}"


def baseline_of(pytester) -> Path:
    return pytester.path / "baselines" / "test_mine-test_mine.json"


def test_a_missing_baseline_fails_and_says_what_to_do(project, pytester) -> None:
    """Before anything is rendered or run."""
    result = project('open("ran", "w") and image')
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ['*no such baseline; make one: pytest "test_mine.py::test_mine" --update-baseline*']
    )
    assert not baseline_of(pytester).exists()
    assert not (pytester.path / "ran").exists()


@pytest.mark.parametrize("reason", ["", "  ", "test_mine.py"])
def test_an_update_needs_its_reason(project, pytester, reason: str) -> None:
    """A path in its place is a reason forgotten."""
    result = project(ITSELF, "--update-baseline", reason)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*--update-baseline*expected the reason*"])
    assert not baseline_of(pytester).exists()


@pytest.mark.thorough
def test_every_test_has_a_baseline_of_its_own(project, pytester) -> None:
    """Classes and parameters tell tests apart; the reason may be as long as it has to be."""
    project(ITSELF)
    pytester.makepyfile(
        test_mine=f"""
        import pytest

        class TestA:
            @pytest.mark.parametrize("seeds", [2, 3])
            def test_it(self, twin_regression, seeds):
                twin_regression.camera("yard", {str(SYSTEM)!r}, seeds=seeds)

        class TestB:
            def test_it(self, twin_regression):
                twin_regression.camera("yard", {str(SYSTEM)!r}, seeds=4)
        """
    )
    options = ("-p", "no:cacheprovider", "--update-baseline", "because " * 50)
    pytester.runpytest_inprocess(*options).assert_outcomes(passed=3)
    assert {path.name for path in (pytester.path / "baselines").iterdir()} == {
        "test_mine-TestA-test_it-2.json",
        "test_mine-TestA-test_it-3.json",
        "test_mine-TestB-test_it.json",
    }


def test_an_unchanged_method_passes(project, pytester) -> None:
    project(ITSELF, "--update-baseline", "first of all").assert_outcomes(passed=1)
    project(ITSELF).assert_outcomes(passed=1)
    assert not (pytester.path / "regression-pictures").exists()


@pytest.mark.thorough
def test_a_loss_of_a_fifth_of_a_decibel_fails_with_pictures(project, pytester) -> None:
    project(ITSELF, "--update-baseline", "first of all").assert_outcomes(passed=1)
    result = project(WORSE)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["mine: worse than its baseline (mine: first of all)", "*psnr_db: 43.*WORSE"]
    )
    # pytest repeats the message in its summary where it runs under CI.
    told = next(line for line in result.outlines if line.strip().startswith("psnr_db"))
    assert float(re.search(r"loss (\S+) dB", told)[1]) == pytest.approx(0.2, abs=0.04)
    picture = pytester.path / "regression-pictures" / "test_mine-test_mine.png"
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_a_gain_passes_and_is_offered_as_the_new_baseline(project) -> None:
    project(WORSE, "--update-baseline", "with a fault").assert_outcomes(passed=1)
    result = project(ITSELF)
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*test_mine.py::test_mine: better; keep it: pytest*"])


@pytest.mark.whole
def test_notes_of_workers_reach_the_terminal(pytester) -> None:
    """With pytest-xdist tests run in processes that have no terminal."""
    pytester.makepyfile(test_mine="def test_mine(twin_regression): twin_regression.notes += ['so']")
    result = pytester.runpytest_subprocess("-n", "1")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*= baselines =*", "so"])


@pytest.mark.thorough
def test_a_baseline_holds_reasons_versions_and_figures_and_no_date(project, pytester) -> None:
    project(ITSELF, "--update-baseline", "first of all")
    once = baseline_of(pytester).read_text()
    project(ITSELF, "--update-baseline", "nothing has changed")
    assert baseline_of(pytester).read_text() == once
    project(WORSE, "--update-baseline", "cheaper detector")
    baseline = read_baseline(baseline_of(pytester))
    first, second = baseline.history
    assert (first["reason"], second["reason"]) == ("first of all", "cheaper detector")
    assert first["before"] is None
    assert second["before"] == first["after"]
    assert second["before"]["psnr_db"] - second["after"]["psnr_db"] == pytest.approx(0.2, abs=0.04)
    assert second["after"] == baseline.means()
    assert second["versions"].keys() >= {"ugv-twin", "numpy", "mitsuba", "drjit"}
    text = baseline_of(pytester).read_text()
    assert not re.search(r"20\d\d-\d\d|\d\d:\d\d", text)
    assert len(text) < 10_000


def test_figures_of_another_setup_are_not_compared(project, pytester) -> None:
    project(ITSELF, "--update-baseline", "first of all")
    known = read_baseline(baseline_of(pytester))
    known.setup["fidelity"]["samples"] = 16
    write_baseline(known, baseline_of(pytester))
    result = project(ITSELF)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*made with another setup: fidelity: *'samples': 16*"])


def test_values_of_another_setup_are_named() -> None:
    """As many as differ, by their dotted names, where the baseline holds them; one of an earlier
    version has digests alone. A body that moves shows by its name.
    """
    scene, system = load_scene("yard"), load_system("workable")
    before = _setup(scene, system)
    moved = replace(
        scene,
        objects=(replace(scene.objects[0], velocity_m_per_s=(1.0, 2.0, 3.0)), *scene.objects[1:]),
    )
    noisy = system.with_({"readout.read_noise_e": 321.0, "optics.f_number": 2.5})
    known = before["values"]["design"]
    (told,) = differences(before, _setup(scene, noisy), {"scene": scene, "design": noisy})
    was = {n: known[n] for n in ("optics.f_number", "readout.read_noise_e")}
    now = {"optics.f_number": 2.5, "readout.read_noise_e": 321.0}
    assert told == f"design: {was!r} in the baseline, {now!r} now"
    (told,) = differences(before, _setup(moved, system), {"scene": moved, "design": system})
    assert re.fullmatch(r"scene: {'objects\.\w+': '\w{12}'} in .*, {'objects\.\w+': .*} now", told)
    del before["values"]
    (told,) = differences(before, _setup(scene, noisy), {"scene": scene, "design": noisy})
    assert re.fullmatch(
        r"design: 'workable \w{12}' in the baseline, 'workable .changed. \w{12}' now", told
    )


def test_the_same_by_another_name_is_the_same_setup(tmp_path: Path) -> None:
    """A copied folder with another description and a comment: baselines hold its content, those of
    an earlier version too.
    """
    for name, words in (("one", "A wall"), ("other", "My wall")):
        shutil.copytree(scenes_folder() / "fig3b", tmp_path / name)
        text = (tmp_path / name / "scene.toml").read_text()
        text = re.sub(r"(?m)^description = .*$", "", text)
        (tmp_path / name / "scene.toml").write_text(f'description = "{words}"\n{text}# {words}\n')
    one, other = load_scene(tmp_path / "one"), load_scene(tmp_path / "other")
    system = load_system("workable")
    alike = system.model_copy(update={"name": "mine", "description": "mine"})
    before = _setup(one, system)
    assert before["scene"] != _setup(other, alike)["scene"]
    now, contents = _setup(other, alike), {"scene": other, "design": alike}
    assert differences(before, now, contents) == []
    del before["values"]
    assert differences(before, now, contents) == []


def _setup(scene: Scene, system: System) -> dict[str, Any]:
    return setup_of("camera", scene, (), system, Fidelity().part(LightFidelity), 48, ())


@pytest.mark.thorough
def test_a_baseline_outlives_knobs_that_are_newer_and_those_that_are_gone(
    project, pytester
) -> None:
    """And knobs of the other sensor, which earlier versions kept too."""
    project(ITSELF, "--update-baseline", "first of all")
    known = read_baseline(baseline_of(pytester))
    del known.setup["fidelity"]["air_orders"]
    known.setup["fidelity"]["of_former_times"] = 200_000
    known.setup["fidelity"]["radar_edges"] = 7
    write_baseline(known, baseline_of(pytester))
    project(ITSELF).assert_outcomes(passed=1)


@pytest.mark.thorough
def test_a_knob_that_a_baseline_lacks_stood_where_it_did_then(project, pytester) -> None:
    """Before there were tolerances light had fixed numbers of paths, whatever the default is."""
    project(ITSELF, "--update-baseline", "first of all")
    known = read_baseline(baseline_of(pytester))
    del known.setup["fidelity"]["light_tolerance"]
    write_baseline(known, baseline_of(pytester))
    result = project(ITSELF)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["*fidelity: {'light_tolerance': None} in the baseline, {'light_tolerance': 0.2} now*"]
    )


@pytest.mark.thorough
def test_no_number_is_a_failure_and_no_baseline(project, pytester) -> None:
    bad = "image * np.nan"
    result = project(bad, "--update-baseline", "first of all")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*psnr_db is nan at seed 0*"])
    assert not baseline_of(pytester).exists()
    project(ITSELF, "--update-baseline", "first of all").assert_outcomes(passed=1)
    project(bad).assert_outcomes(failed=1)


def test_an_image_on_another_grid_is_refused(project) -> None:
    result = project("image[:16]", "--update-baseline", "first of all")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*gave an image (16, 32), expected (32, 32)*"])


KNOWN = Baseline(
    {"kind": "camera"}, {"psnr_db": [30.0, 31.0]}, "digest", {"png": ""}, ({"reason": "why"},)
)


@pytest.mark.parametrize(
    "content",
    [b"{", b"", b"[]", b"\xff\xfe", b"[" * 200_000, b'{"format": 1}', b'{"format": 2}'],
)
def test_a_damaged_baseline_is_told(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.json: (is no|is not|cannot be)"):
        read_baseline(path)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("figures", {"psnr_db": [29.0, 31.0]}),
        ("figures", {"psnr_db": ["thirty", 31.0]}),
        ("figures", {"psnr_db": 30.0}),
        ("figures", {}),
        ("history", []),
        ("history", None),
        ("example", {}),
        ("model_error", {"psnr_db": [9.0, 9.0]}),
        ("more", 1),
    ],
)
def test_a_baseline_edited_by_hand_is_told(field: str, value: object, tmp_path: Path) -> None:
    """Whatever was changed: one message, and no figure is compared with what nobody measured."""
    path = tmp_path / "x.json"
    write_baseline(KNOWN, path)
    assert read_baseline(path) == KNOWN
    path.write_text(json.dumps(json.loads(path.read_text()) | {field: value}))
    with pytest.raises(InputError, match=r"x\.json: is not as it was written: its digest"):
        read_baseline(path)


def test_a_baseline_of_before_there_were_errors_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_baseline(replace(KNOWN, model_error={"psnr_db": [0.1, 0.02]}), path)
    assert read_baseline(path).errors()["psnr_db"] == Interval(30.5, 0.1, 0.02)
    content = json.loads(path.read_text())
    for name in ("model_error", "format", "digest"):
        del content[name]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(text.encode()).hexdigest()
    path.write_text(json.dumps({"format": 2, "digest": digest, **content}))
    assert read_baseline(path).errors()["psnr_db"] == Interval(30.5)


@pytest.mark.thorough
def test_an_edited_baseline_fails_the_test_in_one_line(project, pytester) -> None:
    project(ITSELF, "--update-baseline", "first of all")
    content = json.loads(baseline_of(pytester).read_text())
    content["figures"]["psnr_db"][0] -= 1.0
    baseline_of(pytester).write_text(json.dumps(content))
    result = project(ITSELF)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*its digest does not fit*--update-baseline*"])
    for shown in ("*Traceback*", "*During handling*", "*baseline.py:*", "*checker.py:*"):
        result.stdout.no_fnmatch_line(shown)
    project(ITSELF, "--update-baseline", "made anew").assert_outcomes(passed=1)


def test_an_unknown_method_is_told_before_anything_is_rendered(tmp_path: Path) -> None:
    class Nothing:
        def light(self, *_: object) -> None:
            raise AssertionError("rendered")

    fixture = Regression(Nothing(), tmp_path, tmp_path, "t", "t", None, [])
    with pytest.raises(InputError, match=r"'best' is none of .*lmmse"):
        fixture.camera("yard", SYSTEM, method="best")
    with pytest.raises(ValueError, match="at least 2"):
        Regression(Nothing(), tmp_path, tmp_path, "t", "t", None, []).camera(
            "yard", SYSTEM, seeds=1
        )


def test_loading_the_plugin_imports_nothing_heavy() -> None:
    """Every pytest in an environment with this package loads it."""
    script = (
        "import sys, pytest; before = set(sys.modules); import twin.regression.plugin; "
        "new = {m.split('.')[0] for m in set(sys.modules) - before}; "
        "print(sorted(new - {'twin', 'hardware'}))"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], check=True, capture_output=True, text=True
    )
    assert found.stdout.strip() == "[]"
