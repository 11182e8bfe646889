"""How a plane that comes nearer is seen: it grows, and its light with it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.reconstruction.motion.model import Motion, all_finite

Array = NDArray[np.float64]

#: Least distance that a plane may come to, over that of the reference time.
_NEAREST = 0.02


@dataclass(frozen=True)
class PlaneMotion(Motion):
    """A plane across the boresight, lit by the camera itself, that moves and before which it turns.

    Parameters
    ----------
    depth_m
        Along the boresight at the reference time.
    velocity_m_per_s
        Of the plane relative to the camera (3,), in the camera's frame at the reference time (REP
        103: x along the boresight, y left, z up).
    field_rad
        Whole angles that the image spans down and along.
    turn_rad_per_s
        Of the camera (3,), in the same frame.

    Exact for a plane. Its light falls with the square of the distance, as that of what an imaged
    pattern lights (`Motion.brightness`).
    """

    depth_m: float
    velocity_m_per_s: tuple[float, float, float]
    field_rad: tuple[float, float]
    turn_rad_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (all_finite(self.depth_m) and self.depth_m > 0):
            raise InputError(f"motion: depth_m: {self.depth_m}, expected a positive number")
        for name in ("velocity_m_per_s", "turn_rad_per_s"):
            value = getattr(self, name)
            if np.shape(value) != (3,) or not all_finite(value):
                raise InputError(f"motion: {name}: {value}, expected three finite numbers")
        if not all(0 < angle < np.pi for angle in self.field_rad):
            raise InputError(f"motion: field_rad: {self.field_rad}, expected angles below pi")

    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.sources`. Raises InputError where the camera has reached the plane."""
        middle, scale = _pinhole(shape, self.field_rad)
        first, _ = self._points(time_s, places, shape)
        return np.asarray(middle - scale * first[:, [2, 1]] / first[:, :1])

    def brightness(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.brightness`."""
        first, then = self._points(time_s, places, shape)
        return np.asarray((first**2).sum(axis=1) / (then**2).sum(axis=1))

    def _points(self, time_s: float, places: Array, shape: tuple[int, int]) -> tuple[Array, Array]:
        """What places show at a time, ``(n, 3)``: where it was at time 0, and where it is then,
        relative to the camera, along its axes of time 0.
        """
        from scipy.spatial.transform import Rotation  # takes 0.1 s to import

        middle, scale = _pinhole(shape, self.field_rad)
        up, left = (-(places - middle) / scale).T
        rays = np.column_stack([np.ones(len(places)), left, up])
        if any(self.turn_rad_per_s):
            rays = Rotation.from_rotvec(time_s * np.array(self.turn_rad_per_s)).apply(rays)
        way_m = time_s * np.array(self.velocity_m_per_s)
        depth_m = self.depth_m + way_m[0]
        if depth_m < _NEAREST * self.depth_m or (rays[:, 0] <= 0).any():
            raise InputError(f"motion: at {time_s:g} s the camera has reached what a cell shows")
        then = rays * (depth_m / rays[:, :1])
        return then - way_m, then


def _pinhole(shape: tuple[int, int], field_rad: tuple[float, float]) -> tuple[Array, Array]:
    """The image's middle, and cells per tangent, ``(2,)`` down and along."""
    scale = np.array(shape) / 2 / np.tan(np.array(field_rad) / 2)
    return (np.array(shape) - 1) / 2, scale
