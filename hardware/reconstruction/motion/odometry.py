"""How a rig moves the image of what stands still: pinhole projection with the depth of cells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.reconstruction.motion.model import Motion, fixed_point, sampled
from hardware.records import QuaternionPose

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RigMotion(Motion):
    """A rig that drives and turns before a scene at rest.

    Parameters
    ----------
    depth_m : (rows, columns)
        Of each cell along the boresight at the reference time; infinite: the sky.
    velocity_m_per_s, angular_velocity_rad_per_s : (3,)
        Of the rig, both constant in its frame at the reference time (REP 103: x along the
        boresight, y left, z up).
    field_rad : (2,)
        Whole angles that the image spans down and along.

    Exact for points that stay in view; what is covered and uncovered is not told apart, and between
    cells depth is taken linear in its inverse.
    """

    depth_m: Array
    velocity_m_per_s: Array
    angular_velocity_rad_per_s: Array
    field_rad: tuple[float, float]

    def __post_init__(self) -> None:
        depth = np.asarray(self.depth_m, np.float64)
        if depth.ndim != 2 or np.isnan(depth).any() or (depth <= 0).any():
            raise InputError(
                f"motion: depth_m: shape {depth.shape}, expected positive numbers (rows, columns)"
            )
        for name in ("velocity_m_per_s", "angular_velocity_rad_per_s"):
            value = np.asarray(getattr(self, name), np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(f"motion: {name}: {value}, expected three numbers")
        if not all(0 < angle < np.pi for angle in self.field_rad):
            raise InputError(f"motion: field_rad: {self.field_rad}, expected angles below pi")

    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.sources`. Raises InputError where the rig has reached what it sees."""
        depth = np.asarray(self.depth_m, np.float64)
        if depth.shape != shape:
            raise InputError(
                f"motion: depth_m: of {depth.shape[0]} x {depth.shape[1]} cells, the image has "
                f"{shape[0]} x {shape[1]}"
            )
        inverse = 1 / depth[..., None]
        return fixed_point(places, lambda s: self._moved(time_s, s, inverse, shape) - s)

    def _moved(
        self, time_s: float, places: Array, inverse_depth: Array, shape: tuple[int, int]
    ) -> Array:
        """Where points seen at ``places`` at time 0 are seen at a time."""
        from scipy.spatial.transform import Rotation  # takes 0.1 s to import

        middle = (np.array(shape) - 1) / 2
        cells_per_tangent = np.array(shape) / 2 / np.tan(np.array(self.field_rad) / 2)
        up, left = (-(places - middle) / cells_per_tangent).T
        # Directions with x = 1; points are these times depth, so scaled by its inverse.
        rays = np.column_stack([np.ones(len(places)), left, up])
        way_m = time_s * np.asarray(self.velocity_m_per_s, np.float64)
        turn = Rotation.from_rotvec(time_s * np.asarray(self.angular_velocity_rad_per_s))
        seen = turn.inv().apply(rays - sampled(inverse_depth, places) * way_m)
        if (seen[:, 0] <= 1e-3).any():
            raise InputError(f"motion: at {time_s:g} s the rig has reached what a cell shows")
        tangents = np.column_stack([-seen[:, 2], -seen[:, 1]]) / seen[:, :1]
        return np.asarray(middle + tangents * cells_per_tangent)


def twist_between(
    before: QuaternionPose, after: QuaternionPose, elapsed_s: float
) -> tuple[Array, Array]:
    """Velocity (m/s) and angular velocity (rad/s), (3,) each, in the frame of the first of two
    poses, that lead to the second. Raises InputError unless time has passed.
    """
    if not (np.isfinite(elapsed_s) and elapsed_s > 0):
        raise InputError(f"elapsed_s: {elapsed_s} is not a positive number")
    back = before.rotation.inv()
    way_m = back.apply(after.position_m - before.position_m)
    return way_m / elapsed_s, (back * after.rotation).as_rotvec() / elapsed_s
