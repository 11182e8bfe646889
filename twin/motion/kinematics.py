"""Where a rigid body is at an instant, how it moves and how that changes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (..., 3): a fifth of the time of NumPy's for a few."""
    product: Array = a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]
    return product


_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


@dataclass(frozen=True, eq=False)
class Kinematics:
    """State of a moving frame at one time, arrays (3,), or at n times, arrays (n, 3).

    ``pose`` leads from the frame to the one it is told in (the world). Velocity and acceleration
    are those of the frame's origin; all four vectors stand in the axes of the world.
    """

    pose: RigidTransform
    velocity_m_per_s: Array
    angular_velocity_rad_per_s: Array
    acceleration_m_per_s2: Array
    angular_acceleration_rad_per_s2: Array

    def __getitem__(self, index: int | slice) -> "Kinematics":
        """The state at one of several times, or at some of them."""
        return Kinematics(
            self.pose[index],
            self.velocity_m_per_s[index],
            self.angular_velocity_rad_per_s[index],
            self.acceleration_m_per_s2[index],
            self.angular_acceleration_rad_per_s2[index],
        )

    def __mul__(self, inner: "Kinematics") -> "Kinematics":
        """State of a frame that moves within this one, at the same times."""
        turn = self.pose.rotation
        arm = turn.apply(inner.pose.translation)
        slip = turn.apply(inner.velocity_m_per_s)
        spin = turn.apply(inner.angular_velocity_rad_per_s)
        own = self.angular_velocity_rad_per_s
        return Kinematics(
            self.pose * inner.pose,
            self.velocity_m_per_s + cross(own, arm) + slip,
            own + spin,
            self.acceleration_m_per_s2
            + cross(self.angular_acceleration_rad_per_s2, arm)
            + cross(own, cross(own, arm))  # towards the axis
            + 2 * cross(own, slip)  # Coriolis
            + turn.apply(inner.acceleration_m_per_s2),
            self.angular_acceleration_rad_per_s2
            + cross(own, spin)
            + turn.apply(inner.angular_acceleration_rad_per_s2),
        )

    def carrying(self, pose: RigidTransform) -> "Kinematics":
        """State of a frame that stands at a pose within this one."""
        arm = self.pose.rotation.apply(pose.translation)
        own, change = self.angular_velocity_rad_per_s, self.angular_acceleration_rad_per_s2
        turning = cross(own, arm)
        return Kinematics(
            self.pose * pose,
            self.velocity_m_per_s + turning,
            own,
            self.acceleration_m_per_s2 + cross(change, arm) + cross(own, turning),
            change,
        )

    def carried_by(self, pose: RigidTransform) -> "Kinematics":
        """State of this frame where all that it is told in stands at a pose."""
        turn = pose.rotation
        return Kinematics(
            pose * self.pose,
            turn.apply(self.velocity_m_per_s),
            turn.apply(self.angular_velocity_rad_per_s),
            turn.apply(self.acceleration_m_per_s2),
            turn.apply(self.angular_acceleration_rad_per_s2),
        )

    def of_points(self, points_m: ArrayLike) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration of points that the frame carries, in the world.

        ``points_m`` (k, 3) in the frame; each result (k, 3) at one time, (n, k, 3) at n times.
        """
        points = np.asarray(points_m, dtype=np.float64)
        turn = self.pose.rotation.as_matrix()
        arm = points @ np.swapaxes(turn, -1, -2)
        place, velocity, acceleration = (
            part[..., None, :]
            for part in (
                self.pose.translation,
                self.velocity_m_per_s,
                self.acceleration_m_per_s2,
            )
        )
        rate = self.angular_velocity_rad_per_s[..., None, :]
        turning = cross(rate, arm)
        return (
            place + arm,
            velocity + turning,
            acceleration
            + cross(self.angular_acceleration_rad_per_s2[..., None, :], arm)
            + cross(rate, turning),
        )

    def at_world(self, points_m: ArrayLike) -> tuple[Array, Array]:
        """Velocity and acceleration of what is at points (k, 3) of the world now, (k, 3) each.

        For a state at one time.
        """
        arm = np.asarray(points_m, dtype=np.float64) - self.pose.translation
        turning = cross(self.angular_velocity_rad_per_s, arm)
        return (
            self.velocity_m_per_s + turning,
            self.acceleration_m_per_s2
            + cross(self.angular_acceleration_rad_per_s2, arm)
            + cross(self.angular_velocity_rad_per_s, turning),
        )


def at_rest(pose: RigidTransform, count: int) -> Kinematics:
    """A frame that stands still, at ``count`` times."""
    poses = RigidTransform.from_matrix(np.tile(pose.as_matrix(), (count, 1, 1)))
    zero = np.zeros((count, 3))
    return Kinematics(poses, zero, zero, zero, zero)
