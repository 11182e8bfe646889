"""The mesh under the radar: triangles in float64, what they are made of, how they meet rays."""

from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba_of_radar
from twin.errors import InputError
from twin.geometry import Geometry, mitsuba_mesh, scene_of_shapes
from twin.radar.scattering.surface import PEC, LayeredSurface

Array = NDArray[np.float64]

_LARGEST_M = 1e5  # as for scenes: beyond it float32 rays miss what they should hit


@dataclass(frozen=True, eq=False)
class MeshTarget:
    """A geometry, surfaces, and which of them each face has, (m,).

    Faces count from both sides; which way they wind does not matter. Phases and cross-sections
    refer to the origin of the geometry's frame.

    Raises InputError on a mesh with faces that have no area, or larger than 100 km.
    """

    geometry: Geometry
    surfaces: tuple[LayeredSurface, ...] = (PEC,)
    surface_of_face: NDArray[np.integer] | None = None

    def __post_init__(self) -> None:
        solid = len(self.geometry.without_empty_faces("target").faces)
        if empty := len(self.geometry.faces) - solid:
            raise InputError(f"target: {empty} faces have no area")
        reach = float(np.abs(self.geometry.vertices_m).max())
        if reach > _LARGEST_M:
            raise InputError(f"target: reaches to {reach:.3g} m, expected at most {_LARGEST_M:g} m")

    @cached_property
    def engine(self) -> "TargetScene":
        """What rays need, on the device."""
        return TargetScene(self)


class TargetScene:
    """The mesh around its own centre as a Mitsuba scene in float32, its planes in float64."""

    def __init__(self, target: MeshTarget) -> None:
        mi = mitsuba_of_radar()
        geometry = target.geometry
        center, self.radius_m = geometry.sphere
        # Rays are traced relative to the centre: float32 keeps what the mesh is, not where it is.
        vertices = geometry.vertices_m - center
        shape = mitsuba_mesh(mi, vertices, geometry.faces, name="target")
        self.scene = scene_of_shapes(mi, {"target": shape})
        self.center_m = center
        # A point of the plane and its normal, six numbers per face.
        planes = np.hstack([vertices[geometry.faces[:, 0]], geometry.normals])
        self.planes = mi.Float64(np.ascontiguousarray(planes).ravel())
        indices = target.surface_of_face
        if indices is None:
            indices = np.zeros(len(geometry.faces), dtype=np.uint32)
        self.surface_of_face = mi.UInt32(np.asarray(indices, dtype=np.uint32))
        dr.eval(self.planes, self.surface_of_face)
