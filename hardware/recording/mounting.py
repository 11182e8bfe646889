"""How sensors are mounted on a rig, and what a camera sees: from a log, or from a file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import atan
from pathlib import Path
from typing import Any

import numpy as np

from hardware.errors import InputError
from hardware.files import read_toml
from hardware.recording.cdr import Reader
from hardware.recording.poses import transforms
from hardware.recording.reading import Ending, LoggedMessage, read_messages
from hardware.recording.ros import CAMERA_INFO, TRANSFORMS
from hardware.records import QuaternionPose

_FIELDS = "field_deg"


@dataclass(frozen=True)
class Mounting:
    """Poses of sensors on the rig, and the whole angles down and along that cameras span, rad, each
    by the sensor's frame; and the types of messages in the log that tell them.
    """

    poses: Mapping[str, QuaternionPose] = field(default_factory=dict)
    fields_rad: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    kinds: frozenset[str] = frozenset()


def read_mounting(path: str | Path) -> Mounting:
    """From a TOML file: ``NAME = [x, y, z, qw, qx, qy, qz]`` of each sensor, and a table
    ``[field_deg]`` of ``NAME = [down, along]`` of cameras.

    Raises InputError naming the file and the key.
    """
    poses, fields = dict[str, QuaternionPose](), dict[str, tuple[float, float]]()
    for name, values in read_toml(path).items():
        try:
            if name == _FIELDS:
                fields = {camera: _angles(camera, two) for camera, two in values.items()}
                continue
            poses[name] = QuaternionPose.from_numbers(values)
            if not any(poses[name][3:]):
                raise InputError("a quaternion of zeros")
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{path}: {name}: {error}") from error
    return Mounting(poses, fields)


def logged_mounting(path: str | Path) -> Mounting:
    """From a log's static transforms of the rig and its cameras' sensor_msgs/CameraInfo.

    Raises InputError for a broken message, naming it.
    """
    poses, fields = dict[str, QuaternionPose](), dict[str, tuple[float, float]]()
    kinds = set[str]()
    for number, logged in enumerate(read_messages(path, Ending())):
        kinds.add(logged.schema.name)
        try:
            if logged.topic == "/tf_static" and logged.schema.name == TRANSFORMS.name:
                for _, parent, child, pose in transforms(Reader(logged.message.data)):
                    if parent == "rig":
                        poses[child] = pose
            elif logged.schema.name == CAMERA_INFO.name:
                fields.update(_field(logged))
        except ValueError as error:  # InputError, and text that is no UTF-8
            raise InputError(f"{path}: message {number} on {logged.topic}: {error}") from error
    return Mounting(poses, fields, frozenset(kinds))


def _angles(camera: str, two: Any) -> tuple[float, float]:
    down, along = np.radians([float(angle) for angle in two]).tolist()
    if not (0 < down < np.pi and 0 < along < np.pi):
        raise InputError(f"{camera}: {two}, expected two angles between 0 and 180 degrees")
    return down, along


def _field(logged: LoggedMessage) -> dict[str, tuple[float, float]]:
    """Angles of a camera's frame; none where it is not calibrated."""
    reader = Reader(logged.message.data)
    reader.number("int32")
    reader.number("uint32")
    frame = reader.text()
    rows, columns = reader.number("uint32"), reader.number("uint32")
    reader.text()
    reader.array("float64")
    k = [reader.number("float64") for _ in range(9)]
    if not (rows and columns and k[0] > 0 and k[4] > 0):
        return {}
    return {frame: (2 * atan(rows / 2 / k[4]), 2 * atan(columns / 2 / k[0]))}
