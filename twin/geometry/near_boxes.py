"""Pairs of boxes that touch or nearly do.

Boxes of like size are looked up in one tree of their middles, so what is compared grows with the
number of neighbours, not with that of all pairs.
"""

from itertools import chain

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_NEAR = 0.02  # of the larger one's size


def near_pairs(boxes: Array) -> tuple[Indices, int]:
    """Pairs of boxes (n, 2, 3) closer along every axis than a share of the larger one's size, the
    lower number first; and how many pairs were compared to find them.
    """
    from scipy.spatial import cKDTree

    low, high = boxes[:, 0], boxes[:, 1]
    middle, size = (low + high) / 2, (high - low).max(axis=1)
    reach = size * (0.5 + _NEAR)
    # Boxes within a factor of two of each other share a tree: none is searched far beyond its own.
    octave = np.frexp(size)[1]
    pairs, compared = [np.zeros((0, 2), dtype=np.int64)], 0
    for level in np.unique(octave):
        there, asking = np.flatnonzero(octave == level), np.flatnonzero(octave <= level)
        tree = cKDTree(middle[there])
        lists = tree.query_ball_point(
            middle[asking], reach[asking] + reach[there].max(), p=np.inf, return_sorted=False
        )
        counts = np.fromiter(map(len, lists), dtype=np.int64, count=len(lists))
        compared += int(counts.sum())
        a = np.repeat(asking, counts)
        b = there[np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=int(counts.sum()))]
        once = (octave[a] < level) | (a < b)  # within a level both ask
        a, b = a[once], b[once]
        gap = np.maximum(low[a] - high[b], low[b] - high[a]).max(axis=1)
        near = gap <= _NEAR * np.maximum(size[a], size[b])
        pairs.append(np.sort(np.stack([a[near], b[near]], axis=1), axis=1))
    return np.concatenate(pairs), compared
