"""Errors by kind: what is wrong outside is told in one line, a fault of the software is not."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

import hardware
from hardware import cli
from hardware.drivers.radio import RadioError
from hardware.errors import (
    DeviceError,
    HardwareError,
    InputError,
    LinkError,
    NoAnswerError,
    check_finite,
)
from hardware.recording.chunks import RefusedError
from hardware.sources import SourceError

PACKAGE = Path(hardware.__file__).parent


@pytest.mark.parametrize(
    ("error", "kind", "builtin"),
    [
        (InputError, HardwareError, ValueError),
        (SourceError, InputError, ValueError),
        (RefusedError, InputError, ValueError),
        (DeviceError, HardwareError, ValueError),
        (LinkError, HardwareError, ConnectionError),
        (NoAnswerError, LinkError, TimeoutError),
        (RadioError, LinkError, OSError),
    ],
)
def test_every_error_has_its_kind_and_can_be_caught_as_a_built_in_one(
    error: type[Exception], kind: type[Exception], builtin: type[Exception]
) -> None:
    assert issubclass(error, kind)
    assert issubclass(error, builtin)
    assert issubclass(error, HardwareError)


def test_no_module_raises_a_bare_value_error() -> None:
    """Else a command could not tell it from one of NumPy's."""
    found = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Raise)
        and node.exc is not None
        and "ValueError" in {n.id for n in ast.walk(node.exc) if isinstance(n, ast.Name)}
    ]
    assert found == []


@pytest.mark.parametrize(
    "wrong",
    [
        float("nan"),
        float("-inf"),
        pytest.param(10**400, id="1e400"),
        pytest.param(-(10**400), id="-1e400"),
        True,
        "1",
    ],
)
def test_what_no_double_holds_is_no_finite_number(wrong: object) -> None:
    with pytest.raises(InputError, match=r"width: .*, expected a finite number"):
        check_finite("width", wrong)
    for right in (0, 10**308, np.float32(-1.5)):
        check_finite("width", right)


@pytest.fixture
def raising(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """The command `info`, in which something fails."""

    def run(error: Exception) -> None:
        def fails(*_: object) -> None:
            raise error

        monkeypatch.setattr("hardware.recording.reading.read_messages", fails)
        monkeypatch.setattr(sys, "argv", ["ugv", "info", str(tmp_path / "run.mcap")])
        cli.main()

    return run


@pytest.mark.parametrize("kind", [InputError, DeviceError, LinkError, NoAnswerError, RadioError])
def test_a_command_tells_an_error_of_a_kind_in_one_line(
    raising, kind: type[Exception], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        raising(kind("run.mcap: is wrong"))
    assert ended.value.code == 2
    assert capsys.readouterr().err == "ugv: error: run.mcap: is wrong\n"


def test_a_library_s_value_error_is_a_fault(raising) -> None:
    """Not told as if an input were wrong: it comes through, with its trace."""
    with pytest.raises(ValueError, match="could not be broadcast") as library:
        np.zeros(2) + np.zeros(3)
    with pytest.raises(ValueError, match="could not be broadcast") as caught:
        raising(library.value)
    assert not isinstance(caught.value, HardwareError)
