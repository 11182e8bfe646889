"""What a world that may move costs a scene at rest: the share of the processor time of a frame and
of a burst that is spent in the code of motion, and whether counts are the same without it.

The share is a profile's, which makes short functions look longer than they are: it is one from
above.
"""

import cProfile
import pstats
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.moving_radar import at_rest
from benchmarks.timing import Figure
from twin.camera import capture
from twin.fidelity import DEFAULT
from twin.radar import load_radar, radar_capture
from twin.scene import load_scene
from twin.system import load_system

_RUNS = 3
#: Paths of the code of motion.
_MOTION = (
    "/twin/motion/",
    "/twin/camera/motion.py",
    "/twin/camera/moving_frame.py",
    "/twin/camera/frozen.py",
    "/twin/radar/propagation/interval/",
    "/twin/radar/propagation/one_way/motion.py",
    "/twin/radar/propagation/one_way/device_motion.py",
)
#: In these files, but what is asked for without motion too: the trace itself, and the places of
#: images.
_OTHER = ("traced_interval", "gathered")


def figures() -> Iterator[Figure]:
    """Name, value and unit of each figure; everything warm."""
    system, radar = load_system("workable"), load_radar("hybrid-79")
    for name in ("table1", "yard", "crossing"):
        scene = at_rest(load_scene(name))
        share = _share_of_motion(lambda s=scene: capture(s, system, seed=1))
        yield f"camera, {name} at rest: CPU time in the code of motion", 100 * share, "%"
        off = replace(DEFAULT, motion_tolerance=None)
        one, other = (capture(scene, system, seed=1, fidelity=f) for f in (DEFAULT, off))
        same = np.array_equal(one.record.counts, other.record.counts)
        yield f"camera, {name} at rest: the same counts without it", float(same), "(1: yes)"
    for name in ("street", "yard"):
        scene = at_rest(load_scene(name))
        share = _share_of_motion(lambda s=scene: radar_capture(s, radar, seed=1))
        yield f"radar, {name} at rest: CPU time in the code of motion", 100 * share, "%"


def _share_of_motion(work: Callable[[], Any]) -> float:
    """Of the processor time of some runs, after one that compiles."""
    work()
    profile = cProfile.Profile(time.process_time)
    for _ in range(_RUNS):
        profile.runcall(work)
    calls: dict[Any, Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    whole = sum(own_s for _, _, own_s, _, _ in calls.values())
    of_motion = 0.0
    for function, (_, _, _, _, callers) in calls.items():
        if _is_of_motion(function):
            of_motion += sum(
                times[3] for caller, times in callers.items() if not _is_of_motion(caller)
            )
    return float(of_motion / whole)


def _is_of_motion(function: tuple[str, int, str]) -> bool:
    path, _, name = function
    return name not in _OTHER and any(part in path for part in _MOTION)
