"""Boxes around objects, along the axes of the world."""

from collections.abc import Sequence

import numpy as np

from twin.geometry import shapes_of
from twin.scene.objects import Array, SceneObject


def boxes_of(items: Sequence[SceneObject]) -> Array:
    """Least and largest coordinates of what their faces use, in the world, (n, 2, 3)."""
    shapes_of([item.geometry for item in items])  # together: each alone takes longer
    return np.array([item.box_m for item in items], dtype=np.float64).reshape(-1, 2, 3)


def distances_m(boxes: Array, place_m: Array) -> Array:
    """Distances of boxes (n, 2, 3) from a point, 0 from within."""
    off = np.maximum(np.maximum(boxes[:, 0] - place_m, place_m - boxes[:, 1]), 0.0)
    distances: Array = np.linalg.norm(off, axis=1)
    return distances
