"""The UHD driver against the real UHD library, as far as it goes without a radio."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cobs
import pytest

from hardware.drivers.radio import Fault, RadioError, open_radio

ROOT = Path(__file__).parents[2]
#: Debian's package belongs to Debian's Python.
PYTHONS = (sys.executable, "/usr/bin/python3")


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What uhd_checks.py prints under the first Python that has UHD."""
    # What the camera's driver beside the radio's needs, and another Python may lack.
    beside = tmp_path_factory.mktemp("beside")
    (beside / "cobs").symlink_to(Path(cobs.__file__).parent)
    needs = "import uhd, numpy, scipy; uhd.types.TimeSpec"
    for python in PYTHONS:
        if not Path(python).exists():
            continue
        environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{beside}"}
        there = subprocess.run([python, "-c", needs], capture_output=True, check=False)
        if there.returncode == 0:
            script = str(ROOT / "tests" / "hardware" / "uhd_checks.py")
            done = subprocess.run(
                [python, script], capture_output=True, text=True, env=environment, check=False
            )
            assert done.returncode == 0, done.stderr
            return json.loads(done.stdout[done.stdout.index("{") :].splitlines()[0])
    pytest.skip("no Python here has UHD (Debian: python3-uhd)")


def test_discovery_without_a_radio_is_one_clear_line(said: dict) -> None:
    for url, line in said["discovery"].items():
        assert line.startswith(f"{url}: ")
        assert "No devices found" in line
        assert "\n" not in line
    assert len(said["discovery"]) == 3


def test_time_survives_uhd_to_the_nanosecond(said: dict) -> None:
    assert set(said["times"]) == {0}


def test_every_code_of_uhd_is_mapped(said: dict) -> None:
    """UHD 4: overflow is also its code for lost packets; chain, alignment and bad packets are the
    driver's or the device's fault, which no burst survives.
    """
    found = dict(said["faults"])
    assert {name: found.pop(name) for name in list(found) if name.startswith("transmit")} == {
        "transmit burst_ack": 0,
        "transmit underflow": Fault.UNDERFLOW,
        "transmit seq_error": Fault.OUT_OF_SEQUENCE,
        "transmit time_error": Fault.LATE,
        "transmit underflow_in_packet": Fault.UNDERFLOW,
        "transmit seq_error_in_packet": Fault.OUT_OF_SEQUENCE,
        "transmit user_payload": 0,
    }
    for name, fault in {
        "none False": 0,
        "none True": Fault.OUT_OF_SEQUENCE,
        "timeout False": Fault.TIMEOUT,
        "late False": Fault.LATE,
        "overflow False": Fault.OVERFLOW,
        "overflow True": Fault.OUT_OF_SEQUENCE,
    }.items():
        assert found[name] == fault
    for name in ("broken_chain", "alignment", "bad_packet"):
        assert found[f"{name} False"] == f"uhd: {name}: says {name}"


@pytest.mark.parametrize(
    ("case", "faults", "there", "first_lost"),
    [
        ("good", Fault(0), 1000, -1),
        ("overflow", Fault.OVERFLOW, 700, 300),
        ("late", Fault.LATE, 0, 0),
        ("timeout", Fault.TIMEOUT, 600, 600),
        ("underflow", Fault.UNDERFLOW, 1000, -1),
        ("no acknowledgement", Fault.TIMEOUT, 1000, -1),
    ],
)
def test_samples_stand_where_their_time_says(
    said: dict, case: str, faults: Fault, there: int, first_lost: int
) -> None:
    """Real types of UHD above streamers that stand in: what is lost leaves a gap, nothing moves."""
    found = said["streams"][case]
    assert found["faults"] == faults
    assert (found["there"], found["first_lost"]) == (there, first_lost)
    assert found["right"]
    assert found["silent"]
    assert found["tuned"] == 2500000000.25
    assert found["now"] == 1_000_000_000
    stream, send = found["log"]
    assert stream == ["stream", 1000, 1_010_000_000]
    # Patience: 10 ms ahead, 50 us of samples, half a second.
    assert send == ["send", [1, 1000], 0.51]


def test_without_uhd_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uhd", None)
    with pytest.raises(RadioError, match=r"cannot be imported .*; install Debian's python3-uhd"):
        open_radio("uhd:type=b200", sample_rate_hz=20e6)
    with pytest.raises(ValueError, match="sample_rate_hz is missing"):
        open_radio("uhd:type=b200")
