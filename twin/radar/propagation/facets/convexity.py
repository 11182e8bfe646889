"""Convex parts of meshes: what one of them hides of a plane from a point is convex, too."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.meshes.kept import Kept
from twin.radar.propagation.meshes.shape import Shape, shapes_of, welded
from twin.radar.propagation.scene.mesh_scene import MeshScene
from twin.scene import SceneObject

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_MOST_FACES = 32  # of a flat patch that is looked at as one
_LARGEST_MESH = 200_000  # faces, likewise
_ROUNDED = 1e-6  # of a patch's size: what juts out no more is convex
_parts: "Kept[tuple[Indices, int]]" = Kept()


def convex_parts(world: MeshScene) -> NDArray[np.uint32]:
    """Of every facet of the world a number that those of one convex part of a mesh share: all of a
    convex body, a flat convex patch, or the facet alone.
    """
    found = np.zeros(len(world.faces), dtype=np.uint32)
    items = [item for item in world.items if item is not None]
    shapes = shapes_of(items)
    new = [i for i, shape in enumerate(shapes) if _parts.get([shape]) is None]
    if new:
        of_new = _of_meshes([items[i] for i in new], [shapes[i] for i in new])
        for i, part in zip(new, of_new, strict=True):
            _parts.put(part, [shapes[i]])
    first = 0
    for shape, rows in zip(shapes, world.face_ranges, strict=True):
        held = _parts.get([shape])
        assert held is not None
        found[rows] = held[0] + first
        first += held[1]
    return found


def _of_meshes(
    items: Sequence[SceneObject], shapes: Sequence[Shape]
) -> Iterator[tuple[Indices, int]]:
    """Parts of each mesh, and how many there are: all meshes in one go."""
    first_face = np.cumsum([0, *(len(item.faces) for item in items)])
    first_patch = np.cumsum([0, *(len(shape.patch_area_m2) for shape in shapes)])
    first_point = np.cumsum([0, *(len(item.vertices_m) for item in items)])
    patch = np.concatenate(
        [shape.patch_of_face + n for shape, n in zip(shapes, first_patch, strict=False)]
    )
    sizes = np.bincount(patch, minlength=int(first_patch[-1]))
    is_asked = [
        not s.is_convex and len(i.faces) <= _LARGEST_MESH
        for i, s in zip(items, shapes, strict=True)
    ]
    joined = (sizes > 1) & (sizes <= _MOST_FACES) & np.repeat(is_asked, np.diff(first_patch))
    rows = np.flatnonzero(joined[patch])
    if len(rows):
        rows = rows[np.argsort(patch[rows], kind="stable")]
        mesh = np.repeat(np.arange(len(items)), np.diff(first_face))[rows]
        points = np.concatenate([item.vertices_m - item.vertices_m[0] for item in items])
        faces = np.concatenate([item.faces for item in items])[rows] + first_point[mesh][:, None]
        mesh = np.unique(mesh, return_inverse=True)[1].reshape(-1)
        joined &= _are_convex(points, faces, mesh, patch[rows], len(sizes))
    label = np.where(joined[patch], patch, len(sizes) + np.arange(len(patch)))
    for (a, b), shape in zip(pairwise(first_face), shapes, strict=True):
        if shape.is_convex:
            yield np.zeros(b - a, dtype=np.int64), 1
            continue
        numbers, part = np.unique(label[a:b], return_inverse=True)
        yield part.reshape(-1), len(numbers)


def _are_convex(
    points: Array, faces: Indices, mesh: Indices, patch: Indices, count: int
) -> NDArray[np.bool_]:
    """Which flat patches have no corner outside one of their border's edges, (count,); by the mesh
    and the patch of every face (m, 3), patch by patch.
    """
    corners = welded(points, faces, mesh)
    ends = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    of_edge = np.repeat(patch, 3)
    many = int(corners.max()) + 1
    keys = (of_edge * many + ends.min(axis=1)) * many + ends.max(axis=1)
    _, which, shared = np.unique(keys, return_inverse=True, return_counts=True)
    border = np.flatnonzero(shared[which.reshape(-1)] == 1)
    place = points[faces]
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
    found: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    return found
