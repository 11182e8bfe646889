"""The vehicle's input and output: the camera's stream up to an image, the radio's sweeps."""

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import hardware
from benchmarks.timing import Figure, Timing, timed
from hardware import PatternSet, reconstruct
from hardware.drivers import SpiCamera, SpiSettings
from hardware.drivers.radio import Schedule, acquire, open_radio
from hardware.drivers.radio.setup import read_setup
from hardware.records import RadarFrontEnd
from twin.camera.stream import still_light, stills
from twin.fidelity import Fidelity
from twin.radar import load_radar, radar_echo
from twin.scene import load_scene
from twin.serve.camera import VirtualCamera
from twin.serve.clock import DeviceClock
from twin.serve.line import Terminal
from twin.serve.radio import VirtualRadio
from twin.serve.serial import CameraServer
from twin.serve.sweeps import RadarSweep
from twin.serve.zeromq import RadioServer
from twin.system import System, load_system

_SETTINGS = SpiSettings(PatternSet(8, 8, 64), 10e-6)
_SETS = 2000
_WARM_SWEEPS, _LIVE_SWEEPS = 5, 30


def figures() -> Iterator[Figure]:
    """Name, value and unit; the camera's own need a C compiler for the reference firmware."""
    yield from _virtual_camera()
    yield from _radio()
    yield from _rates()
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


def _virtual_camera() -> Iterator[Figure]:
    """The twin behind a terminal, host and device together on one core."""
    scene, content = load_scene("yard"), load_system("workable").model_dump()
    content["emitter"] |= {name: {"value": 8, "assumed": "64"} for name in ("rows", "columns")}
    content["acquisition"]["n_patterns"] = {"value": 64, "assumed": "64"}
    system, quick = System.model_validate(content), Fidelity(samples=4, max_depth=1)
    light, clock = still_light(scene, system, fidelity=quick), DeviceClock("fast")
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})  # of this thread, and of those it starts
    try:
        server = CameraServer(
            lambda send, overrun: VirtualCamera(
                system,
                scene.sun,
                lambda system: stills(scene, system, fidelity=quick, lit=light),
                clock=clock,
                send=send,
            ),
            Terminal(),
            clock=clock,
        )
        wanted = SpiSettings(PatternSet(8, 8, 64), 80e-6)
        with _served(server), SpiCamera(server.line.url, wanted) as camera:
            camera.acquire()  # what is compiled, is
            wall, busy = time.perf_counter(), time.process_time()
            n = sum(1 for _ in camera.records(sets=_SETS))
            wall, busy = time.perf_counter() - wall, time.process_time() - busy
    finally:
        os.sched_setaffinity(0, cores)
    assert n == _SETS
    yield "virtual camera, 64 patterns, terminal: twin and driver on one core", n / wall, "frames/s"
    yield "virtual camera: if the core did nothing else", n / busy, "frames/s"


def _radio() -> Iterator[Figure]:
    """The prototype's 25 carriers; the scene's answer is at hand, so that nothing is simulated but
    the receiver.
    """
    design = load_radar("prototype")
    echo = radar_echo(load_scene("yard"), design, fidelity=Fidelity(radar="targets")).condensed()
    swept = RadarSweep(echo, echo.record())
    radio = VirtualRadio(design, lambda number: swept, clock=DeviceClock("fast"))
    what = f"radio, a sweep of {len(radio.carriers_hz)} carriers (prototype)"
    yield f"{what}: through ZeroMQ", _sweeps(radio, remote=True), ""
    yield f"{what}: the virtual radio itself", _sweeps(radio, remote=False), ""


def _rates() -> Iterator[Figure]:
    """Sweeps that `twin serve` holds in real pace, with all cores; the driver is another process.

    The design's own rhythm is 7.9 a second, less the driver's lead at each sweep.
    """
    for scene in ("yard", "fig3b"):
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        with tempfile.TemporaryDirectory() as folder:
            setup = Path(folder) / "setup.json"
            command = [sys.executable, "-m", "twin", "serve", scene, "--radar-at", f"tcp:{port}"]
            command += ["--radar-setup", str(setup)]
            with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as it:
                assert it.stdout is not None
                it.stdout.readline()
                try:
                    rate, late = _captured(f"zmq://127.0.0.1:{port}", *read_setup(setup))
                finally:
                    it.terminate()
        yield f"virtual radio in real pace, {scene}, prototype: sweeps", rate, "1/s"
        yield f"virtual radio in real pace, {scene}, prototype: steps that came late", late, "%"


def _captured(url: str, schedule: Schedule, front_end: RadarFrontEnd) -> tuple[float, float]:
    """Sweeps a second, and per cent of steps that are flagged."""
    with open_radio(url) as radio:
        acquire(radio, schedule, front_end, bursts=_WARM_SWEEPS)
        record = acquire(radio, schedule, front_end, bursts=_LIVE_SWEEPS)
    starts = record.device_time_ns[:, 0, 0]
    rate = 1e9 * (len(starts) - 1) / float(starts[-1] - starts[0])
    return rate, 100 * float((record.flags != 0).any(axis=2).mean())


def _sweeps(radio: VirtualRadio, *, remote: bool) -> Timing:
    schedule, front_end = radio.schedule, radio.front_end
    if not remote:
        return timed(lambda: acquire(radio, schedule, front_end), runs=19, warm_up=2)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = RadioServer(radio, "127.0.0.1", port, n_samples=radio.n_samples)
    with _served(server), open_radio(f"zmq://127.0.0.1:{port}") as driver:
        return timed(lambda: acquire(driver, schedule, front_end), runs=19, warm_up=2)


@contextmanager
def _served(server: CameraServer | RadioServer) -> Iterator[None]:
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield
    finally:
        server.stop()
        thread.join()


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
