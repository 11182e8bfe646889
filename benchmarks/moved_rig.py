"""How far a rig may move before the light and the echoes of one place no longer hold at the next:
`scenes/yard` with its car stopped, moved ahead and aside. And what it costs to place the camera's
meshes anew.
"""

import cProfile
import pstats
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.moving_radar import at_rest
from benchmarks.timing import Figure
from tests.physics.retraced import errors_by_body
from twin.camera import capture
from twin.camera.chain import Chain
from twin.camera.light import render
from twin.camera.permitted_error import PermittedError
from twin.camera.rendered import RenderedLight
from twin.fidelity import DEFAULT, PRESETS, Fidelity
from twin.motion import Product, Still, Straight
from twin.radar import load_radar
from twin.radar.propagation.solvers import trace
from twin.scene import Scene, load_scene
from twin.system import load_system

_AHEAD, _ASIDE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_DIRECTIONS = {"ahead": _AHEAD, "aside": _ASIDE}
_WAYS_MM = 0.3, 1.0, 3.0, 10.0
#: Surfaces alone, so that bodies' echoes are those that contributions follow.
_SURFACES = DEFAULT.with_(radar_edges=0, radar_shadowed=0)


def figures() -> Iterator[Figure]:
    """Light over the default's noise, with the same paths; echoes as they were, each with the delay
    and the phase of its new way, against echoes traced anew.
    """
    scene = at_rest(load_scene("yard"))
    for name, direction in _DIRECTIONS.items():
        for way_mm, changed in zip(_WAYS_MM, _light(scene, direction), strict=True):
            yield f"light, {way_mm:g} mm {name}: change over noise, rms over cells", changed, ""
    for name, direction in _DIRECTIONS.items():
        for way_mm, errors in zip(_WAYS_MM, _echoes(scene, direction), strict=True):
            for body, error in errors.items():
                yield f"echo of {body}, {way_mm:g} mm {name}: change", 100 * error, "%"
    for name, fidelity in (("default", DEFAULT), ("draft", PRESETS["draft"])):
        share = _share_of_meshes(_at_1_m_per_s(scene, _AHEAD), fidelity)
        yield f"placing meshes, of a moving frame's CPU time, {name}", 100 * share, "%"


def _light(scene: Scene, direction: tuple[float, float, float]) -> Iterator[float]:
    system, pose = load_system("workable"), scene.rig.pose
    chain = Chain.of(system, scene.sun)

    def rendered_at(way_m: float) -> RenderedLight:
        place = np.asarray(pose.position_m) + way_m * np.asarray(direction)
        there = scene.at(replace(pose, position_m=tuple(place.tolist())))
        seed = np.random.SeedSequence(1)
        return render(there, system, fidelity=PRESETS["reference"], seed=seed)

    here = rendered_at(0.0)
    noise_w = PermittedError(chain, here, DEFAULT).noise_w(here.light.cells).ravel()
    before_w = np.ravel(chain.powers(here).cells_w)
    for way_mm in _WAYS_MM:
        after_w = np.ravel(chain.powers(rendered_at(1e-3 * way_mm)).cells_w)
        yield float(np.sqrt(np.mean(((after_w - before_w) / noise_w) ** 2)))


def _echoes(scene: Scene, direction: tuple[float, float, float]) -> Iterator[dict[str, float]]:
    """At 1 m/s, so that millimetres are milliseconds."""
    radar, moving = load_radar("hybrid-79"), _at_1_m_per_s(scene, direction)
    found = trace(moving, radar, fidelity=_SURFACES)
    for way_mm in _WAYS_MM:
        yield errors_by_body(moving, radar, found, _SURFACES, np.array([1e-3 * way_mm]))


def _at_1_m_per_s(scene: Scene, direction: tuple[float, float, float]) -> Scene:
    course = Product((Straight(direction), Still(scene.rig.pose.transform)))
    return replace(scene, rig=scene.rig.following(course))


def _share_of_meshes(scene: Scene, fidelity: Fidelity) -> float:
    """Of the processor time of a frame, after one that compiles."""
    system = load_system("workable")
    capture(scene, system, seed=1, fidelity=fidelity)
    profile = cProfile.Profile(time.process_time)
    profile.runcall(capture, scene, system, seed=1, fidelity=fidelity)
    calls = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    (placing_s,) = (times[3] for (_, _, name), times in calls.items() if name == "mitsuba_scene")
    return float(placing_s / sum(times[2] for times in calls.values()))
