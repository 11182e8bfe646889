"""NumPy on one thread, the engine on its share of the cores; the camera's reference firmware,
compiled and run behind a terminal.
"""

import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

# Matrices here are small: more threads wait for each other, at twice the processor's time.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Commands compute everything anew, and leave nothing in the user's own folder.
os.environ["UGV_TWIN_CACHE"] = ""

import numpy as np
import pytest
from numpy.typing import NDArray

import hardware
from hardware import PatternSet

_SIDE_BY_SIDE = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))


def pytest_runtest_setup() -> None:
    """Of tests side by side, each with threads of the engine on all cores, these wait for those of
    the others: the radar's take 1.4 times as much of the processor's time.
    """
    if "drjit" in sys.modules and _SIDE_BY_SIDE > 1:
        cores = os.cpu_count() or 1
        sys.modules["drjit"].set_thread_count(max(1, cores // _SIDE_BY_SIDE))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of the variants of a test all beyond the first n that ``quick(n)`` names are thorough."""
    count = Counter[str]()
    for item in items:
        if mark := item.get_closest_marker("quick"):
            test = item.nodeid.partition("[")[0]
            count[test] += 1
            if count[test] > mark.args[0]:
                item.add_marker("thorough")


sys.path.insert(0, str(Path(__file__).parent))  # helpers beside this file can be imported

_SOURCES = Path(hardware.__file__).parent / "drivers" / "firmware"
_STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


@dataclass(frozen=True)
class Firmware:
    """The compiled program."""

    program: Path

    @contextmanager
    def running(self, *arguments: str) -> Iterator[str]:
        """Path of the terminal behind which it runs."""
        device = subprocess.Popen(
            [self.program, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert device.stdin is not None
        assert device.stdout is not None
        try:
            yield device.stdout.readline().strip()
        finally:
            device.stdin.close()
            try:
                device.wait(10)
            finally:
                device.kill()
                device.wait()
                device.stdout.close()

    def translate(self, direction: str, lines: list[str]) -> list[str]:
        """Hex lines as on the wire of hex lines of type, tag, payload; or the other way."""
        command = [self.program, f"--{direction}"]
        text = "\n".join(lines) + "\n"
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
        return done.stdout.split("\n")[:-1]

    def counts(self, patterns: PatternSet, gain: int = 0) -> NDArray[np.int64]:
        """What its two detectors count in one set, (n_exposures, 2)."""
        cells = np.arange(patterns.n_cells)[:, None]
        picture = (37 * cells + 11 * np.arange(2 // patterns.n_arms)) % 97
        return np.rint(patterns.signal(picture)).astype(np.int64) * 2**gain + 100


def _compiled(folder: Path, *options: str) -> Firmware:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler: the reference firmware cannot be built")
    program = folder / "device"
    sources = sorted(map(str, _SOURCES.glob("*.c")))
    assert sources
    subprocess.run([compiler, *_STRICT, *options, "-o", str(program), *sources, "-lm"], check=True)
    return Firmware(program)


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Firmware:
    return _compiled(tmp_path_factory.mktemp("firmware"))


@pytest.fixture(scope="session")
def checked_firmware(tmp_path_factory: pytest.TempPathFactory) -> Firmware:
    """The same, which ends itself where it writes outside its memory or computes nonsense."""
    checks = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-Wno-error")
    return _compiled(tmp_path_factory.mktemp("checked"), *checks)
