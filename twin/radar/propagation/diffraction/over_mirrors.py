"""Waves over the borders of mirrors to bodies, which their echoes by images do not hold.

A body over a mirror is lit or not as rays tell. Waves over the mirror's border change that by the
knife-edge factor of their longer path at most, once on each way that goes over the mirror.
"""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.mirror_borders import free_border
from twin.radar.propagation.diffraction.shadow_bounds import level_beside
from twin.radar.propagation.prepared_scene import PreparedScene

Array = NDArray[np.float64]

_POINTS = 64  # of a body, about, to which ways over mirrors are looked at


def border_levels(
    prepared: PreparedScene, of_object: NDArray[np.int32], count: int, images: NDArray[np.integer]
) -> Array:
    """Of waves over the borders of the mirrors of some images, by their numbers, to each of
    ``count`` bodies, over the wave by the image, rms over the body, (count, n_images); 0 of others.
    ``of_object``: every object's body, or -1.
    """
    levels = np.zeros((count, len(prepared.images)))
    points = [points_of(prepared, np.flatnonzero(of_object == body)) for body in range(count)]
    size = np.cumsum([0, *map(len, points)])
    every = np.concatenate([np.zeros((0, 3)), *points])
    wavenumber = 2 * np.pi / prepared.wavelength_m
    for row in images:
        image, level = prepared.images[row], np.zeros(len(every))
        for number in range(len(image.patches)):
            rim = free_border(prepared, image, number)
            if len(rim.ends) and len(every):
                level += level_beside(rim, every - image.place, wavenumber)
        for body in range(count):
            own = level[size[body] : size[body + 1]]
            levels[body, row] = np.sqrt(np.mean(own**2)) if len(own) else 0.0
    return levels


def points_of(prepared: PreparedScene, members: NDArray[np.intp]) -> Array:
    """Centroids of faces of some objects, (n, 3), as many of one as of another."""
    points = []
    for item in (prepared.originals[member] for member in members):
        corners = item.vertices_m[item.geometry.faces] - prepared.anchor_m
        step = max(1, len(corners) * len(members) // _POINTS)
        points.append(corners[::step].mean(axis=1))
    return np.concatenate([np.zeros((0, 3)), *points])
