"""What a frame that is rendered once leaves out where things move during it."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from twin.camera.chain import Chain
from twin.camera.exposures import Exposures
from twin.camera.model_error import side_by_side
from twin.camera.motion import WorldInMotion
from twin.camera.mounting import devices, field_points
from twin.camera.moving_frame import exposure_noise_w, lit_share
from twin.camera.rendered import RenderedLight
from twin.camera.swept import image_points
from twin.optics.devices import Device
from twin.scene import Scene
from twin.warned import CaptureWarning

Array = NDArray[np.float64]


def frozen_warnings(
    scene: Scene, chain: Chain, rendered: RenderedLight
) -> tuple[CaptureWarning, ...]:
    """Warning of motion during a frame that is taken as still, where it may change counts by more
    than their noise.

    A cell that something moving passes changes by the contrast of the cells as far around it as
    things move, or by the share of a cell that they move; such changes add up over the lit cells of
    an exposure as independent ones. Only to the end of trajectories that end before the frame.
    """
    if scene.at_rest and not scene.rig.moves:
        return ()
    duration = min(Exposures.of(chain.system).duration_s, scene.span_s[1])
    world = WorldInMotion(scene, duration)
    if duration <= 0 or world.is_at_rest:
        return ()
    emitter, detector, _ = devices(scene, chain.system)
    shape = chain.system.image_shape
    changed = world.changes(world.looks_s, emitter, detector, shape).any(axis=0).reshape(shape)
    passed = _cells_passed(world, emitter, rendered.truth.depth_m)
    power = chain.powers(rendered)
    image = side_by_side(power.cells_w.sum(axis=0), chain.system)
    size = 2 * min(math.ceil(passed), max(shape)) + 1
    contrast = maximum_filter(image, size) - minimum_filter(image, size)
    change = min(passed, 1.0) * contrast[changed]
    noise_w = exposure_noise_w(chain, rendered)
    over = math.sqrt(lit_share(chain)) * float(np.linalg.norm(change)) / noise_w
    if not over > 1:
        return ()
    text = (
        f"what moves passes up to {passed:.2g} cells during a frame, which is taken as still: "
        f"counts may be off by up to some {over:.2g} times their noise: fidelity.motion_tolerance"
    )
    return (CaptureWarning("model", text),)


def _cells_passed(world: WorldInMotion, emitter: Device, depth_m: Array) -> float:
    """The farthest that surfaces seen at the frame's start move in the image, in cells; of bodies
    that come into the field later, their middles.
    """
    shape = depth_m.shape
    left, up = field_points(shape, emitter.tan_half_field)
    along = np.stack([np.ones_like(left), left, up], axis=-1) @ emitter.axes
    deep = np.where(np.isfinite(depth_m), depth_m, 1.0)
    places = emitter.origin_m + deep[..., None] * along
    cells = max(shape) / (2 * emitter.tan_half_field)
    farthest = 0.0
    for moves, middle, covered in world.starts(emitter, shape):
        seen = places[covered & np.isfinite(depth_m)]
        points = np.concatenate([seen, middle[None]])
        went = np.einsum("nij,kj->nki", moves[:, :3, :3], points) + moves[:, None, :3, 3]
        image = np.array([image_points(each, emitter) for each in went])
        inside = (np.abs(image) <= emitter.tan_half_field).all(axis=-1)
        inside &= (went - emitter.origin_m) @ emitter.axes[0] > 0
        if not inside.any():
            continue
        first = np.argmax(inside, axis=0)
        off = np.linalg.norm(image - image[first, np.arange(len(points))], axis=-1)
        farthest = max(farthest, float(np.where(inside, off, 0.0).max()))
    return cells * farthest
