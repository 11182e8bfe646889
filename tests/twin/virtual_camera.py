"""A virtual camera on a line, and what the twin gives of the same settings directly."""

import threading
from contextlib import contextmanager
from itertools import islice

from hardware import PatternSet
from hardware.drivers import Patience, SpiSettings
from twin.camera.stream import still_light, stills
from twin.fidelity import Fidelity
from twin.scene import load_scene
from twin.serve.camera import VirtualCamera
from twin.serve.clock import DeviceClock
from twin.serve.configuration import configure_system
from twin.serve.faults import CameraFaults
from twin.serve.line import Terminal
from twin.serve.serial import CameraServer
from twin.system import System, load_system

SEED = 6
QUICK = Fidelity(samples=4, max_depth=1, motion_tolerance=None)
PATIENCE = Patience(reply_s=0.4, attempts=5, reconnect_s=10.0, between_attempts_s=0.05)
SETTINGS = SpiSettings(PatternSet(16, 16, 32), 80e-6, 100e-6)


def quick_world():
    """Scene, a camera of 16 x 16 cells, its light."""
    scene = load_scene("yard")
    content = load_system("workable").model_dump()
    content["emitter"] |= {name: {"value": 16, "assumed": "quick"} for name in ("rows", "columns")}
    content["acquisition"]["n_patterns"] = {"value": 256, "assumed": "quick"}
    system = System.model_validate(content)
    return scene, system, still_light(scene, system, seed=SEED, fidelity=QUICK)


def direct(world, wanted: SpiSettings, sets: int):
    scene, system, light = world
    records = stills(scene, configure_system(system, wanted), seed=SEED, fidelity=QUICK, lit=light)
    return list(islice(records, sets))


@contextmanager
def served(world, line=None, *, pace="fast", faults=None, seed=0, frames=iter):
    """The camera on a line; yields the server. ``frames``: of the records of a run, as the camera
    asks for them.
    """
    scene, system, light = world
    faults = faults or CameraFaults()
    clock = DeviceClock(pace, faults.drift)
    server = CameraServer(
        lambda send, overrun: VirtualCamera(
            system,
            scene.sun,
            lambda made: frames(stills(scene, made, seed=SEED, fidelity=QUICK, lit=light)),
            clock=clock,
            send=send,
            overrun=overrun,
        ),
        line or Terminal(),
        clock=clock,
        faults=faults,
        seed=seed,
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
