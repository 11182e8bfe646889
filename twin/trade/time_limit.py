"""The smallest tolerance whose frames a time allows on this machine."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from twin.camera import capture
from twin.errors import InputError
from twin.fidelity import Fidelity, RadarFidelity, Tolerance
from twin.radar import RadarDesign, load_radar, radar_capture
from twin.scene import Scene, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

#: Tolerances that are tried, each half of the one before.
_SHARES = tuple(2.0 / 2**step for step in range(10))
#: Of a frame's time from one tolerance to its half at least, before two have been measured.
_LEAST_GROWTH = 1.1


@dataclass(frozen=True)
class TimedShare:
    """What a sensor's frame takes at a tolerance, a share of the sensor's noise."""

    noise_share: float
    frame_s: float

    def __str__(self) -> str:
        return f"{self.noise_share:.3g} of the noise, {1e3 * self.frame_s:.3g} ms a frame"


@dataclass(frozen=True)
class TimedFidelity:
    """Knobs with what they were chosen by; None for a sensor that there is not."""

    fidelity: Fidelity
    camera: TimedShare | None
    radar: TimedShare | None

    def __str__(self) -> str:
        told = {"camera": self.camera, "radar": self.radar}
        return "; ".join(f"{name}: {share}" for name, share in told.items() if share)


def fidelity_within(
    scene: str | Path | Scene,
    frame_s: float,
    *,
    system: str | Path | System | None = "workable",
    radar: str | Path | RadarDesign | None = "hybrid-79",
    seed: int = 0,
) -> TimedFidelity:
    """The smallest tolerance at which a frame takes no longer than ``frame_s`` on this machine,
    for the camera and the radar each; from 2 of the sensor's noise down to 0.004.

    A frame is all from the scene to the counts, once kernels are compiled and the scene is loaded.
    It is measured, so what is chosen differs between machines and may differ between runs; results
    depend on what was chosen alone. Choosing takes about twice ``frame_s`` beside the first frame.

    Raises InputError where a frame takes longer at the largest tolerance already.
    """
    if not 0 < frame_s < float("inf"):
        raise InputError(f"within: {frame_s:g} s is not above 0")
    world = scene if isinstance(scene, Scene) else load_scene(scene)
    camera = echoes = None
    knobs = Tolerance().knobs()
    if system is not None:
        sensor, rendered = load_system(system), mitsuba_scene(world)

        def image(fidelity: Fidelity) -> object:
            return capture(world, sensor, seed=seed, fidelity=fidelity, mesh_scene=rendered)

        camera = finest("camera", image, frame_s, None)
        knobs = replace(knobs, light_tolerance=camera.noise_share)
    if radar is not None:
        design = load_radar(radar)

        def burst(fidelity: Fidelity) -> object:
            return radar_capture(world, design, seed=seed, fidelity=fidelity)

        echoes = finest("radar", burst, frame_s, design.total_bandwidth_hz)
        found = Tolerance(echoes.noise_share).knobs(design.total_bandwidth_hz)
        knobs = knobs.with_(found.part(RadarFidelity).said())
    return TimedFidelity(knobs, camera, echoes)


def finest(
    sensor: str, frame: Callable[[Fidelity], object], limit_s: float, bandwidth_hz: float | None
) -> TimedShare:
    """The last of the tolerances that stays within the limit, as far as the next ones are worth
    trying: a frame takes the longer, the smaller the tolerance.
    """

    def timed(share: float) -> TimedShare:
        start = time.perf_counter()
        frame(Tolerance(share).knobs(bandwidth_hz))
        return TimedShare(share, time.perf_counter() - start)

    timed(_SHARES[0])  # compiles
    best = timed(_SHARES[0])
    if best.frame_s > limit_s:
        raise InputError(
            f"within: {limit_s:g} s: a frame of the {sensor} takes {best.frame_s:.2g} s at the "
            f"largest tolerance, {best.noise_share:g} of the noise"
        )
    growth = _LEAST_GROWTH
    for share in _SHARES[1:]:
        if best.frame_s * growth > limit_s:
            break
        tried = timed(share)
        if tried.frame_s > limit_s:
            break
        growth = max(tried.frame_s / best.frame_s, _LEAST_GROWTH)
        best = tried
    return best
