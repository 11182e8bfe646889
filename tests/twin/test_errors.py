"""Errors of the simulator: one root, by kind, and what the vehicle makes of them."""

import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import hardware
import twin
from hardware import DeviceError, OwnFunctionError
from twin import cli
from twin.errors import EngineError, InputError, TwinError
from twin.serve.source import records
from twin.sweep.inputs import ChangedError
from twin.workers import SchedulerGoneError, WorkerDiedError


@pytest.mark.parametrize(
    ("error", "kind", "builtin"),
    [
        (InputError, TwinError, ValueError),
        (OwnFunctionError, InputError, ValueError),
        (DeviceError, TwinError, ValueError),
        (ChangedError, InputError, ValueError),
        (EngineError, TwinError, RuntimeError),
        (WorkerDiedError, EngineError, RuntimeError),
        (SchedulerGoneError, EngineError, RuntimeError),
    ],
)
def test_every_error_has_its_kind(
    error: type[Exception], kind: type[Exception], builtin: type[Exception]
) -> None:
    assert issubclass(error, kind)
    assert issubclass(error, builtin)
    assert issubclass(error, TwinError)
    assert (twin.InputError, twin.EngineError) == (InputError, EngineError)


def test_what_the_vehicle_finds_wrong_is_the_twin_s_input_error() -> None:
    """The twin makes the vehicle's records and runs its processing: one ``except`` is enough."""
    assert twin.InputError is hardware.InputError
    assert twin.TwinError is hardware.HardwareError
    with pytest.raises(twin.InputError, match=r"prefix_s: -1 is negative"):
        hardware.OfdmWaveform(79e9, 4, 1e6, 4, 1e-5, 1, -1)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: twin.capture("yard", twin.load_system("workable")), "scene = 'yard': .*a Scene"),  # type: ignore[arg-type]
        (lambda: twin.capture(twin.load_scene("yard"), "paper"), "system = 'paper': .*a System"),  # type: ignore[arg-type]
        (
            lambda: twin.capture(twin.load_scene("yard"), twin.load_system("workable"), seed=-1),
            "seed: -1: expected a whole number",
        ),
        (
            lambda: twin.radar_capture(twin.load_scene("yard"), "hybrid-79"),  # type: ignore[arg-type]
            "radar = 'hybrid-79': .*twin.load_radar",
        ),
        (
            lambda: twin.trace("yard", twin.load_radar("hybrid-79")),  # type: ignore[arg-type]
            "scene = 'yard': .*twin.load_scene",
        ),
        (
            lambda: twin.trace(twin.load_scene("yard"), None),  # type: ignore[arg-type]
            "radar = None: .*twin.load_radar",
        ),
        (
            lambda: twin.trace(
                twin.load_scene("yard"), twin.load_radar("hybrid-79"), followed_s=float("nan")
            ),
            "followed_s: nan: expected a time",
        ),
        (lambda: hardware.reconstruct("record.h5"), "record = 'record.h5': .*hardware.read_record"),  # type: ignore[arg-type]
        (lambda: hardware.process("radar.h5"), "expected a RadarRecord"),  # type: ignore[arg-type]
        (
            lambda: twin.evaluate(twin.load_system("workable"), None),  # type: ignore[arg-type]
            "^capture = None: expected a Capture, as twin.capture",
        ),
        (
            lambda: twin.evaluate("workable", None),  # type: ignore[arg-type]
            "^system = 'workable': expected a System",
        ),
        (lambda: twin.Part(name="x"), "^part: needs exactly one section of emitter, .*weather$"),
        (lambda: twin.Part(name="x", lens=3), "^part: lens = 3: no such field"),  # type: ignore[call-arg]
    ],
)
def test_a_name_in_place_of_what_it_names_is_told(call: Callable[[], object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        call()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"emitter.switching_time_s": 1e300}, "emitter.switching_time_s"),
        ({"filter.width_m": 1e-300}, "filter: width_m = 1e-300: expected 1e-15 to 0.001"),
        ({"detector.part": 10**400}, "is neither a TOML file nor one of"),
    ],
)
def test_what_no_device_has_is_refused_where_it_is_set(
    changes: dict[str, object], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        twin.load_system("workable").with_(changes)


def test_what_is_scored_beside_a_capture_is_checked() -> None:
    """Of another grid, or no image at all: before anything is reconstructed."""
    small = {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 64}
    system = twin.load_system("workable").with_(small)
    knobs = twin.Fidelity(samples=4, max_depth=1)
    taken = twin.capture(twin.load_scene("table1"), system, fidelity=knobs)
    with pytest.raises(InputError, match=r"^system: workable shows 64 x 64 cells, expected"):
        twin.evaluate(twin.load_system("workable"), taken)
    with pytest.raises(InputError, match=r"^reconstructions\[0\] = 3: expected a Reconstruction"):
        twin.evaluate(system, taken, [3])  # type: ignore[list-item]
    image = hardware.reconstruct(taken.record)
    with pytest.raises(InputError, match=r"^reconstructions: a Reconstruction, expected a list"):
        twin.evaluate(system, taken, image)  # type: ignore[arg-type]
    assert twin.evaluate(system, taken, [image]).reconstructions == (image,)


@pytest.mark.parametrize("error", [InputError("a: b"), EngineError("a: b"), DeviceError("a: b")])
def test_a_command_tells_an_error_of_a_kind_in_one_line(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("twin.system.load_system", fails)
    monkeypatch.setattr(sys, "argv", ["twin", "budget", "--system", "mine"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "twin: error: a: b\n"


def test_a_library_s_value_error_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ValueError("operands could not be broadcast")

    monkeypatch.setattr("twin.system.load_system", fails)
    monkeypatch.setattr(sys, "argv", ["twin", "budget", "--system", "mine"])
    with pytest.raises(ValueError, match="broadcast") as caught:
        cli.main()
    assert not isinstance(caught.value, TwinError)


@pytest.mark.parametrize(("scene", "camera"), [("table1", "still_light"), ("yard", "MovingFrames")])
def test_to_the_vehicle_an_engine_that_fails_is_a_device(
    monkeypatch: pytest.MonkeyPatch, scene: str, camera: str
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise EngineError("no libLLVM")

    monkeypatch.setattr(f"twin.serve.source.{camera}", fails)
    with pytest.raises(DeviceError, match=rf"^twin:{scene}: no libLLVM$"):
        records(f"twin:{scene}")


def test_every_error_that_is_raised_with_words_is_of_a_kind() -> None:
    """ValueError is what libraries raise: none of our own says anything by it."""
    root = Path(twin.__file__).parent
    bare = re.compile(r"raise (ValueError|RuntimeError|Exception)\(")
    found = [path for path in root.rglob("*.py") if bare.search(path.read_text("utf-8"))]
    assert found == []


def test_a_fault_in_the_closed_form_ends_a_sweep(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A library's ValueError in our own computation is no point that cannot be."""

    def fails(*_: object) -> None:
        raise ValueError("operands could not be broadcast")

    monkeypatch.setattr("twin.sweep.evaluate.closed_form", fails)
    study = twin.Study(
        name="s", model="closed-form", metrics=["snr"], grid={"link.distance_m": [1.0, 2.0]}
    )
    with pytest.raises(ValueError, match="broadcast") as caught:
        twin.run_sweep(study, out=tmp_path / "out", workers=0)
    assert not isinstance(caught.value, TwinError)
