"""What stands in one mesh with a large surface: objects of their own to the radar.

An object has one role. Without this, whatever a modelling program joined with the ground, a box or
a pole, would be silent: a large surface mirrors by its large flat patches alone.
"""

from collections.abc import Collection, Set
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin.geometry import Geometry, connected
from twin.geometry.near_boxes import near_pairs
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.scene.scattering_models import (
    LARGE_BESIDE_OPTICS,
    SMALLEST,
    ScatteringModel,
    role_by_size,
)
from twin.scene import Scene, SceneObject
from twin.scene.boxes import boxes_of, distances_m

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_IN_PLANE_M = 1e-4
_MOST_OBJECTS = 256  # where there are more that do not touch, all are one


def parted(scene: Scene, radar: RadarDesign) -> Scene:
    """The scene with such parts as objects ``NAME (other parts)``, or ``NAME (other part 1)`` and
    so on where some do not touch: what hangs together by edges of two faces and has no large flat
    patch. The same scene where there are none. What the scene declares to be a surface, or to
    scatter, is left whole.
    """
    taken = {item.name for item in scene.objects}
    of_items = _pieces(scene, radar, (None, "table"))
    objects: list[SceneObject] = []
    for item in scene.objects:
        if (pieces := of_items.get(item.name)) is None:
            objects.append(item)
        else:
            names = [item.name, *_names(item.name, len(pieces) - 1, taken)]
            objects += map(_part, [item] * len(pieces), names, pieces)
    return replace(scene, objects=tuple(objects)) if len(objects) > len(taken) else scene


def silent_parts(scene: Scene, radar: RadarDesign) -> tuple[str, ...]:
    """Warnings of what stands in one mesh with a declared surface, and has no echo."""
    return tuple(
        f"{name}: declared to be a surface, so that {len(pieces) - 1} part(s) of its mesh that "
        "stand on it have no echo but that of flat sides of three Fresnel zones: without "
        f'radar = "surface" under [objects.{name}] they are objects of their own'
        for name, pieces in _pieces(scene, radar, ("surface",)).items()
    )


def _pieces(
    scene: Scene, radar: RadarDesign, declared: Collection[str | None]
) -> dict[str, tuple[Geometry, ...]]:
    """By names of objects that are ``declared`` so, of large surfaces alone, as of `_apart`."""
    wavelength_m = radar.ofdm.wavelength_m
    place_m = scene.rig.position_m + scene.rig.device("radar")[0]
    items = [item for item in scene.objects if item.radar in declared]
    if not items:
        return {}
    near_m = np.maximum(distances_m(boxes_of(items), place_m), wavelength_m)
    found = {}
    for item, distance_m in zip(items, near_m.tolist(), strict=True):
        if _may_have_parts(item.geometry, distance_m, wavelength_m):
            x, y, z = item.pose.inv().apply(place_m).tolist()
            pieces = _apart(item.geometry, (x, y, z), wavelength_m)
            if pieces is not None:
                found[item.name] = pieces
    return found


def _may_have_parts(geometry: Geometry, distance_m: float, wavelength_m: float) -> bool:
    """Whether it is a large surface with small sides that does not hang together."""
    shape = geometry.shape
    if role_by_size(shape, distance_m, wavelength_m) is not ScatteringModel.SURFACE:
        return False
    farthest_m = distance_m + 2 * geometry.sphere[1]
    has_small = shape.patch_area_m2.min() < LARGE_BESIDE_OPTICS**2 * wavelength_m * farthest_m
    return bool(has_small and geometry.parts.any())


def _names(name: str, parts: int, taken: Set[str]) -> list[str]:
    """Of parts of an object, unlike those of the scene's objects."""
    names = [f"{name} (other part {n})" for n in range(1, parts + 1)]
    if parts == 1:
        names = [f"{name} (other parts)"]
    again = ("", *(f" ({number})" for number in range(2, len(taken) + 2)))
    return next(
        unlike for more in again if taken.isdisjoint(unlike := [f"{one}{more}" for one in names])
    )


def _part(item: SceneObject, name: str, geometry: Geometry) -> SceneObject:
    """One that is not the surface scatters, though a side of it may be large beside the nearest."""
    role = item.radar if name == item.name else "optics"
    part = replace(item, name=name, geometry=geometry, radar=role)
    return part if item.motion is None else part.following(item.motion, item.parent)


