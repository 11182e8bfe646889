"""Where a camera sees what a radar follows: boxes of the image from places and velocities."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.errors import InputError
from hardware.radar.tracking import TargetTrack
from hardware.reconstruction.motion.layers import MovingBox
from hardware.reconstruction.motion.model import Shift
from hardware.records import QuaternionPose

Array = NDArray[np.float64]

#: Least distance along the boresight at which an object is taken as in view, m.
_NEAREST_M = 0.1


def box_in_view(
    position_m: ArrayLike,
    velocity_m_per_s: ArrayLike,
    size_m: ArrayLike,
    field_rad: tuple[float, float],
    shape: tuple[int, int],
) -> MovingBox | None:
    """The box of an image within which a cuboid is seen; None where part of it is not ahead.

    Parameters
    ----------
    position_m, velocity_m_per_s : (3,)
        Of its middle relative to the camera at the reference time, in the camera's frame (REP 103:
        x along the boresight, y left, z up).
    size_m : (3,)
        Its extent along x, y and z.
    field_rad
        Whole angles that the image spans down and along.
    shape
        Rows and columns.

    Pinhole projection; all of the box moves as its middle does, which leaves out its growth as it
    comes nearer: 1 % of its size within a frame for each % of its distance.
    """
    middle, velocity, size = (
        np.asarray(value, np.float64) for value in (position_m, velocity_m_per_s, size_m)
    )
    for name, value in (("position_m", middle), ("velocity_m_per_s", velocity), ("size_m", size)):
        if value.shape != (3,) or not np.isfinite(value).all():
            raise InputError(f"motion: {name}: {value}, expected three finite numbers")
    if (size <= 0).any():
        raise InputError(f"motion: size_m: {size}, expected positive numbers")
    if not all(0 < angle < np.pi for angle in field_rad):
        raise InputError(f"motion: field_rad: {field_rad}, expected angles below pi")
    signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    corners = middle + signs * size
    if corners[:, 0].min() < _NEAREST_M:
        return None
    scale = np.array(shape) / 2 / np.tan(np.array(field_rad) / 2)
    places = (np.array(shape) - 1) / 2 - scale * corners[:, [2, 1]] / corners[:, :1]
    (top, left), (bottom, right) = places.min(axis=0), places.max(axis=0)
    x = middle[0]
    down, along = -scale * (velocity[[2, 1]] / x - middle[[2, 1]] * velocity[0] / x**2)
    return MovingBox(top, left, bottom, right, Shift(float(down), float(along)))


def tracked_boxes(
    tracks: Sequence[TargetTrack],
    camera: QuaternionPose,
    rig_velocity_m_per_s: ArrayLike,
    *,
    height_m: float,
    size_m: ArrayLike,
    field_rad: tuple[float, float],
    shape: tuple[int, int],
) -> tuple[MovingBox, ...]:
    """Boxes of a radar's tracks in a camera's image, the nearest first.

    Tracks are places and velocities on the ground of the world at the reference time; ``height_m``
    is that of their middles and ``size_m`` (3,) their extent, which a radar does not tell.
    ``camera`` is the camera's pose and ``rig_velocity_m_per_s`` (3,) its velocity in the world.
    Tracks without an azimuth, and what is not wholly ahead or not in the image, have no box.
    """
    found = []
    back = camera.rotation.inv()
    for track in tracks:
        if not track.estimate.has_position:
            continue
        x, y, vx, vy = track.state
        place = back.apply(np.array([x, y, height_m]) - camera.position_m)
        velocity = back.apply(np.array([vx, vy, 0.0]) - np.asarray(rig_velocity_m_per_s))
        box = box_in_view(place, velocity, size_m, field_rad, shape)
        if box and _in_image(box, shape):
            found.append((float(np.linalg.norm(place)), box))
    return tuple(box for _, box in sorted(found, key=lambda one: one[0]))


def _in_image(box: MovingBox, shape: tuple[int, int]) -> bool:
    down = box.bottom > -0.5 and box.top < shape[0] - 0.5
    return down and box.right > -0.5 and box.left < shape[1] - 0.5
