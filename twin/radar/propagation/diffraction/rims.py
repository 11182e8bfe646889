"""Diffracted paths over the rim of an obstacle: Kirchhoff's integral, edge by edge, end by end."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.diffraction.knife_edge import (
    knife_edge_factor,
    missing_edge_factor,
)
from twin.radar.propagation.meshes.silhouettes import Lines, Outline
from twin.radar.rows import alike, dots, first_rows, lengths

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_NEGLIGIBLE = 0.1  # of the faintest path: share below which the wave from an edge's end is left out
_OF_TWO = 0.3  # likewise, where nothing but ends is looked for
_STRAIGHT = 0.985  # cosine: 10 deg, from which on a corner is sharp
_FAR = 3.0  # rad: of a path over an edge's end over the edge's own one
#: Of the first Fresnel zone's radius: obstacles closer to an edge don't disturb a path over it; at
#: most, where rays may err by more than a third of the first.
_BESIDE, _FAR_BESIDE = 0.02, 0.05
#: Of a path over an edge's line beside the direct one: from there on an edge is exactly in the way.
_EXACT_RAD = 1e-8
#: Of the root of wavelength and distance: by how much points are moved that an edge's end is
#: exactly in the way to; and of the sum of unit vectors along edges: below, they go straight on.
_MOVED, _STRAIGHT_ON = 3e-5, 0.1
_UNSURE_M = 3e-4  # from an edge within which float32 rays may err; as much more for every 10 m
_MERGED_LENGTH_M = 1e-3  # 0.04 rad at the ends of a band of 4 GHz
_MERGED_PLACE_M = 0.01  # of fences, posts stand by themselves


@dataclass(frozen=True, eq=False)
class DiffractedPaths:
    """Paths over one or two edges of obstacles.

    point, item, edge : (n,)
        Numbers of the point that the path leads to, of the obstacle, and of one of the edges.
    stops : (n, 2, 3)
        Where the path passes the edges, the one nearer to the source first; for one edge the same
        place twice.
    aside : (n, 2, 3)
        Offset from these into the light, where rays test whether the path is clear.
    along : (n, 3)
        Unit vector along the edge; 0 for a path over an edge's end.
    corner : (n, 2, 3)
        Of a path over a sharp corner of two edges, unit vectors along both from there; else 0.
    amplitude : (n,)
        Over that of the direct wave, without the phase of the longer path.
    longer_m : (n,)
        By how much the path is longer than the direct one.
    lit_m : (n,)
        Distance of the direct path from the edge, positive on the lit side; inf for a path over an
        edge's end or over two edges.
    """

    point: Indices
    item: Indices
    edge: Indices
    stops: Array
    aside: Array
    along: Array
    corner: Array
    amplitude: Complex
    longer_m: Array
    lit_m: Array

    def take(self, which: NDArray[Any]) -> "DiffractedPaths":
        """Only some of them, by index or mask."""
        return DiffractedPaths(*(getattr(self, f.name)[which] for f in fields(DiffractedPaths)))

    def into_light(self, source: Array) -> Array:
        """Unit vectors (n, 3) across edges and the paths to them, into the light; 0 at ends."""
        across = np.cross(self.along, self.stops[:, 0] - source)
        across *= np.sign(dots(across, self.aside[:, 0]))[:, None]
        unit: Array = across / np.maximum(lengths(across), 1e-300)[:, None]
        return unit

    @staticmethod
    def concatenate(parts: Sequence["DiffractedPaths"]) -> "DiffractedPaths":
        """One after the other."""
        names = [f.name for f in fields(DiffractedPaths)]
        return DiffractedPaths(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def farthest(faintest: float) -> float:
    """Phase of the longer path at which the knife-edge factor has fallen to an amplitude."""
    return 1 / (4 * np.pi * faintest**2)


def beside_corners(rim: Outline, source: Array, places: Array, wavenumber: float) -> Array:
    """Points (n, 3), of which those are moved whose direct path passes an edge's end exactly, as at
    round coordinates: between the edges that meet there, since what waves a point has depends on
    the side that the corner is approached from.
    """
    close = _pairs(rim, places - source, wavenumber, _EXACT_RAD)
    to_ends = np.abs(np.stack([close.at, rim.lines.length_m[close.edge] - close.at], axis=1))
    moved_m = _MOVED * np.sqrt(2 * np.pi / wavenumber * lengths(close.direct))
    rows = np.flatnonzero(to_ends.min(axis=1, initial=np.inf) < moved_m)
    points, first = np.unique(close.point[rows], return_index=True)
    rows = rows[first]
    edge, end = close.edge[rows], to_ends[rows].argmin(axis=1)
    along = (1 - 2 * end)[:, None] * rim.lines.along[edge]
    between = along + rim.onwards[edge, end]
    between = np.where((lengths(between) > _STRAIGHT_ON)[:, None], between, along)
    moved = places.copy()
    moved[points] += (moved_m[rows] / lengths(between))[:, None] * between
    return moved


def rim_paths(
    rim: Outline, source: Array, places: Array, wavenumber: float, faintest: float
) -> DiffractedPaths:
    """Paths over the outline of an obstacle, as seen from a source, to points (n, 3), down to an
    amplitude: over its edges and over their ends.
    """
    pairs = _pairs(rim, places - source, wavenumber, farthest(faintest))
    paths = [_edge_paths(pairs), _paths_over_ends(pairs, _NEGLIGIBLE * faintest)]
    both = DiffractedPaths.concatenate(paths)
    return replace(both, stops=both.stops + source)


def edge_paths(
    rim: Outline, source: Array, places: Array, wavenumber: float, faintest: float
) -> DiffractedPaths:
    """Only the paths over edges, without those over their ends."""
    paths = _edge_paths(_pairs(rim, places - source, wavenumber, farthest(faintest)))
    return replace(paths, stops=paths.stops + source)


def end_waves(
    rim: Outline, direct: Array, wavenumber: float, faintest: float
) -> tuple[Indices, Array, Complex]:
    """Only the paths over ends of edges, down to an amplitude, to the ends of vectors (n, 3) from
    the source: rows of these, where the paths pass the ends, from the source, and amplitudes; of
    each edge to 1 / (2 `_FAR`) where its end is far from where its own path meets it.
    """
    pairs = _pairs(rim, direct, wavenumber, farthest(faintest))
    ends = _ends(pairs, _OF_TWO * faintest, _FAR)
    ends = ends.take(np.abs(ends.amplitude) >= faintest)
    return pairs.point[ends.pair], rim.ends[pairs.edge[ends.pair], ends.end], ends.amplitude


def near_edges(
    rim: Outline, direct: Array, radius_m: float, wavenumber: float, faintest: float
) -> Indices:
    """Edges that may diffract a wave to points within a sphere around the end of a direct path
    (3,).

    Within the sphere the path difference changes by at most twice the radius.
    """
    most = farthest(faintest) + 2 * wavenumber * radius_m
    return np.unique(_pairs(rim, direct[None], wavenumber, most).edge)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of a point and an edge near the direct path to it, (n, ...).

    ``places`` (m, 3) are all points relative to the source; the shortest path over the edge's line
    meets it ``at`` (m) from the first end and is longer than the direct path by a phase ``q``;
    ``lit_m``: the point's distance from the shadow's border, positive in the light; of one on the
    same side of the edge as the source, where there is no border, from the edge.
    """

    rim: Outline
    places: Array
    point: Indices
    edge: Indices
    at: Array
    q: Array
    lit_m: Array
    wavenumber: float

    def take(self, which: NDArray[Any]) -> "_Pairs":
        """Only some of them, by index or mask."""
        point, edge, at, q, lit_m = (
            x[which] for x in (self.point, self.edge, self.at, self.q, self.lit_m)
        )
        return _Pairs(self.rim, self.places, point, edge, at, q, lit_m, self.wavenumber)

    @cached_property
    def direct(self) -> Array:
        """Vectors (n, 3) from the source to the point."""
        direct: Array = self.places[self.point]
        return direct

    def depth(self, place: Array) -> Array:
        """How far along the direct path places are, 0 to 1."""
        depth: Array = dots(place, self.direct) / dots(self.places, self.places)[self.point]
        return depth


