"""`--tolerance`, `--within`, `--explain`: what commands compute with them, and what they refuse."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hardware import read_record
from tests.physics.test_missed_effects import missed
from twin import cli
from twin.camera import capture
from twin.drive import Drive, drive
from twin.errors import InputError
from twin.fidelity import Fidelity, Tolerance
from twin.job import run
from twin.radar import load_radar
from twin.scene import load_scene
from twin.serve.serving import ServedDevice
from twin.system import load_system

Command = Callable[..., tuple[int, str, str]]
SIZE = "[emitter]\nrows = 8\ncolumns = 8\n[acquisition]\nn_patterns = 64\n"


@pytest.fixture
def twin(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """The command, in this process: exit status, standard output, standard error."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["twin", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        told = capsys.readouterr()
        return int(ended.value.code or 0), told.out, told.err

    return call


@pytest.fixture
def few_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of tolerances that `--within` tries, those that take no time."""
    monkeypatch.setattr("twin.trade.time_limit._SHARES", (2.0, 1.0, 0.5))


def small(folder: Path, base: str = "workable") -> Path:
    """A design with 8 x 8 cells."""
    (folder / "small.toml").write_text(f'base = "{base}"\n{SIZE}')
    return folder / "small.toml"


def counts(design: Path, fidelity: Fidelity | Tolerance | None) -> Any:
    return capture(load_scene("table1"), load_system(design), fidelity=fidelity).record.counts


def alone(design: Path) -> tuple[object, ...]:
    """Options of a camera by itself."""
    return ("table1", "--system", design, "--radar", "none")


def test_a_run_has_the_light_of_its_tolerance(twin: Command, tmp_path: Path) -> None:
    design, out = small(tmp_path), tmp_path / "run"
    ended, *_ = twin("run", *alone(design), "--compare", "none", "--out", out, "--tolerance", "1 %")
    assert ended == 0
    found = read_record(out / "record.h5").counts
    np.testing.assert_array_equal(found, counts(design, Tolerance(cell_share=0.01)))
    assert (found != counts(design, None)).any()


def test_a_drive_has_the_light_of_its_tolerance(twin: Command, tmp_path: Path) -> None:
    design, files = small(tmp_path), (tmp_path / "told.mcap", tmp_path / "python.mcap")
    options = ("--tolerance", "2", "--duration", "0.02 s", "--out", files[0])
    assert twin("drive", *alone(design), *options)[0] == 0
    asked = ((Tolerance(2.0), True), (Tolerance(2.0).knobs(), True), (Tolerance(), False))
    for fidelity, same in asked:
        plan = Drive(
            scene=load_scene("table1"),
            system=load_system(design),
            radar=None,
            duration_s=0.02,
            fidelity=fidelity,
        )
        drive(plan, files[1])
        assert (files[0].read_bytes() == files[1].read_bytes()) == same
        files[1].unlink()


@pytest.mark.usefixtures("few_shares")
@pytest.mark.parametrize("option", ["--tolerance", "--within"])
def test_a_served_camera_has_the_knobs_asked_for(
    twin: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str
) -> None:
    served: list[Fidelity] = []
    listened: list[int] = []

    def camera(*_: object, fidelity: Fidelity, **__: object) -> Any:
        served.append(fidelity)
        return ServedDevice(
            "camera", "tcp:", lambda: None, lambda: None, lambda: listened.append(1)
        )

    monkeypatch.setattr("twin.serve.serving.serve_camera", camera)
    monkeypatch.setattr("twin.serve.serving.run", lambda devices: None)
    value = {"--tolerance": "0.05", "--within": "60 s"}[option]
    design = small(tmp_path)
    ended, told, aside = twin(
        "serve", "table1", "--system", design, "--spi-at", "pty", option, value
    )
    assert ended == 0
    assert listened == [1]
    # What takes its time is told; stdout begins with what a program waits for.
    assert ("choosing the accuracy" in aside) == (option == "--within")
    assert "camera: computing the first frame" in aside
    assert "computing" not in told
    # 60 s allow the smallest share that is tried.
    (knobs,) = served
    assert knobs.light_tolerance == (0.05 if option == "--tolerance" else 0.5)
    assert ("within 60 s: camera: 0.5 of the noise" in told) == (option == "--within")


@pytest.mark.usefixtures("few_shares")
def test_a_run_within_a_time_has_the_light_that_it_prints(twin: Command, tmp_path: Path) -> None:
    design, out = small(tmp_path), tmp_path / "run"
    ended, told, _ = twin(
        "run", *alone(design), "--compare", "none", "--out", out, "--within", "60 s"
    )
    assert ended == 0
    assert "within 60 s: camera: 0.5 of the noise" in told
    found = read_record(out / "record.h5").counts
    np.testing.assert_array_equal(found, counts(design, Tolerance(0.5)))


@pytest.mark.thorough
def test_explain_lists_every_decision_of_the_run(twin: Command, tmp_path: Path) -> None:
    """A row for each in the summary, whether it is taken; what is missed has a warning too."""
    design, out = small(tmp_path, "lidar-scan"), tmp_path / "run"
    command = ("run", *alone(design), "--compare", "none", "--out", out)
    plain, explained = twin(*command), twin(*command, "--explain")
    assert "what was modelled, by bounds" not in plain[1]
    table = explained[1].partition("what was modelled, by bounds")[2]
    rows = table.splitlines()
    decisions = json.loads((out / "summary.json").read_text())["decisions"]
    assert len(decisions) >= 3
    for decision in decisions:
        (row,) = (r for r in rows if f" small   {decision['effect']} " in r)
        assert ("yes" if decision["taken"] else "no") in row.split()
    expected = capture(load_scene("table1"), load_system(design)).decisions
    (lost,) = missed(expected)
    assert lost.effect == "indirect light"
    warnings = [line for line in (explained[1] + explained[2]).splitlines() if "warning" in line]
    assert any("indirect light: not computed" in line for line in warnings)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--system", "lidar-scan", "--radar", "none", "--tolerance", "2 mm"), "without a radar"),
        (("--radar", "none", "--tolerance", "0.1, 0.5 dB"), "0.5 dB of an echo, without a radar"),
        (("--system", "none", "--tolerance", "1 %"), "1 % of a cell's light, without a camera"),
    ],
)
@pytest.mark.parametrize("command", ["run", "drive"])
def test_an_error_of_a_sensor_that_there_is_not_is_one_line(
    twin: Command, tmp_path: Path, options: tuple[str, ...], told: str, command: str
) -> None:
    rest = ("--duration", "0.1 s") if command == "drive" else ()
    ended, out, error = twin(command, "table1", *options, *rest, "--out", tmp_path / "out")
    assert (ended, out) == (1, "") or (ended, out) == (2, "")
    assert told in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("system", "radar", "asked", "told"),
    [
        ("lidar-scan", None, "2 mm", "without a radar"),
        ("workable", None, "0.1, 0.5 dB", "0.5 dB of an echo, without a radar"),
        (None, "hybrid-79", "1 %", "1 % of a cell's light, without a camera"),
        (None, "hybrid-79", "SSIM 0.01", "a score of an image, without a camera"),
    ],
)
def test_python_refuses_it_as_the_command_does(
    tmp_path: Path, system: str | None, radar: str | None, asked: str, told: str
) -> None:
    """A capture, of one sensor, takes of a tolerance what is of that sensor."""
    tolerance, scene = Tolerance.of(asked), load_scene("table1")
    with pytest.raises(InputError, match=told):
        run(scene, system, radar=radar, fidelity=tolerance, out=tmp_path / "out")
    with pytest.raises(InputError, match=told):
        Drive(
            scene=scene,
            system=load_system(system) if system else None,
            radar=load_radar(radar) if radar else None,
            duration_s=0.1,
            fidelity=tolerance,
        )
    assert list(tmp_path.iterdir()) == []
    if system == "workable":
        design = small(tmp_path)
        np.testing.assert_array_equal(counts(design, tolerance), counts(design, Tolerance(0.1)))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--tolerance", "PSNR 0.1 dB"), "of levels no scores of images are measured"),
        (("--tolerance", "0.1, 2 mm", "--radar", "none"), "without a radar"),
        (("--tolerance", "1 um"), "cannot be promised"),
    ],
)
def test_a_trade_refuses_what_it_cannot_measure(
    twin: Command, options: tuple[str, ...], told: str
) -> None:
    ended, _, error = twin("trade", "table1", *options)
    assert ended != 0
    assert told in error
    assert error.count("\n") == 1
