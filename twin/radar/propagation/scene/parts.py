"""What stands in one mesh with a large surface: an object of its own to the radar.

An object has one role. Without this, whatever a modelling program joined with the ground, a box or
a pole, would be silent: a large surface mirrors by its large flat patches alone.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from twin.geometry import Geometry
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.scene.scattering_models import (
    LARGE_BESIDE_OPTICS,
    SMALLEST,
    ScatteringModel,
    role_by_size,
)
from twin.scene import Scene, SceneObject
from twin.scene.boxes import boxes_of, distances_m

_IN_PLANE_M = 1e-4
_MOST_PLANES = 64  # a mesh of more is no ground or wall with things on it


def parted(scene: Scene, radar: RadarDesign) -> Scene:
    """The scene with such parts as objects ``NAME (other parts)``, all of a large surface's
    together: what hangs together by common corners and has no large flat patch. The same scene
    where there are none. What the scene declares to be a surface is left whole.
    """
    wavelength_m = radar.ofdm.wavelength_m
    place_m = scene.rig.position_m + scene.rig.device("radar")[0]
    near_m = np.maximum(distances_m(boxes_of(scene.objects), place_m), wavelength_m)
    objects: list[SceneObject] = []
    for item, distance_m in zip(scene.objects, near_m.tolist(), strict=True):
        split = None
        if item.radar is None and _may_have_parts(item, distance_m, wavelength_m):
            x, y, z = item.pose.inv().apply(place_m).tolist()
            split = _apart(item.geometry, (x, y, z), wavelength_m)
        if split is None:
            objects.append(item)
        else:
            names = item.name, f"{item.name} (other parts)"
            objects += map(_part, (item, item), names, split)
    return replace(scene, objects=tuple(objects)) if len(objects) > len(near_m) else scene


def _may_have_parts(item: SceneObject, distance_m: float, wavelength_m: float) -> bool:
    """Whether it is a large surface that does not hang together."""
    role = role_by_size(item.geometry.shape, distance_m, wavelength_m)
    return role is ScatteringModel.SURFACE and bool(item.geometry.parts.any())


def _part(item: SceneObject, name: str, geometry: Geometry) -> SceneObject:
    part = replace(item, name=name, geometry=geometry)
    return part if item.motion is None else part.following(item.motion, item.parent)


@lru_cache(maxsize=32)
def _apart(
    geometry: Geometry, place_m: tuple[float, float, float], wavelength_m: float
) -> tuple[Geometry, Geometry] | None:
    """The parts of a mesh with a patch that is large at its distance from a place, and all others;
    None where there are no others that could scatter.
    """
    shape, part = geometry.shape, geometry.parts
    order, by_patch = (np.argsort(x, kind="stable") for x in (part, shape.patch_of_face))
    count = int(part.max()) + 1
    first = np.searchsorted(part[order], np.arange(count))
    points = geometry.corners_m[order]
    low, high = (
        end.reduceat(by_face, first)
        for end, by_face in ((np.minimum, points.min(axis=1)), (np.maximum, points.max(axis=1)))
    )
    near_m = distances_m(np.stack([low, high], axis=1), np.array(place_m))
    least_m2 = LARGE_BESIDE_OPTICS**2 * wavelength_m * np.maximum(near_m, wavelength_m)
    patch_m2 = np.maximum.reduceat(shape.patch_area_m2[shape.patch_of_face][order], first)
    is_large = patch_m2 >= least_m2
    planes = np.unique(shape.patch_of_face[is_large[part]])
    planes = planes[shape.patch_area_m2[planes] >= least_m2.min()]
    if len(planes) > _MOST_PLANES:
        return None
    # The bottom of what stands on the ground is in its plane; of a pavement's slabs all is.
    in_plane = np.zeros(count, dtype=bool)
    for face in np.searchsorted(shape.patch_of_face, planes, sorter=by_patch).tolist():
        normal, corner = geometry.normals[by_patch[face]], geometry.corners_m[by_patch[face], 0]
        off_m = np.abs((points - corner) @ normal).max(axis=1)
        in_plane |= np.maximum.reduceat(off_m, first) < _IN_PLANE_M
    is_other = ~(is_large | in_plane)[part]
    if is_other.all() or not is_other.any():
        return None
    surface, others = (
        Geometry(geometry.vertices_m, geometry.faces[which], geometry.uv)
        for which in (~is_other, is_other)
    )
    return (surface, others) if others.shape.size_m >= SMALLEST * wavelength_m else None
