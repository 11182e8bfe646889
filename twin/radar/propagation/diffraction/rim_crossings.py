"""Where edges of outlines cross or touch as seen from a point: there one passes below another, and
both may end.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.meshes.silhouettes import Outline

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_ASKEW = 0.1  # sine of the angle between edges that cross, as seen, at least
_END_M = 1e-4  # of an edge's end: closer to it the edge ends there
_ON_IT = 1e-6  # radians from an edge: on it


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
        least = _END_M / np.sqrt(np.dot(side, side))
        for j in range(len(others)):
            x, y, z = normals[j]
            below = x * begin[0] + y * begin[1] + z * begin[2]
            slope = x * side[0] + y * side[1] + z * side[2]
            if below * slope >= 0 or abs(below) >= abs(slope):
                continue
            share = -below / slope
            there = begin + share * side
            if not (
                least < share < 1 - least
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


def beside(
    rim: Outline, edges: Indices, others: Sequence[Outline], reach_m: Array
) -> tuple[Indices, Array]:
    """Of some edges of an outline, by number, those which ends of edges of any outlines are seen
    beside, in their light up to a reach (n,) or on them, one for each; and the share of its length.
    """
    ends, lit = (np.ascontiguousarray(x[edges]) for x in (rim.ends, rim.lit))
    every = np.unique(np.concatenate([other.ends.reshape(-1, 3) for other in others]), axis=0)
    row, share = kernel(_beside)(ends, lit, every, reach_m)
    return edges[row], share


def _beside(ends: Array, lit: Array, points: Array, reach_m: Array) -> tuple[Indices, Array]:
    rows, shares = [0 for _ in range(0)], [0.0 for _ in range(0)]
    for i in range(len(ends)):
        begin, side = ends[i, 0], ends[i, 1] - ends[i, 0]
        # Across it in the plane of the source: sights of places on it are told apart by that.
        flat = np.cross(lit[i], side)
        level, least = np.dot(flat, begin), _END_M / np.sqrt(np.dot(side, side))
        nearest = -_ON_IT * np.sqrt(np.dot(begin, begin))
        for j in range(len(points)):
            x, y, z = points[j]
            height = x * lit[i, 0] + y * lit[i, 1] + z * lit[i, 2]
            if height < 4 * nearest or height > 4 * reach_m[i]:
                continue  # whatever its distance: what is close is not four times as far
            # How far the point's sight meets the edge's line, over where the point is.
            scale = level / (x * flat[0] + y * flat[1] + z * flat[2])
            if not (0 < scale < np.inf and nearest <= height * scale <= reach_m[i]):
                continue
            along = 0.0
            for k in range(3):
                along += (points[j, k] * scale - height * scale * lit[i, k] - begin[k]) * side[k]
            share = along / np.dot(side, side)
            if least < share < 1 - least:
                rows.append(i)
                shares.append(share)
    return np.array(rows), np.array(shares)


def _above(one: Array, other: Array, normal: Array) -> bool:
    """Whether one turns to the other, by less than half a turn, about the normal."""
    x = one[1] * other[2] - one[2] * other[1]
    y = one[2] * other[0] - one[0] * other[2]
    z = one[0] * other[1] - one[1] * other[0]
    return bool(x * normal[0] + y * normal[1] + z * normal[2] >= 0)
