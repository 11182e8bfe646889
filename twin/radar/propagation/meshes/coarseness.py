"""How far facets stay off the smooth surface that they stand for.

Where two facets bend smoothly into each other by an angle t, and the middles of both lie d from the
edge between them, the surface has a radius of about 2 d / t there. Across a facet its depth below
such a surface scatters by a share of d t: an error of the phase that repeats from facet to facet,
and, as a grating would, returns its own share of the echo.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Standard deviation of the depth over 2 d t. A paraboloid's below an equilateral triangle, as
#: middles of neighbours stand 2 / 3 of a height apart: sqrt(0.0375) / 2; a cylinder's below a
#: strip: sqrt(1 / 80 - 1 / 144) / 2, in two directions below a quadrangle.
_OF_TRIANGLE = 0.0968
_OF_POLYGON = 0.0373 * 2**0.5


def depths_m(
    corners: Array,
    normals: Array,
    area: Array,
    bends: Indices,
    turn: Array,
    patch: Indices,
    mesh_of_face: Indices,
    count: int,
) -> Array:
    """Of each of some meshes the depth, standard deviation over its smoothly bent facets; 0 of what
    has none, (count,).

    Parameters
    ----------
    corners, normals, area
        Of all facets, (m, 3, 3), (m, 3), (m,).
    bends, turn
        Pairs of facets on either side of a smooth edge, (n, 2), and the angle between them, (n,).
    patch
        Number of the plane patch of each facet, (m,); those in a plane are one polygon.
    mesh_of_face
        Number of the mesh of each facet, (m,).
    """
    patches = int(patch.max(initial=-1)) + 1
    total = np.bincount(patch, area, patches)
    faces = np.bincount(patch, area > 0, patches)
    weighted = corners.mean(axis=1) * area[:, None]
    sums = [np.bincount(patch, column, patches) for column in weighted.T]
    middle: Array = np.stack(sums, axis=1) / np.maximum(total, 1e-300)[:, None]
    first, second = bends.T
    apart = middle[patch[second]] - middle[patch[first]]
    # A point d from the edge lies d sin t off the other plane. Of unlike neighbours the narrower
    # one shows the radius: a wide one beside it is flat.
    off = [np.abs(np.sum(normals[face] * apart, axis=1)) for face in (first, second)]
    one, other = (o / np.maximum(np.sin(turn), 1e-300) for o in off)
    distance = np.minimum(one, other)
    edge = np.cross(normals[first], normals[second]) / np.maximum(np.sin(turn), 1e-300)[:, None]
    across = np.sum(apart**2, axis=1) - np.sum(apart * edge, axis=1) ** 2
    is_folded = across < one**2 + other**2  # back upon itself, as at the rim of something thin
    single = (faces[patch[first]] == 1) & (faces[patch[second]] == 1)
    depth = np.where(single, _OF_TRIANGLE, _OF_POLYGON) * 2 * distance * turn
    weight = np.where(is_folded, 0.0, np.minimum(total[patch[first]], total[patch[second]]))
    mesh = mesh_of_face[first]
    square = np.bincount(mesh, weight * depth**2, count)
    found: Array = np.sqrt(square / np.maximum(np.bincount(mesh, weight, count), 1e-300))
    return found
