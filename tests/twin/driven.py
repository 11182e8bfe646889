"""A drive that takes a moment: a rig before flat patches, with a small camera and a short radar."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from twin.drive import DeviceClock, Drive
from twin.fidelity import Fidelity
from twin.motion.trajectory import through
from twin.radar import load_radar
from twin.scene import Scene, load_scene
from twin.system import load_system

#: Frames of 12.8 ms and bursts of 0.6 ms, rendered and traced in a moment.
CAMERA = load_system("workable").with_(
    {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 64}
)
RADAR = load_radar("hybrid-79").with_({"waveform.n_slots": 16, "waveform.n_subcarriers": 128})
FAST = Fidelity(samples=4, max_depth=1, radar="targets")
CLOCKS = {"camera_clock": DeviceClock(2e-3, 50.0), "radar_clock": DeviceClock(-1e-3, -30.0)}


def driven_scene(until_s: float = 10.0) -> Scene:
    """The patches of `table1` before a rig that drives at 5 m/s and turns left."""
    scene = load_scene("table1")
    times = np.linspace(0, until_s, 5)
    places = np.stack([5 * times, 0.1 * times**2, np.full(5, 1.2)], axis=1)
    turned = Rotation.from_rotvec(np.outer(0.05 * times, [0, 0, 1]))
    rig = scene.rig.following(through(times, places, turned, "error"))
    return replace(scene, rig=rig)


def plan(**changes: object) -> Drive:
    """Three frames and three bursts, unless told otherwise."""
    settings = {
        "scene": driven_scene(),
        "system": CAMERA,
        "radar": RADAR,
        "duration_s": 0.045,
        "fidelity": FAST,
        "radar_period_s": 0.02,
        "truth_period_s": 0.01,
        "seed": 3,
        **CLOCKS,
    }
    return Drive(**(settings | changes))  # type: ignore[arg-type]
