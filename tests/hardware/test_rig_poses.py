"""How a rig drives, by the poses that its sensors tell."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hardware.records import QuaternionPose
from hardware.rig_poses import RigPoses

FRAME = 0, 400_000_000, 800_000_000
STAMPS = range(50_000_000, 800_000_000, 100_000_000)


def driving(time_ns: float) -> QuaternionPose:
    """At 5 m/s, 0.1 rad/s to the left, in a world whose origin is elsewhere."""
    t = 1e-9 * time_ns
    return QuaternionPose.of([3.0 + 5 * t, -2.0 * t, 1.2], Rotation.from_rotvec([0, 0, 0.1 * t]))


def test_constant_motion_is_that_of_the_poses() -> None:
    poses = RigPoses()
    for stamp in STAMPS:
        poses.add("/radar", stamp, driving(stamp))
    found = poses.within(*FRAME)
    np.testing.assert_allclose(found.pose, driving(FRAME[1]), atol=1e-9)
    expected = Rotation.from_rotvec([0, 0, 0.04]).inv().apply([5.0, -2.0, 0.0])
    np.testing.assert_allclose(found.velocity_m_per_s, expected, atol=1e-9)
    np.testing.assert_allclose(found.turn_rad_per_s, [0, 0, 0.1], atol=1e-9)
    assert found.moves


@pytest.mark.parametrize("first", ["/radar", "/spi"])
def test_sensors_that_differ_on_where_the_rig_stands_do_not_move_it(first: str) -> None:
    """Each sensor's own poses are at rest. Between them lie 0.3 m, as of devices that know no pose
    (both tell the origin, the radar is mounted 0.3 m lower), or of a mounting measured wrongly:
    taken together they would be 0.4 m/s upwards.
    """
    poses = RigPoses()
    for sensor in sorted(("/radar", "/spi"), key=lambda one: one != first):
        if sensor == "/spi":
            poses.add("/spi", 0, QuaternionPose())
        else:
            for stamp in STAMPS:
                poses.add("/radar", stamp, QuaternionPose(z_m=0.3))
    found = poses.within(*FRAME)
    assert not found.moves
    assert found.pose == QuaternionPose(z_m=0.3)  # in the world in which the tracks stand


def test_where_none_tells_two_within_the_frame_those_about_it_count() -> None:
    poses = RigPoses()
    for stamp in (-700_000_000, 0):
        poses.add("/spi", stamp, driving(stamp))
    poses.add("/radar", 100_000_000, QuaternionPose(z_m=9.0))
    found = poses.within(*FRAME)
    np.testing.assert_allclose(found.turn_rad_per_s, [0, 0, 0.1], atol=1e-9)


def test_one_pose_is_rest() -> None:
    poses = RigPoses()
    poses.add("/spi", 0, driving(0))
    assert not poses.within(*FRAME).moves
