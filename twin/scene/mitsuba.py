"""The scene's triangles as a Mitsuba scene at 1550 nm."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from twin.engine import mitsuba
from twin.scene.meshes import Mesh, divided
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
            (divided(Mesh(item.vertices_m - origin, item.faces, item.uv)), item.reflectance)
            for item in scene.objects
        ]
    )


def first_hits(meshes: Sequence[Mesh], origins: Array, rays: Array) -> Array:
    """Distance to the first surface along each ray, (n,); inf where there is none."""
    mi = mitsuba()
    start, along = (mi.Point3f(origins.T), mi.Vector3f(rays.T))
    # As one: a shape of its own for each of thousands takes seconds.
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    whole = Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + n for mesh, n in zip(meshes, first, strict=False)]),
    )
    hit = _assemble([(whole, 0.0)]).ray_intersect(mi.Ray3f(start, along))
    return np.where(np.array(hit.is_valid()), np.array(hit.t, np.float64), np.inf)


def _assemble(parts: Sequence[tuple[Mesh, Reflectance]]) -> Any:
    shapes = {f"object_{i}": _shape(*part) for i, part in enumerate(parts)}
    mi = mitsuba()
    settings: dict[str, Any] = {"type": "scene"}
    if mi.variant().startswith("llvm"):
        # Else rays slip through where triangles join: a quarter of them at 89.99 deg.
        settings["embree_use_robust_intersections"] = True
    return mi.load_dict({**settings, **shapes})


def _shape(mesh: Mesh, reflectance: Reflectance) -> Any:
    mi = mitsuba()
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(
        {"type": "twosided", "sides": {"type": "diffuse", "reflectance": _texture(reflectance)}}
    )
    properties["face_normals"] = True
    shape = mi.Mesh(
        "mesh",
        vertex_count=len(mesh.vertices),
        face_count=len(mesh.faces),
        has_vertex_texcoords=mesh.uv is not None,
        props=properties,
    )
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    if mesh.uv is not None:
        parameters["vertex_texcoords"] = mesh.uv.astype(np.float32).ravel()
    parameters.update()
    return shape


def _texture(reflectance: Reflectance) -> dict[str, Any]:
    if isinstance(reflectance, Texture):
        # Raw, without hardware lookup: a GPU's bilinear weights have 8 bits.
        return {
            "type": "bitmap",
            "bitmap": mitsuba().Bitmap(reflectance.image[:, :, None]),
            "raw": True,
            "filter_type": reflectance.filter_type,
            "wrap_mode": reflectance.wrap_mode,
            "accel": False,
        }
    return {"type": "spectrum", "value": float(reflectance)}
