"""What the README shows runs as it stands there."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from hardware.recording import Log, ros
from hardware.records.state import QuaternionPose
from twin.scene import load_scene
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


def test_the_scenes_motion_loads(tmp_path: Path) -> None:
    shapes = "".join(
        f'<shape type="sphere" id="{name}"><float name="radius" value="0.3"/>'
        f'<point name="center" x="{x}" y="0.6" z="0.3"/><bsdf type="diffuse" id="{row}"/></shape>'
        for name, row, x in (("car", "car_paint", 6), ("wheel", "rubber", 5), ("arm", "skin", 7))
    )
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{shapes}</scene>')
    sun = "[sun]\nazimuth_deg = 0.0\nelevation_deg = 38.0\nilluminance_lx = 1e5\n"
    (tmp_path / "scene.toml").write_text(blocks("toml")[2] + sun)
    with Log(tmp_path / "drive.mcap") as log:
        for stamp in (10**18, 10**18 + 10**9):
            pose = QuaternionPose(x_m=(stamp - 10**18) * 1e-9)
            message = ros.transform(pose, stamp, "world", "rig")
            log.message("/tf", ros.TRANSFORMS, message, stamp, stamp)
    scene = load_scene(tmp_path).after(0.5)
    car, wheel, arm = scene.objects
    assert scene.rig.pose.position_m == pytest.approx((0.5, 0.0, 0.0))
    assert car.middle_m[0] == pytest.approx(6.7)
    assert wheel.middle_m[0] == pytest.approx(5.7)
    assert wheel.state.angular_velocity_rad_per_s[1] == pytest.approx(1.4 / 0.3)
    assert arm.state.angular_velocity_rad_per_s.any()


def test_a_system_of_own_parts_loads(tmp_path: Path) -> None:
    text = "".join(blocks("toml")[3:])
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
