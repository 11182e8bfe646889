"""Triangles as Mitsuba takes them: in float32, none too large for its distance."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Float32 has 1.7e7 steps: a triangle this much longer than it is far is found to 1.5e-5 of its
#: distance, well below the renderer's own offset of shadow rays.
_EDGE_OVER_DISTANCE = 256.0
_AT_ONCE = 2**18  # triangles, 100 MB while they are looked at


def mitsuba_mesh(
    mi: Any,
    vertices_m: Array,
    faces: NDArray[np.integer],
    uv: Array | None = None,
    *,
    name: str = "mesh",
    properties: Any = None,
) -> Any:
    """A Mitsuba mesh of vertices (n, 3), faces (m, 3) and texture coordinates (n, 2).

    ``mi`` is Mitsuba in the variant wanted; ``properties`` are its own of the shape.
    """
    more = {} if properties is None else {"props": properties}
    shape = mi.Mesh(name, len(vertices_m), len(faces), has_vertex_texcoords=uv is not None, **more)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = vertices_m.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    if uv is not None:
        parameters["vertex_texcoords"] = uv.astype(np.float32).ravel()
    parameters.update()
    return shape


def scene_of_shapes(mi: Any, shapes: Mapping[str, Any]) -> Any:
    """A Mitsuba scene of shapes by their names, where no ray slips through joints of triangles.

    With Embree's fast intersections a quarter of the rays at 89.99 degrees does, and one exactly
    along a joint may.
    """
    settings: dict[str, Any] = {"type": "scene"}
    if mi.variant().startswith("llvm"):
        settings["embree_use_robust_intersections"] = True
    return mi.load_dict({**settings, **shapes})


def are_too_large(vertices_m: Array, faces: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Triangles (m,) that are too large for where they are, as seen from the origin."""
    found = np.zeros(len(faces), dtype=bool)
    if not len(faces) or np.linalg.norm(np.ptp(vertices_m, axis=0)) <= _EDGE_OVER_DISTANCE:
        return found  # of 1 m: none is longer
    for first in range(0, len(faces), _AT_ONCE):
        corners = vertices_m[faces[first : first + _AT_ONCE]]
        longest = _edges_m(corners).max(axis=1)
        nearest = np.linalg.norm(corners.mean(axis=1), axis=1) - longest
        found[first : first + _AT_ONCE] = longest > _EDGE_OVER_DISTANCE * np.maximum(nearest, 1.0)
    return found


def _edges_m(corners: Array) -> Array:
    """Lengths of the edges of triangles (m, 3, 3), (m, 3)."""
    edges: Array = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    return edges


def divided(
    vertices_m: Array, faces: NDArray[np.int32], uv: Array | None = None
) -> tuple[Array, NDArray[np.int32], Array | None]:
    """The same surface about the origin with no triangle that is large where it is near: vertices,
    faces and texture coordinates, the same arrays where nothing is.

    A renderer in float32 finds a point of a triangle only to the step of its corners' coordinates,
    8 mm at 1e5 m: light is lost to the surface's own shadow. So edges are halved, in float64,
    until none is longer than `_EDGE_OVER_DISTANCE` times the triangle's distance (or 1 m).
    """
    vertices = vertices_m
    while True:
        split = are_too_large(vertices, faces)
        if not split.any():
            return vertices, faces, uv
        first = _edges_m(vertices[faces[split]]).argmax(axis=1)[:, None]
        turn = (first + np.arange(3)) % 3
        a, b, c = np.take_along_axis(faces[split], turn, axis=1).T
        middle = len(vertices) + np.arange(len(a))
        halves = np.concatenate(
            [np.column_stack([a, middle, c]), np.column_stack([middle, b, c])]
        ).astype(faces.dtype)
        vertices = np.concatenate([vertices, (vertices[a] + vertices[b]) / 2])
        uv = None if uv is None else np.concatenate([uv, (uv[a] + uv[b]) / 2])
        faces = np.concatenate([faces[~split], halves])
