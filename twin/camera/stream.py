"""Frame after frame from a moving rig: the world is built once, only the sensors move.

Moving the rig costs nothing; moving geometry would rebuild the renderer's acceleration structure.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hardware.records import SpiRecord
from twin.camera.chain import Chain
from twin.camera.light import Rendered, render, render_light
from twin.camera.mounting import check_rig, devices
from twin.camera.truth import Truth, depths
from twin.fidelity import Fidelity
from twin.optics.paths import Quality
from twin.scene import Pose, Scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System

_FRAME = Fidelity(samples=16, max_depth=1)
_SUN = Quality(samples=1, max_depth=1)  # of 32 x 32 parts, which are summed


def frames(
    scene: Scene,
    system: System,
    poses: Iterable[Pose],
    *,
    fidelity: Fidelity = _FRAME,
    sun_quality: Quality = _SUN,
    seed: int = 0,
) -> Iterator[SpiRecord]:
    """Records of a rig that stands still at each pose for one frame.

    Parameters
    ----------
    scene, system
        What is looked at, and with what. Geometry is relative to the scene's own pose: poses should
        stay within a kilometre of it.
    poses
        In the world, one for each frame.
    fidelity
        By default 16 paths per cell, direct light: against the noise of a frame more is rarely
        visible.
    sun_quality
        Knobs of the path tracer for the sun, whose parts are summed.
    seed
        Frame i is drawn from (seed, i): the same whatever came before.
    """
    check_rig(scene, system)
    world, chain = mitsuba_scene(scene), Chain.of(system, scene.sun)
    mounted = devices(scene.at(Pose((0.0, 0.0, 0.0))), system)[:2]
    unknown = Truth(np.zeros(system.picture_shape), np.full(system.picture_shape, np.inf))
    for index, pose in enumerate(poses):
        *seeds, noise_seed = np.random.SeedSequence([seed, index]).spawn(3)
        rotation = pose.rotation.as_matrix()
        shift = np.asarray(pose.position_m) - scene.rig.position_m
        emitter, detector = (device.moved(rotation, shift) for device in mounted)
        truth = unknown  # a cell's angle to the detector is then that of its direction
        if system.weather:
            truth = replace(unknown, depth_m=depths(world, emitter, system.picture_shape))
        sun = scene.sun.direction
        rendered = render_light(
            world, system, emitter, detector, sun, truth, fidelity, sun_quality, seeds
        )
        rng = np.random.default_rng(noise_seed)
        _, counts, flags = chain.take(chain.powers(rendered), rng=rng, noise=fidelity.noise)
        yield chain.record(pose, counts, flags, index)


def stills(
    scene: Scene,
    system: System,
    *,
    seed: int = 0,
    fidelity: Fidelity | None = None,
    rendered: Rendered | None = None,
) -> Iterator[SpiRecord]:
    """Records of a rig that stands still, without end: light is rendered once, noise drawn anew.

    Parameters
    ----------
    scene, system, fidelity
        As `twin.camera.acquisition.capture` takes them.
    seed
        The first record is the one that `capture` makes of it.
    rendered
        `still_light` of the same scene and seed, when it is at hand already.
    """
    fidelity = fidelity or Fidelity()
    _, noise_seed = np.random.SeedSequence(seed).spawn(2)
    chain, rng = Chain.of(system, scene.sun), np.random.default_rng(noise_seed)
    power = chain.powers(rendered or still_light(scene, system, seed=seed, fidelity=fidelity))
    steady_w = chain.steady(power)
    for number in itertools.count():
        _, counts, flags = chain.take(power, rng=rng, noise=fidelity.noise, steady_w=steady_w)
        yield chain.record(scene.rig.pose, counts, flags, number)


def still_light(
    scene: Scene, system: System, *, seed: int = 0, fidelity: Fidelity | None = None
) -> Rendered:
    """Light of `stills`: that of every system with the same emitter, optics and detector."""
    light_seed, _ = np.random.SeedSequence(seed).spawn(2)
    return render(scene, system, fidelity=fidelity or Fidelity(), seed=light_seed)
