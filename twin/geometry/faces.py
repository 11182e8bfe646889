"""Normals, areas and planes of triangles.

Sums over three columns are written out: NumPy's own over a short axis take ten times as long.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def normals(vertices_m: Array, faces: NDArray[np.integer]) -> Array:
    """Unit normals of faces by the sense of their corners, (m, 3); 0 of one without an area."""
    first, second = _sides(vertices_m, faces)
    # Scaled first: the squares of tiny edges would underflow.
    x, y, z = np.maximum(np.abs(first), np.abs(second)).T
    size = np.maximum(np.maximum(x, y), z)
    size[size == 0] = 1.0
    first /= size[:, None]
    second /= size[:, None]
    across = np.cross(first, second)
    length = lengths(across)
    length[length == 0] = 1.0
    across /= length[:, None]
    return across


def areas(vertices_m: Array, faces: NDArray[np.integer]) -> Array:
    """Areas of faces, (m,)."""
    first, second = _sides(vertices_m, faces)
    found: Array = lengths(np.cross(first, second)) / 2
    return found


def planes(vertices_m: Array, faces: NDArray[np.integer]) -> Array:
    """A point of each face's plane and its normal, (m, 6)."""
    return np.hstack([vertices_m[faces[:, 0]], normals(vertices_m, faces)])


def dots(a: Array, b: Array) -> Array:
    """Inner products of vectors (n, 3), (n,)."""
    products: Array = a * b
    return products[:, 0] + products[:, 1] + products[:, 2]


def lengths(vectors: Array) -> Array:
    """Of vectors (n, 3), (n,)."""
    found: Array = np.sqrt(dots(vectors, vectors))
    return found


def _sides(vertices_m: Array, faces: NDArray[np.integer]) -> tuple[Array, Array]:
    a = vertices_m[faces[:, 0]]
    return vertices_m[faces[:, 1]] - a, vertices_m[faces[:, 2]] - a
