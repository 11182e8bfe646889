"""Series of frames from a moving or resting rig in a scene that is built once.

Moving the rig costs nothing; moving geometry would rebuild the renderer's acceleration structure.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hardware.records import SpiRecord
from twin.camera.acquisition import capture, measure
from twin.camera.chain import Chain
from twin.camera.light import render_light
from twin.camera.lit_frame import LitFrame, lit_frame
from twin.camera.mounting import check_rig, light_problem
from twin.camera.still_world import StillWorld
from twin.camera.truth import Truth, depths
from twin.fidelity import Accuracy, Fidelity, knobs_of
from twin.optics.paths import TracingQuality
from twin.scene import Pose, Scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System

_FRAME = Fidelity(samples=16, max_depth=1)
_SUN = TracingQuality(samples=1, max_depth=1)  # of 32 x 32 parts, which are summed


def frames(
    scene: Scene,
    system: System,
    poses: Iterable[Pose],
    *,
    fidelity: Fidelity = _FRAME,
    sun_quality: TracingQuality = _SUN,
    seed: int = 0,
) -> Iterator[SpiRecord]:
    """Records of a rig that stands still at each pose for one frame.

    Parameters
    ----------
    scene, system
        Scene and design of the camera. Coordinates are relative to the scene's own pose: poses
        should stay within a kilometre of it.
    poses
        In the world, one for each frame.
    fidelity
        By default 16 paths per cell, direct light: the noise of a frame usually hides the error.
    sun_quality
        Settings of the path tracer for the sun, whose parts are summed.
    seed
        Frame i is drawn from (seed, i), independent of the preceding frames.
    """
    check_rig(scene, system)
    chain, unturned = Chain.of(system, scene.sun), scene.at(Pose((0.0, 0.0, 0.0)))
    mounted = light_problem(unturned, system, mitsuba_scene(scene))
    unknown = Truth(np.zeros(system.image_shape), np.full(system.image_shape, np.inf))
    for index, pose in enumerate(poses):
        *seeds, noise_seed = np.random.SeedSequence([seed, index]).spawn(3)
        shift = np.asarray(pose.position_m) - scene.rig.position_m
        problem = mounted.moved(pose.rotation.as_matrix(), shift)
        truth = unknown  # infinite depth: the angle to the detector is that of the cell's direction
        if system.weather:
            depth = depths(problem.scene, problem.emitter, system.image_shape)
            truth = replace(unknown, depth_m=depth)
        rendered = render_light(problem, chain, truth, fidelity, seeds, sun_quality=sun_quality)
        rng = np.random.default_rng(noise_seed)
        _, counts, flags = chain.measure_frame(
            chain.powers(rendered), rng=rng, noise=fidelity.noise
        )
        yield chain.record(pose, counts, flags, index)


def stills(
    scene: Scene,
    system: System,
    *,
    seed: int = 0,
    fidelity: Accuracy | None = None,
    lit: LitFrame | None = None,
) -> Iterator[SpiRecord]:
    """Endless records of one frame: light is rendered once, noise is drawn for each record. Where
    things move each is of the same time; `MovingFrames` are those that follow each other.

    Parameters
    ----------
    scene, system, fidelity
        As `twin.camera.acquisition.capture` takes them.
    seed
        The first record is that of `capture` with the same seed.
    lit
        `still_light` of the same scene and seed, if already computed.
    """
    knobs = knobs_of(fidelity)
    _, noise_seed = np.random.SeedSequence(seed).spawn(2)
    chain, rng = Chain.of(system, scene.sun), np.random.default_rng(noise_seed)
    lit = lit or still_light(scene, system, seed=seed, fidelity=knobs)
    power, motion = chain.powers(lit.rendered), lit.motion
    mean_w, sun_w = (motion.signal_w, motion.sun_w) if motion else (None, None)
    mean_w = chain.mean_signal(power) if mean_w is None else mean_w
    for number in itertools.count():
        _, counts, flags = chain.measure_frame(
            power, rng=rng, noise=knobs.noise, mean_w=mean_w, sun_w=sun_w
        )
        yield chain.record(scene.rig.pose, counts, flags, number)


def still_light(
    scene: Scene, system: System, *, seed: int = 0, fidelity: Accuracy | None = None
) -> LitFrame:
    """Light of `stills`: that of every system with the same emitter, optics and detector."""
    light_seed, _ = np.random.SeedSequence(seed).spawn(2)
    return lit_frame(scene, system, fidelity=knobs_of(fidelity), seed=light_seed)


def moves(scene: Scene) -> bool:
    """Whether anything in a scene does, its rig or an object; the sun does not count."""
    return scene.rig.moves or not scene.at_rest


@dataclass(frozen=True, eq=False)
class MovingFrames:
    """Frame k of a camera in a world that moves, k frames after the scene's own instant.

    Frame k is drawn from ``seed`` + k and depends on nothing else, but that all frames have the
    same paths of light where nothing moves but the sun; frame 0 is that of `capture`.
    Raises InputError as `capture`, and where a trajectory ends before the frame does.
    """

    scene: Scene
    system: System
    seed: int = 0
    fidelity: Accuracy | None = None

    def __call__(self, number: int) -> SpiRecord:
        """The record of one frame, in any order."""
        at_s, seed = number * self.system.frame_time_s, self.seed + number
        if moves(self.scene):
            world = self.scene.after(at_s)
            taken = capture(world, self.system, seed=seed, fidelity=self.fidelity)
        else:
            world, light = self._still.at(at_s)
            rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[1])
            taken = measure(world, self.system, light, rng=rng, noise=self._knobs.noise)
        return numbered(taken.record, self.system, number)

    @property
    def _knobs(self) -> Fidelity:
        return knobs_of(self.fidelity)

    @cached_property
    def _still(self) -> StillWorld:
        """With the paths of frame 0 in all frames."""
        light_seed, _ = np.random.SeedSequence(self.seed).spawn(2)
        return StillWorld(self.scene, self.system, self._knobs, light_seed)


def numbered(record: SpiRecord, system: System, number: int, start_ns: int = 0) -> SpiRecord:
    """A record of a single frame as number ``number`` of a series without pauses that began at
    ``start_ns`` of the device's clock.
    """
    n = len(record.counts)
    begin_ns = start_ns + round(number * 1e9 * system.frame_time_s)
    return replace(
        record,
        device_time_ns=record.device_time_ns + begin_ns,
        sequence=((number * n + np.arange(n)) % 2**32).astype(np.uint32),
    )
