"""The command ``ugv``, as a user runs it."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from moving_scenes import AnalyticScene, moving_record
from ugv_command import ugv

from hardware import PatternSet, SpiRecord, reconstruct, write_record
from hardware.commands.entry import outcome
from hardware.files import whole_file
from hardware.reconstruction import METHODS, Mixing
from hardware.records import Flag, QuaternionPose


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SpiRecord]:
    patterns = PatternSet(8, 16, 40)
    n = patterns.n_exposures
    cells = np.random.default_rng(0).integers(0, 500, size=(128, 2))
    made = SpiRecord(
        counts=patterns.signal(cells).astype(np.int32),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=2.0,
        offset_counts=0.0,
        adc_bits=24,
        device="test",
        pose=QuaternionPose(),
    )
    path = tmp_path_factory.mktemp("record") / "frame.h5"
    write_record(made, path)
    return path, made


@pytest.mark.library("PIL")
def test_it_draws_the_image(record: tuple[Path, SpiRecord], tmp_path: Path) -> None:
    """Each cell is a square of grey, white from the 99.5th percentile on; both images in a row."""
    from PIL import Image

    path, made = record
    arguments = (
        "reconstruct",
        str(path),
        "--method",
        "zero-fill",
        "--out",
        str(tmp_path / "a.npz"),
    )
    done = ugv(*arguments, "--png", str(tmp_path / "a.png"))
    assert done.returncode == 0, done.stderr
    drawn = np.asarray(Image.open(tmp_path / "a.png"))
    light = reconstruct(made, "zero-fill").picture
    side = drawn.shape[0] // light.shape[0]
    assert drawn.shape == (side * light.shape[0], side * light.shape[1])
    assert min(drawn.shape) >= 512
    level = np.sqrt(np.clip(light / np.percentile(light, 99.5), 0, 1))
    np.testing.assert_array_equal(
        drawn[side // 2 :: side, side // 2 :: side], (255 * level).round()
    )
    done = ugv(*arguments, "--png", str(tmp_path / "a.jpeg"))
    assert (done.returncode, "expected a name that ends in .png" in done.stderr) == (2, True)


@pytest.mark.parametrize("method", ["lmmse", "tv"])
def test_it_writes_what_the_library_gives(record: tuple[Path, SpiRecord], method: str) -> None:
    path, made = record
    done = ugv("reconstruct", str(path), "--method", method)
    assert done.returncode == 0, done.stderr
    assert "2 images of 8 x 16" in done.stdout
    expected = reconstruct(made, method)
    with np.load(path.with_name(f"frame-{method}.npz")) as stored:
        np.testing.assert_allclose(stored["image"], expected.image)
        assert ("standard_error" in stored) == (expected.standard_error is not None)


def test_a_mixing_comes_from_a_file(record: tuple[Path, SpiRecord], tmp_path: Path) -> None:
    path, made = record
    matrix = np.random.default_rng(1).random((128, 8, 20))
    np.save(tmp_path / "m.npy", matrix)
    out = tmp_path / "image.npz"
    done = ugv("reconstruct", str(path), "--mixing", str(tmp_path / "m.npy"), "--out", str(out))
    assert done.returncode == 0, done.stderr
    expected = reconstruct(made, mixing=Mixing(matrix.reshape(128, -1), 8, 20))
    with np.load(out) as stored:
        np.testing.assert_allclose(stored["image"], expected.image)


def test_every_method_is_listed() -> None:
    listed = ugv("methods").stdout
    for name, method in METHODS.items():
        assert f"{name}: {method.summary}" in listed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.h5"], "missing.h5: no such record"),
        ([__file__], "test_cli.py: is no HDF5 file, expected a ugv-spi-record"),
        (["RECORD", "--method", "magic"], "method: 'magic' is none of"),
        (["RECORD", "--mixing", "missing.npy"], "missing.npy"),
        (["RECORD", "--methods", "x"], "No such option"),
    ],
)
def test_errors_are_one_line(record, arguments: list[str], message: str) -> None:
    done = ugv("reconstruct", *(a.replace("RECORD", str(record[0])) for a in arguments))
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.library("PIL")
@pytest.mark.parametrize(
    ("option", "name", "message"),
    [
        ("--out", "none/a.npz", "No such file or directory"),
        ("--out", ".", "Is a directory"),
        ("--png", "none/a.png", "No such file or directory"),
        ("--png", "a.jpeg", "expected a name that ends in .png"),
    ],
)
def test_what_cannot_be_written_is_told_before_the_work(
    record: tuple[Path, SpiRecord], tmp_path: Path, option: str, name: str, message: str
) -> None:
    path, _ = record
    done = ugv("reconstruct", str(path), "--verbose", option, str(tmp_path / name))
    assert (done.returncode, message in done.stderr) == (2, True), done.stderr
    assert str(tmp_path) in done.stderr
    assert "reconstructed" not in done.stderr


def test_a_result_goes_into_a_pipe_as_it_is(tmp_path: Path) -> None:
    """A file that took the place of a pipe or a device would be lost, and so would that."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with whole_file(pipe) as partial:
        assert partial == pipe
    assert pipe.is_fifo()
    assert os.listdir(tmp_path) == ["pipe"]


