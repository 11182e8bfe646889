"""Cells whose light a body may change: where it is seen, and what it hides."""

import numpy as np
from numpy.typing import NDArray

from twin.optics.devices import Device

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: In front of a device, m: a body nearer than that may be anywhere in its field.
_NEAR_M = 1e-3


def image_points(places: Array, camera: Device) -> Array:
    """Where a camera sees places (n, 3) on the plane at distance 1, up and left, (n, 2)."""
    ahead, left, up = camera.axes @ (places - camera.origin_m).T
    return np.asarray(np.stack([up, left], axis=1) / np.maximum(ahead, _NEAR_M)[:, None])


def covers(
    corners: Array, margin_m: float, emitter: Device, detector: Device, shape: tuple[int, int]
) -> Flags:
    """Cells of an emitter, (rows, columns), in which a convex body may be hit, or be in the way
    from what is behind it to a detector.

    ``corners`` (n, 3) of the body, which with a margin around them is all of it. What it hides from
    the detector is seen from the emitter in directions between those to the body and those away
    from the detector through it. A device that is more than a point, or unsharp, has all cells.
    """
    devices = (emitter, detector)
    if any(d.blur_tan or d.pupil_radius_m or d.pitch_m is not None for d in devices):
        return np.ones(shape, dtype=bool)
    pick = 2 * np.indices((2, 2, 2)).reshape(3, -1).T - 1
    points = (corners[:, None] + margin_m * pick).reshape(-1, 3)
    seen = np.concatenate([points - emitter.origin_m, points - detector.origin_m])
    ahead = seen @ emitter.axes[0]
    if ahead.max() <= 0:
        return np.zeros(shape, dtype=bool)
    if ahead.min() < _NEAR_M:
        return np.ones(shape, dtype=bool)
    tangents = image_points(seen + emitter.origin_m, emitter) / emitter.tan_half_field
    cells = (1 - tangents) / 2 * np.array(shape)
    low, high = np.floor(cells.min(axis=0)) - 1, np.ceil(cells.max(axis=0)) + 1
    (top, left), (bottom, right) = (np.clip(x, 0, shape).astype(int) for x in (low, high))
    found = np.zeros(shape, dtype=bool)
    found[top:bottom, left:right] = True
    return found
