"""Whether straight ways pass a thin obstacle, in float64: wires, blades and sheets seen edge-on
have two edges closer to a way than rays in float32 can tell.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.diffraction.rims import DiffractedPaths
from twin.radar.rows import alike, dots, lengths
from twin.scene import SceneObject

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_NEXT_TO_M = 0.01  # of an edge, where a way is looked at


def pass_thin(
    items: Sequence[SceneObject],
    anchor_m: Array,
    source: Array,
    places: Array,
    paths: DiffractedPaths,
    dark: Indices,
    lit: Indices,
) -> NDArray[np.bool_]:
    """Whether straight ways from a source to places, which are in the ``dark`` of edges and close
    to these, (n,), by the numbers of their paths, pass the obstacle beside another edge of it, of
    the ``lit`` ones.
    """
    found, both = np.zeros(len(dark), dtype=bool), np.concatenate([dark, lit])
    of_way = alike([paths.point[both], paths.item[both]])
    between = np.flatnonzero(np.isin(of_way[: len(dark)], of_way[len(dark) :]))
    edges = dark[between]
    along = places[paths.point[edges]] - source
    along *= _NEXT_TO_M / lengths(along)[:, None]
    share = dots(paths.stops[edges, 0] - source, along) / _NEXT_TO_M**2
    begin = source + (share - 1)[:, None] * along
    for item in np.unique(paths.item[edges]):
        some = np.flatnonzero(paths.item[edges] == item)
        corners = items[item].vertices_m[items[item].geometry.faces] - anchor_m
        found[between[some]] = kernel(_pass, _meets)(corners, begin[some], 2 * along[some])
    return found


def _pass(corners: Array, begin: Array, way: Array) -> NDArray[np.bool_]:
    """Whether ways (n, 3) meet none of the facets (m, 3, 3)."""
    clear = np.ones(len(begin), dtype=np.bool_)
    for i in range(len(begin)):
        for k in range(len(corners)):
            if _meets(corners[k], begin[i], way[i]):
                clear[i] = False
                break
    return clear


def _meets(corners: Array, begin: Array, way: Array) -> bool:
    """Whether a way meets a facet, in whose plane it does not run.

    Möller and Trumbore, Fast, minimum storage ray-triangle intersection, J. Graphics Tools 2
    (1), 1997.
    """
    one, other, off = np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        one[k], other[k] = corners[1, k] - corners[0, k], corners[2, k] - corners[0, k]
        off[k] = begin[k] - corners[0, k]
    across, beside = np.cross(way, other), np.cross(off, one)
    slope = np.dot(one, across)
    if slope == 0:
        return False
    u, v = np.dot(off, across) / slope, np.dot(way, beside) / slope
    share = np.dot(other, beside) / slope
    return bool(u >= 0 and v >= 0 and u + v <= 1 and 0 <= share <= 1)