@lru_cache(maxsize=32)
def _apart(
    geometry: Geometry, place_m: tuple[float, float, float], wavelength_m: float
) -> tuple[Geometry, ...] | None:
    """The parts of a mesh with a patch that is large at its distance from a place, and all others,
    those that touch as one; None where there are no others that could scatter.
    """
    is_other = _others(geometry, place_m, wavelength_m)
    if is_other is None:
        return None
    groups = [np.flatnonzero(is_other)[rows] for rows in _touching(geometry, is_other)]
    pieces = [_piece(geometry, rows) for rows in groups]
    large = [piece.shape.size_m >= SMALLEST * wavelength_m for piece in pieces]
    for rows, is_large in zip(groups, large, strict=True):
        is_other[rows] = is_large
    if not is_other.any():
        return None
    found = [piece for piece, is_large in zip(pieces, large, strict=True) if is_large]
    if len(found) > _MOST_OBJECTS:
        found = [_piece(geometry, np.flatnonzero(is_other))]
    return _piece(geometry, np.flatnonzero(~is_other)), *found


def _piece(geometry: Geometry, faces: Indices) -> Geometry:
    return Geometry(geometry.vertices_m, geometry.faces[faces], geometry.uv)


def _touching(geometry: Geometry, some: NDArray[np.bool_]) -> list[Indices]:
    """Of some faces those whose parts touch, by their boxes, as one: numbers among these faces."""
    part = np.unique(geometry.parts[some], return_inverse=True)[1]
    boxes = boxes_of_parts(geometry.corners_m[some], part)
    group = connected(near_pairs(boxes)[0], len(boxes))[part]
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


def boxes_of_parts(points: Array, part: NDArray[np.integer]) -> Array:
    """Boxes (n_parts, 2, 3) around points (n, k, 3) of parts from 0 on."""
    low, high = np.full((2, int(part.max(initial=-1)) + 1, 3), np.inf)
    np.minimum.at(low, part, points.min(axis=1))
    np.minimum.at(high, part, -points.max(axis=1))
    return np.stack([low, -high], axis=1)


def _others(
    geometry: Geometry, place_m: tuple[float, float, float], wavelength_m: float
) -> NDArray[np.bool_] | None:
    """Faces of parts without a large patch, (m,)."""
    shape, has_area = geometry.shape, geometry.parts >= 0
    part, points = geometry.parts[has_area], geometry.corners_m[has_area]
    patch = shape.patch_of_face[has_area]
    near_m = distances_m(boxes_of_parts(points, part), np.array(place_m))
    least_m2 = LARGE_BESIDE_OPTICS**2 * wavelength_m * np.maximum(near_m, wavelength_m)
    patch_m2 = np.zeros(len(least_m2))
    np.maximum.at(patch_m2, part, shape.patch_area_m2[patch])
    is_surface = patch_m2 >= least_m2
    if is_surface.all() or not is_surface.any():
        return None
    # The bottom of what stands on the ground is in its plane; of a pavement's slabs all is.
    is_side = is_surface[part] & (shape.patch_area_m2[patch] >= least_m2.min())
    some = np.flatnonzero(is_side)[np.unique(patch[is_side], return_index=True)[1]]
    normals = geometry.normals[has_area][some]
    is_surface |= _in_planes(points, part, ~is_surface, points[some, 0], normals)
    is_other = np.zeros(len(has_area), dtype=bool)
    is_other[has_area] = ~is_surface[part]
    return is_other if is_other.any() else None


def _in_planes(
    points: Array, part: Indices, asked: NDArray[np.bool_], place: Array, normal: Array
) -> NDArray[np.bool_]:
    """Which of the parts that are ``asked``, of corners (m, 3, 3), lie in one of some planes."""
    order = np.argsort(part, kind="stable")
    first = np.searchsorted(part[order], np.arange(len(asked) + 1))
    faces = np.split(order, first[1:-1])
    height = np.einsum("ij,ij->i", place, normal)
    found = np.zeros(len(asked), dtype=bool)
    for number in np.flatnonzero(asked).tolist():
        corners = points[faces[number]].reshape(-1, 3)
        near = np.flatnonzero(np.abs(normal @ corners[0] - height) < _IN_PLANE_M)
        off_m = np.abs(corners @ normal[near].T - height[near]).max(axis=0)
        found[number] = (off_m < _IN_PLANE_M).any()
    return found
