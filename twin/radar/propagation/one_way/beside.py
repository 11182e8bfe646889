"""Places beside the way from a point to an image: where several mirrors meet, or one ends, a ray
straight there may meet neither, or both.
"""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.one_way.motion import NEAREST_M
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.rows import lengths

Array = NDArray[np.float64]

#: Over one mirror, as a share of the way, far beyond float32's step there; in corners, of a Fresnel
#: zone: beyond these steps 64 m from the anchor.
_ASIDE, _IN_CORNERS = 1e-4, 0.05
_OBLIQUE = np.array([0.36, 0.48, 0.8])  # parallel to no corner


def beside(context: TracingContext, source: NDArray[np.integer], places: Array) -> Array:
    """By how much points (n, 3) are moved to either side of their ways to images (n,)."""
    from_image = places - np.array(context.positions).reshape(-1, 3)[source]
    in_corners = _in_corners(float(context.wavelength[0]), lengths(from_image))
    aside = np.where(np.array(context.orders)[source] == 1, _ASIDE, in_corners)
    return aside[:, None] * np.cross(from_image, _OBLIQUE)


def most_beside_m(wavelength_m: float, images: Array, places: Array) -> Array:
    """How far any of the points (n, 3) may be moved in a corner, by any of the images (m, 3)."""
    length_m = np.linalg.norm(places[:, None] - images, axis=-1).max(axis=1)
    return _in_corners(wavelength_m, length_m) * length_m


def _in_corners(wavelength_m: float, length_m: Array) -> Array:
    return _IN_CORNERS * np.sqrt(wavelength_m / np.maximum(length_m, NEAREST_M))
