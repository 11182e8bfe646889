"""The process beside a run: what it computes, what it raises, and that it never stays behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import drjit
import psutil
import pytest

from twin.child_process import Helper, attempt
from twin.errors import EngineError, InputError
from twin.fidelity import PRESETS
from twin.job import run


@pytest.fixture
def helper() -> Iterator[Helper]:
    started = Helper("math")
    yield started
    started.close()


def test_gives_what_the_call_gives(helper: Helper) -> None:
    assert helper.ask(pow, 3, 4)
    assert helper.answer() == 81


def test_input_errors_come_as_they_are(helper: Helper) -> None:
    assert helper.ask(Helper.answer, "no helper")
    with pytest.raises(EngineError, match="AttributeError: 'str' object has no attribute"):
        helper.answer()
    assert attempt(_refuse)[1].args == ("field: 3: expected 4",)


def _refuse() -> None:
    raise InputError("field: 3: expected 4")


def test_code_of_ones_own_may_not_exit(helper: Helper) -> None:
    assert helper.ask(sys.exit, 3)
    with pytest.raises(EngineError, match=r"code of one's own called sys.exit\(3\)"):
        helper.answer()


def test_a_process_that_dies_is_told(helper: Helper) -> None:
    assert helper.ask(os._exit, 1)
    with pytest.raises(EngineError, match="a process started by this one has died: exit status 1"):
        helper.answer()


def test_a_process_that_is_killed_is_told(helper: Helper) -> None:
    assert helper.ask(signal.raise_signal, signal.SIGKILL)
    with pytest.raises(EngineError, match="has died: ended by SIGKILL, for want of memory maybe"):
        helper.answer()


def test_one_call_and_no_other(helper: Helper) -> None:
    assert helper.ask(abs, -3)
    assert not helper.ask(abs, -4)
    assert helper.answer() == 3
    helper.close()
    assert not helper.ask(abs, -5)
    helper.close()


def test_what_cannot_be_sent_is_not_asked(helper: Helper) -> None:
    assert not helper.ask(partial(lambda x: x, 3))
    assert helper.ask(abs, -3)
    assert helper.answer() == 3


@pytest.mark.thorough
def test_a_run_writes_the_same_with_and_without(tmp_path: Path) -> None:
    helper = Helper("twin.job")
    results = [
        run("yard", compare=None, fidelity=PRESETS["draft"], out=tmp_path / name, helper=by)
        for name, by in (("alone", None), ("helped", helper))
    ]
    helper.close()
    for name in ("record.h5", "radar.h5", "truth.exr", "detections.csv", "truth.csv"):
        alone, helped = ((result.out / name).read_bytes() for result in results)
        assert alone == helped, name
    assert list(results[0].seconds) == sorted(
        results[1].seconds, key=list(results[0].seconds).index
    )


@pytest.mark.thorough
def test_a_run_tells_the_camera_error_of_the_helper(tmp_path: Path) -> None:
    """A reconstruction that fails, which only the helper calls."""
    own = tmp_path / "own.py"
    own.write_text(
        "def solve(values, noise_variance, sensing):\n    raise ValueError('of one of my own')\n"
    )
    words = []
    for by in (None, Helper("twin.job")):
        with pytest.raises((InputError, EngineError)) as raised:
            run("yard", compare=None, fidelity=PRESETS["draft"], out=tmp_path / "out",
                method=f"{own}:solve", helper=by)  # fmt: skip
        words.append(str(raised.value))
    assert words[0] == words[1]
    assert "of one of my own" in words[0]
    assert not (tmp_path / "out").exists()


def test_all_cores_are_used_again_after_an_error(tmp_path: Path) -> None:
    """Of the radar, while the helper computes the camera."""
    own = tmp_path / "own.py"
    own.write_text("def find(channel, waveform, image):\n    raise ValueError('of my own')\n")
    helper = Helper("twin.job")
    with pytest.raises(InputError, match="of my own"):
        run("table1", compare=None, radar="paper-80", fidelity=PRESETS["draft"],
            out=tmp_path / "out", detection=f"{own}:find", helper=helper)  # fmt: skip
    helper.close()
    assert drjit.thread_count() == len(os.sched_getaffinity(0))


@pytest.mark.parametrize(
    "number",
    [pytest.param(n, marks=pytest.mark.thorough) for n in (signal.SIGINT, signal.SIGTERM)]
    + [signal.SIGKILL],
)
def test_no_process_stays_behind(number: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "twin", "run", "yard", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    whole = psutil.Process(process.pid)
    end = time.monotonic() + 30
    while not (started := whole.children(recursive=True)) and time.monotonic() < end:
        time.sleep(0.05)
    assert started
    time.sleep(1.0)
    started = whole.children(recursive=True)
    process.send_signal(number)
    process.wait(timeout=20)
    _, alive = psutil.wait_procs(started, timeout=20)
    assert not alive
