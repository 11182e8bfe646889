"""Which objects are one body: those that touch, by their boxes, and move alike or as parts of one.

Parts that the same object carries are one body whether they turn or not, a car with its wheels, a
person with arms and legs: what errors are relative to does not change when they begin to move.

Boxes of like size are looked up in one tree of their middles, so what is compared grows with the
number of neighbours, not with that of all pairs.
"""

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from twin.radar.propagation.one_way.motion import RigidMotions
from twin.scene import SceneObject
from twin.scene.boxes import boxes_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_ROUNDING = 1e-9  # of velocities, accelerations and angular velocities, in SI units
_NEAR = 0.02  # of the larger one's size: objects closer than this are one body


def bodies_of(items: Sequence[SceneObject]) -> Indices:
    """Number of the body that each object belongs to, in the order of their first objects."""
    pairs = touching(items)
    links = coo_array(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(items), len(items))
    )
    labels = connected_components(links, directed=False)[1]
    _, first, body = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    numbers: Indices = rank[body]
    return numbers


def touching(items: Sequence[SceneObject]) -> Indices:
    """Pairs of objects, the lower number first, that touch and move alike, (n, 2)."""
    boxes = boxes_of(items)
    pairs = near_pairs(boxes)[0]
    return pairs[_move_alike(items, pairs, boxes.mean(axis=1))]


def _move_alike(items: Sequence[SceneObject], pairs: Indices, middle_m: Array) -> Mask:
    """Whether both of a pair (n, 2) move alike as one rigid body, (n,), exactly where none has a
    motion of its own, else but for the rounding of motions that lead to the same; or have one
    carrier.
    """
    motions = RigidMotions.of(items, np.zeros(3))
    first, second = pairs.T
    if not any(item.motion is not None for item in items):
        same: Mask = (motions.velocity_m_per_s[first] == motions.velocity_m_per_s[second]).all(
            axis=1
        )
        return same
    places = middle_m[first]
    states = [
        (*motions.at(number, places), motions.spin_rad_per_s[number]) for number in (first, second)
    ]
    alike = np.ones(len(pairs), dtype=bool)
    for one, other in zip(*states, strict=True):
        alike &= (np.abs(one - other) <= _ROUNDING * (1 + np.abs(one))).all(axis=1)
    carrier = _carriers(items)
    alike |= carrier[first] == carrier[second]
    return alike


def _carriers(items: Sequence[SceneObject]) -> NDArray[np.str_]:
    """Name of the object that carries each directly or by way of others, its own for none."""
    parents = {item.name: item.parent for item in items}
    names = []
    for item in items:
        name = item.name
        while parent := parents.get(name):
            name = parent
        names.append(name)
    return np.array(names)


def near_pairs(boxes: Array) -> tuple[Indices, int]:
    """Pairs of boxes (n, 2, 3) closer along every axis than a share of the larger one's size, the
    lower number first; and how many pairs were compared to find them.
    """
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
