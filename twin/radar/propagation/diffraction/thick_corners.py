"""Waves by the corner of a thick obstacle: that of its edges which the source sees, and behind it
that of those which the points see.

Of each two edges, one behind the other, `knife_edge` knows the field behind both as if these were
infinitely long. Where two such pairs meet at right angles across the way, at a corner each, the
heights over both pairs are independent, and the field behind both planes is a product: with t_1 the
share of the wave that the first plane's one edge takes, t_2 the second's, t_12 what both take, and
l of the other edges, it is 1 - t_1 l_1 - t_2 l_2 + t_12 l_12. What of it the straight wave and the
waves over each pair of edges don't hold is the wave by the corners.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.radar.propagation.diffraction.double_bends import DoubleBends
from twin.radar.propagation.diffraction.knife_edge import knife_edge_factor
from twin.radar.propagation.diffraction.rims import DiffractedPaths
from twin.radar.propagation.diffraction.two_edges import ONE_EDGE
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.rows import dots, lengths, phasors

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_ALIGNED = 0.95  # cosine between edges of both corners, at least
_SQUARE = 0.3  # cosine between a corner's edges as seen along the way, at most
_SAME_M = 1e-6  # of places of one corner, at most
_BEHIND = 0.95  # cosine between the way and that from one corner to the other, at least
_SEEN = 0.5  # of the length of an edge, as seen along the way, at least


class CornerPairs(NamedTuple):
    """Corners of one obstacle, the one nearer to the source first, (n, 2, 3) from there; and unit
    vectors along both edges of the first, away from it, (n, 2, 3).
    """

    places: Array
    edges: Array

    @staticmethod
    def of(seen: Outline, towards: Array) -> "CornerPairs":
        """Convex ones of edges that the source or the points see, aligned with each other and about
        square across a way (3,).
        """
        way = towards / np.linalg.norm(towards)
        corners = _corners(seen, way)
        cosine = np.einsum("iad,jbd->ijab", corners.edges, corners.edges)
        as_they_are = np.minimum(cosine[..., 0, 0], cosine[..., 1, 1])
        swapped = np.minimum(cosine[..., 0, 1], cosine[..., 1, 0])
        behind = corners.places - corners.places[:, None]
        is_behind = behind @ way > _BEHIND * np.linalg.norm(behind, axis=2) + _SAME_M
        i, j = np.nonzero(is_behind & (np.maximum(as_they_are, swapped) > _ALIGNED))
        order = np.argsort(lengths(corners.places[j] - corners.places[i]), kind="stable")
        taken, pairs = set[int](), []
        for one, other in zip(i[order].tolist(), j[order].tolist(), strict=True):
            if taken.isdisjoint((one, other)):
                taken |= {one, other}
                pairs.append((one, other))
        both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        return CornerPairs(corners.places[both], corners.edges[both[:, 0]])


class _Corners(NamedTuple):
    places: Array
    edges: Array


def _corners(seen: Outline, way: Array) -> _Corners:
    """Places where two edges meet that are about square across a way, with the light outside."""
    along = seen.lines.along
    inwards = np.stack([along, -along], axis=1).reshape(-1, 3)
    places, lit = seen.ends.reshape(-1, 3), np.repeat(seen.lit, 2, axis=0)
    across = inwards - (inwards @ way)[:, None] * way
    size = lengths(across)
    some = np.flatnonzero(size > _SEEN)
    places, inwards, lit = places[some], inwards[some], lit[some]
    across = across[some] / size[some, None]
    i, j = cKDTree(places).query_pairs(_SAME_M, output_type="ndarray").T
    is_corner = np.abs(dots(across[i], across[j])) < _SQUARE
    is_corner &= (dots(lit[i], inwards[j]) < 0) & (dots(lit[j], inwards[i]) < 0)
    i, j = i[is_corner], j[is_corner]
    _, first = np.unique(np.round(places[i] / _SAME_M), axis=0, return_index=True)
    i, j = i[first], j[first]
    return _Corners(places[i], np.stack([inwards[i], inwards[j]], axis=1))


class _Behind(NamedTuple):
    """Behind two parallel edges: what each takes of the wave, (n, 2), and what both planes leave,
    (n,); and whether the straight wave passes each.
    """

    taken: Complex
    left: Complex
    is_lit: Flags

    @property
    def both(self) -> Complex:
        """What both edges take."""
        return np.asarray(self.left - 1 + self.taken.sum(axis=1))


@dataclass(frozen=True, eq=False)
class ThickCorners:
    """Corners at ``stops`` (n, 2, 3), the one nearer to the ``source`` (n, 3) first; ``edges`` (n,
    2, 3): unit vectors along both edges, away from these; ``known``: places (n, 3) to which the
    other waves are known, and go on from past borders of shadows.
    """

    source: Array
    known: Array
    wavenumber: float
    stops: Array
    edges: Array

    def waves(self, path: Indices, places: Array) -> tuple[Complex, Array]:
        """Of some of them (m,), by number, at places (m, 3), over the straight one, without the
        phases by which their paths are longer; and these.
        """
        one, other = (self._behind(axis, path, places) for axis in (0, 1))
        whole = 1 - np.sum(one.taken * other.taken, axis=1) + one.both * other.both
        one_lit, other_lit = (is_lit[path] for is_lit in self._known_lit)
        rest = ~other_lit * (one.left - one_lit) + ~one_lit * (other.left - other_lit)
        rest += one_lit | other_lit
        turns = [self.source[path], *self.stops[path].swapaxes(0, 1), places]
        way = sum(lengths(end - begin) for begin, end in pairwise(turns))
        longer = self.wavenumber * (way - lengths(places - turns[0]))
        return (whole - rest) * phasors(longer), longer

    def wave(self, path: Indices, places: Array) -> tuple[Complex, Array]:
        """Factors (m,) over what they are where they are known, and by which phases they are longer
        than there, beside straight ones.
        """
        wave, longer = self.waves(path, places)
        known, known_longer = self._known_waves
        return wave / known[path], longer - known_longer[path]

    @property
    def apart(self) -> Array:
        """1 - correlation^2 of the edges one behind the other, (n,)."""
        turns = [self.source, *self.stops.swapaxes(0, 1), self.known]
        a, b, c = (lengths(end - begin) for begin, end in pairwise(turns))
        return np.asarray(1 - a * c / ((a + b) * (b + c)))

    @cached_property
    def is_plain(self) -> Flags:
        """Whether the straight waves to known places pass both of parallel edges, or neither."""
        every = np.arange(len(self.known))
        pairs = [self._behind(axis, every, self.known).is_lit for axis in (0, 1)]
        return np.asarray(np.all([lit[:, 0] == lit[:, 1] for lit in pairs], axis=0))

    @cached_property
    def _known_waves(self) -> tuple[Complex, Array]:
        return self.waves(np.arange(len(self.known)), self.known)

    @cached_property
    def _known_lit(self) -> tuple[Flags, Flags]:
        """Whether the straight waves pass both edges of each pair."""
        every = np.arange(len(self.known))
        one, other = (self._behind(axis, every, self.known).is_lit for axis in (0, 1))
        return np.asarray(one.all(axis=1)), np.asarray(other.all(axis=1))

    def _behind(self, axis: int, path: Indices, places: Array) -> _Behind:
        """Behind the edges along one of both axes."""
        light = np.repeat(-self.edges[:, None, 1 - axis], 2, axis=1)
        along = self.edges[:, axis]
        bends = DoubleBends(self.source, self.known, self.wavenumber, self.stops, along, light)
        field = bends.field(path, places)
        over = np.where(field.is_lit, -1, 1) * knife_edge_factor(field.q) * phasors(-field.q)
        left = field.is_straight + np.sum(field.alone * over, axis=1)
        left = left + field.last * phasors(-field.longer)
        return _Behind(1 - field.is_lit - over, left, field.is_lit)


def by_thick_corners(
    pairs: CornerPairs,
    paths: DiffractedPaths,
    source: Array,
    places: Array,
    wavenumber: float,
    faintest: float,
) -> tuple[DiffractedPaths, Indices]:
    """Paths to points, at ``places`` (n, 3), by pairs of corners of an obstacle, down to an
    amplitude; and the rows of those that they replace among ``paths`` over its edges and their
    ends: over ends there, and over the edge between both corners.

    Where the straight way passes one edge of two, and not the other, these remain.
    """
    found, rows = [paths.take(np.zeros(0, dtype=np.intp))], [np.zeros(0, dtype=np.int64)]
    ends = np.flatnonzero(paths.corner.any(axis=(1, 2)))
    if not len(ends) or not len(pairs.places):
        return found[0], rows[0]
    at = paths.stops[:, 0] - source
    near = cKDTree(at[ends]).query_ball_point(pairs.places, _SAME_M)
    for both, edges, met in zip(*pairs, near, strict=True):
        there = ends[np.sort(np.concatenate([*met]).astype(np.int64))]
        if not len(there):
            continue
        points, first = np.unique(paths.point[there], return_index=True)
        first = there[first]
        every = np.ones((len(points), 1))
        corners = ThickCorners(
            every * source,
            places[points],
            wavenumber,
            every[..., None] * (source + both),
            every[..., None] * edges,
        )
        some = np.flatnonzero(corners.is_plain & (corners.apart > ONE_EDGE))
        edge = np.flatnonzero(_is_between(at, paths.along, both))
        there = np.concatenate([there, edge])
        rows.append(there[np.isin(paths.point[there], points[some])])
        amplitude, longer = corners.waves(some, corners.known[some])
        strong = np.abs(amplitude) >= faintest
        some, amplitude, longer = some[strong], amplitude[strong], longer[strong]
        one = paths.take(first[some])
        outwards = -edges.sum(axis=0) / np.linalg.norm(edges.sum(axis=0))
        found.append(
            replace(
                one,
                stops=corners.stops[some],
                aside=np.linalg.norm(one.aside, axis=2, keepdims=True) * outwards,
                corner=corners.edges[some],
                amplitude=amplitude,
                longer_m=longer / wavenumber,
            )
        )
    return DiffractedPaths.concatenate(found), np.concatenate(rows)


def _is_between(at: Array, along: Array, both: Array) -> Flags:
    """Whether places on edges (n, 3), along unit vectors, are on the edge between two corners."""
    way = both[1] - both[0]
    length = np.linalg.norm(way)
    off = np.cross(at - both[0], way / length)
    is_along = np.abs(along @ way) > (1 - 1e-9) * length
    return np.asarray((lengths(off) < _SAME_M) & is_along)
