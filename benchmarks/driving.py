"""`twin drive` with both sensors: pace and memory, and the bytes after ten kills at random.

The camera takes a frame of 32 x 32 cells in 2.6 s, and the radar sends a burst every 20 s, both
with the knobs of `draft`. ``python -m benchmarks driving`` drives a minute; ``python -m
benchmarks.driving 600`` as many seconds as it is told, and ``python -m benchmarks.driving 2
default`` with all that `twin drive` does by default, without kills: frames of 64 x 64 cells and ten
bursts a second to a tolerance of 0.2.
"""

import contextlib
import hashlib
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

_SCENE, _DURATION_S, _KILLS, _RADAR_PERIOD_S = "crossing", 60.0, 10, 20.0
_SYSTEM = """
base = "paper"
[emitter]
rows = { value = 32, assumed = "a quarter of the cells of `paper`" }
columns = { value = 32, assumed = "as rows" }
[acquisition]
n_patterns = { value = 1024, assumed = "a complete set" }
pattern_period_s = { value = 1.26e-3, assumed = "a frame as long as that of `paper`" }
"""
_SYSTEM_FILE, _LOOK_S = "camera.toml", 0.2
#: After the log has reached a length drawn at random, a drive goes on for up to as long: it is
#: killed in the middle of an event, or while what was left is still being written anew.
_LONGEST_S = 20.0


def figures(duration_s: float = _DURATION_S) -> Iterator[tuple[str, float, str]]:
    """Name, value and unit of each figure."""
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole.mcap", Path(folder) / "killed.mcap"
        (Path(folder) / _SYSTEM_FILE).write_text(_SYSTEM)
        settings = (
            *("--radar-period", f"{_RADAR_PERIOD_S} s"),
            *("--system", str(Path(folder) / _SYSTEM_FILE)),
            *("--fidelity", "draft"),
        )
        drive = _Run(whole, duration_s, settings).ended()
        size = whole.stat().st_size
        yield f"drive of {_SCENE}, {duration_s:g} s, of real time", duration_s / drive.took_s, ""
        for name, value in drive.memory():
            yield f"its largest memory, {name}", value, "MB"
        yield "its log", size / 1e6, "MB"
        rng, begun = random.Random(0), time.monotonic()
        for moment in sorted(rng.uniform(0, 1) for _ in range(_KILLS)):
            run = _Run(killed, duration_s, settings).killed(
                moment * size, rng.uniform(0, _LONGEST_S)
            )
            share = killed.stat().st_size / size if killed.exists() else 0.0
            yield f"killed after {run.took_s:.0f} s, of its log written", share, ""
            yield "its largest memory", max(run.memory_mb), "MB"
        last = _Run(killed, duration_s, settings).ended()
        yield "the last one's largest memory", max(last.memory_mb), "MB"
        took_s = time.monotonic() - begun
        yield f"killed {_KILLS} times and gone on with, of real time", duration_s / took_s, ""
        same = _digest(whole) == _digest(killed)
        yield "the same bytes as the whole one's", float(same), "(1: yes)"


def by_default(duration_s: float) -> Iterator[tuple[str, float, str]]:
    """Of a drive of which only the duration is given."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.mcap"
        drive = _Run(path, duration_s).ended()
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        label = f"drive of {_SCENE} by default, {duration_s:g} s"
        yield f"{label}, of real time", duration_s / drive.took_s, ""
        yield f"{label}, CPU time for a second", (used.ru_utime + used.ru_stime) / duration_s, "s"
        for name, value in drive.memory():
            yield f"its largest memory, {name}", value, "MB"
        for name, value in drive.memory(min):
            yield f"its least memory, {name}", value, "MB"
        yield "its log", path.stat().st_size / 1e6, "MB"


@dataclass
class _Run:
    """A process that drives into a log, in a group of its own, and its resident memory over time,
    with that of the processes that it starts.

    Raises RuntimeError where it fails.
    """

    path: Path
    duration_s: float
    settings: Sequence[str] = ()
    memory_mb: list[float] = field(default_factory=list)
    took_s: float = 0.0

    def __post_init__(self) -> None:
        command = [sys.executable, "-m", "twin", "drive", _SCENE, "--out", str(self.path)]
        command += ["--duration", f"{self.duration_s:g} s", *self.settings]
        self._begun = time.monotonic()
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)

    def ended(self) -> "_Run":
        """Once it has ended by itself."""
        while self._goes_on():
            pass
        return self

    def killed(self, size: float, further_s: float) -> "_Run":
        """Killed so long after its log is as large."""
        while self._goes_on() and not (self.path.exists() and self.path.stat().st_size >= size):
            pass
        end = time.monotonic() + further_s
        while time.monotonic() < end and self._goes_on():
            pass
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        return self

    def memory(self, of: Callable[[Sequence[float]], float] = max) -> Iterator[tuple[str, float]]:
        """Name of each fifth of its time, and what it held at most, or by another measure."""
        n = len(self.memory_mb)
        for fifth in range(5):
            some = self.memory_mb[fifth * n // 5 : max((fifth + 1) * n // 5, fifth * n // 5 + 1)]
            yield f"fifth {fifth + 1} of its time", of(some)

    def _goes_on(self) -> bool:
        """Whether it does, after a look at its memory and a wait."""
        if self._process.poll() is None:
            self.memory_mb.append(_resident_mb(psutil.Process(self._process.pid)))
            self.took_s = time.monotonic() - self._begun
            time.sleep(_LOOK_S)
            return True
        if self._process.returncode:
            raise RuntimeError(f"{self.path}: the drive ended with {self._process.returncode}")
        return False


def _resident_mb(process: psutil.Process) -> float:
    """Of a process and those that it started."""
    total = 0
    for one in (process, *process.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            total += one.memory_info().rss
    return total / 1e6


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


if __name__ == "__main__":
    duration = [float(argument) for argument in sys.argv[1:2]]
    for name, value, unit in by_default(*duration) if "default" in sys.argv else figures(*duration):
        print(f"{name}: {value:.4g} {unit}", flush=True)
