"""Diffracted paths over two edges, one after the other, given the paths over each alone."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import double_knife_edge
from twin.radar.propagation.diffraction.rims import DiffractedPaths
from twin.radar.rows import matching_pairs

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: 1 less the square of the correlation of two edges, below which they count as one: 0.4 dB.
ONE_EDGE = 0.02
_ALIGNED = 0.9  # cosine from which two edges count as parallel, one behind the other


def consecutive_edges(
    near: DiffractedPaths, far: DiffractedPaths, source: Array, places: Array
) -> tuple[Indices, Indices]:
    """Pairs of paths over two parallel edges on the same side of an obstacle, one behind the other:
    one of ``near``, whose edges are seen from the source, and one of ``far``, whose edges are seen
    from the points, at ``places`` (n, 3). At most one pair for each of ``near``, and none for an
    edge seen from both; one of ``far`` that is as good as one of ``near`` has that one alone. Of
    several behind one it is the outermost as seen from the point.
    """
    i, j = matching_pairs(near.point, far.point)
    same = np.zeros(len(near.point), dtype=bool)
    same[i[(near.edge[i] == far.edge[j]) & (near.item[i] == far.item[j])]] = True
    sides = np.sum(_unit(near.aside[i, 0]) * _unit(far.aside[j, 0]), axis=1)
    runs = np.abs(np.sum(near.along[i] * far.along[j], axis=1))
    is_aligned = np.minimum(sides, runs) > _ALIGNED
    stop = near.stops[i, 0]
    before, behind = (np.linalg.norm(x - stop, axis=1) for x in (source, places[near.point[i]]))
    between = np.linalg.norm(far.stops[j, 0] - stop, axis=1)
    is_one = is_aligned & (between * (1 / before + 1 / behind) < ONE_EDGE)
    has_one = np.zeros(len(far.point), dtype=bool)
    has_one[j[is_one]] = True
    rows = np.flatnonzero(~same[i] & is_aligned & (is_one | ~has_one[j]))
    best = np.round(np.minimum(sides, runs)[rows], 2)
    height = _heights(far, source, places)[j[rows]]
    rows = rows[np.lexsort((-height, -best, i[rows]))]
    first = np.unique(i[rows], return_index=True)[1]
    return i[rows][first], j[rows][first]


def _heights(paths: DiffractedPaths, source: Array, places: Array) -> Array:
    """Of edges over the straight ways as seen from the points, as angles, negative in the light."""
    seen = places[paths.point] - source
    way = _unit(seen)
    stop = paths.stops[:, 0] - source
    off = np.linalg.norm(stop - np.sum(stop * way, axis=1)[:, None] * way, axis=1)
    height: Array = np.where(paths.lit_m > 0, -off, off) / np.linalg.norm(seen - stop, axis=1)
    return height


def double_edge_paths(
    source: Array,
    places: Array,
    near: DiffractedPaths,
    far: DiffractedPaths,
    wavenumber: float,
    cosine: Array | float = 1.0,
    faintest: float = 0.0,
) -> tuple[DiffractedPaths, Array, NDArray[np.bool_]]:
    """Paths from a source to points (n, 3) over two edges, given the paths over each alone;
    ``cosine`` of the angle between the directions into their light, ``faintest`` as of
    `double_knife_edge`.

    Returns the paths; 1 - correlation^2 of the edges (see `double_knife_edge`), 0 where both are
    one edge; and whether the path over ``near``, or over ``far``, alone remains beside it, (n, 2).
    """
    swap = _reach(near, source) > _reach(far, source)
    one, other = _either(swap, far, near), _either(swap, near, far)
    first, second = one.stops[:, 0], other.stops[:, 0]
    for _ in range(3):  # shortest path over both edges, by relaxation
        first = _shortest(source, second, first, one.along)
        second = _shortest(first, places, second, other.along)
    a, b, c = (
        np.linalg.norm(leg, axis=1) for leg in (first - source, second - first, places - second)
    )
    correlation = np.sqrt(a * c / np.maximum((a + b) * (b + c), 1e-300))
    amplitude, alone = double_knife_edge(
        wavenumber * np.stack([one.longer_m, other.longer_m], axis=1),
        np.stack([one.lit_m > 0, other.lit_m > 0], axis=1),
        cosine * correlation,
        faintest,
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
    """The rows of ``one`` where ``which``, else those of ``other``."""

    def select(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
        return np.where(which.reshape(-1, *(1,) * (a.ndim - 1)), a, b)

    return DiffractedPaths(
        *(select(getattr(one, f.name), getattr(other, f.name)) for f in fields(DiffractedPaths))
    )


def _shortest(begin: Array, end: Array, place: Array, along: Array) -> Array:
    """Where the shortest path between points over lines (n, 3) meets these lines."""
    at, off = [], []
    for point in (begin, end):
        towards = point - place
        at.append(np.sum(towards * along, axis=1))
        off.append(np.linalg.norm(towards - at[-1][:, None] * along, axis=1))
    share = (at[0] * off[1] + at[1] * off[0]) / np.maximum(off[0] + off[1], 1e-300)
    crossing: Array = place + share[:, None] * along
    return crossing


def _unit(vector: Array) -> Array:
    unit: Array = vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-300)
    return unit
