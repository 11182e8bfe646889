"""What the rim of an obstacle adds to a wave: Kirchhoff's integral, edge by edge and end by end."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import beyond_end, over_edge, over_two_edges
from twin.radar.propagation.meshes.silhouettes import Outline

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_UNHEARD = 0.1  # of the faintest way, below which an edge's end adds nothing to others' there
#: Of the first Fresnel zone's radius: what stands closer to an edge doesn't disturb a way over it.
_BESIDE = 0.05
_ALIKE_M = 1e-3  # 0.04 rad at the ends of a band of 4 GHz
_TOGETHER_M = 0.1  # 1 degree from 6 m off
_ALIGNED = 0.9  # cosine from which two edges are passed as one after the other


@dataclass(frozen=True, eq=False)
class DiffractedPaths:
    """Over edges, each (n, ...): to which point and over which obstacle; where it passes the edges,
    the one nearer to the source first, and which way these run; amplitude over the straight way's
    and length beyond it; how far off the edge the straight way passes in the light.

    ``stops`` (n, 2, 3) are the same twice for one edge; ``aside`` (n, 2, 3) of them, rays may tell
    whether a way is open. ``edge`` is the number of one of them.
    Over an edge's end ``along`` is 0 and ``lit_m`` inf; over two edges ``lit_m`` is inf.
    """

    point: Indices
    item: Indices
    edge: Indices
    stops: Array
    aside: Array
    along: Array
    amplitude: NDArray[np.complex128]
    longer_m: Array
    lit_m: Array

    def take(self, which: NDArray[Any]) -> "DiffractedPaths":
        """Only some of them, by index or mask."""
        return DiffractedPaths(*(getattr(self, f.name)[which] for f in fields(DiffractedPaths)))

    @staticmethod
    def concatenate(parts: Sequence["DiffractedPaths"]) -> "DiffractedPaths":
        """One after the other."""
        names = [f.name for f in fields(DiffractedPaths)]
        return DiffractedPaths(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def farthest(faintest: float) -> float:
    """Difference of path in radians at which a knife edge has fallen to an amplitude."""
    return 1 / (4 * np.pi * faintest**2)


def over_rim(
    rim: Outline, source: Array, places: Array, wavenumber: float, faintest: float
) -> DiffractedPaths:
    """What the outline of an obstacle, as seen from a source, adds at points (n, 3), down to an
    amplitude.
    """
    pairs = _pairs(rim, places - source, wavenumber, farthest(faintest))
    ends = [_past_end(rim, pairs, end, _UNHEARD * faintest) for end in (0, 1)]
    paths = DiffractedPaths.concatenate(
        [_over_edge(rim, pairs), _summed(DiffractedPaths.concatenate(ends))]
    )
    return replace(paths, stops=paths.stops + source)


def over_edges(
    rim: Outline, source: Array, places: Array, wavenumber: float, faintest: float
) -> DiffractedPaths:
    """The same without the edges' ends."""
    paths = _over_edge(rim, _pairs(rim, places - source, wavenumber, farthest(faintest)))
    return replace(paths, stops=paths.stops + source)


