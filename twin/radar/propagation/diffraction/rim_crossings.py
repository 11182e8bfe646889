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
    row, share = kernel(_crossings)(ends, every)
    return edges[row], share


def _crossings(ends: Array, others: Array) -> tuple[Indices, Array]:
    rows, shares = [0 for _ in range(0)], [0.0 for _ in range(0)]
    for i in range(len(ends)):
        begin, side = ends[i, 0], ends[i, 1] - ends[i, 0]
        for j in range(len(others)):
            # The plane of the other edge and the point that both are seen from.
            normal = np.cross(others[j, 0], others[j, 1])
            slope = np.dot(normal, side)
            if slope == 0:
                continue
            share = -np.dot(normal, begin) / slope
            if not _WITHIN < share < 1 - _WITHIN:
                continue
            there = begin + share * side
            first, last = np.cross(others[j, 0], there), np.cross(there, others[j, 1])
            if np.dot(first, normal) < 0 or np.dot(last, normal) < 0:
                continue
            across = side - np.dot(side, there) / np.dot(there, there) * there
            size = np.sqrt(np.dot(normal, normal) * np.dot(across, across))
            if abs(np.dot(normal, across)) > _ASKEW * size:
                rows.append(i)
                shares.append(share)
    return np.array(rows), np.array(shares)