def _pairs(rim: Outline, direct: Array, wavenumber: float, most: float) -> _Pairs:
    """Pairs of points, at the ends of vectors (n, 3) from the source, and edges, over which the
    path is longer by at most a phase ``most``.
    """
    direct, ends, lit = (np.ascontiguousarray(x) for x in (direct, rim.ends, rim.lit))
    point, edge, at, q, lit_m = kernel(_near)(rim.lines, ends, lit, direct, wavenumber, most)
    return _Pairs(rim, direct, point, edge, at, q, lit_m, wavenumber)


def _near(
    lines: Lines, ends: Array, lit: Array, direct: Array, wavenumber: float, most: float
) -> tuple[Indices, Indices, Array, Array, Array]:
    along, foot, at_source = lines.along, lines.foot, lines.at_m
    point, edge = [0 for _ in range(0)], [0 for _ in range(0)]
    at, phase, lit_m = [0.0 for _ in range(0)], [0.0 for _ in range(0)], [0.0 for _ in range(0)]
    for i in range(len(direct)):
        x, y, z = direct[i]
        square = x * x + y * y + z * z
        straight = np.sqrt(square)
        farthest = 0.5 * ((straight + most / wavenumber) ** 2 - square)
        for j in range(len(ends)):
            forward = x * along[j, 0] + y * along[j, 1] + z * along[j, 2]
            across = x * foot[j, 0] + y * foot[j, 1] + z * foot[j, 2]
            off = lines.off_m[j]
            off_square = max(square - forward**2 - 2 * across + off * off, 0.0)
            # Most are too far for sure, which needs no root.
            product = farthest + across - off * off
            if product < 0 or off * off * off_square > product * product * (1 + 1e-9):
                continue
            off_place = np.sqrt(off_square)
            # The square of the path's length less that of the direct one.
            more = max(2 * (off * off_place + off * off - across), 0.0)
            q = max(wavenumber * more / (np.sqrt(square + more) + straight), 1e-12)
            if q <= most:
                both = max(off + off_place, 1e-300)
                at_place = at_source[j] + forward
                at.append((at_source[j] * off_place + at_place * off) / both)
                point.append(i)
                edge.append(j)
                phase.append(q)
                begin, border, beside = 0.0, 0.0, 0.0
                for axis in range(3):
                    begin += ends[j, 0, axis] * (ends[j, 0, axis] - direct[i, axis])
                    border += lit[j, axis] * direct[i, axis]
                    beside += (direct[i, axis] - forward * along[j, axis] - foot[j, axis]) ** 2
                is_one_side = begin > at_source[j] * at_place
                lit_m.append(np.sqrt(beside) if is_one_side else border)
    return np.array(point), np.array(edge), np.array(at), np.array(phase), np.array(lit_m)


