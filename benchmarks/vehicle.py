"""The vehicle's input and output: the camera's stream, from bytes on a line to an image."""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import hardware
from benchmarks.timing import Figure, timed
from hardware import PatternSet, reconstruct
from hardware.drivers import SpiCamera, SpiSettings

_SETTINGS = SpiSettings(PatternSet(8, 8, 64), 10e-6)
_SETS = 2000


def figures() -> Iterator[Figure]:
    """Name, value and unit; needs a C compiler for the reference firmware."""
    compiler = shutil.which("cc")
    if compiler is None:
        return
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "device"
        sources = (Path(hardware.__file__).parent / "drivers" / "firmware").glob("*.c")
        subprocess.run([compiler, "-O2", "-o", program, *sources, "-lm"], check=True)
        yield from _stream(program)
        yield from _latency(program)


def _stream(program: Path) -> Iterator[Figure]:
    """Frames of 64 patterns and complements, through a terminal, as fast as they come."""
    with _running(program, "--fast") as path, SpiCamera(path, _SETTINGS) as camera:
        wall, busy = time.perf_counter(), time.process_time()
        n = sum(1 for _ in camera.records(sets=_SETS))
        wall, busy = time.perf_counter() - wall, time.process_time() - busy
    assert n == _SETS
    yield "camera stream, 64 patterns, terminal: through the driver", n / wall, "frames/s"
    yield "camera stream: what one core alone could take", n / busy, "frames/s"


def _latency(program: Path) -> Iterator[Figure]:
    """Work of driver and reconstruction per frame of a 33 fps stream.

    From a frame's last byte on the line to the image there is nothing but this work.
    """
    with _running(program, "--fast") as path, SpiCamera(path, _SETTINGS) as camera:
        records = camera.records()
        first = next(records)
        reconstruct(first)
        timing = timed(lambda: reconstruct(next(records)), runs=99, warm_up=9)
        records.close()  # type: ignore[attr-defined]
    yield "camera at 33 fps: driver and reconstruction add to a frame (LMMSE)", timing, ""


@contextmanager
def _running(program: Path, *arguments: str) -> Iterator[str]:
    device = subprocess.Popen(
        [program, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert device.stdin is not None
    assert device.stdout is not None
    with device:
        yield device.stdout.readline().strip()
        device.stdin.close()
