"""Light of a frame in which things move: every exposure sees the world at its own time."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.camera.chain import Chain
from twin.camera.exposures import Exposures
from twin.camera.frozen import count_change
from twin.camera.light_at_instants import LightAtInstants
from twin.camera.light_by_cell import light_by_cell
from twin.camera.light_by_render import light_by_render
from twin.camera.motion import WorldInMotion
from twin.camera.mounting import light_problem
from twin.camera.rendered import RenderedLight
from twin.camera.scanned_frame import TIMES, scanned_light
from twin.fidelity import Fidelity
from twin.scene import Pose, Scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: What the sun's light is off by from instant to instant, over what its paths err by: those of
#: neighbouring instants are alike (in the yard; few instants tell it badly).
_OF_PATHS = 0.25
#: Error of paths over what is permitted above which a warning is given; it is an estimate.
_FEW_PATHS = 1.5


@dataclass(frozen=True, eq=False)
class FrameLight:
    """Mean powers on the detectors in every exposure of a frame, W, (n_exposures, n_shutters,
    n_detectors): of the patterns, and of the sun while a shutter is open; None where motion changes
    counts by less than the tolerance, so that the light of the middle is that of all exposures.
    ``decision``: at how many instants light was rendered, and what interpolation may be off by.
    ``pose``: the rig's at the start. ``sun_scatter``: what the sun's light is off by from instant
    to instant, between exposures that are compared, over their noise. ``paths_error_w``: what paths
    of each cell's light err by at the worst instant, (n_detectors, n_cells); None: not told.
    """

    signal_w: Array | None
    sun_w: Array | None
    pose: Pose
    decision: Decision
    warnings: tuple[CaptureWarning, ...] = ()
    sun_scatter: float = 0.0
    paths_error_w: Array | None = None


def world_in_motion(scene: Scene, system: System, fidelity: Fidelity) -> WorldInMotion | None:
    """The world during a frame that begins with a scene; None where nothing moves in it, or is to.

    Raises InputError for a trajectory that ends before the frame does.
    """
    if fidelity.motion_tolerance is None or (scene.at_rest and not scene.rig.moves):
        return None
    world = WorldInMotion(scene, Exposures.of(system).duration_s)
    return None if world.is_at_rest else world


def frame_light(
    world: WorldInMotion,
    chain: Chain,
    rendered: RenderedLight,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
) -> FrameLight:
    """Light of all exposures of a frame.

    ``rendered``: light in the middle of the frame. To its noise the tolerances refer, and of it are
    the angles at which light meets the filter.
    """
    start, scene, system = time.perf_counter(), world.scene, chain.system
    tolerance, change = fidelity.motion_tolerance or 0.0, count_change(world, chain, rendered)

    def decided(effect: str, off: float, *, taken: bool) -> Decision:
        cost_s = time.perf_counter() - start if taken else math.nan
        unit = "of an exposure's noise"
        return Decision("camera", effect, off, tolerance, unit, taken, cost_s)

    whole = change.within(world.duration_s)
    if whole <= tolerance:
        decision = decided("motion within a frame", whole, taken=False)
        return FrameLight(None, None, scene.rig.pose, decision)
    problem = light_problem(scene, system, world)
    exposures = Exposures.of(system)
    if system.optics.is_scanned and problem.air is None:
        signal_w, sun_w = scanned_light(world, chain, problem, fidelity, seeds)
        # Of a mean of as many times, where light has a kink between two of them.
        off = change.within(exposures.integration_s) / (8 * TIMES**2)
        effect = f"motion within a frame, each cell at {TIMES} times of its own"
        decision = decided(effect, off, taken=True)
        return FrameLight(signal_w, sun_w, scene.rig.pose, decision)
    one_bucket = system.n_detectors == 1 and not system.time_of_flight
    if one_bucket and problem.air is None:
        light = light_by_cell(world, chain, problem, rendered, fidelity, seeds, change)
    else:
        light = light_by_render(world, chain, fidelity, seeds, change)
    signal_w, sun_w = light.exposed(chain, exposures)
    effect = f"motion within a frame, {light.n_instants} instants"
    if light.path_error and not fidelity.has_light_tolerance:
        # Over what is permitted to the emitter's light, half of all.
        error = light.path_error * tolerance / math.sqrt(2)
        effect += f"; besides, {fidelity.samples} paths of a cell err by up to {error:.2g}"
    decision = decided(effect, light.motion_error * tolerance, taken=True)
    # Of exposures that are compared.
    compared = 1.0
    if system.acquisition.mode.value == "differential":
        # An exposure and the next, between two instants of the sun's light.
        interval_s = world.duration_s / max(len(light.sun_times_s) - 1, 1)
        compared = min(system.acquisition.pattern_period_s.value / interval_s, 1.0)
    seen, by_paths = compared * light.sun_scatter_w, 0.0
    if np.ptp(light.sun_w) > 0:
        by_paths = compared * _OF_PATHS * float(chain.powers(rendered).sun_error_w.max())
    warnings = _warnings(light, seen / change.noise_w, tolerance, fidelity)
    scatter = math.hypot(seen, by_paths) / change.noise_w
    return FrameLight(
        signal_w, sun_w, scene.rig.pose, decision, warnings, scatter, light.paths_error_w
    )


def _warnings(
    light: LightAtInstants, sun_scatter: float, tolerance: float, fidelity: Fidelity
) -> tuple[CaptureWarning, ...]:
    """``sun_scatter``: of the sun's light between exposures that are compared, over their noise."""
    found = []
    if sun_scatter > tolerance:
        text = (
            f"the sun's light scatters by {sun_scatter:.2g} of an exposure's noise between "
            f"instants, {tolerance:g} permitted: by what moves in the sun, or what paths err by; a "
            "differential mode takes it out"
        )
        found.append(CaptureWarning("tolerance", text))
    if fidelity.has_light_tolerance and light.path_error > _FEW_PATHS:
        text = (
            f"paths of light of some instants err by {light.path_error:.2g} times what is "
            "permitted: fidelity.light_tolerance; or raise fidelity.light_rays"
        )
        found.append(CaptureWarning("tolerance", text))
    if light.motion_error <= 1:
        return tuple(found)
    return (
        *found,
        CaptureWarning(
            "tolerance",
            f"light between instants is off by up to {light.motion_error * tolerance:.2g} of an "
            f"exposure's noise, {tolerance:g} permitted: what moves is too fast for as many "
            "instants as are rendered: fidelity.motion_tolerance",
        ),
    )
