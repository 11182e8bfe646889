"""Edges at which what a mesh has in one plane ends.

A mesh may list part of a plane more than once: a closed house joined with the ground has its floor
in it. There an edge of one triangle ends nothing, as another goes on beyond it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.geometry.near_boxes import near_pairs
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_BEYOND_M = 1e-4  # an edge: where another triangle goes on; far beyond rounding of coordinates
_MANY = 2000  # edges that are compared with all others
_RASTER = 1024  # cells, at most, along a side of the raster in which triangles are looked up
_SHORTEST_M = 1e-3  # what is left of an edge: less comes from looking beyond it


class OpenEdges(NamedTuple):
    """Edges, or parts of them, with triangles on one side alone, (n, ...): ``ends`` (n, 2, 3), the
    numbers of their ``corner`` (n, 2), and the third corner of a triangle, ``within`` (n, 3).
    """

    ends: Array
    corner: Indices
    within: Array


def open_edges(points: Array, faces: Indices, normal: Array) -> OpenEdges:
    """Of triangles in a plane with this normal, whose corners at one place have one number."""
    corner = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    within = points[faces[:, [2, 0, 1]].reshape(-1)]
    inward = np.cross(normal, points[corner[:, 1]] - points[corner[:, 0]])
    side = np.sign(dots(inward, within - points[corner[:, 0]])).astype(np.int64)
    solid = np.flatnonzero(side)
    _, first, number = np.unique(corner[solid], axis=0, return_index=True, return_inverse=True)
    sides = np.zeros(len(first), dtype=np.int64)
    np.add.at(sides, number.reshape(-1), side[solid])
    count = np.bincount(number.reshape(-1), minlength=len(first))
    rows = solid[first[np.abs(sides) == count]]
    found = OpenEdges(points[corner[rows]], corner[rows], within[rows])
    outward = -side[rows, None] * inward[rows]
    outward /= np.maximum(lengths(outward), 1e-300)[:, None]
    inner = _inner(found.ends, outward)
    beyond = found.ends[inner] + _BEYOND_M * outward[inner, None]
    row, covered = _covered(beyond, points[faces], normal)
    return _without(found, inner[row], covered, len(points))


def _inner(ends: Array, outward: Array) -> Indices:
    """Edges beyond which some other one is: all but those of the convex hull."""
    if len(ends) > _MANY:
        return np.arange(len(ends))
    farthest = (outward @ ends.reshape(-1, 3).T).max(axis=1, initial=-np.inf)
    return np.flatnonzero(farthest > dots(outward, ends[:, 0]) + _BEYOND_M / 2)


def _covered(ends: Array, triangles: Array, normal: Array) -> tuple[Indices, Array]:
    """Which of some lines (n, 2, 3) triangles (m, 3, 3) cover, and from where to where, in shares
    of their lengths, (k, 2).
    """
    if not len(ends):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    lines, areas = (np.stack([x.min(axis=1), x.max(axis=1)], axis=1) for x in (ends, triangles))
    near = _beside(areas, lines, normal)
    triangles, boxes = triangles[near], np.concatenate([lines, areas[near]])
    pairs = near_pairs(boxes)[0]
    pairs = pairs[(pairs[:, 0] < len(ends)) & (pairs[:, 1] >= len(ends))]
    line, triangle = pairs[:, 0], triangles[pairs[:, 1] - len(ends)]
    begin, along = ends[line, 0], ends[line, 1] - ends[line, 0]
    corner, other, third = (triangle[:, k] for k in range(3))
    sense = np.sign(np.cross(other - corner, third - corner) @ normal)
    low, high = np.zeros(len(line)), np.ones(len(line))
    for k in range(3):
        inward = np.cross(normal, triangle[:, (k + 1) % 3] - triangle[:, k]) * sense[:, None]
        depth, slope = dots(inward, begin - triangle[:, k]), dots(inward, along)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -depth / slope
        low = np.where(slope > 0, np.maximum(low, at), low)
        high = np.where(slope < 0, np.minimum(high, at), high)
        high = np.where((slope == 0) & (depth <= 0), -np.inf, high)
    some = np.flatnonzero(low < high)
    return line[some], np.stack([low, high], axis=1)[some]


def _beside(boxes: Array, others: Array, normal: Array) -> NDArray[np.bool_]:
    """Which boxes (n, 2, 3) along a plane may touch any of others, (n,): by the cells of a raster,
    so that of millions of triangles those are left that are beside a few thousand edges.
    """
    axes, n = np.argsort(np.abs(normal))[:2], min(math.isqrt(len(boxes)) + 1, _RASTER)
    low = others[:, 0].min(axis=0)[axes] - _BEYOND_M
    cell = (others[:, 1].max(axis=0)[axes] + _BEYOND_M - low) / n

    def cells(of: Array, grow_m: float) -> Indices:
        begin = np.floor((of[:, 0][:, axes] - grow_m - low) / cell)
        end = np.floor((of[:, 1][:, axes] + grow_m - low) / cell)
        outside = (end < 0).any(axis=1) | (begin >= n).any(axis=1)
        found = np.clip(np.stack([begin, end + 1]), 0, n).astype(np.int64)
        found[1, outside] = found[0, outside]
        return found

    (left, low_row), (right, high_row) = (ends.T for ends in cells(others, _BEYOND_M))
    marks = np.zeros((n + 1, n + 1), dtype=np.int64)
    for column, row, sign in (
        (left, low_row, 1),
        (right, high_row, 1),
        (left, high_row, -1),
        (right, low_row, -1),
    ):
        np.add.at(marks, (column, row), sign)
    is_marked = marks.cumsum(axis=0).cumsum(axis=1) > 0
    sums = np.zeros((n + 1, n + 1), dtype=np.int64)
    sums[1:, 1:] = is_marked[:-1, :-1].cumsum(axis=0).cumsum(axis=1)
    (left, low_row), (right, high_row) = (ends.T for ends in cells(boxes, 0.0))
    count = sums[right, high_row] - sums[left, high_row]
    count += sums[left, low_row] - sums[right, low_row]
    return np.asarray(count > 0)


def _without(edges: OpenEdges, row: Indices, covered: Array, n_corners: int) -> OpenEdges:
    """Edges without the parts of some of them that are covered."""
    uncut = np.setdiff1d(np.arange(len(edges.ends)), row)
    parts = [OpenEdges(edges.ends[uncut], edges.corner[uncut], edges.within[uncut])]
    for number in np.unique(row).tolist():
        begin, end = edges.ends[number]
        own = covered[row == number]
        own = own[np.argsort(own[:, 0])]
        starts = np.concatenate([[0.0], np.maximum.accumulate(own[:, 1])])
        ends = np.concatenate([own[:, 0], [1.0]])
        least = _SHORTEST_M / np.linalg.norm(end - begin)
        for low, high in zip(starts.tolist(), ends.tolist(), strict=True):
            if high - low <= least:
                continue
            place = begin + np.array([[low], [high]]) * (end - begin)
            corner = edges.corner[number].copy()
            for k, is_new in enumerate((low > 0, high < 1)):
                if is_new:
                    corner[k], n_corners = n_corners, n_corners + 1
            parts.append(OpenEdges(place[None], corner[None], edges.within[[number]]))
    return OpenEdges(*(np.concatenate(values) for values in zip(*parts, strict=True)))
