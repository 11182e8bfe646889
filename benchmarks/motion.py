"""Frames of `scenes/crossing` in which the rig, a car and a person move: time, and counts against
renders of single exposures anew; and of `scenes/yard`, where a car does, what each accuracy costs
with its motion and without.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Figure
from twin.camera import Capture, capture
from twin.camera.chain import Chain
from twin.camera.exposure_noise import exposure_noise_w
from twin.camera.exposures import Exposures
from twin.camera.light import render, render_light
from twin.camera.mounting import light_problem
from twin.camera.moving_frame import frame_light, world_in_motion
from twin.camera.truth import Truth, depths
from twin.fidelity import DEFAULT, PRESETS, Fidelity
from twin.optics.paths import TracingQuality
from twin.scene import Scene, load_scene
from twin.system import System, load_system

Array = NDArray[np.float64]

#: Exposures that are rendered anew, spread over the frame.
_ANEW = 40
#: Paths of a cell, direct and indirect, of a render anew; the sun does not count. With 8 bounces up
#: to 0.1 of a count's noise is missing.
_REFERENCE = Fidelity(samples=32**2, max_depth=40, indirect_samples=32**2)
_NO_SUN = TracingQuality(samples=1, max_depth=1)
_ACCURACIES = {
    "default": DEFAULT,
    "a tenth of the noise": Fidelity(light_tolerance=0.03, motion_tolerance=0.03),
}
_RUNS = 3
#: `--fidelity` of each, and the default.
_LEVELS = {**PRESETS, "default": DEFAULT}


def figures() -> Iterator[Figure]:
    """64 x 64 cells of `workable`, differential patterns; everything warm. Processor time, of all
    cores together.
    """
    yield from moving_yard()
    scene = load_scene("crossing")
    for name, fidelity in _ACCURACIES.items():
        for n_patterns in (4096, 128):
            system = load_system("workable").with_({"acquisition.n_patterns": n_patterns})
            took = _cpu_s(lambda s=system, f=fidelity: capture(scene, s, fidelity=f))
            yield f"moving frame, {n_patterns} patterns, {name}", took, "s of CPU"
    system = load_system("workable")
    which = np.linspace(0, system.n_exposures - 1, _ANEW).astype(int)
    true_w = _anew(scene, system, which)
    for name, fidelity in _ACCURACIES.items():
        yield from _errors(name, fidelity, scene, system, which, true_w)


def _cpu_s(work: Callable[[], Capture]) -> float:
    """The least of some runs, after one that compiles."""
    work()
    took = []
    for _ in range(_RUNS):
        before = time.process_time()
        work()
        took.append(time.process_time() - before)
    return min(took)


def moving_yard() -> Iterator[Figure]:
    """`twin.capture` of the yard, as README.md tells it."""
    scene, system = load_scene("yard"), load_system("workable")
    for name in ("draft", "standard", "default", "reference"):
        followed = _LEVELS[name]
        still = replace(followed, motion_tolerance=None)
        for kind, fidelity in (("car taken as still", still), ("car moves", followed)):
            took = _cpu_s(lambda f=fidelity: capture(scene, system, seed=1, fidelity=f))
            yield f"capture of the yard, {name}, {kind}", took, "s of CPU"


def _anew(scene: Scene, system: System, which: NDArray[np.int64]) -> Array:
    """Mean signal of some exposures, W, from a stock scene at the middle of each."""
    chain, middles_s, found = Chain.of(system, scene.sun), Exposures.of(system).middles_s, []
    for row in which.tolist():
        problem = light_problem(scene.after(float(middles_s[row])), system)
        depth = depths(problem.scene, problem.emitter, system.image_shape)
        truth, seeds = Truth(np.zeros_like(depth), depth), np.random.SeedSequence([2, row]).spawn(2)
        light = render_light(problem, chain, truth, _REFERENCE, seeds, sun_quality=_NO_SUN)
        found.append(chain.mean_signal(chain.powers(light))[row, 0, 0])
    return np.array(found)


def _errors(
    name: str,
    fidelity: Fidelity,
    scene: Scene,
    system: System,
    which: NDArray[np.int64],
    true_w: Array,
) -> Iterator[Figure]:
    """Of the emitter's light in counts, over their noise."""
    world = world_in_motion(scene, system, fidelity)
    assert world is not None
    chain, seed = Chain.of(system, scene.sun), np.random.SeedSequence(1)
    rendered = render(scene.after(world.duration_s / 2), system, fidelity=fidelity, seed=seed)
    frame = frame_light(world, chain, rendered, fidelity, seed.spawn(2))
    assert frame.signal_w is not None
    error = (frame.signal_w[which, 0, 0] - true_w) / exposure_noise_w(chain, rendered)
    unit, label = "of a count's noise", f"{name}: counts against {_ANEW} renders anew"
    yield f"{label}, rms", float(np.sqrt(np.mean(error**2))), unit
    yield f"{label}, mean", float(error.mean()), unit
    yield f"{label}, largest", float(np.abs(error).max()), unit
    yield f"{name}: interpolation in time, stated", frame.decision.bound, unit
