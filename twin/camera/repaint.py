"""One render for every reflectance: light split by object, put together for any paint.

Holds while light bounces once and one bucket collects it; textured objects keep their texture.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.air import Veil, glow, veil_of, where_air_scatters
from twin.camera.light import SUN_PARTS, Light, Rendered
from twin.camera.limits import grazing, unsampled
from twin.camera.mounting import check_rig, devices
from twin.camera.truth import Truth, depths, incidence_cosines, object_shares
from twin.fidelity import Fidelity
from twin.optics.by_object import ByObject, gather_by_object
from twin.optics.devices import Device, Grid
from twin.optics.paths import DeviceLight, SunLight
from twin.optics.weather import air_of_system
from twin.scene import Scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]


def can_repaint(system: System, fidelity: Fidelity) -> bool:
    """Whether one render serves every reflectance."""
    return fidelity.max_depth == 1 and system.n_detectors == 1 and not system.time_of_flight


@dataclass(frozen=True, eq=False)
class Unpainted:
    """Light of emitter and sun by object, per unit of reflectance; and what does not depend on it.

    ``shares``: mean over each cell of an object's presence (its texture, if it has one),
    (n_objects, rows, columns). ``cosines`` (rows, columns) of incidence in the middle of each cell;
    ``warnings``: what rays leave uncertain whatever the paint.
    """

    emitter_parts: ByObject
    sun_parts: ByObject
    shares: Array
    depth_m: Array
    emitter: Device
    detector: Device
    veil: Veil | None
    glow: Array
    cosines: Array
    warnings: tuple[CaptureWarning, ...]

    def painted(self, scene: Scene) -> Rendered:
        """As `render` gives it, with the reflectances of a scene of the same objects."""
        reflectance = np.array(
            [o.reflectance if isinstance(o.reflectance, float) else 1.0 for o in scene.objects]
        )
        light = self.emitter_parts.gathered(reflectance)
        sun = self.sun_parts.gathered(reflectance).total
        cells = light.total.reshape(1, -1)
        return Rendered(
            light=Light(
                cells + self.veil.light if self.veil else cells,
                light.standard_error.reshape(1, -1),
            ),
            sun=sun + self.glow,
            truth=Truth(np.tensordot(reflectance, self.shares, axes=1), self.depth_m),
            emitter=self.emitter,
            detector=self.detector,
            veil=self.veil,
            warnings=(
                *self.warnings,
                *grazing(light.total.reshape(self.cosines.shape), self.cosines),
            ),
        )


def render_unpainted(
    scene: Scene, system: System, *, fidelity: Fidelity, seed: np.random.SeedSequence
) -> Unpainted:
    """Render a scene for a system and every reflectance; draws what `render` draws.

    Raises ValueError where one render does not serve every reflectance.
    """
    if not can_repaint(system, fidelity):
        raise ValueError("fidelity: only direct light on one bucket can be repainted")
    check_rig(scene, system)
    emitter, detector, _ = devices(scene, system)
    world = mitsuba_scene(_white(scene))
    shape = system.picture_shape
    air = air_of_system(system)
    first, second = (int(child.generate_state(1)[0]) for child in seed.spawn(2))
    depth = depths(world, emitter, shape)
    quality = where_air_scatters(air, depth, fidelity.quality)
    nothing: Any = 0.0
    direction = scene.sun.direction
    parts = (SUN_PARTS, SUN_PARTS)
    return Unpainted(
        emitter_parts=gather_by_object(
            world,
            Grid(emitter, *shape),
            DeviceLight(detector, "pupil"),
            role="emitter",
            quality=quality,
            seed=first,
            air=air,
        ),
        sun_parts=gather_by_object(
            world,
            Grid(detector, *parts),
            SunLight(direction),
            role="pupil",
            quality=quality,
            seed=second,
            air=air,
        ),
        shares=object_shares(world, emitter, shape),
        depth_m=depth,
        emitter=emitter,
        detector=detector,
        veil=veil_of(system, air, emitter, detector, depth) if air else None,
        glow=glow(air, world, detector, parts, direction) if air else nothing,
        cosines=incidence_cosines(world, emitter, shape),
        warnings=tuple(unsampled(scene, emitter, shape[0] * shape[1] * fidelity.samples)),
    )


def _white(scene: Scene) -> Scene:
    """The scene with every plain object's reflectance 1."""
    painted = [
        replace(item, reflectance=1.0) if isinstance(item.reflectance, float) else item
        for item in scene.objects
    ]
    return replace(scene, objects=tuple(painted))
