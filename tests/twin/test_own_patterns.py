"""A user's own patterns through runs, studies and the virtual camera."""

from pathlib import Path

import numpy as np
import pytest

from hardware import own_patterns, read_record, reconstruct
from twin import Fidelity, InputError, load_scene, load_system, run
from twin.camera.acquisition import measure
from twin.camera.light import render
from twin.sweep import load_study, open_sweep, run_sweep

QUICK = Fidelity(samples=4, max_depth=1)
BITS = np.random.default_rng(0).integers(0, 2, (144, 12, 12))
SYSTEM = """
base = "workable"
[emitter]
rows = 12
columns = 12
[acquisition]
patterns = { value = "mine.npy", source = "drawn" }
n_patterns = 144
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    np.save(tmp_path / "mine.npy", BITS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    return tmp_path


def test_a_run_shows_them(folder: Path) -> None:
    """From a system's file to report and record, 12 x 12 cells that no Hadamard matrix has; what
    the vehicle makes of the record alone is what the report shows.
    """
    result = run(
        "table1", folder / "system.toml", compare=None, radar=None, fidelity=QUICK,
        out=folder / "out",
    )  # fmt: skip
    record = read_record(folder / "out" / "record.h5")
    assert record.patterns == own_patterns(BITS)
    assert not result.evaluations[0].verdict.void
    images = {image.method: image.image for image in result.evaluations[0].reconstructions}
    assert set(images) == {"least-squares", "lmmse"}
    np.testing.assert_allclose(reconstruct(record).image, images["lmmse"])
    digest = own_patterns(BITS).digest[:8]
    assert f"own ({digest})" in (folder / "out" / "report.html").read_text()


@pytest.mark.quick(1)
@pytest.mark.parametrize("mode", ["differential", "plain", "reference"])
def test_noise_of_cells_is_that_of_least_squares(folder: Path, mode: str) -> None:
    """Scatter of the images of 100 records over what the twin predicts for each cell: root mean
    square over 144 cells within 5 %, where 100 records alone leave it to a percent. Half of the
    patterns are measured: a square random matrix would be nearly singular.
    """
    changes = {"acquisition.n_patterns": 72, "acquisition.mode": mode}
    scene, system = load_scene("table1"), load_system(folder / "system.toml").with_(changes)
    problem = render(scene, system, fidelity=QUICK, seed=np.random.SeedSequence(0))
    images = []
    for seed in range(100):
        taken = measure(scene, system, problem, rng=np.random.default_rng(seed))
        images.append(reconstruct(taken.record, "least-squares").image[0].ravel())
    expected = taken.noise.cells_noise_e(system.patterns)
    ratio = np.std(images, axis=0) / expected
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1, abs=0.05)
    assert taken.noise.pixel_noise_e(system.patterns) == pytest.approx(
        np.sqrt(np.mean(expected**2)), rel=0.05
    )


@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_a_study_takes_files_of_patterns(folder: Path, workers: int) -> None:
    """By their content: a changed file is another study."""
    np.save(folder / "half.npy", BITS[::-1] * (np.arange(144) < 72).reshape(-1, 1, 1))
    (folder / "study.toml").write_text(
        """
scene = "table1"
system = "system.toml"
metrics = ["psnr_db"]
[set]
"fidelity.preset" = "draft"
[grid]
"system.acquisition.patterns" = ["mine.npy", "half.npy"]
"""
    )
    done = run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=workers)
    assert done.n_failed == 0, done.reasons
    psnr = open_sweep(done.out).psnr_db.values
    assert psnr[0] > psnr[1] + 0.5
    np.save(folder / "half.npy", BITS)
    with pytest.raises(InputError, match=r"other content of.* file half\.npy"):
        run_sweep(load_study(folder / "study.toml"), out=folder / "out", workers=0)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (BITS[:, :8], "8 x 12 cells, emitter.rows x columns are 12 x 12"),
        (BITS[:100], "100 patterns, acquisition.n_patterns = 144"),
        (BITS + 3, "int64 from 3 to 4, expected 0 and 1"),
    ],
)
def test_a_system_says_what_does_not_fit(folder: Path, content: np.ndarray, told: str) -> None:
    np.save(folder / "mine.npy", content)
    with pytest.raises(InputError, match=rf"system\.toml: acquisition\.patterns: .*{told}"):
        load_system(folder / "system.toml")
    with pytest.raises(InputError, match=r"acquisition\.patterns: none\.npy: no such file"):
        load_system("workable").with_({"acquisition.patterns": "none.npy"})


def test_in_python_they_are_an_array(folder: Path) -> None:
    """Given as an array they are those of the file, through copies and processes too."""
    import pickle

    cells = {"emitter.rows": 12, "emitter.columns": 12, "acquisition.n_patterns": 144}
    given = load_system("workable").with_({**cells, "acquisition.patterns": BITS})
    assert given.patterns == load_system(folder / "system.toml").patterns
    assert pickle.loads(pickle.dumps(given)) == given