def test_version_help_and_completion() -> None:
    assert ugv("--version").stdout == f"ugv {version('ugv-twin')}\n"
    assert ugv("detect", "-h").stdout == ugv("detect", "--help").stdout
    asked = {"_UGV_COMPLETE": "complete_bash", "COMP_WORDS": "ugv rec", "COMP_CWORD": "1"}
    code = "import sys; sys.argv = ['ugv']; from hardware.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        check=True,
    )
    assert {"reconstruct", "recover"} <= set(done.stdout.split())


def test_quiet_verbose_and_a_document(record: tuple[Path, SpiRecord], tmp_path: Path) -> None:
    """The verdict alone; times beside the same lines; the numbers of what is written."""
    path, made = record
    out = tmp_path / "image.npz"
    words = ("reconstruct", path, "--out", out)
    plain = ugv(*words)
    quiet = ugv(*words, "-q")
    assert quiet.stderr == ""
    assert [line[:6] for line in quiet.stdout.splitlines()] == ["lmmse:"]
    assert f"read {path}" in ugv(*words, "-v").stderr
    done = ugv(*words, "--json")
    content = json.loads(done.stdout)
    assert len(done.stderr.splitlines()) == len((plain.stdout + plain.stderr).splitlines())
    image = reconstruct(made).image
    values = {figure["name"]: figure["value"] for figure in content["figures"]}
    assert values["least cell"] == pytest.approx(image.min())
    assert values["greatest cell"] == pytest.approx(image.max())
    assert content["shape"] == [2, 8, 16]
    assert content["written"] == [str(out)]


def test_quiet_tells_what_is_wrong_with_a_record(
    record: tuple[Path, SpiRecord], tmp_path: Path
) -> None:
    """A verdict on a saturated record alone would say that the image is good."""
    flags = np.zeros(80, np.uint8)
    flags[::2] = Flag.SATURATED
    path = tmp_path / "saturated.h5"
    write_record(replace(record[1], flags=flags), path)
    done = ugv("reconstruct", path, "--out", tmp_path / "image.npz", "-q")
    assert done.stderr == f"warning: {path}: 40 of 80 exposures are marked saturated\n"


def test_methods_as_a_document() -> None:
    named = {method["name"] for method in json.loads(ugv("methods", "--json").stdout)["methods"]}
    assert named == set(METHODS)


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = AnalyticScene.of(3, 32, 12.0)
    record = moving_record(
        lambda t: scene.cells(32, 4 * t, 10 * t).ravel(),
        PatternSet(32, 32, 128, "interleaved"),
        noise=0.03,
    )
    path = tmp_path_factory.mktemp("moved") / "frame.h5"
    write_record(record, path)
    return path


def test_motion_is_a_velocity_or_a_file(moved: Path, tmp_path: Path) -> None:
    """Three ways to say the same motion give the same image."""
    track, field = tmp_path / "track.csv", tmp_path / "field.npy"
    track.write_text("time_s,down_cells,right_cells\n-1,-4,-10\n1,4,10\n")
    np.save(field, np.zeros((32, 32, 2)) + (4.0, 10.0))
    images = []
    for given in ("4,10", str(track), str(field)):
        done = ugv("reconstruct", str(moved), "--motion", given, "--out", str(tmp_path / "a.npz"))
        assert done.returncode == 0, done.stderr
        with np.load(tmp_path / "a.npz") as stored:
            images.append(stored["image"])
    np.testing.assert_allclose(images[1], images[0], rtol=1e-4)
    assert np.abs(images[2] - images[0]).max() < 0.05 * np.ptp(images[0])


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("nan,1", None, "down_cells_per_s: nan, expected finite numbers"),
        ("forward", None, "--motion: 'forward': expected"),
        ("gone.csv", None, "gone.csv: no such file"),
        ("a.csv", "t,x\n", "a.csv: line 1: ['t', 'x'], expected"),
        ("b.csv", "time_s,down_cells,right_cells\n0,0\n", "b.csv: line 2: ['0', '0'], expected"),
        ("c.csv", "time_s,down_cells,right_cells\n0,0,0\n0,1,1\n", "c.csv: line 3: time_s: 0 does"),
        ("d.npy", "no array", "d.npy: "),
    ],
)
def test_wrong_motion_is_told(
    moved: Path, tmp_path: Path, name: str, text: str | None, told: str
) -> None:
    given = name
    if "." in name:
        given = str(tmp_path / name)
        if text is not None:
            Path(given).write_text(text)
    done = ugv("reconstruct", str(moved), "--motion", given)
    assert done.returncode == 2
    assert told in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("told", "threads"), [(None, "1"), ("2", "2")])
def test_blas_has_one_thread_unless_told(
    monkeypatch: pytest.MonkeyPatch, told: str | None, threads: str
) -> None:
    """On a busy machine two that wait for each other took four times the CPU time."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", told or "")
    if told is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    assert outcome(lambda *_, **__: 0, "ugv", ValueError) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == threads
