"""Where edges of outlines cross as seen from a point: there one passes below another, and both may
end.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.meshes.silhouettes import Outline

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_ASKEW = 0.1  # sine of the angle between edges that cross, as seen, at least
_WITHIN = 1e-6  # of an edge: closer to its end it ends there


def crossings(rim: Outline, edges: Indices, others: Sequence[Outline]) -> tuple[Indices, Array]:
    """Of some edges of an outline, by number, those which edges of other outlines cross, one for
    each crossing, and the share of its length at which.
    """
    ends = np.ascontiguousarray(rim.ends[edges])
    every = np.concatenate([other.ends for other in others])
    # The planes of the other edges and the point that all are seen from.
    normals = np.cross(every[:, 0], every[:, 1])
    row, share = kernel(_crossings, _above)(ends, every, normals)
    return edges[row], share


def _crossings(ends: Array, others: Array, normals: Array) -> tuple[Indices, Array]:
    rows, shares = [0 for _ in range(0)], [0.0 for _ in range(0)]
    for i in range(len(ends)):
        begin, side = ends[i, 0], ends[i, 1] - ends[i, 0]
        for j in range(len(others)):
            x, y, z = normals[j]
            below = x * begin[0] + y * begin[1] + z * begin[2]
            slope = x * side[0] + y * side[1] + z * side[2]
            if below * slope >= 0 or abs(below) >= abs(slope):
                continue
            share = -below / slope
            there = begin + share * side
            if not (
                _WITHIN < share < 1 - _WITHIN
                and _above(others[j, 0], there, normals[j])
                and _above(there, others[j, 1], normals[j])
            ):
                continue
            across = side - np.dot(side, there) / np.dot(there, there) * there
            size = np.sqrt(np.dot(normals[j], normals[j]) * np.dot(across, across))
            if abs(np.dot(normals[j], across)) > _ASKEW * size:
                rows.append(i)
                shares.append(share)
    return np.array(rows), np.array(shares)


def _above(one: Array, other: Array, normal: Array) -> bool:
    """Whether one turns to the other, by less than half a turn, about the normal."""
    x = one[1] * other[2] - one[2] * other[1]
    y = one[2] * other[0] - one[0] * other[2]
    z = one[0] * other[1] - one[1] * other[0]
    return bool(x * normal[0] + y * normal[1] + z * normal[2] >= 0)
