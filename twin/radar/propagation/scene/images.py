"""Mirror images of the radar in large flat surfaces: where echoes seem to start and to end.

An echo over the ground goes out from the radar's image below it. Sources and receivers are the
radar itself and its images, in sequences of up to a few surfaces; rays tell which of them count.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.scene.mesh_scene import Flat

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Image:
    """The radar seen in a sequence of patches, the one nearest to it first.

    ``places`` (m + 1, 3): the radar, and its image after each reflection.
    """

    patches: tuple[int, ...]
    places: Array

    @property
    def place(self) -> Array:
        """Where the image stands."""
        here: Array = self.places[-1]
        return here


def mirrored(point: Array, flat: Flat) -> Array:
    """Mirror image of points (..., 3)."""
    return in_planes(point, flat.point, flat.normal)


def in_planes(points: Array, at: Array, normal: Array) -> Array:
    """Mirror images of points (..., 3), each in the plane through a point with a unit normal."""
    off = np.sum((points - at) * normal, axis=-1, keepdims=True)
    images: Array = points - 2 * off * normal
    return images


def in_plane(normals: Array) -> tuple[Array, Array]:
    """Two directions in planes of unit normals (n, 3), one of them level, as walls' sides are."""
    level = np.stack([-normals[:, 1], normals[:, 0], 0 * normals[:, 0]], axis=1)
    size = np.linalg.norm(level, axis=1, keepdims=True)
    level = np.where(size > 1e-9, level / np.maximum(size, 1e-9), [1.0, 0.0, 0.0])
    return level, np.cross(normals, level)
