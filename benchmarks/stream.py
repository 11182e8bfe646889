"""Frames of both sensors in a stream of the yard, up to the vehicle's image and detections; while
its car moves also as by default, when light is followed within each frame.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from typing import Any

from benchmarks.timing import Figure, Timing, processor_time, timed
from hardware import process, reconstruct
from twin.camera.stream import MovingFrames, frames, stills
from twin.fidelity import Fidelity
from twin.radar import load_radar
from twin.scene import Pose, Scene, load_scene
from twin.serve.sweeps import RadarSweeps
from twin.system import load_system

_CAMERAS = {
    "16 paths a cell, direct": Fidelity(samples=16, max_depth=1),
    "standard": Fidelity(),
    "tolerance 0.2": Fidelity(light_tolerance=0.2),
}


def figures() -> Iterator[Figure]:
    """64 x 64 cells of `workable`, 4096 differential patterns; `hybrid-79`; everything warm."""
    scene, system = load_scene("yard"), load_system("workable")
    resting = stills(scene, system)
    yield from _camera("rig at rest", lambda: reconstruct(next(resting)))
    for name, fidelity in _CAMERAS.items():
        moved = frames(scene, system, _moved(scene), fidelity=fidelity)
        yield from _camera(f"moving rig, {name}", lambda moved=moved: reconstruct(next(moved)))
    following, frame = MovingFrames(scene, system), count()

    def followed() -> Any:
        return reconstruct(following(next(frame)))

    yield from _camera("car moves within each frame, default", followed, runs=5)
    for name, world, reuse in (
        ("all at rest", _at_rest(scene), 1),
        ("car moves", scene, 1),
        ("the same, 100 bursts traced together", scene, 100),
    ):
        radar, number = RadarSweeps(world, load_radar("hybrid-79"), 0, reuse=reuse), count()

        def detections(radar: RadarSweeps = radar, number: Iterator[int] = number) -> Any:
            return process(radar.record(next(number)))

        def hybrid(detections: Callable[[], Any] = detections) -> None:
            reconstruct(next(resting))
            detections()

        yield f"radar, {name}: burst to detections", timed(detections, runs=5), ""
        yield f"both sensors, rig and light at rest, {name}: a frame", timed(hybrid, runs=5), ""
    bursts, burst = RadarSweeps(scene, load_radar("hybrid-79"), 0, reuse=1), count()

    def by_default() -> None:
        followed()
        process(bursts.record(next(burst)))

    yield "both sensors, car moves, by default: a frame", timed(by_default, runs=5), ""


def _camera(name: str, frame: Callable[[], Any], runs: int = 25) -> Iterator[Figure]:
    took: Timing = timed(frame, runs=runs, warm_up=3)
    yield f"camera, {name}: record to image", took, ""
    yield f"camera, {name}: frames per second", 1 / took.median_s, "1/s"
    processor_s, _ = processor_time(frame)
    yield f"camera, {name}: record to image, processor time", processor_s, "s"


def _moved(scene: Scene) -> Iterator[Pose]:
    """Poses a millimetre apart, to the left."""
    pose = scene.rig.pose
    x, y, z = pose.position_m
    return (replace(pose, position_m=(x, y + 1e-3 * number, z)) for number in count())


def _at_rest(scene: Scene) -> Scene:
    still = (0.0, 0.0, 0.0)
    return replace(
        scene,
        objects=tuple(replace(item, velocity_m_per_s=still) for item in scene.objects),
        targets=tuple(replace(target, velocity_m_per_s=still) for target in scene.targets),
    )
