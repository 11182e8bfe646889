"""How lengths and directions of straight ways change where both of their ends move uniformly."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Distances are taken to be no shorter where something is divided by them.
NEAREST_M = 1e-12


def lengthening(velocity: Array, direction: Array, length_m: Array | float) -> tuple[Any, Any]:
    """First and second derivative in time of the distance between two points that move uniformly.

    ``velocity`` (..., 3) of one relative to the other, ``direction`` (..., 3) the unit vector from
    the other to it, ``length_m`` (...) their distance: v . d in m/s, and |v - (v . d) d|^2 / r in
    m/s^2, both (...).
    """
    rate = np.sum(velocity * direction, axis=-1)
    across = velocity - rate[..., None] * direction
    return rate, np.sum(across**2, axis=-1) / np.maximum(length_m, NEAREST_M)


def turning(velocity: Array, direction: Array, length_m: Array | float) -> Array:
    """Derivative in time of ``direction`` (..., 3), in 1/s; parameters as of `lengthening`."""
    across = velocity - np.sum(velocity * direction, axis=-1, keepdims=True) * direction
    rate_per_s: Array = across / np.maximum(length_m, NEAREST_M)[..., None]
    return rate_per_s