def _edge_paths(pairs: _Pairs) -> DiffractedPaths:
    """Paths over the edge itself, where the shortest path meets it between its ends."""
    rim, along, length = pairs.rim, pairs.rim.lines.along, pairs.rim.lines.length_m
    pairs = pairs.take((pairs.at > 0) & (pairs.at < length[pairs.edge]))
    place = rim.ends[pairs.edge, 0] + pairs.at[:, None] * along[pairs.edge]
    depth = pairs.depth(place)
    some = np.flatnonzero((depth > 0) & (depth < 1))
    pairs, place, depth = pairs.take(some), place[some], depth[some]
    sign = np.where(pairs.lit_m > 0, -1, 1)
    amplitude = sign * knife_edge_factor(pairs.q)
    # Next to an end, where another rim may begin, the light is between both.
    to_end = np.stack([pairs.at, length[pairs.edge] - pairs.at], axis=1)
    end = to_end.argmin(axis=1)
    beside_m = _beside_m(pairs, place, rim.room_m[pairs.edge])
    is_next = to_end.min(axis=1) < beside_m
    aside = np.where(is_next[:, None], rim.aside[pairs.edge, end], rim.lit[pairs.edge])
    aside *= beside_m[:, None]
    lit_m = pairs.lit_m * depth
    return _paths_by(pairs, place, pairs.q, along[pairs.edge], aside, amplitude, lit_m)


