"""How much waves over edges of obstacles may change waves to bodies by ways that are not followed
round obstacles: over mirrors, and to facets that reflect more than once.

Of each body, image of the radar and leg of the way, between two mirrors or before the first or
behind the last: the knife-edge waves of the nearest edges of each obstacle, by geometry alone,
those of different obstacles as independent ones.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.mirror_borders import between_mirrors
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadow_bounds import change_beside
from twin.radar.propagation.diffraction.views import are_beside
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.scene.images import Image, mirrored

#: Objects of a city: waves round so many obstacles are followed to single reflections alone.
MANY_OBSTACLES = 200

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def levels_beside(
    obstacles: Screens, pairs: Sequence[tuple[int, int]], points: dict[int, Array]
) -> Array:
    """What waves over edges of others than a body change of those to its ``points`` (n, 3), over
    the straight ones, rms over the body, for pairs of a body and an image, by their numbers,
    (n_pairs,).
    """
    levels = np.zeros(len(pairs))
    for row, (body, number) in enumerate(pairs):
        image, square = obstacles.prepared.images[number], np.zeros(len(points[body]))
        for leg in range(len(image.places)):
            square += _on_leg(obstacles, image, leg, body, points[body])
        levels[row] = np.sqrt(np.mean(square)) if len(square) else 0.0
    return levels


def _on_leg(obstacles: Screens, image: Image, leg: int, body: int, points: Array) -> Array:
    """Sum of squares to each of the points, (n,)."""
    prepared, source = obstacles.prepared, image.places[leg]
    for patch in image.patches[leg:][::-1]:
        points = mirrored(points, prepared.flats[patch])
    direct, square = points - source, np.zeros(len(points))
    mirrors = prepared.flats.object[list(image.patches)]
    others = np.setdiff1d(np.flatnonzero(obstacles.body != body), mirrors)
    if not len(others) or not len(points):
        return square
    beside = are_beside(obstacles, others, direct, np.zeros(len(points)), source)
    near = others[beside.any(axis=0)]
    owner = np.where(obstacles.body[near] >= 0, obstacles.body[near], -1 - near)
    reach_m = float(np.mean(np.linalg.norm(direct, axis=1)))
    for number in np.unique(owner):
        members = near[owner == number].tolist()
        # Whole outlines from images and in cities: the rays that find outer rims would take long.
        is_whole = leg > 0 or len(obstacles.items) > MANY_OBSTACLES
        rim = Outline.together(
            [
                obstacles.outline(item, source)
                if is_whole
                else obstacles.rim(item, source, reach_m, body)
                for item in members
            ]
        )
        rim = between_mirrors(prepared, image, leg, rim)
        if len(rim.ends):
            square += change_beside(rim, direct, obstacles.wavenumber) ** 2
    return square
