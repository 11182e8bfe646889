"""Figures of the radar in the bundled scenes: times of a frame, and the errors of every body.

References are made as those of `twin trade`, once for each scene: a fine tolerance, more bounces
and images than any level follows, and a direct echo by brute force where a body is small enough
for that. They know neither edges nor ways round obstacles, so errors are measured without these;
times are those of whole levels.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count

import drjit as dr
import numpy as np

from benchmarks.timing import Figure, timed
from hardware.radar.process import process
from twin.fidelity import DEFAULT, PRESETS, Fidelity
from twin.radar import RadarDesign, load_radar, radar_capture
from twin.radar.acquisition import channel
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.solvers import trace
from twin.scene import Scene, load_scene
from twin.trade.bodies import Bodies, echoes_by_body, errors_of, reference_bodies

#: Two more bounces than are ever followed by bounds: on the yard's car all later ones add 0.1 %.
_FINEST = Fidelity(radar_tolerance=0.02, radar_bounces=8, radar_images=2)
_LEVELS = {"default": DEFAULT, **PRESETS}
_RUNS = {"default": 3, "standard": 3, "draft": 3, "reference": 1}
_STEP_M = 0.0137  # by which the car moves from frame to frame


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    radar = load_radar("hybrid-79")
    for name in ("yard", "street"):
        scene = load_scene(name)
        yield f"{name}: triangles", float(scene.triangles), ""
        finest = trace(scene, radar, fidelity=_FINEST)
        bodies = reference_bodies(scene, radar, _FINEST, finest, 0)
        del finest
        for preset, runs in _RUNS.items():
            fidelity = _LEVELS[preset]
            smooth = fidelity.with_(radar="optics", radar_edges=0, radar_shadowed=0)
            found = trace(scene, radar, fidelity=smooth)
            yield from _errors(f"{name}, {preset}", found, radar, bodies)
            del found
            yield from _times(f"{name}, {preset}", scene, radar, fidelity, runs)
        yield from _ranges(name, scene, radar)


def _times(
    what: str, scene: Scene, radar: RadarDesign, fidelity: Fidelity, runs: int
) -> Iterator[Figure]:
    """Warm, each from the scene on; the last with the car elsewhere in every frame."""
    wave, step = radar.ofdm, count(1)

    def frame(now: Scene) -> int:
        return len(process(radar_capture(now, radar, fidelity=fidelity).record).detections)

    def moved() -> int:
        return frame(_driven(scene, _STEP_M * next(step)))

    def synthesis() -> None:
        channel(
            trace(scene, radar, fidelity=fidelity), radar, Atmosphere(), fidelity.nufft_tolerance
        )

    moved()  # warm
    finding = timed(lambda: trace(scene, radar, fidelity=fidelity), runs, warm_up=0)
    yield f"{what}: echoes", finding, ""
    began_s = time.process_time()
    trace(scene, radar, fidelity=fidelity)
    yield f"{what}: echoes, CPU time", time.process_time() - began_s, "s"
    bins = f"{wave.n_subcarriers} x {wave.n_slots}"
    yield f"{what}: echoes and channel of {bins}", timed(synthesis, runs, warm_up=0), ""
    still = timed(lambda: frame(scene), runs, warm_up=0)
    yield f"{what}: whole frame", still, ""
    began_s = time.process_time()
    frame(scene)
    yield f"{what}: whole frame, CPU time", time.process_time() - began_s, "s"
    first = trace(scene, radar, fidelity=fidelity, keep=True)

    def kept() -> float:
        return trace(
            _driven(scene, _STEP_M * next(step)), radar, fidelity=fidelity, earlier=first
        ).reused_share

    kept()  # warm
    yield f"{what}: echoes, car moved, with what holds of one frame", timed(kept, runs, 0), ""
    yield f"{what}: contributions that hold then", 100 * kept(), "%"
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        driven = timed(moved, runs, warm_up=0)
        yield f"{what}: whole frame, car moved", driven, ""
        kernels = [entry for entry in dr.kernel_history() if "cache_hit" in entry]
    yield f"{what}: whole frame, car moved over still", driven.median_s / still.median_s, ""
    compiled = sum(not entry["cache_hit"] for entry in kernels)
    yield f"{what}: kernels that these compile anew", float(compiled), ""


def _driven(scene: Scene, forward_m: float) -> Scene:
    """With the car farther ahead."""
    return replace(
        scene,
        objects=tuple(
            o.moved([forward_m, 0.0, 0.0]) if o.name.startswith("car") else o for o in scene.objects
        ),
    )


def _errors(what: str, found: Propagation, radar: RadarDesign, bodies: Bodies) -> Iterator[Figure]:
    """Complex, rms over the band, of the echoes of surfaces: of their sum and of every body's."""
    yield f"{what}: contributions of surfaces", float(len(found.surfaces.delay_s)), ""
    echo = echoes_by_body(found, bodies.names, radar, bodies.frequencies_hz).sum(axis=0)
    whole = bodies.echo.sum(axis=0)
    off = float(np.linalg.norm(echo - whole) / np.linalg.norm(whole))
    yield f"{what}: error of all bodies' sum", 100 * off, "%"
    estimated = {body.name: body.estimated_error for body in found.bodies}
    aside = "" if all(b.is_bounded for b in found.bodies) else ", what fixed knobs leave out aside"
    for error in errors_of(bodies, found, radar, found.bodies[0].tolerance):
        yield (
            f"{what}: error of {error.body}, {error.level_db:.1f} dB",
            100 * error.error,
            f"% (estimated {100 * estimated.get(error.body, np.nan):.2g} %{aside}; "
            f"{error.reference})",
        )


def _ranges(name: str, scene: Scene, radar: RadarDesign) -> Iterator[Figure]:
    """What a frame by default detects, against the truth."""
    taken = radar_capture(scene, radar)
    ranges = np.array([d.range_m for d in process(taken.record).detections])
    for truth in taken.truth:
        off = ranges - truth.range_m
        nearest = float(off[np.abs(off).argmin()]) if len(off) else float("nan")
        yield f"{name}: {truth.name}, range of the nearest detection less truth", nearest, "m"
