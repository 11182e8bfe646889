"""`twin drive`: pace and memory over a minute, and the bytes after ten kills at random.

The camera is that of system `paper`, whose frames take 2.6 s, with the light of `draft`. Ten
minutes take ten times as long: set `_DURATION_S`.
"""

import hashlib
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

_SCENE, _DURATION_S, _KILLS = "crossing", 60, 10
_LOOK_S = 0.5


def figures() -> Iterator[tuple[str, float, str]]:
    """Name, value and unit of each figure."""
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole.mcap", Path(folder) / "killed.mcap"
        begun = time.monotonic()
        memory_mb = list(_watched(_started(whole)))
        elapsed_s = time.monotonic() - begun
        yield (
            f"drive of {_SCENE}, camera, {_DURATION_S} s: of real time",
            _DURATION_S / elapsed_s,
            "",
        )
        half = len(memory_mb) // 2
        yield "its largest memory, first half", max(memory_mb[:half]), "MB"
        yield "its largest memory, second half", max(memory_mb[half:]), "MB"
        yield "its log", whole.stat().st_size / 1e6, "MB"
        rng = random.Random(0)
        for moment in sorted(rng.uniform(0, 1) for _ in range(_KILLS)):
            _killed_at(_started(killed), killed, moment * whole.stat().st_size)
        _started(killed).wait()
        same = _digest(whole) == _digest(killed)
        yield (
            f"killed {_KILLS} times at random and gone on with: same bytes",
            float(same),
            "(1: yes)",
        )


def _started(path: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "twin", "drive", _SCENE, "--duration", f"{_DURATION_S} s"]
    command += ["--system", "paper", "--fidelity", "draft", "--radar", "none", "--out", str(path)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def _watched(process: "subprocess.Popen[bytes]") -> Iterator[float]:
    """Resident memory of a process, MB, until it ends."""
    while process.poll() is None:
        pages = Path(f"/proc/{process.pid}/statm").read_text().split()
        if len(pages) > 1:
            yield int(pages[1]) * 4096 / 1e6
        time.sleep(_LOOK_S)
    if process.returncode:
        raise RuntimeError(f"drive ended with {process.returncode}")


def _killed_at(process: "subprocess.Popen[bytes]", path: Path, size: float) -> None:
    """Kill a process once its log is as large."""
    while process.poll() is None and (not path.exists() or path.stat().st_size < size):
        time.sleep(_LOOK_S / 10)
    process.send_signal(signal.SIGKILL)
    process.wait()


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
