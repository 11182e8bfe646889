"""A frame of `scenes/crossing` in which the rig, a car and a person move: time, and every count
against a render of each exposure anew.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.timing import Figure, timed
from twin.camera import capture
from twin.camera.chain import Chain
from twin.camera.exposure_noise import exposure_noise_w
from twin.camera.exposures import Exposures
from twin.camera.light import render, render_light
from twin.camera.mounting import light_problem
from twin.camera.moving_frame import frame_light, world_in_motion
from twin.camera.truth import Truth, depths
from twin.fidelity import Fidelity
from twin.scene import load_scene
from twin.system import load_system

#: Exposures that are rendered anew, spread over the frame.
_ANEW = 200
_REFERENCE = Fidelity(samples=32**2, max_depth=8, indirect_samples=32**2)
_TOLERANCES = {
    "a tenth of each count's noise": Fidelity(light_tolerance=0.03, motion_tolerance=0.03),
    "tolerance 0.2": Fidelity(light_tolerance=0.2, motion_tolerance=0.1),
}


def figures() -> Iterator[Figure]:
    """64 x 64 cells of `workable`, differential patterns; everything warm."""
    scene = load_scene("crossing")
    for name, fidelity in _TOLERANCES.items():
        for n_patterns in (4096, 128):
            system = load_system("workable").with_({"acquisition.n_patterns": n_patterns})
            took = timed(
                lambda system=system, fidelity=fidelity: capture(scene, system, fidelity=fidelity),
                runs=3,
                warm_up=1,
            )
            yield f"moving frame, {n_patterns} patterns, {name}", took, ""
        yield from _errors(name, fidelity)


def _errors(name: str, fidelity: Fidelity) -> Iterator[Figure]:
    """Of the emitter's light in counts, over their noise."""
    scene, system = load_scene("crossing"), load_system("workable")
    world = world_in_motion(scene, system, fidelity)
    assert world is not None
    chain, seed = Chain.of(system, scene.sun), np.random.SeedSequence(1)
    middle = scene.after(world.duration_s / 2)
    rendered = render(middle, system, fidelity=fidelity, seed=seed)
    frame = frame_light(world, chain, rendered, fidelity, seed.spawn(2))
    noise_w = exposure_noise_w(chain, rendered)
    exposures = Exposures.of(system)
    which = np.linspace(0, len(exposures.starts_s) - 1, _ANEW).astype(int)
    errors = []
    for row in which.tolist():
        problem = light_problem(scene.after(float(exposures.middles_s[row])), system)
        depth = depths(problem.scene, problem.emitter, system.image_shape)
        truth = Truth(np.zeros_like(depth), depth)
        seeds = np.random.SeedSequence([2, row]).spawn(2)
        power = chain.powers(render_light(problem, chain, truth, _REFERENCE, seeds))
        true_w = chain.mean_signal(power)[row]
        errors.append(float(np.abs(frame.signal_w[row] - true_w).max()) / noise_w)
    yield (
        f"{name}: counts against {_ANEW} renders anew, rms",
        float(np.hypot.reduce(errors)) / (_ANEW**0.5),
        "of a count's noise",
    )
    yield f"{name}: the same, the largest", max(errors), "of a count's noise"
