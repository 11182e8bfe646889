"""A user's own reconstruction and detection in a study and in a run."""

import json
from pathlib import Path

import numpy as np
import pytest

from hardware import detect
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.job import run
from twin.sweep import Study, load_study, open_sweep, run_sweep

QUICK = Fidelity(samples=1, max_depth=1, noise="gaussian", radar="targets")
MINE = """
FACTOR = 1.0
def inverse(values, noise_variance, sensing):
    return FACTOR * sensing.adjoint(values) / sensing.n_cells

def nothing(channel, waveform, image):
    return []
"""
STUDY = """
scene = "yard"
metrics = ["psnr_db", "detections"]
[set]
"fidelity.preset" = "draft"
"fidelity.radar" = "targets"
[grid]
"processing.method" = ["zero-fill", "mine.py:inverse"]
"processing.detection" = ["", "mine.py:nothing"]
"""


def half(values, noise_variance, sensing):
    return sensing.adjoint(values) / sensing.n_cells / 2


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_a_study_takes_functions_from_files(folder: Path, workers: int) -> None:
    """Files are found beside the study, in this process and in another: a plain inverse gives what
    zero-fill gives, and a detection that finds nothing finds nothing.
    """
    done = run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=workers)
    assert done.n_failed == 0, done.reasons
    data = open_sweep(done.out)
    psnr = data.psnr_db.sel({"processing.detection": ""})
    np.testing.assert_allclose(psnr[0], psnr[1])
    assert np.isfinite(psnr).all()
    assert (data.detections.sel({"processing.detection": ""}) > 0).all()
    assert (data.detections.sel({"processing.detection": "mine.py:nothing"}) == 0).all()


def test_results_of_a_changed_function_are_not_mixed(folder: Path) -> None:
    """Of the same name, but another source: the folder of the first is refused."""
    run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=0)
    (folder / "mine.py").write_text(MINE.replace("1.0", "0.5"))
    with pytest.raises(InputError, match=r"other content of.* method mine\.py:inverse"):
        run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=0)
    done = run_sweep(load_study(folder / "study.toml"), out=folder / "new", workers=0)
    psnr = open_sweep(done.out).psnr_db.sel({"processing.detection": ""})
    assert psnr[1] < psnr[0] - 1


@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.whole)])
def test_a_study_in_python_takes_functions(tmp_path: Path, workers: int) -> None:
    study = Study(
        name="own",
        scene="yard",
        metrics=["psnr_db", "detections"],
        set={"fidelity.preset": QUICK},
        grid={
            "processing.method": ["zero-fill", half],
            "processing.detection": ["", lambda channel, waveform, image: []],
        },
    )
    done = run_sweep(study, out=tmp_path / "out", workers=workers)
    assert done.n_failed == 0, done.reasons
    data = open_sweep(done.out)
    psnr = data.psnr_db.values[:, 0]
    assert psnr[1] < psnr[0]
    found = data.detections.values
    assert (found[:, 0] > 0).all()
    assert (found[:, 1] == 0).all()


@pytest.mark.parametrize(
    ("parameter", "text", "told"),
    [
        ("processing.method", "mine.py:absent", "has no function 'absent'"),
        ("processing.method", "none.py:f", "does not exist"),
        ("processing.method", "mine.py:more:than_one", "no file.py:function"),
        ("processing.detection", "mine.py:absent", "has no function 'absent'"),
        ("processing.detection", "mine", "ugv.detection"),
    ],
)
def test_a_study_says_what_is_wrong(folder: Path, parameter: str, text: str, told: str) -> None:
    path = folder / "wrong.toml"
    path.write_text(
        f'scene = "table1"\nmetrics = ["psnr_db", "detections"]\n[set]\n"{parameter}" = "{text}"\n'
    )
    with pytest.raises(InputError, match=told):
        load_study(path)


def test_a_run_takes_functions(folder: Path) -> None:
    """Shown beside the bundled ones, named with a digest in the report, the list and the result."""
    result = run(
        "table1",
        compare=None,
        fidelity=QUICK,
        out=folder / "out",
        method=f"{folder / 'mine.py'}:inverse",
        detection=detect,
    )
    names = {image.method for image in result.evaluations[0].reconstructions}
    (own,) = names - {"zero-fill", "lmmse"}
    assert own.startswith("inverse-")
    assert result.radar is not None
    assert result.radar.frame.detection.startswith("detect-")
    index = json.loads((result.out / "run.json").read_text())
    assert (index["method"], index["detection"]) == (own, result.radar.frame.detection)
    page = (result.out / "report.html").read_text()
    assert f"detections by {result.radar.frame.detection}" in page
    with pytest.raises(InputError, match="has no function 'absent'"):
        run("table1", method=f"{folder / 'mine.py'}:absent")