def near_edges(
    rim: Outline, way: Array, radius_m: float, wavenumber: float, faintest: float
) -> Indices:
    """Edges that may count for a point within a sphere at the end of a way (3,): a point that far
    off changes no difference of path by more than twice that.
    """
    most = farthest(faintest) + 2 * wavenumber * radius_m
    return np.unique(_pairs(rim, way[None], wavenumber, most).edge)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Points and edges close to each other's straight way, (n, ...).

    ``way`` leads from the source to the point, ``lit_m`` (n,) off the edge's plane; the shortest
    way over the edge's line meets it ``at`` (m) from the first end and is ``q`` radians longer.
    """

    point: Indices
    edge: Indices
    way: Array
    lit_m: Array
    at: Array
    q: Array
    wavenumber: float

    def depth(self, place: Array) -> Array:
        """How far along the straight way places are, 0 to 1."""
        depth: Array = np.sum(place * self.way, axis=1) / np.sum(self.way**2, axis=1)
        return depth


def _pairs(rim: Outline, way: Array, wavenumber: float, most: float) -> _Pairs:
    """Pairs of points, at the end of ways (n, 3), and edges whose way is at most so many radians
    longer.
    """
    first, along = rim.ends[:, 0], _along(rim)[0]
    # Feet of the perpendiculars on an edge's line, and how far off it the source and points are.
    at_source = -np.sum(first * along, axis=1)
    foot = first + at_source[:, None] * along
    off_source = np.linalg.norm(foot, axis=1)
    square = np.sum(way**2, axis=1)[:, None]
    forward, across = way @ along.T, way @ foot.T
    off_place = np.sqrt(np.maximum(square - forward**2 - 2 * across + off_source**2, 0))
    # The square of the broken way's length less that of the straight one's.
    more = np.maximum(2 * (off_source * off_place + off_source**2 - across), 0)
    q = np.maximum(wavenumber * more / (np.sqrt(square + more) + np.sqrt(square)), 1e-12)
    i, j = np.nonzero(q <= most)
    both = np.maximum(off_source[j] + off_place[i, j], 1e-300)
    at_place = at_source[j] + forward[i, j]
    at = (at_source[j] * off_place[i, j] + at_place * off_source[j]) / both
    return _Pairs(i, j, way[i], np.sum(rim.lit[j] * way[i], axis=1), at, q[i, j], wavenumber)


def _along(rim: Outline) -> tuple[Array, Array]:
    """Unit vectors (m, 3) along edges, and lengths."""
    side = rim.ends[:, 1] - rim.ends[:, 0]
    length = np.linalg.norm(side, axis=1)
    return side / length[:, None], length


def _over_edge(rim: Outline, pairs: _Pairs) -> DiffractedPaths:
    """Over the edge itself, where the shortest way meets it."""
    along, length = (x[pairs.edge] for x in _along(rim))
    place = rim.ends[pairs.edge, 0] + pairs.at[:, None] * along
    depth = pairs.depth(place)
    inside = (pairs.at > 0) & (pairs.at < length) & (depth > 0) & (depth < 1)
    some = np.flatnonzero(inside)
    sign = np.where(pairs.lit_m[some] > 0, -1, 1)
    amplitude = sign * over_edge(pairs.q[some])
    lit_m = (pairs.lit_m * depth)[some]
    return _paths_by(rim, pairs, some, place, pairs.q, along, amplitude, lit_m)


def _past_end(rim: Outline, pairs: _Pairs, end: int, faintest: float) -> DiffractedPaths:
    """What is missing beyond one end of edges; the ends' numbers stand for the item."""
    place = rim.ends[pairs.edge, end]
    length = np.linalg.norm(pairs.way, axis=1)
    broken = np.linalg.norm(place, axis=1) + np.linalg.norm(pairs.way - place, axis=1)
    p = np.maximum(pairs.wavenumber * (broken - length) - pairs.q, 0)
    # It falls as this, the first term of its series.
    loud = np.sqrt(pairs.q) / (4 * np.pi * np.maximum(np.sqrt(p) * (p + pairs.q), 1e-30))
    depth = pairs.depth(place)
    some = np.flatnonzero((depth > 0) & (depth < 1) & (loud > faintest))
    inwards = pairs.at if end == 0 else _along(rim)[1][pairs.edge] - pairs.at
    turn = np.where(pairs.lit_m[some] > 0, 1, -1) * np.where(inwards[some] > 0, 1, -1)
    amplitude = turn * beyond_end(pairs.q[some], p[some])
    none, far = np.zeros_like(pairs.way), np.full(len(some), np.inf)
    paths = _paths_by(rim, pairs, some, place, pairs.q + p, none, amplitude, far)
    return replace(paths, item=rim.corner[pairs.edge[some], end])


def _paths_by(
    rim: Outline,
    pairs: _Pairs,
    some: Indices,
    place: Array,
    radians: Array,
    along: Array,
    amplitude: NDArray[np.complex128],
    lit_m: Array,
) -> DiffractedPaths:
    """Some of the pairs as ways by way of a place each."""
    there, back = (np.linalg.norm(x, axis=1)[some] for x in (place, pairs.way - place))
    zone = np.sqrt(2 * np.pi / pairs.wavenumber * there * back / (there + back))
    aside = _BESIDE * zone[:, None] * rim.lit[pairs.edge[some]]
    return DiffractedPaths(
        point=pairs.point[some],
        item=np.zeros(len(some), dtype=np.int64),
        edge=rim.edge[pairs.edge[some]],
        stops=np.repeat(place[some][:, None], 2, axis=1),
        aside=np.repeat(aside[:, None], 2, axis=1),
        along=along[some],
        amplitude=amplitude,
        longer_m=radians[some] / pairs.wavenumber,
        lit_m=lit_m,
    )


def _summed(ends: DiffractedPaths) -> DiffractedPaths:
    """Ends of edges that meet, added up."""
    corners = int(ends.item.max(initial=0)) + 1
    _, one, same = np.unique(
        ends.point * corners + ends.item, return_index=True, return_inverse=True
    )
    amplitude, aside = np.zeros(len(one), dtype=np.complex128), np.zeros((len(one), 2, 3))
    np.add.at(amplitude, same, ends.amplitude)
    np.add.at(aside, same, ends.aside)
    strongest = ends.take(one)
    aside = _unit(aside) * np.linalg.norm(strongest.aside, axis=-1, keepdims=True)
    none = np.zeros(len(one), dtype=np.int64)
    return replace(strongest, aside=aside, amplitude=amplitude, item=none)


def bundled(paths: DiffractedPaths, wavenumber: float) -> DiffractedPaths:
    """Ways to a point that are alike in length and place as one: a curved outline has hundreds."""
    cells = np.hstack(
        [
            paths.point[:, None],
            np.floor(paths.longer_m / _ALIKE_M)[:, None],
            np.floor(paths.stops[:, 0] / _TOGETHER_M),
        ]
    )
    _, same = np.unique(cells, axis=0, return_inverse=True)
    order = np.lexsort((-np.abs(paths.amplitude), same))
    one = order[np.unique(same[order], return_index=True)[1]]
    turn = np.exp(-1j * wavenumber * (paths.longer_m - paths.longer_m[one][same]))
    amplitude = np.zeros(len(one), dtype=np.complex128)
    np.add.at(amplitude, same, paths.amplitude * turn)
    return replace(paths.take(one), amplitude=amplitude)


