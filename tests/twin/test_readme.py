"""What the README shows runs as it stands there."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from twin.sweep import load_study
from twin.sweep.evaluate import evaluate_chunk
from twin.system import load_system

README = (Path(__file__).parents[2] / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_python_examples_run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks("python"):
        exec(block, names)
    printed = capsys.readouterr().out
    assert "lmmse: PSNR" in printed
    assert "Detection(range_m=5.63" in printed
    (folder,) = (tmp_path / "runs").glob("yard*")
    assert folder.name == "yard_(changed)-workable_(changed)-alone-hybrid-79_(changed)"


def test_the_system_file_loads(tmp_path: Path) -> None:
    _, text, *_ = blocks("toml")
    assert tomllib.loads(text)["base"] == "paper"
    (tmp_path / "mine.toml").write_text(text)
    (tmp_path / "filter.csv").write_text("nm,T\n1530,0\n1550,0.5\n1570,0\n")
    assert load_system(tmp_path / "mine.toml").optics.f_number.value == 0.8


def test_a_system_of_own_parts_loads(tmp_path: Path) -> None:
    text = "".join(blocks("toml")[2:])
    (tmp_path / "mine.toml").write_text(f'base = "workable"\n{text}')
    np.save(tmp_path / "masks.npy", np.zeros((512, 64, 64), np.uint8))
    assert load_system(tmp_path / "mine.toml").patterns.count == 512
    assert load_system(tmp_path / "mine.toml").weather is not None


def test_the_study_runs(tmp_path: Path) -> None:
    text, *_ = blocks("toml")
    (tmp_path / "study.toml").write_text(text)
    study = load_study(tmp_path / "study.toml")
    chunk = evaluate_chunk(study, 0, 2)
    assert study.n_points == 36
    assert not chunk.errors
    assert np.isfinite(chunk.values["psnr_db"]).all()