@dataclass(frozen=True, eq=False)
class _Ends:
    """Corners, (n,), which paths of some pairs lead over, by the row of a ``pair`` whose edge ends
    there, and which ``end`` it is, 0 or 1; the phase ``p`` by which the path is longer than that
    over the edge's line; and ``amplitude``, added up over all edges that end there.
    """

    pair: Indices
    end: Indices
    p: Array
    amplitude: Complex

    def take(self, which: NDArray[Any]) -> "_Ends":
        """Only some of them, by index or mask."""
        return _Ends(self.pair[which], self.end[which], self.p[which], self.amplitude[which])


def _ends(pairs: _Pairs, faintest: float, far: float = np.inf) -> _Ends:
    """Over both ends of edges, of which paths subtract the edge missing beyond: from a phase
    ``far`` on by the first term of an asymptotic series.
    """
    rim, ends = pairs.rim, np.ascontiguousarray(pairs.rim.ends)
    pair, end, p, level = kernel(_passing)(
        ends, pairs.places, pairs.point, pairs.edge, pairs.q, pairs.wavenumber, faintest
    )
    point, edge, at, q, lit_m = (
        x[pair] for x in (pairs.point, pairs.edge, pairs.at, pairs.q, pairs.lit_m)
    )
    factor, near = -1j * level, p < far
    factor[near] = missing_edge_factor(q[near], p[near])
    inwards = np.where(end == 0, at, rim.lines.length_m[edge] - at)
    factor *= np.where((lit_m > 0) == (inwards > 0), 1, -1)
    same = alike([point, rim.corner[edge, end]])
    one = first_rows(same)
    amplitude = np.zeros(len(one), dtype=np.complex128)
    np.add.at(amplitude, same, factor)
    return _Ends(pair[one], end[one], p[one], amplitude)


def _paths_over_ends(pairs: _Pairs, faintest: float) -> DiffractedPaths:
    """Paths over both ends of edges, those that meet in one corner added up."""
    rim, ends = pairs.rim, _ends(pairs, faintest)
    pairs, end = pairs.take(ends.pair), ends.end
    place = rim.ends[pairs.edge, end]
    none, unlit_m = np.zeros_like(pairs.direct), np.full(len(end), np.inf)
    beside_m = _beside_m(pairs, place, rim.room_at_ends_m[pairs.edge, end])
    aside = beside_m[:, None] * rim.aside[pairs.edge, end]
    paths = _paths_by(pairs, place, pairs.q + ends.p, none, aside, ends.amplitude, unlit_m)
    inwards = (1 - 2 * end)[:, None] * rim.lines.along[pairs.edge]
    both = np.stack([inwards, rim.onwards[pairs.edge, end]], axis=1)
    is_sharp = both[:, 1].any(axis=1) & (dots(both[:, 0], both[:, 1]) > -_STRAIGHT)
    stops = np.stack([place, rim.past[pairs.edge, end]], axis=1)
    is_before = lengths(stops[:, 0]) > lengths(stops[:, 1])
    stops[is_before] = stops[is_before, ::-1]
    return replace(paths, stops=stops, corner=np.where(is_sharp[:, None, None], both, 0.0))


