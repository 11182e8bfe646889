"""Small scenes in which things move before the camera, and the light of all exposures to them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.designs import changed
from twin.camera.chain import Chain
from twin.camera.exposure_noise import exposure_noise_w
from twin.camera.light import render, render_light
from twin.camera.mounting import light_problem
from twin.camera.moving_frame import FrameLight, frame_light, world_in_motion
from twin.camera.truth import Truth, depths
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.scene import Pose, Rig, Scene, SceneObject, Sun
from twin.system import System

Array = NDArray[np.float64]

FINE = Fidelity(light_tolerance=0.05, motion_tolerance=0.05)
EXACT = Fidelity(128**2, 8, indirect_samples=32**2)
SIDE = 16
SUN = Sun(200.0, 30.0, 1e3)


def small(**values: object) -> System:
    """``workable`` of 16 x 16 cells, or with other values too."""
    return changed(
        **{
            "emitter__rows": {"value": SIDE, "assumed": "test"},
            "emitter__columns": {"value": SIDE, "assumed": "test"},
            "acquisition__n_patterns": {"value": SIDE**2, "assumed": "test"},
            **values,
        }
    )


def plate(name: str, y: tuple[float, float], z: tuple[float, float], x: float = 5.0) -> SceneObject:
    """An upright plate that faces the rig."""
    corners = np.array([[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]])
    return SceneObject(
        name, Geometry(corners, np.array([[0, 2, 1], [0, 3, 2]], np.int32)), "m", 0.5
    )


def world(*objects: SceneObject, rig: Rig | None = None) -> Scene:
    """Emitter and detector at one place."""
    here = Pose((0.0, 0.0, 0.0))
    mounted = rig or Rig(here, here, replace(here))
    return Scene("test", Path("test"), "", objects, mounted, SUN)


def going(item: SceneObject, *velocity: float) -> SceneObject:
    return replace(item, velocity_m_per_s=velocity)


def exposed(scene: Scene, system: System, fidelity: Fidelity = FINE) -> tuple[FrameLight, float]:
    """Light of all exposures, and the noise of one, W."""
    moving = world_in_motion(scene, system, fidelity)
    assert moving is not None
    chain, seed = Chain.of(system, scene.sun), np.random.SeedSequence(3)
    middle = scene.after(moving.duration_s / 2)
    rendered = render(middle, system, fidelity=fidelity, seed=seed)
    return (
        frame_light(moving, chain, rendered, fidelity, seed.spawn(2)),
        exposure_noise_w(chain, rendered),
    )


def passed(system: System, chain: Chain) -> Array:
    """Share of the line that passes from each cell, (n_cells,): in the corners less."""
    rows, columns = system.image_shape
    half = np.tan(np.radians(system.emitter.field_of_view_deg.value / 2))
    up, left = (half * (2 * np.arange(0.5, 32 * n) / (32 * n) - 1) for n in (rows, columns))
    shares = chain.sky.emitter_at(np.degrees(np.arctan(np.hypot(up[:, None], left))))
    return np.asarray(shares.reshape(rows, 32, columns, 32).mean(axis=(1, 3)).ravel())


def anew(
    scene: Scene,
    system: System,
    times: Array,
    fidelity: Fidelity = EXACT,
) -> list[Array]:
    """Powers of the cells and of the sun at these times: all rendered anew, from a stock scene."""
    chain, found = Chain.of(system, scene.sun), []
    for seconds in times:
        problem = light_problem(scene.after(float(seconds)), system)
        depth = depths(problem.scene, problem.emitter, system.image_shape)
        truth = Truth(np.zeros_like(depth), depth)
        seeds = np.random.SeedSequence([7, int(1e6 * seconds)]).spawn(2)
        found.append(chain.powers(render_light(problem, chain, truth, fidelity, seeds)))
    return found
