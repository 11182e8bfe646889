"""Waves over an edge of one obstacle and then over an edge of another, farther away.

By Kirchhoff's integral over the planes of both, as behind one thick obstacle (`knife_edge`), but
for edges at any angle: the two heights over the straight path are correlated the less the more the
edges are turned to each other, and negatively where the obstacles stand on opposite sides of it.
Edges are taken as infinitely long; waves over the ends of either, or over three obstacles, are left
out.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.rims import DiffractedPaths
from twin.radar.propagation.diffraction.two_edges import double_edge_paths
from twin.radar.rows import dots, matching_pairs

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_MOST_PAIRS = 2**17  # at once: 50 MB
_PARALLEL = 1 - 1e-6  # cosine between edges, at most
_AT_BORDER = 2.0  # times as far off as rays pass by an edge


@dataclass(frozen=True, eq=False)
class TwoObstacles:
    """Paths over two edges, (n,).

    ``single`` (n, 2): numbers of the paths over each edge alone, the nearer one first; ``alone``
    (n, 2): whether it passes by the other edge on its lit side; ``is_border`` (n, 2): so near to
    that edge that rays beside its own one can't tell.
    """

    paths: DiffractedPaths
    single: Indices
    alone: Flags
    is_border: Flags


def candidates(paths: DiffractedPaths, source: Array) -> Iterator[Indices]:
    """Pairs (n, 2) of paths over edges of two objects to one point, the nearer edge first; some at
    once.
    """
    edges = np.flatnonzero(np.isfinite(paths.lit_m))
    edges = edges[np.argsort(paths.point[edges], kind="stable")]
    at_m = np.linalg.norm(paths.stops[:, 0] - source, axis=1)
    _, first, count = np.unique(paths.point[edges], return_index=True, return_counts=True)
    several = np.cumsum(count**2) // _MOST_PAIRS
    for rows in np.split(edges, first[1:][np.diff(several) > 0]):
        one, other = (rows[k] for k in matching_pairs(paths.point[rows], paths.point[rows]))
        is_pair = (paths.item[one] != paths.item[other]) & (at_m[one] < at_m[other])
        yield np.stack([one[is_pair], other[is_pair]], axis=1)


def over_two_obstacles(
    paths: DiffractedPaths,
    pairs: Indices,
    source: Array,
    places: Array,
    wavenumber: float,
    faintest: float,
) -> TwoObstacles:
    """Given the paths to points, at ``places``, over each of two edges alone; those over both that
    are weaker than ``faintest`` may have no amplitude.
    """
    near, far = (paths.take(column) for column in pairs.T)
    seen = places[near.point]
    cosine = dots(near.into_light(source), far.into_light(source))
    cosine = np.clip(cosine, -_PARALLEL, _PARALLEL)
    both, _, alone = double_edge_paths(source, seen, near, far, wavenumber, cosine, faintest)
    both = replace(both, along=far.along)  # where the wave bends last
    stops = [source, *both.stops.swapaxes(0, 1), seen]
    a, b, c = (np.linalg.norm(end - begin, axis=1) for begin, end in pairwise(stops))
    longer_m = both.longer_m[:, None] - np.stack([near.longer_m, far.longer_m], axis=1)
    legs = np.stack([b * c / (b + c), a * b / (a + b)], axis=1)
    off_m = np.sqrt(np.maximum(2 * longer_m * legs, 0))
    beside_m = np.linalg.norm(paths.aside[:, 0], axis=1)[pairs]
    return TwoObstacles(both, pairs, alone, off_m < _AT_BORDER * beside_m)


def open_beside(
    two: TwoObstacles, paths: DiffractedPaths, is_open: Flags, blocker: Indices
) -> Flags:
    """Which paths over one edge are open: half planes decide at the border of another's shadow.

    ``blocker`` (n,): object that rays beside the edge of each meet first, -1 for none.
    """
    row, column = np.nonzero(two.is_border)
    one, other = two.single[row, column], two.single[row, 1 - column]
    is_open = is_open.copy()
    is_open[one[blocker[one] == paths.item[other]]] = True
    is_open[one[~two.alone[row, column]]] = False
    return is_open
