"""Poses from logs, of our own and as ROS 2 tools write them."""

from pathlib import Path

import numpy as np
import pytest

from hardware.errors import InputError
from hardware.recording import Log, ros
from hardware.recording.poses import read_poses
from hardware.records.state import QuaternionPose

POSES = [QuaternionPose(0.5 * k, -1.0, 0.25, 0.6, 0.0, 0.0, 0.8) for k in range(3)]
STAMPS = [1_700_000_000_123_456_789 + 10**8 * k for k in range(3)]

NUMBERS = "float64 x\nfloat64 y\nfloat64 z\n"
RULE = "=" * 80 + "\n"
PARTS = (
    f"{RULE}MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n"
    f"{RULE}MSG: geometry_msgs/Point\n{NUMBERS}"
    f"{RULE}MSG: geometry_msgs/Quaternion\n{NUMBERS}float64 w\n{ros.HEADER_PARTS}"
)
STAMPED = f"std_msgs/Header header\ngeometry_msgs/Pose pose\n{PARTS}"
ODOMETRY = (
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    f"{RULE}MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\n"
    f"float64[36] covariance\n{PARTS}"
)


def content(pose: QuaternionPose) -> dict:
    return {
        "position": {"x": pose.x_m, "y": pose.y_m, "z": pose.z_m},
        "orientation": {"x": pose.qx, "y": pose.qy, "z": pose.qz, "w": pose.qw},
    }


@pytest.mark.library("mcap_ros2")
@pytest.mark.parametrize("kind", ["geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"])
def test_poses_as_ros_tools_write_them(tmp_path: Path, kind: str) -> None:
    from mcap_ros2.writer import Writer

    path = tmp_path / "log.mcap"
    stamped = kind.endswith("PoseStamped")
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef(kind, STAMPED if stamped else ODOMETRY)
        for stamp, pose in zip(STAMPS, POSES, strict=True):
            seconds, rest = divmod(stamp, 10**9)
            message = {
                "header": {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": "map"},
                "pose": content(pose),
            }
            if not stamped:
                message["pose"] = {"pose": content(pose), "covariance": [0.0] * 36}
                message["child_frame_id"] = "base_link"
            writer.write_message("/pose", schema, message, stamp, stamp)
        writer.finish()
    found = read_poses(path, "/pose", "base_link")
    assert found.stamp_ns.tolist() == STAMPS
    assert list(found.poses) == POSES
    assert found.parent == "map"


def test_transforms_of_one_frame_are_picked_out(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with Log(path) as log:
        for stamp, pose in zip(STAMPS, POSES, strict=True):
            for child, at in (("camera", QuaternionPose()), ("rig", pose), ("rig", pose)):
                log.message(
                    "/tf", ros.TRANSFORMS, ros.transform(at, stamp, "world", child), stamp, stamp
                )
    found = read_poses(path)
    assert list(found.poses) == POSES
    assert np.array_equal(found.message, [1, 4, 7])
    assert found.parent == "world"
    with pytest.raises(InputError, match="no pose of 'base' on /tf; frames: camera, rig"):
        read_poses(path, child="base")


def test_frames_that_change_their_parent_and_broken_messages_are_refused(tmp_path: Path) -> None:
    two = tmp_path / "two.mcap"
    with Log(two) as log:
        for parent, stamp in (("map", STAMPS[0]), ("odom", STAMPS[1])):
            told = ros.transform(POSES[0], stamp, parent, "rig")
            log.message("/tf", ros.TRANSFORMS, told, stamp, stamp)
    with pytest.raises(InputError, match="'rig' stands in the frames map, odom: expected one"):
        read_poses(two)
    broken = tmp_path / "broken.mcap"
    with Log(broken) as log:
        told = ros.transform(POSES[0], STAMPS[0], "map", "rig")[:-4]
        log.message("/tf", ros.TRANSFORMS, told, STAMPS[0], STAMPS[0])
    with pytest.raises(InputError, match=r"broken\.mcap: message 0 on /tf: message: ends after"):
        read_poses(broken)
