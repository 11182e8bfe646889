"""Parts of one body that do not touch, one behind another: waves round the first are left out.

What is hidden by a body itself is decided by rays alone, since its own edges are those of its echo.
Of a mesh of several bodies, as of an imported scene, that leaves out what goes round one of them to
another. No bound of it is computed: it is told.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.geometry import connected
from twin.geometry.near_boxes import near_pairs
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import in_plane
from twin.radar.propagation.scene.parts import boxes_of_parts
from twin.radar.rows import lengths
from twin.scene import SceneObject

Array = NDArray[np.float64]

_ASIDE = 2.0  # radii of the first Fresnel zone within which an edge beside a way counts
_MOST_PARTS = 1000  # of a body, among which pairs are looked at


def parts_in_line(
    prepared: PreparedScene,
    body: NDArray[np.int32],
    names: Sequence[tuple[str, ...]],
    fidelity: Fidelity,
) -> tuple[str, ...]:
    """A warning of such bodies, by the ``body`` of each object and the ``names`` of each body's
    objects, unless no waves round obstacles are asked for at all.
    """
    if fidelity.radar_shadowed == 0:
        return ()
    found = [
        objects[0]
        for number, objects in enumerate(names)
        if _has_parts_in_line([prepared.items[i] for i in np.flatnonzero(body == number)], prepared)
    ]
    if not found:
        return ()
    return (
        f"{', '.join(found)}: parts that do not touch stand one behind another; waves round the "
        "first to the next are left out, and no stated error holds them: make them objects of "
        "their own",
    )


def _has_parts_in_line(items: Sequence[SceneObject], prepared: PreparedScene) -> bool:
    boxes = np.concatenate([_boxes(item) for item in items]) - prepared.anchor_m
    if len(boxes) > _MOST_PARTS:
        return True
    group = connected(near_pairs(boxes)[0], len(boxes))
    if not group.any():
        return False
    boxes = boxes_of_parts(boxes, group) - prepared.place
    return bool(_stand_in_line(boxes, prepared.wavelength_m).any())


def _boxes(item: SceneObject) -> Array:
    """Boxes of an object's parts in the world, (n, 2, 3)."""
    has_area = item.geometry.parts >= 0
    return boxes_of_parts(
        item.vertices_m[item.geometry.faces[has_area]], item.geometry.parts[has_area]
    )


def _stand_in_line(boxes: Array, wavelength_m: float) -> NDArray[np.bool_]:
    """Whether the first of two boxes relative to the radar (n, 2, 3), by their middles, hides a
    part of the second or stands close beside the way to it, (n, n).
    """
    middle = boxes.mean(axis=1)
    distance_m = lengths(middle)
    ahead = middle.sum(axis=0)
    ahead /= max(float(np.linalg.norm(ahead)), 1e-300)
    axes = np.array([ahead, *(axis[0] for axis in in_plane(ahead[None]))])
    corners = np.stack([boxes[:, k, range(3)] for k in product((0, 1), repeat=3)], axis=1) @ axes.T
    depth_m = corners[..., :1]
    seen = corners[..., 1:] / np.where(depth_m > 0, depth_m, np.nan)
    low, high = seen.min(axis=1), seen.max(axis=1)  # NaN beside and behind the radar
    one, other = distance_m[:, None], distance_m[None]
    zone_m = np.sqrt(wavelength_m * one * np.maximum(other - one, 0) / other)
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=2)
    is_near: NDArray[np.bool_] = (one < other) & (apart < _ASIDE * zone_m / one)
    return is_near
