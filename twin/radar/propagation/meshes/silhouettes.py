"""Outlines of bodies as seen from a point: edges with all their faces on one side of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.meshes.kept import Kept
from twin.radar.propagation.meshes.shape import welded
from twin.scene import SceneObject

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: A face seen edge on has its edges on either side: seen from this much aside, of the distance, it
#: is one of the two.
_ASIDE = 1e-9 * np.array([0.36, 0.48, 0.8])
_known: "Kept[_Wires]" = Kept()


@dataclass(frozen=True, eq=False)
class Outline:
    """Edges of an object, (m, ...), each with the object on one side as seen from some point.

    ``ends`` (m, 2, 3) are relative to that point; ``edge`` (m,) and ``corner`` (m, 2) number edges
    and their ends, the same from everywhere; ``lit`` (m, 3) is the unit vector across the edge and
    the line of sight, away from the object.
    """

    ends: Array
    edge: Indices
    corner: Indices
    lit: Array

    def chosen(self, which: NDArray[np.integer]) -> "Outline":
        """Only some of them, by index."""
        return Outline(self.ends[which], self.edge[which], self.corner[which], self.lit[which])

    def from_elsewhere(self, place: Array) -> "Outline":
        """The same edges relative to another point, itself relative to the first."""
        ends = self.ends - place
        lit = np.cross(ends[:, 0], ends[:, 1])
        lit *= np.sign(np.sum(lit * self.lit, axis=1, keepdims=True))
        lit /= np.maximum(np.linalg.norm(lit, axis=1, keepdims=True), 1e-300)
        return Outline(ends, self.edge, self.corner, lit)


@dataclass(frozen=True, eq=False)
class _Wires:
    """Edges (e, 2) by their ends, and of each face (f, 3) its edges, whether it runs along them
    from the first end to the second, +1 or -1, and corners; how many faces each edge has.
    """

    ends: Indices
    faces: Indices
    edge_of_face: Indices
    along: Indices
    faces_of_edge: Indices


def _wires_of(item: SceneObject) -> _Wires:
    """The same for all that share their faces, which are rigid bodies."""
    return _known.get([item.faces]) or _known.put(_wires(item), [item.faces])


def _wires(item: SceneObject) -> _Wires:
    corners = welded(item.vertices_m - item.vertices_m[item.faces[0, 0]], item.faces)
    # Any of the vertices that are one stands for them.
    number = np.empty(int(corners.max(initial=0)) + 1, dtype=np.int64)
    number[corners] = item.faces
    faces = number[corners]
    a, b, c = (item.vertices_m[faces[:, i]] for i in range(3))
    faces = faces[(np.cross(b - a, c - a) != 0).any(axis=1)]
    pairs = faces[:, [[0, 1], [1, 2], [2, 0]]]
    rows = np.sort(pairs, axis=2).reshape(-1, 2)
    keys = rows[:, 0] * len(item.vertices_m) + rows[:, 1]
    _, first, edge, count = np.unique(
        keys, return_index=True, return_inverse=True, return_counts=True
    )
    along = np.where(pairs[..., 0] < pairs[..., 1], 1, -1)
    return _Wires(rows[first], faces, edge.reshape(-1, 3), along, count)


def outline(item: SceneObject, source_m: Array) -> Outline:
    """The outline of an object from a point, with what of it the object itself hides or shows in
    front of itself.
    """
    wires = _wires_of(item)
    points = item.vertices_m - source_m
    size = float(np.abs(points[wires.ends]).max(initial=0.0))
    a, b, c = (points[wires.faces[:, i]] + _ASIDE * size for i in range(3))
    turn = np.sum(np.cross(a, b) * c, axis=1)
    side = np.where(turn > 0, 1, -1)[:, None] * wires.along
    n = len(wires.ends)
    balance = np.bincount(wires.edge_of_face.ravel(), side.ravel(), minlength=n)
    on_it = np.flatnonzero(np.abs(balance) == wires.faces_of_edge)
    ends = points[wires.ends[on_it]]
    lit = -np.sign(balance[on_it])[:, None] * np.cross(ends[:, 0], ends[:, 1])
    length = np.linalg.norm(lit, axis=1)
    seen = length > 1e-12 * size**2  # not end on
    return Outline(ends[seen], on_it[seen], wires.ends[on_it][seen], lit[seen] / length[seen, None])
