"""The scene's triangles as a Mitsuba scene at 1550 nm."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.geometry import Geometry, divided, mitsuba_mesh, scene_of_shapes
from twin.scene.model import Array, Scene
from twin.scene.texture import Reflectance, Texture


def mitsuba_scene(scene: Scene) -> Any:
    """Lambertian, two-sided surfaces, facets flat, coordinates relative to the rig.

    Positions are moved to the rig in float64 before they become float32, so that a scene in map
    coordinates keeps its geometry.
    """
    origin = scene.rig.position_m
    return _assemble(
        [
            (*divided(o.vertices_m - origin, o.geometry.faces, o.geometry.uv), o.reflectance)
            for o in scene.objects
        ]
    )


def first_hits(meshes: Sequence[Geometry], origins: Array, rays: Array) -> Array:
    """Distance to the first surface along each ray, (n,); inf where there is none."""
    mi = mitsuba()
    start, along = (mi.Point3f(origins.T), mi.Vector3f(rays.T))
    # As one: a shape of its own for each of thousands takes seconds.
    whole = Geometry.concatenate(meshes)
    scene = _assemble([(whole.vertices_m, whole.faces, None, 0.0)])
    hit = scene.ray_intersect(mi.Ray3f(start, along))
    return np.where(np.array(hit.is_valid()), np.array(hit.t, np.float64), np.inf)


def _assemble(parts: Sequence[tuple[Array, NDArray[np.int32], Array | None, Reflectance]]) -> Any:
    """Of vertices, faces, texture coordinates and reflectance of each shape."""
    shapes = {f"object_{i}": _shape(*part) for i, part in enumerate(parts)}
    return scene_of_shapes(mitsuba(), shapes)


def _shape(
    vertices_m: Array, faces: NDArray[np.int32], uv: Array | None, reflectance: Reflectance
) -> Any:
    mi = mitsuba()
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(
        {"type": "twosided", "sides": {"type": "diffuse", "reflectance": _texture(reflectance)}}
    )
    properties["face_normals"] = True
    return mitsuba_mesh(mi, vertices_m, faces, uv, properties=properties)


def _texture(reflectance: Reflectance) -> dict[str, Any]:
    if isinstance(reflectance, Texture):
        # Raw, without hardware lookup: a GPU's bilinear weights have 8 bits.
        return {
            "type": "bitmap",
            # Mitsuba takes no array that is read-only.
            "bitmap": mitsuba().Bitmap(reflectance.image[:, :, None].copy()),
            "raw": True,
            "filter_type": reflectance.filter_type,
            "wrap_mode": reflectance.wrap_mode,
            "accel": False,
        }
    return {"type": "spectrum", "value": float(reflectance)}
