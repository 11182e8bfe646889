"""How far facets stay off the smooth surface that they stand for.

Where two facets bend smoothly into each other by an angle t, and the middles of both lie d from the
edge between them, the surface has a radius of about 2 d / t there. Across a facet its depth below
such a surface scatters by a share of d t: an error of the phase that repeats from facet to facet,
and, as a grating would, returns its own share of the echo.
"""

import numpy as np
from numpy.typing import NDArray

from twin.geometry.faces import dots

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Standard deviation of the depth over 2 d t. A paraboloid's below an equilateral triangle, as
#: middles of neighbours stand 2 / 3 of a height apart: sqrt(0.0375) / 2; a cylinder's below a
#: strip: sqrt(1 / 80 - 1 / 144) / 2, in two directions below a quadrangle.
_OF_TRIANGLE = 0.0968
_OF_POLYGON = 0.0373 * 2**0.5
_AT_ONCE = 2**18  # pairs of facets, 100 MB while they are looked at


def depths_m(
    points: Array,
    faces: NDArray[np.int32],
    normals: Array,
    area: Array,
    *,
    bends: NDArray[np.int32],
    turn: Array,
    patch: Indices,
    mesh_of_face: Indices,
    count: int,
) -> Array:
    """Of each of some meshes the depth, standard deviation over its smoothly bent facets; 0 of what
    has none, (count,).

    Parameters
    ----------
    points, faces, normals, area
        Vertices (n, 3), and of all facets their corners (m, 3), (m, 3), (m,).
    bends, turn
        Pairs of facets on either side of a smooth edge, (n, 2), and the angle between them, (n,).
    patch
        Number of the plane patch of each facet, (m,); those in a plane are one polygon.
    mesh_of_face
        Number of the mesh of each facet, (m,).
    """
    square, weight = np.zeros(count), np.zeros(count)
    if not len(bends):
        return square
    total = np.bincount(patch, area)
    is_single = np.bincount(patch, area > 0) == 1
    middle = np.empty((len(total), 3))
    for axis in range(3):
        a, b, c = points[:, axis].copy()[faces.T]
        middle[:, axis] = np.bincount(patch, (a + b + c) / 3 * area) / np.maximum(total, 1e-300)
    for first in range(0, len(bends), _AT_ONCE):
        pairs, bend = bends[first : first + _AT_ONCE].T, turn[first : first + _AT_ONCE]
        sides = patch[pairs]
        apart = middle[sides[1]] - middle[sides[0]]
        distance, is_folded = _reach(normals[pairs], apart, bend)
        is_triangle = is_single[sides[0]] & is_single[sides[1]]
        depth = np.where(is_triangle, _OF_TRIANGLE, _OF_POLYGON) * 2 * distance * bend
        share = np.where(is_folded, 0.0, np.minimum(total[sides[0]], total[sides[1]]))
        mesh = mesh_of_face[pairs[0]]
        square += np.bincount(mesh, share * depth**2, count)
        weight += np.bincount(mesh, share, count)
    found: Array = np.sqrt(square / np.maximum(weight, 1e-300))
    return found


def _reach(normals: Array, apart: Array, turn: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance of the middles of pairs of facets from the edge between them, of the nearer one, and
    whether the surface folds back upon itself there, as at the rim of something thin; both (n,).

    By their normals (2, n, 3), the way from the one's middle to the other's (n, 3), and the angle.
    """
    sine = np.maximum(np.sin(turn), 1e-300)
    # A point d from the edge lies d sin t off the other plane. Of unlike neighbours the narrower
    # one shows the radius: a wide one beside it is flat.
    one, other = (np.abs(dots(normal, apart)) / sine for normal in normals)
    edge = np.cross(*normals) / sine[:, None]
    across = dots(apart, apart) - dots(apart, edge) ** 2
    return np.minimum(one, other), across < one**2 + other**2
