"""Which objects are one body: those that touch, by their boxes, and move alike or as parts of one.

Parts that the same object carries are one body whether they turn or not, a car with its wheels, a
person with arms and legs: what errors are relative to does not change when they begin to move.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from twin.geometry.near_boxes import near_pairs
from twin.radar.propagation.one_way.motion import RigidMotions
from twin.scene import SceneObject
from twin.scene.boxes import boxes_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_ROUNDING = 1e-9  # of velocities, accelerations and angular velocities, in SI units


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
