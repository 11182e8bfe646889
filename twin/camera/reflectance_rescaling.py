"""One render for every reflectance: light by object, each part times the object's reflectance.

Valid for direct light on a single detector; textured objects keep their texture.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.camera.air import (
    CellBackscatter,
    airlight_of,
    backscatter_of,
    lost_airlight_of,
    where_air_scatters,
)
from twin.camera.equal_paths import SUN_PARTS, unseen_sun, with_missed
from twin.camera.left_out import (
    bounces_share,
    lie_in_a_plane,
    rounding_share,
    typical_reflectance,
)
from twin.camera.mounting import check_rig, light_problem, with_near_pupil
from twin.camera.render_warnings import (
    grazing_warnings,
    near_pupil_warnings,
    undersampling_warnings,
)
from twin.camera.rendered import DetectorLight, RenderedLight
from twin.camera.truth import Truth, depths, incidence_cosines, object_shares
from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.optics.by_object import LightByObject, gather_by_object
from twin.optics.devices import Device
from twin.scene import Scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]


def can_rescale(system: System, fidelity: Fidelity) -> bool:
    """Whether one render serves every reflectance."""
    return (
        fidelity.max_depth == 1
        and not fidelity.has_light_tolerance
        and system.n_detectors == 1
        and not system.time_of_flight
    )


@dataclass(frozen=True, eq=False)
class UnitReflectanceLight:
    """Light of emitter and sun by object, per unit of reflectance; and the parts independent of it.

    ``shares``: share of each cell that an object covers (times its texture, if it has one),
    (n_objects, rows, columns). ``cosines`` (rows, columns) of incidence in the middle of each cell;
    ``warnings``: uncertainties of the render that do not depend on reflectance; ``is_flat``:
    whether all lies in one plane, so that light bounces once; ``facet_light`` (1, n_cells): see
    `twin.optics.unseen.facet_light`.
    """

    emitter_parts: LightByObject
    sun_parts: LightByObject
    shares: Array
    depth_m: Array
    emitter: Device
    detector: Device
    backscatter: CellBackscatter | None
    airlight: Array | None
    lost_airlight: Array
    cosines: Array
    warnings: tuple[CaptureWarning, ...]
    is_flat: bool
    sun_unseen: float
    facet_light: Array

    def rescaled(self, scene: Scene) -> RenderedLight:
        """The result of `render` for the reflectances of a scene of the same objects."""
        reflectance = np.array(
            [o.reflectance if isinstance(o.reflectance, float) else 1.0 for o in scene.objects]
        )
        light = self.emitter_parts.with_reflectance(reflectance)
        sun = self.sun_parts.with_reflectance(reflectance)
        albedo = np.tensordot(reflectance, self.shares, axes=1)
        bounces = (
            0.0
            if self.is_flat
            else bounces_share(typical_reflectance(scene.objects, albedo), 1, None)
        )
        left_out = rounding_share(self.cosines).reshape(1, -1) + bounces
        cells, image = light.total.reshape(1, -1), light.total.reshape(self.cosines.shape)
        return RenderedLight(
            light=replace(
                with_missed(
                    DetectorLight(cells, light.standard_error.reshape(1, -1)),
                    reflectance.max(initial=0.0) * self.facet_light,
                    self.emitter_parts.samples,
                ),
                cells=cells + self.backscatter.light if self.backscatter else cells,
                left_out=np.multiply(left_out, cells, out=np.zeros_like(cells), where=cells > 0),
            ),
            sun=sun.total if self.airlight is None else sun.total + self.airlight,
            sun_error=sun.standard_error,
            sun_left_out=np.multiply(
                bounces, sun.total, out=np.zeros_like(sun.total), where=sun.total > 0
            )
            + self.lost_airlight
            if sun.total.any()
            else self.sun_unseen + self.lost_airlight,
            truth=Truth(albedo, self.depth_m),
            emitter=self.emitter,
            detector=self.detector,
            backscatter=self.backscatter,
            warnings=(
                *self.warnings,
                *grazing_warnings(image, self.cosines),
                *near_pupil_warnings(
                    image, self.cosines, self.depth_m, self.emitter, self.detector
                ),
            ),
        )


def render_unit_reflectance(
    scene: Scene, system: System, *, fidelity: Fidelity, seed: np.random.SeedSequence
) -> UnitReflectanceLight:
    """Render a scene for a system and every reflectance, with the random numbers of `render`.

    Raises InputError unless `can_rescale`.
    """
    if not can_rescale(system, fidelity):
        raise InputError("fidelity: only direct light on one bucket scales with the reflectances")
    check_rig(scene, system)
    problem = light_problem(_with_unit_reflectance(scene), system)
    mesh_scene, emitter, shape = problem.scene, problem.emitter, system.image_shape
    first, second = (int(child.generate_state(1)[0]) for child in seed.spawn(2))
    depth, sun_parts = depths(mesh_scene, emitter, shape), (SUN_PARTS, SUN_PARTS)
    problem = with_near_pupil(problem, system, depth)
    quality = where_air_scatters(problem.air, depth, fidelity.quality)
    return UnitReflectanceLight(
        emitter_parts=gather_by_object(problem.from_emitter(shape, quality, first)),
        sun_parts=gather_by_object(problem.from_sun(sun_parts, quality, second)),
        shares=object_shares(mesh_scene, emitter, shape),
        depth_m=depth,
        emitter=emitter,
        detector=problem.detector,
        backscatter=backscatter_of(system, problem) if problem.air else None,
        airlight=airlight_of(problem, sun_parts) if problem.air else None,
        lost_airlight=lost_airlight_of(problem, sun_parts),
        cosines=incidence_cosines(mesh_scene, emitter, shape),
        warnings=tuple(
            undersampling_warnings(scene, emitter, shape[0] * shape[1] * fidelity.samples)
        ),
        is_flat=lie_in_a_plane(item.vertices_m for item in scene.objects),
        sun_unseen=unseen_sun(problem, sun_parts, quality),
        facet_light=problem.facet_light(shape).reshape(1, -1),
    )


def _with_unit_reflectance(scene: Scene) -> Scene:
    """The scene with reflectance 1 on every object without a texture."""
    objects = [
        replace(item, reflectance=1.0) if isinstance(item.reflectance, float) else item
        for item in scene.objects
    ]
    return replace(scene, objects=tuple(objects))
