"""A user's own propagation model in place of the radar's bundled ones."""

import json
from pathlib import Path

import numpy as np
import pytest

from twin import (
    PRESETS,
    Contributions,
    Fidelity,
    InputError,
    load_radar,
    load_scene,
    radar_capture,
    run,
)
from twin.digest import digest
from twin.sweep import Study, load_study, open_sweep, run_sweep

CODE = """
import numpy as np
from twin import Contributions
RANGE_M = 30.0

def one_echo(scene, radar, fidelity, seed):
    "One point of -100 dB straight ahead."
    delay_s = np.array([2 * RANGE_M / 299792458.0])
    return Contributions.ahead(np.array([1e-5 + 0j]), delay_s, np.zeros(1))

def straight(scene, radar, fidelity, seed):
    from twin.radar.propagation.free_space import straight_paths
    return straight_paths(scene, radar)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(CODE)
    return tmp_path


def test_the_bundled_one_by_a_users_function_gives_the_same_bits(folder: Path) -> None:
    scene, radar = load_scene("yard"), load_radar("hybrid-79")
    own = Fidelity(radar=f"{folder / 'mine.py'}:straight")
    known, found = (
        radar_capture(scene, radar, seed=1, fidelity=f).record.iq
        for f in (Fidelity(radar="targets"), own)
    )
    np.testing.assert_array_equal(known, found)


def test_a_run_finds_what_it_says(folder: Path) -> None:
    """One echo at 30 m, named with its digest in the list of settings."""
    own = Fidelity(radar=f"{folder / 'mine.py'}:one_echo", samples=1)
    result = run("yard", None, radar="hybrid-79", fidelity=own, out=folder / "out")
    assert result.radar is not None
    (found,) = result.radar.detections
    assert found.range_m == pytest.approx(30.0, abs=0.01)
    said = json.loads((folder / "out" / "run.json").read_text())["fidelity"]["radar"]
    assert said.startswith("one_echo-")
    assert "echoes by one_echo" in (folder / "out" / "report.html").read_text()


@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_studies_take_it(folder: Path, workers: int) -> None:
    (folder / "study.toml").write_text(
        'scene = "yard"\nmetrics = ["detections"]\n[grid]\n'
        '"fidelity.radar" = ["targets", "mine.py:one_echo"]\n'
    )
    done = run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=workers)
    assert done.n_failed == 0, done.reasons
    known, own = open_sweep(done.out).detections.values
    assert known > own
    (folder / "mine.py").write_text(CODE.replace("30.0", "31.0"))
    with pytest.raises(InputError, match=r"other content of.* function mine\.py:one_echo"):
        run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=0)


@pytest.mark.thorough
def test_a_study_in_python_takes_a_function(tmp_path: Path) -> None:
    def silent(scene, radar, fidelity, seed):
        return Contributions.none()

    quick = Fidelity(radar=silent, samples=1)
    study = Study(name="own", metrics=["detections"], grid={"fidelity.preset": ["draft", quick]})
    done = run_sweep(study, out=tmp_path / "out", workers=0)
    assert done.n_failed == 0, done.reasons
    assert open_sweep(done.out).detections.values[1] == 0
    assert digest(quick) == digest(Fidelity(radar=silent, samples=1))
    assert digest(quick) != digest(Fidelity(radar=lambda scene, radar, fidelity, seed: None))


def test_which_is_the_stricter() -> None:
    def silent(scene, radar, fidelity, seed):
        return Contributions.none()

    own = Fidelity(radar=silent)
    assert (own | PRESETS["reference"]).radar is silent
    assert (PRESETS["draft"] | own).radar is silent
    with pytest.raises(InputError, match="neither is the stricter"):
        _ = own | Fidelity(radar=lambda scene, radar, fidelity, seed: None)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("opticks", "is none of targets, paths, optics, auto, rough, and no function .*'opticks'"),
        (7, "is none of targets"),
        (lambda scene: None, r"takes \(scene\), expected a function of \(scene, radar"),
        ("none.py:f", "does not exist"),
    ],
)
def test_what_is_no_model_is_told_where_it_is_set(given, told: str) -> None:
    with pytest.raises(InputError, match=told):
        Fidelity(radar=given)


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (None, "model: returned a NoneType, expected Contributions"),
        (Contributions.ahead(np.ones(1) * 1j, np.array([np.nan]), np.zeros(1)), "model: delay_s"),
        (
            Contributions.ahead(np.ones(2) * 1j, np.zeros(1), np.zeros(1)),
            r"amplitude of shape \(2,",
        ),
        (Contributions.ahead(np.ones(1) * 1j, -np.ones(1), np.zeros(1)), "is negative"),
    ],
)
def test_what_is_no_echo_is_told(found, told: str) -> None:
    def model(scene, radar, fidelity, seed):
        return found

    with pytest.raises(InputError, match=told):
        radar_capture(load_scene("yard"), load_radar("hybrid-79"), fidelity=Fidelity(radar=model))
