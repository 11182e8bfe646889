"""Poses in a log of this software or of ROS 2: transforms of a frame, poses, odometry."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.recording.cdr import Reader
from hardware.recording.ending import Ending
from hardware.recording.reading import LoggedMessage, read_messages
from hardware.records.state import QuaternionPose


@dataclass(frozen=True, eq=False)
class LoggedPoses:
    """Poses of one frame in another: stamps (n,) in ns, and numbers of their messages."""

    stamp_ns: NDArray[np.int64]
    poses: tuple[QuaternionPose, ...]
    message: NDArray[np.int64]
    parent: str


def read_poses(
    path: str | Path, topic: str = "/tf", child: str = "rig", ending: Ending | None = None
) -> LoggedPoses:
    """Poses of a frame in the order of writing, by the stamps in their messages.

    Parameters
    ----------
    path
        Log (MCAP); messages of tf2_msgs/TFMessage, geometry_msgs/PoseStamped, nav_msgs/Odometry.
    topic, child
        Where they stand, and the frame that they are of. A PoseStamped names no frame.
    ending
        Filled in, see `read_messages`.

    A pose that is told again at the same time is taken once. Raises InputError where the log holds
    none, tells them in more than one parent frame, or holds a broken message.
    """
    stamps: list[int] = []
    poses: list[QuaternionPose] = []
    numbers: list[int] = []
    parents, children, topics = set(), set(), set()
    for number, logged in enumerate(read_messages(path, ending)):
        reads = _KINDS.get(logged.schema.name)
        if reads is None:
            continue
        topics.add(logged.topic)
        if logged.topic != topic:
            continue
        for stamp, parent, frame, pose in _checked(path, number, logged, reads):
            children.add(frame)
            if frame not in (child, ""):
                continue
            if stamps and stamps[-1] == stamp and poses[-1] == pose:
                continue
            parents.add(parent)
            stamps.append(stamp)
            poses.append(pose)
            numbers.append(number)
    if not poses:
        there = ", ".join(sorted(children if topic in topics else topics)) or "none"
        kind = "frames" if topic in topics else "topics with poses"
        raise InputError(f"{path}: no pose of {child!r} on {topic}; {kind}: {there}")
    if len(parents) > 1:
        raise InputError(
            f"{path}: {topic}: {child!r} stands in the frames {', '.join(sorted(parents))}: "
            "expected one"
        )
    return LoggedPoses(np.array(stamps, np.int64), tuple(poses), np.array(numbers), parents.pop())


_Stamped = tuple[int, str, str, QuaternionPose]  # stamp in ns, parent, child


def _checked(
    path: str | Path,
    number: int,
    logged: LoggedMessage,
    reads: Callable[[Reader], Iterator[_Stamped]],
) -> list[_Stamped]:
    try:
        return list(reads(Reader(logged.message.data)))
    except ValueError as error:  # InputError, and text that is no UTF-8
        raise InputError(f"{path}: message {number} on {logged.topic}: {error}") from error


def _header(reader: Reader) -> tuple[int, str]:
    seconds, rest = reader.number("int32"), reader.number("uint32")
    return int(seconds) * 10**9 + int(rest), reader.text()


def _pose(reader: Reader) -> QuaternionPose:
    x, y, z, qx, qy, qz, qw = (reader.number("float64") for _ in range(7))
    return QuaternionPose(x, y, z, qw, qx, qy, qz)


def transforms(reader: Reader) -> Iterator[_Stamped]:
    """Stamp in ns, parent, child and pose of each transform of a tf2_msgs/TFMessage."""
    for _ in range(int(reader.number("uint32"))):
        stamp, parent = _header(reader)
        yield stamp, parent, reader.text(), _pose(reader)


def _pose_stamped(reader: Reader) -> Iterator[_Stamped]:
    stamp, parent = _header(reader)
    yield stamp, parent, "", _pose(reader)


def _odometry(reader: Reader) -> Iterator[_Stamped]:
    stamp, parent = _header(reader)
    yield stamp, parent, reader.text(), _pose(reader)  # covariance and twist follow


_KINDS: dict[str, Callable[[Reader], Iterator[_Stamped]]] = {
    "tf2_msgs/msg/TFMessage": transforms,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "nav_msgs/msg/Odometry": _odometry,
}
