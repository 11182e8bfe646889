"""Waves over the borders of mirrors to bodies, which their echoes by images do not hold.

A body over a mirror is lit or not as rays tell. Waves over the mirror's border change that by the
knife-edge factor of their longer path at most, once on each way that goes over the mirror.
"""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.mirrors import RIGHT, border
from twin.radar.propagation.diffraction.shadow_bounds import level_beside
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]

_POINTS = 64  # of a body, about, to which ways over mirrors are looked at
_BESIDE_M = 1e-3  # of an edge, where another surface goes on
_ONE_PLANE = 1 - 1e-6  # cosine between planes that are one


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
            rim = _free_border(prepared, image, number)
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


def _free_border(prepared: PreparedScene, image: Image, level: int) -> Outline:
    """The border of one of an image's mirrors, as the others show it, without edges beside which
    another goes on in its plane or at a right angle: there the waves of both cancel.
    """
    flats, number, here = prepared.flats, image.patches[level], image.places[0]
    real = border(prepared, number, here)
    normal = flats.normal[number]
    along = real.ends[:, 1] - real.ends[:, 0]
    outward = np.cross(along, normal)
    outward *= (
        -np.sign(dots(outward, real.lit))[:, None] / np.maximum(lengths(along), 1e-300)[:, None]
    )
    beside = here + real.ends.mean(axis=1) + _BESIDE_M * outward
    is_free = np.ones(len(beside), dtype=bool)
    for other in range(len(flats)):
        cosine = abs(normal @ flats.normal[other])
        if other == number or RIGHT < cosine < _ONE_PLANE:
            continue
        height = (beside - flats.point[other]) @ flats.normal[other]
        for row in np.flatnonzero(is_free & (np.abs(height) < 2 * _BESIDE_M)):
            foot = beside[row] - height[row] * flats.normal[other]
            is_free[row] = not flats.covers(other, foot)
    shown = border(prepared, number, image.place, image.patches[level + 1 :])
    return shown.take(np.flatnonzero(is_free))
