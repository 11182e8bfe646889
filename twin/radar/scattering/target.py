"""The mesh under the radar: triangles in float64, what they are made of, how they meet rays."""

from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.errors import InputError
from twin.radar.scattering.surface import PEC, Surface
from twin.scene.meshes import Mesh, validate

Array = NDArray[np.float64]

_LARGEST_M = 1e5  # as for scenes: beyond it float32 rays miss what they should hit


@dataclass(frozen=True, eq=False)
class Target:
    """Vertices (n, 3) in metres, faces (m, 3), surfaces, and which of them each face has, (m,).

    Faces count from both sides; which way they wind does not matter. Phases and cross-sections
    refer to the origin of the vertices' frame.

    Raises InputError on a mesh that no renderer may see, or larger than 100 km.
    """

    vertices_m: Array
    faces: NDArray[np.integer]
    surfaces: tuple[Surface, ...] = (PEC,)
    surface_of_face: NDArray[np.integer] | None = None

    def __post_init__(self) -> None:
        kept = validate(Mesh(self.vertices_m, self.faces), "target")
        if len(kept.faces) != len(self.faces):
            raise InputError(f"target: {len(self.faces) - len(kept.faces)} faces have no area")
        reach = float(np.abs(self.vertices_m).max())
        if reach > _LARGEST_M:
            raise InputError(f"target: reaches to {reach:.3g} m, expected at most {_LARGEST_M:g} m")

    @classmethod
    def from_mesh(cls, mesh: Mesh, surface: Surface = PEC, place: str = "target") -> "Target":
        """One material all over; zero-area faces are left out.

        Raises InputError, beginning with ``place``, where the mesh can't be used.
        """
        kept = validate(mesh, place)
        return cls(kept.vertices, kept.faces, (surface,))

    @cached_property
    def corners_m(self) -> Array:
        """Corners of every face, (m, 3, 3)."""
        corners: Array = self.vertices_m[self.faces]
        return corners

    @cached_property
    def normals(self) -> Array:
        """Unit normals of the faces, (m, 3); their sign says nothing."""
        a, b, c = (self.corners_m[:, i] for i in range(3))
        # Scaled first: the squares of tiny edges would underflow.
        size = np.abs(self.corners_m - a[:, None]).max(axis=(1, 2))[:, None]
        across = np.cross((b - a) / size, (c - a) / size)
        normals: Array = across / np.linalg.norm(across, axis=1, keepdims=True)
        return normals

    @cached_property
    def areas_m2(self) -> Array:
        """Of the faces, (m,)."""
        a, b, c = (self.corners_m[:, i] for i in range(3))
        areas: Array = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        return areas

    @cached_property
    def used_m(self) -> Array:
        """Vertices that a face refers to, (n, 3)."""
        is_used = np.zeros(len(self.vertices_m), dtype=bool)
        is_used[self.faces] = True
        used: Array = self.vertices_m[is_used]
        return used

    @cached_property
    def sphere(self) -> tuple[Array, float]:
        """A sphere around the faces: centre (3,) and radius."""
        center = (self.used_m.min(axis=0) + self.used_m.max(axis=0)) / 2
        return center, float(np.linalg.norm(self.used_m - center, axis=1).max())

    @cached_property
    def engine(self) -> "Traced":
        """What rays need, on the device."""
        return Traced(self)


class Traced:
    """The mesh around its own centre as a Mitsuba scene in float32, its planes in float64."""

    def __init__(self, target: Target) -> None:
        mi = mitsuba()
        center, self.radius_m = target.sphere
        # Rays are traced relative to the centre: float32 keeps what the mesh is, not where it is.
        vertices = target.vertices_m - center
        shape = mi.Mesh("target", vertex_count=len(vertices), face_count=len(target.faces))
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
        parameters["faces"] = target.faces.astype(np.uint32).ravel()
        parameters.update()
        self.scene = mi.load_dict({"type": "scene", "target": shape})
        self.center_m = center
        # A point of the plane and its normal, six numbers per face.
        planes = np.hstack([vertices[target.faces[:, 0]], target.normals])
        self.planes = mi.Float64(np.ascontiguousarray(planes).ravel())
        indices = target.surface_of_face
        if indices is None:
            indices = np.zeros(len(target.faces), dtype=np.uint32)
        self.surface_of_face = mi.UInt32(np.asarray(indices, dtype=np.uint32))
        dr.eval(self.planes, self.surface_of_face)
