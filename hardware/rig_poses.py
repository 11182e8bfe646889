"""How a rig stands and drives within a time, by the poses of it that its sensors tell."""

from bisect import insort
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hardware.records import QuaternionPose

Array = NDArray[np.float64]

_Stamped = tuple[int, QuaternionPose]

#: Poses are kept for so long before the latest.
KEPT_NS = 60 * 10**9
#: Motion of the rig that counts as one.
LEAST_M_PER_S, LEAST_RAD_PER_S = 1e-3, 1e-4


@dataclass(frozen=True, eq=False)
class RigState:
    """Pose in the world, velocity (3,) and turn rate (3,) in the rig's own frame."""

    pose: QuaternionPose
    velocity_m_per_s: Array
    turn_rad_per_s: Array

    @property
    def moves(self) -> bool:
        """Whether it drives or turns."""
        speed, turn = (np.linalg.norm(v) for v in (self.velocity_m_per_s, self.turn_rad_per_s))
        return bool(speed > LEAST_M_PER_S or turn > LEAST_RAD_PER_S)


@dataclass
class RigPoses:
    """Poses of the rig over time, those of each sensor by themselves.

    The velocity is told by one sensor. Where a sensor stands on the rig is known to some error,
    and a sensor that knows no pose tells that of the origin: between poses of two sensors that
    would be motion.
    """

    _poses: dict[str, list[_Stamped]] = field(default_factory=dict)

    def add(self, sensor: str, stamp_ns: int, pose: QuaternionPose) -> None:
        """Take in a pose of the rig that a sensor told, at a time of the host."""
        poses = self._poses.setdefault(sensor, [])
        insort(poses, (stamp_ns, pose))
        poses[:] = [one for one in poses if abs(stamp_ns - one[0]) < KEPT_NS]

    def within(self, begin_ns: int, middle_ns: int, end_ns: int) -> RigState:
        """The rig at the middle of a frame, by the sensor that tells most poses of it within the
        frame, or else about it; as at rest where each tells but one.
        """
        span = end_ns - begin_ns
        within = [_between(each, begin_ns, end_ns) for each in self._poses.values()]
        near = [_between(each, begin_ns - span, end_ns + span) for each in self._poses.values()]
        several = [each for each in within if len(each) > 1]
        return _state(max(several or near, key=len), middle_ns)


def _between(poses: list[_Stamped], begin_ns: int, end_ns: int) -> list[_Stamped]:
    return [one for one in poses if begin_ns <= one[0] <= end_ns]


def _state(poses: list[_Stamped], at_ns: int) -> RigState:
    """By the first and the last pose, velocity and turn rate constant from one to the other."""
    (first_ns, first), (last_ns, last) = poses[0], poses[-1]
    if last_ns == first_ns:
        return RigState(last, np.zeros(3), np.zeros(3))
    from scipy.spatial.transform import Rotation  # takes 0.1 s to import

    elapsed_s, since_s = 1e-9 * (last_ns - first_ns), 1e-9 * (at_ns - first_ns)
    velocity = (last.position_m - first.position_m) / elapsed_s
    turn = (first.rotation.inv() * last.rotation).as_rotvec() / elapsed_s
    rotation = first.rotation * Rotation.from_rotvec(since_s * turn)
    pose = QuaternionPose.of(first.position_m + since_s * velocity, rotation)
    return RigState(pose, np.asarray(rotation.inv().apply(velocity)), np.asarray(turn))
