"""Light of one frame, still or in motion: what every capture, stream and sweep measures."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.accuracy import of_earlier_run
from twin.camera.chain import Chain
from twin.camera.light import render
from twin.camera.moving_frame import FrameLight, frame_light, world_in_motion
from twin.camera.rendered import RenderedLight
from twin.camera.sun_in_frame import sun_of_frame
from twin.detector import Detector
from twin.fidelity import Fidelity, LightFidelity
from twin.kept_results import KeptResults
from twin.progress import OpenStage, silently
from twin.scene import Pose, Scene
from twin.scene.materials import Optical
from twin.system import System

_NOWHERE = Pose((0.0, 0.0, 0.0))


@dataclass(frozen=True, eq=False)
class LitFrame:
    """Light of a frame, as `measure` takes it.

    ``scene`` and ``rendered``: of the frame's middle where things move in it, and ``motion`` is
    then the light of each exposure; of the scene as it is given where nothing moves, or is not to.
    The sun is that of the middle in any case, and stands still.
    """

    scene: Scene
    rendered: RenderedLight
    motion: FrameLight | None = None


def lit_frame(
    scene: Scene,
    system: System,
    *,
    fidelity: Fidelity,
    seed: np.random.SeedSequence,
    mesh_scene: Any = None,
    stage: OpenStage = silently,
    detector: Detector | None = None,
    kept: KeptResults | None = None,
) -> LitFrame:
    """Light of a frame that begins with a scene; arguments as `twin.camera.capture` takes them.

    Raises InputError for a trajectory that ends before the frame does.
    """
    scene = sun_of_frame(scene, system)
    world, seen = world_in_motion(scene, system, fidelity), scene
    if world is not None:
        seen, mesh_scene = replace(scene.after(world.duration_s / 2), sun=scene.sun), None

    def light() -> tuple[RenderedLight, FrameLight | None]:
        rendered = render(
            seen, system, fidelity=fidelity, seed=seed, mesh_scene=mesh_scene, stage=stage
        )
        if world is None:
            return rendered, None
        with stage("motion"):
            chain = Chain.of(system, scene.sun, detector)
            return rendered, frame_light(world, chain, rendered, fidelity, seed.spawn(2))

    if kept is None or detector is not None or _has_own_parts(system):
        return LitFrame(seen, *light())
    of_light = fidelity.part(LightFidelity)
    content = (*_without_echoes(scene), system, of_light, seed.entropy, seed.spawn_key)
    return LitFrame(seen, *kept.get("light", content, light, _of_earlier_run))


def _of_earlier_run(
    light: tuple[RenderedLight, FrameLight | None],
) -> tuple[RenderedLight, FrameLight | None]:
    rendered, frame = light
    rendered = replace(rendered, decisions=of_earlier_run(rendered.decisions))
    if frame is not None:
        (decision,) = of_earlier_run([frame.decision])
        frame = replace(frame, decision=decision)
    return rendered, frame


def _without_echoes(scene: Scene) -> tuple[Scene, dict[str, Optical]]:
    """The scene and its materials without what the radar alone sees: a change of that leaves light
    as it is.
    """
    seen = replace(
        scene,
        objects=tuple(replace(item, radar=None, thickness_m=None) for item in scene.objects),
        rig=replace(scene.rig, radar=_NOWHERE),
        targets=(),
        track=None,
        materials={},
    )
    return seen, {name: row.optical for name, row in scene.materials.items()}


def _has_own_parts(system: System) -> bool:
    """Whether light may depend on anything: code of a user's own is among the system's parts."""
    return any(name.endswith(".function") for name, _ in system.values())
