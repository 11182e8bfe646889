"""Convex parts of meshes, whose shadows on a plane are convex."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from twin.geometry import Geometry, shapes_of
from twin.radar.propagation.scene.mesh_scene import MeshScene

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_MOST_FACES = 32  # of a flat patch that is treated as one
_LARGEST_MESH = 200_000  # faces of a mesh whose patches are merged
_ROUNDED = 1e-6  # of a patch's size: tolerance of the test for convexity
_parts: WeakKeyDictionary[Geometry, tuple[Indices, int]] = WeakKeyDictionary()


def convex_parts(world: MeshScene) -> NDArray[np.uint32]:
    """Number of the convex part of a mesh that each facet belongs to: a whole convex body, a flat
    convex patch, or the facet alone.
    """
    label_of_facet = np.zeros(len(world.faces), dtype=np.uint32)
    geometries = [item.geometry for item in world.items if item is not None]
    new = [geometry for geometry in dict.fromkeys(geometries) if geometry not in _parts]
    if new:
        _parts.update(zip(new, _of_meshes(new), strict=True))
    first = 0
    for geometry, rows in zip(geometries, world.face_ranges, strict=True):
        part, count = _parts[geometry]
        label_of_facet[rows] = part + first
        first += count
    return label_of_facet


def _of_meshes(geometries: Sequence[Geometry]) -> Iterator[tuple[Indices, int]]:
    """Parts of each mesh, and how many there are: all meshes in one go."""
    shapes = shapes_of(geometries)
    first_face = np.cumsum([0, *(len(geometry.faces) for geometry in geometries)])
    first_patch = np.cumsum([0, *(len(shape.patch_area_m2) for shape in shapes)])
    first_point = np.cumsum([0, *(len(geometry.vertices_m) for geometry in geometries)])
    patch = np.concatenate(
        [shape.patch_of_face + n for shape, n in zip(shapes, first_patch, strict=False)]
    )
    sizes = np.bincount(patch, minlength=int(first_patch[-1]))
    has_patches = [
        not s.is_convex and len(g.faces) <= _LARGEST_MESH
        for g, s in zip(geometries, shapes, strict=True)
    ]
    is_mergeable = (
        (sizes > 1) & (sizes <= _MOST_FACES) & np.repeat(has_patches, np.diff(first_patch))
    )
    rows = np.flatnonzero(is_mergeable[patch])
    if len(rows):
        rows = rows[np.argsort(patch[rows], kind="stable")]
        mesh = np.repeat(np.arange(len(geometries)), np.diff(first_face))[rows]
        points = np.concatenate([g.vertices_m - g.vertices_m[0] for g in geometries])
        first = first_point[mesh][:, None]
        faces, corners = (
            np.concatenate(all_faces)[rows] + first
            for all_faces in zip(*((g.faces, g.welded_faces) for g in geometries), strict=True)
        )
        corners = np.unique(corners, return_inverse=True)[1].reshape(-1, 3)
        is_mergeable &= _are_convex(points[faces], corners, patch[rows], len(sizes))
    label = np.where(is_mergeable[patch], patch, len(sizes) + np.arange(len(patch)))
    for (a, b), shape in zip(pairwise(first_face), shapes, strict=True):
        if shape.is_convex:
            yield np.zeros(b - a, dtype=np.int64), 1
            continue
        numbers, part = np.unique(label[a:b], return_inverse=True)
        yield part.reshape(-1), len(numbers)


def _are_convex(place: Array, corners: Indices, patch: Indices, count: int) -> NDArray[np.bool_]:
    """Which flat patches have no corner outside one of their border's edges, (count,); by the
    corners of every face (m, 3, 3), their numbers (m, 3), one for all at one place, and the patch
    of every face (m,), patch by patch.
    """
    ends = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    of_edge = np.repeat(patch, 3)
    many = int(corners.max()) + 1
    keys = (of_edge * many + ends.min(axis=1)) * many + ends.max(axis=1)
    _, which, shared = np.unique(keys, return_inverse=True, return_counts=True)
    border = np.flatnonzero(shared[which.reshape(-1)] == 1)
    a, b, c = (place[border // 3, (border + k) % 3] for k in range(3))
    along, inwards = _unit(b - a), c - a
    inwards = _unit(inwards - np.sum(inwards * along, axis=1, keepdims=True) * along)
    # Every edge of the border against every corner of its patch.
    number = of_edge[border]
    times = np.bincount(of_edge, minlength=count)[number]
    edge = np.repeat(np.arange(len(border)), times)
    at = np.arange(len(edge)) + (np.searchsorted(of_edge, number) - np.cumsum(times) + times)[edge]
    off = place.reshape(-1, 3)[at] - a[edge]
    is_outside = np.sum(off * inwards[edge], axis=1) < -_ROUNDED * np.abs(off).max(axis=1)
    convex: NDArray[np.bool_] = np.bincount(number[edge], is_outside, count) == 0
    return convex


def _unit(vectors: Array) -> Array:
    units: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    return units
