"""Outlines of bodies as seen from a point: edges with all their faces on one side of them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.scene import SceneObject

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_EDGE_ON = 1e-9  # of an object's size: height over a face, up to which it is seen edge on


class Lines(NamedTuple):
    """Lines of edges: unit vectors ``along`` (n, 3), ``length_m`` of the edges (n,); the ``foot``
    (n, 3) of the perpendicular from the source, how far it is along the line from the edge's first
    end, ``at_m``, and from the source, ``off_m``, (n,).
    """

    along: Array
    length_m: Array
    foot: Array
    at_m: Array
    off_m: Array

    @staticmethod
    def of(ends: Array) -> "Lines":
        """Of edges with ends (n, 2, 3) relative to the source."""
        return Lines(*kernel(_lines)(np.ascontiguousarray(ends)))


def _lines(ends: Array) -> tuple[Array, Array, Array, Array, Array]:
    along, foot = np.empty((2, len(ends), 3))
    length_m, at_m, off_m = np.empty((3, len(ends)))
    for i in range(len(ends)):
        side = ends[i, 1] - ends[i, 0]
        length_m[i] = np.sqrt(np.sum(side**2))
        along[i] = side / length_m[i]
        at_m[i] = -np.sum(ends[i, 0] * along[i])
        foot[i] = ends[i, 0] + at_m[i] * along[i]
        off_m[i] = np.sqrt(np.sum(foot[i] ** 2))
    return along, length_m, foot, at_m, off_m


@dataclass(frozen=True, eq=False)
class Outline:
    """Edges of an object, (m, ...), each with the object on one side as seen from some point.

    ``ends`` (m, 2, 3) are relative to that point; ``edge`` (m,) and ``corner`` (m, 2) number edges
    and their ends, the same from everywhere; ``lit`` (m, 3) is the unit vector across the edge and
    the line of sight, away from the object, and ``aside`` (m, 2, 3) that into the light at its
    ends, between it and the edges that go on from there; ``onwards`` (m, 2, 3) those from its ends
    along the edge that goes on, 0 where several do, or none; ``past`` (m, 2, 3): where an edge ends
    below or above another one, the place of that, else its own end; ``room_m`` (m,): how far aside
    of an edge nothing else of the object is, inf where it is not known.
    """

    ends: Array
    edge: Indices
    corner: Indices
    lit: Array
    aside: Array
    onwards: Array
    past: Array
    room_m: Array

    @cached_property
    def lines(self) -> Lines:
        """Of its edges."""
        return Lines.of(self.ends)

    @staticmethod
    def of(ends: Array, edge: Indices, corner: Indices, lit: Array) -> "Outline":
        """Of all edges of an outline."""
        _, number, count = np.unique(corner, return_inverse=True, return_counts=True)
        number = number.reshape(corner.shape)
        along = ends[:, 1] - ends[:, 0]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        inwards = np.stack([along, -along], axis=1)
        light, both = np.zeros((2, len(count), 3))
        np.add.at(light, number, lit[:, None])
        np.add.at(both, number, inwards)
        light /= np.maximum(np.linalg.norm(light, axis=1, keepdims=True), 1e-300)
        onwards = np.where((count == 2)[number][..., None], both[number] - inwards, 0.0)
        room_m = np.full(len(edge), np.inf)
        return Outline(ends, edge, corner, lit, light[number], onwards, ends, room_m)

    @cached_property
    def room_at_ends_m(self) -> Array:
        """As ``room_m`` of all edges that end at a corner, (m, 2)."""
        room_m = np.full(int(self.corner.max(initial=-1)) + 1, np.inf)
        np.minimum.at(room_m, self.corner, self.room_m[:, None])
        return room_m[self.corner]

    def take(self, which: NDArray[np.integer]) -> "Outline":
        """Only some of them, by index."""
        return Outline(*(getattr(self, f.name)[which] for f in fields(Outline)))

    @staticmethod
    def together(parts: "Sequence[Outline]") -> "Outline":
        """Several as one, with corners numbered anew; of each, edges keep their numbers."""
        first = np.cumsum([0, *(int(part.corner.max(initial=-1)) + 1 for part in parts)])
        parts = [
            replace(part, corner=part.corner + n) for part, n in zip(parts, first[:-1], strict=True)
        ]
        columns = ([getattr(part, f.name) for part in parts] for f in fields(Outline))
        return Outline(*(np.concatenate(column) for column in columns))

    def from_elsewhere(self, place: Array) -> "Outline":
        """The same edges relative to another point, itself relative to the first."""
        ends = self.ends - place
        lit = np.cross(ends[:, 0], ends[:, 1])
        lit *= np.sign(np.sum(lit * self.lit, axis=1, keepdims=True))
        lit /= np.maximum(np.linalg.norm(lit, axis=1, keepdims=True), 1e-300)
        return Outline.of(ends, self.edge, self.corner, lit)


def outline(item: SceneObject, source_m: Array) -> Outline:
    """The outline of an object from a point, with what of it the object itself hides or shows in
    front of itself. Faces of a closed one that are seen edge on count as turned away, from wherever
    they are: of a box on whose side both ends of a way stand each sees its nearer edge.
    """
    edges = item.geometry.edges
    points = item.vertices_m - source_m
    size = float(np.abs(points[edges.ends]).max(initial=0.0))
    faces = np.ascontiguousarray(edges.faces)
    side = kernel(_sides)(np.ascontiguousarray(points), faces, edge_on_m(points)) * edges.along
    balance = np.add.reduceat(side[edges.half_edges], edges.first) if len(edges.first) else side
    on_it = np.flatnonzero(np.abs(balance) == edges.count)
    ends = points[edges.ends[on_it]]
    lit = -np.sign(balance[on_it])[:, None] * np.cross(ends[:, 0], ends[:, 1])
    length = np.linalg.norm(lit, axis=1)
    seen = length > 1e-12 * size**2  # not end on
    lit = lit[seen] / length[seen, None]
    return Outline.of(ends[seen], on_it[seen], edges.ends[on_it][seen], lit)


def edge_on_m(points: Array) -> float:
    """Of a mesh with corners (n, 3): heights over its faces up to which these are seen edge on, the
    same from everywhere.
    """
    return _EDGE_ON * float(np.ptp(points, axis=0).max(initial=0.0)) if len(points) else 0.0


def _sides(points: Array, faces: Indices, edge_on_m: float) -> Indices:
    """Of the three half-edges of each face, (3 n,): 1 of faces that turn their inside to the
    origin, as all do that it is less than ``edge_on_m`` over, else -1.
    """
    height = np.empty(len(faces))
    volume = 0.0
    for i in range(len(faces)):
        a, b, c = points[faces[i, 0]], points[faces[i, 1]], points[faces[i, 2]]
        normal = np.cross(b - a, c - a)
        turn = np.sum(normal * a)
        height[i] = turn / max(np.sqrt(np.sum(normal**2)), 1e-300)
        volume += turn
    inwards = 1 if volume >= 0 else -1
    side = np.empty(3 * len(faces), dtype=np.int64)
    for i in range(len(faces)):
        is_inside = height[i] > 0
        if abs(height[i]) <= edge_on_m:
            is_inside = inwards > 0
        side[3 * i : 3 * i + 3] = 1 if is_inside else -1
    return side