def loud(level: Array, group: Indices, faintest: float) -> NDArray[np.bool_]:
    """Levels (n,) that are not below so much of the strongest of their group."""
    strongest = np.zeros(int(group.max(initial=0)) + 1)
    np.maximum.at(strongest, group, level)
    is_loud: NDArray[np.bool_] = level >= faintest * strongest[group]
    return is_loud


def meeting(one: Indices, other: Indices) -> tuple[Indices, Indices]:
    """All pairs of rows with the same number."""
    order = np.argsort(other, kind="stable")
    first, last = (np.searchsorted(other[order], one, side=side) for side in ("left", "right"))
    count = last - first
    rows = np.repeat(np.arange(len(one)), count)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    return rows, order[np.repeat(first, count) + within]


def successive(near: DiffractedPaths, far: DiffractedPaths) -> tuple[Indices, Indices]:
    """Ways over edges of ``near``, seen from the source, and of ``far``, seen from the points, that
    are met one after the other on the same side of an obstacle: one pair for each of ``near`` that
    is not seen from the point as well.
    """
    i, j = meeting(near.point, far.point)
    same = np.zeros(len(near.point), dtype=bool)
    same[i[near.edge[i] == far.edge[j]]] = True
    sides = np.sum(_unit(near.aside[i, 0]) * _unit(far.aside[j, 0]), axis=1)
    runs = np.abs(np.sum(near.along[i] * far.along[j], axis=1))
    rows = np.flatnonzero(~same[i] & (np.minimum(sides, runs) > _ALIGNED))
    best = np.round(np.minimum(sides, runs)[rows], 2)
    rows = rows[np.lexsort((far.longer_m[j[rows]], -best, i[rows]))]
    first = np.unique(i[rows], return_index=True)[1]
    return i[rows][first], j[rows][first]


def over_two(
    source: Array, places: Array, near: DiffractedPaths, far: DiffractedPaths, wavenumber: float
) -> tuple[DiffractedPaths, Array, NDArray[np.bool_]]:
    """Ways over two edges from a source to points (n, 3), each over one of ``near`` and one of
    ``far``, (n,), whichever comes first, which are ways over them alone; 1 less the square of the
    edges' correlation, which is 0 for one edge; and which of the ways over one of them remain,
    (n, 2).
    """
    swap = _reach(near, source) > _reach(far, source)
    one, other = _either(swap, far, near), _either(swap, near, far)
    first, second = one.stops[:, 0], other.stops[:, 0]
    for _ in range(3):  # a string drawn tight
        first = _shortest(source, second, first, one.along)
        second = _shortest(first, places, second, other.along)
    a, b, c = (
        np.linalg.norm(way, axis=1) for way in (first - source, second - first, places - second)
    )
    correlation = np.sqrt(a * c / np.maximum((a + b) * (b + c), 1e-300))
    amplitude, alone = over_two_edges(
        wavenumber * np.stack([one.longer_m, other.longer_m], axis=1),
        np.stack([one.lit_m > 0, other.lit_m > 0], axis=1),
        correlation,
    )
    paths = replace(
        one,
        stops=np.stack([first, second], axis=1),
        aside=np.stack([one.aside[:, 0], other.aside[:, 0]], axis=1),
        amplitude=amplitude,
        longer_m=a + b + c - np.linalg.norm(places - source, axis=1),
        lit_m=np.full(len(a), np.inf),
    )
    return paths, 1 - correlation**2, np.where(swap[:, None], alone[:, ::-1], alone)


def _reach(paths: DiffractedPaths, source: Array) -> Array:
    reach: Array = np.linalg.norm(paths.stops[:, 0] - source, axis=1)
    return reach


def _either(
    which: NDArray[np.bool_], one: DiffractedPaths, other: DiffractedPaths
) -> DiffractedPaths:
    """One where it holds, else the other."""

    def select(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
        return np.where(which.reshape(-1, *(1,) * (a.ndim - 1)), a, b)

    return DiffractedPaths(
        *(select(getattr(one, f.name), getattr(other, f.name)) for f in fields(DiffractedPaths))
    )


def _shortest(begin: Array, end: Array, place: Array, along: Array) -> Array:
    """Where the shortest way between points over lines (n, 3) meets these."""
    at, off = [], []
    for point in (begin, end):
        way = point - place
        at.append(np.sum(way * along, axis=1))
        off.append(np.linalg.norm(way - at[-1][:, None] * along, axis=1))
    share = (at[0] * off[1] + at[1] * off[0]) / np.maximum(off[0] + off[1], 1e-300)
    crossing: Array = place + share[:, None] * along
    return crossing


def _unit(way: Array) -> Array:
    unit: Array = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-300)
    return unit