def _passing(
    ends: Array,
    places: Array,
    point: Indices,
    edge: Indices,
    q: Array,
    wavenumber: float,
    faintest: float,
) -> tuple[Indices, Indices, Array, Array]:
    """Which pairs' paths over which ends of edges, (m, 2, 3) relative to the source, count and pass
    these between source and point; by which phase they are longer than those over the edge's line;
    and their level by the first term.
    """
    rows, which = np.empty((2, 2 * len(point)), dtype=np.int64)
    more, level = np.empty((2, 2 * len(point)))
    count = 0
    for end in range(2):
        for i in range(len(point)):
            x, y, z = places[point[i]]
            a, b, c = ends[edge[i], end]
            forward, square = x * a + y * b + z * c, x * x + y * y + z * z
            if forward <= 0 or forward >= square:
                continue
            there = np.sqrt(a * a + b * b + c * c)
            back = np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2)
            p = max(wavenumber * (there + back - np.sqrt(square)) - q[i], 0.0)
            first = np.sqrt(q[i]) / (4 * np.pi * max(np.sqrt(p) * (p + q[i]), 1e-30))
            if first > faintest:
                rows[count], which[count], more[count], level[count] = i, end, p, first
                count += 1
    return rows[:count], which[:count], more[:count], level[:count]


def _paths_by(
    pairs: _Pairs,
    place: Array,
    radians: Array,
    along: Array,
    aside: Array,
    amplitude: Complex,
    lit_m: Array,
) -> DiffractedPaths:
    """Pairs as paths, each by way of a place."""
    return DiffractedPaths(
        point=pairs.point,
        item=np.zeros(len(pairs.point), dtype=np.int64),
        edge=pairs.rim.edge[pairs.edge],
        stops=np.repeat(place[:, None], 2, axis=1),
        aside=np.repeat(aside[:, None], 2, axis=1),
        along=along,
        corner=np.zeros((len(place), 2, 3)),
        amplitude=amplitude,
        longer_m=radians / pairs.wavenumber,
        lit_m=lit_m,
    )


def _beside_m(pairs: _Pairs, place: Array, room_m: Array) -> Array:
    """How far from a place on an obstacle, next to room (n,), a path passes by it."""
    there, back = lengths(place), lengths(pairs.direct - place)
    zone: Array = np.sqrt(2 * np.pi / pairs.wavenumber * there * back / (there + back))
    beside_m = np.clip(3 * unsure_m(place), _BESIDE * zone, _FAR_BESIDE * zone)
    return np.minimum(beside_m, room_m / 2)


def unsure_m(places: Array) -> Array:
    """How near to edges at places (n, 3) float32 rays may err."""
    unsure: Array = _UNSURE_M * (1 + 0.1 * lengths(places))
    return unsure


def merged(paths: DiffractedPaths, source: Array, wavenumber: float) -> DiffractedPaths:
    """Paths to a point of nearly the same length and place, and with the light on the same side, as
    one: a curved outline has hundreds. Those over ends of edges stay apart from these.
    """
    length = np.floor(paths.longer_m / _MERGED_LENGTH_M).astype(np.int64)
    place = np.floor(paths.stops[:, 0] / _MERGED_PLACE_M).astype(np.int64)
    is_twice = (paths.stops[:, 0] != paths.stops[:, 1]).any(axis=1).astype(np.int64)
    side = np.rint(paths.into_light(source)).astype(np.int64)
    same = alike([paths.point, length, *place.T, is_twice, *side.T])
    order = np.lexsort((-np.abs(paths.amplitude), same))
    one = order[np.unique(same[order], return_index=True)[1]]
    turn = np.exp(-1j * wavenumber * (paths.longer_m - paths.longer_m[one][same]))
    amplitude = np.zeros(len(one), dtype=np.complex128)
    np.add.at(amplitude, same, paths.amplitude * turn)
    return replace(paths.take(one), amplitude=amplitude)


def is_strong(level: Array, group: Indices, faintest: float) -> NDArray[np.bool_]:
    """Whether levels (n,) are at least a share ``faintest`` of the strongest of their group."""
    strongest = np.zeros(int(group.max(initial=0)) + 1)
    np.maximum.at(strongest, group, level)
    strong: NDArray[np.bool_] = level >= faintest * strongest[group]
    return strong
