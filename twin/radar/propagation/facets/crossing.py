"""Which paths may meet something within a box: intersection of boxes with pyramids of rays.

All paths from an image of the radar to a triangle lie in the pyramid between them. All rays that
the triangle reflects lie in the pyramid beyond it, whose apex is the image's mirror image. A box is
outside a pyramid if a plane through one of the pyramid's faces, or a cone around it, separates
them. For paths over mirrors the pyramid is that of the unfolded, straight path, and the boxes are
mirrored.
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.scene.images import Image, in_planes
from twin.radar.propagation.scene.mesh_scene import Flats
from twin.transfer import aligned

Array = NDArray[np.float64]
Corners = tuple[Any, Any, Any]

_MARGIN_M = 1e-2  # around boxes, for errors of float32 rays and of borders between samples
_NUMBERS = 12  # of a box: its middle, and three half edges


def oriented(boxes: Array) -> Array:
    """Centres and half edges, (n, 4, 3), of boxes given by their least and largest coordinates
    (n, 2, 3), with a margin.
    """
    middle, half = boxes.mean(axis=1), np.diff(boxes, axis=1)[:, 0] / 2 + _MARGIN_M
    return np.concatenate([middle[:, None], half[:, :, None] * np.eye(3)], axis=1)


def as_mirrored(boxes: Array, images: Sequence[Image], flats: Flats) -> Array:
    """Boxes (n, 4, 3) along the unfolded path from every image: as they are, and mirrored in the
    last mirrors, (n_images, n_mirrors + 1, n, 4, 3); for images with fewer mirrors the last set
    repeats.
    """
    order = max(len(image.patches) for image in images)
    mirrored = np.empty((len(images), order + 1, *boxes.shape))
    for row, image in zip(mirrored, images, strict=True):
        for level in range(order + 1):
            ends = np.concatenate([boxes[:, :1], boxes[:, :1] + boxes[:, 1:]], axis=1)
            count = min(level, len(image.patches))
            for patch in image.patches[len(image.patches) - count :]:
                ends = in_planes(ends, flats.point[patch], flats.normal[patch])
            row[level] = np.concatenate([ends[:, :1], ends[:, 1:] - ends[:, :1]], axis=1)
    return mirrored


def crossed(
    mi: Any, tip: Any, corners: Corners, boxes: Array, which: Any, *, beyond: bool
) -> NDArray[np.bool_]:
    """Whether pyramids from their apex through triangles may meet any of some boxes, (n,).

    Parameters
    ----------
    tip, corners
        On the device, relative to the anchor.
    boxes
        (n_sets, n_boxes, 4, 3); ``which``: the set for each pyramid, on the device.
    beyond
        Whether the pyramid beyond the triangle, as seen from the apex, is meant, or that before it.
    """
    count = dr.width(corners[0])
    sets, many = boxes.shape[:2]
    table = mi.Float64(aligned(boxes))
    is_crossed = dr.zeros(mi.Bool, count)
    if not count or not sets:
        return np.zeros(count, dtype=bool)
    begin = which * dr.opaque(mi.UInt32, many)
    dr.eval(begin)
    for number in range(many):
        row = _NUMBERS * (begin + dr.opaque(mi.UInt32, number))
        middle, *half = (
            mi.Vector3d(*(dr.gather(mi.Float64, table, row + 3 * k + i) for i in range(3)))
            for k in range(4)
        )
        is_crossed |= ~_apart(tip, corners, middle, half, beyond)
        dr.eval(is_crossed)
    return np.array(is_crossed)


def _apart(tip: Any, corners: Corners, middle: Any, half: Sequence[Any], beyond: bool) -> Any:
    """Whether a plane or a cone separates boxes from pyramids."""
    rays = [corner - tip for corner in corners]
    away = middle - tip

    def reach(normal: Any) -> Any:
        return sum(dr.abs(dr.dot(normal, edge)) for edge in half)

    base = dr.cross(corners[1] - corners[0], corners[2] - corners[0])
    side = dr.select(dr.dot(base, rays[0]) < 0, -1.0, 1.0)  # of the base beyond it
    off = side * dr.dot(base, middle - corners[0])
    apart = off + reach(base) < 0 if beyond else off - reach(base) > 0
    for k in range(3):
        normal = dr.cross(rays[k], rays[(k + 1) % 3])
        inwards = dr.select(dr.dot(normal, rays[(k + 2) % 3]) < 0, -1.0, 1.0)
        apart |= inwards * dr.dot(normal, away) + reach(normal) < 0
    units = [dr.normalize(ray) for ray in rays]
    axis = dr.normalize(units[0] + units[1] + units[2])
    narrowest = dr.minimum(dr.dot(units[0], axis), dr.dot(units[1], axis))
    wide = dr.safe_acos(dr.minimum(narrowest, dr.dot(units[2], axis)))
    radius = dr.sqrt(sum(dr.squared_norm(edge) for edge in half))
    distance = dr.norm(away)
    is_far = distance > radius
    half_width = dr.safe_asin(radius / dr.select(is_far, distance, radius))
    angle = dr.safe_acos(dr.dot(away, axis) / dr.select(is_far, distance, 1.0))
    return apart | (is_far & (angle > wide + half_width))
