"""Figures of physical optics in the scene: a whole frame, and errors against closed forms."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.timing import Figure, timed
from hardware.radar.process import process
from twin.fidelity import Fidelity
from twin.radar import RadarDesign, load_radar, radar_capture
from twin.radar.propagation.finding import trace
from twin.scene import Scene, load_scene

_OPTICS = Fidelity(radar="optics", nufft_tolerance=1e-5)
_EDGES = _OPTICS.with_(radar_edges=2_000_000)


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    scene = load_scene("street")
    yield "triangles of scenes/street", float(scene.triangles), ""
    for name in ("hybrid-79-slow", "hybrid-79"):
        yield from _frame(scene, load_radar(name))
    yield from _errors(scene, load_radar("hybrid-79"))


def _frame(scene: Scene, radar: RadarDesign) -> Iterator[Figure]:
    """Echoes to detections, warm; the same scene again, and with the car moved each time."""
    step = iter(range(1, 1000))

    def frame(now: Scene) -> int:
        return len(process(radar_capture(now, radar, fidelity=_OPTICS).record).detections)

    slots = f"{radar.ofdm.n_slots} slots"
    frame(scene), frame(_driven(scene, 0.001))  # warm
    yield f"street, {slots}: echoes", timed(lambda: trace(scene, radar, fidelity=_OPTICS)), ""
    edges = timed(lambda: trace(scene, radar, fidelity=_EDGES))
    yield f"street, {slots}: echoes and edges", edges, ""
    yield f"street, {slots}: whole frame", timed(lambda: frame(scene)), ""
    moving = timed(lambda: frame(_driven(scene, 0.01 * next(step))))
    yield f"street, {slots}: whole frame, car moved", moving, ""


def _driven(scene: Scene, seconds: float) -> Scene:
    """Everything as it stands a while later."""
    return replace(
        scene,
        objects=tuple(
            replace(o, vertices_m=o.vertices_m + seconds * np.array(o.velocity_m_per_s))
            if any(o.velocity_m_per_s)
            else o
            for o in scene.objects
        ),
    )


def _errors(scene: Scene, radar: RadarDesign) -> Iterator[Figure]:
    """What a frame finds, against the truth."""
    found = trace(scene, radar, fidelity=_OPTICS)
    yield "street: contributions", float(len(found.echoes.delay_s)), ""
    edges = trace(scene, radar, fidelity=_EDGES)
    yield "street: contributions with edges", float(len(edges.echoes.delay_s)), ""
    taken = radar_capture(scene, radar, fidelity=_OPTICS)
    ranges = np.array([d.range_m for d in process(taken.record).detections])
    for truth in taken.truth:
        off = ranges - truth.range_m
        nearest = float(off[np.abs(off).argmin()]) if len(off) else float("nan")
        yield f"street: {truth.name}, range of the nearest detection less truth", nearest, "m"
