"""How sensors are mounted on a rig, and what a camera sees: from a log, or from a file."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hardware.errors import InputError
from hardware.files import read_toml
from hardware.recording.cdr import Reader
from hardware.recording.ending import Ending
from hardware.recording.kinds import KINDS
from hardware.recording.poses import transforms
from hardware.recording.reading import LoggedMessage, read_messages
from hardware.recording.ros import CAMERA_INFO, TRANSFORMS
from hardware.records import QuaternionPose

_FIELDS = "field_deg"
#: Types of records.
SPI, RADAR = (kind.definition.name for kind in KINDS)


@dataclass(frozen=True)
class Mounting:
    """Where sensors are on a rig, and what cameras see.

    Parameters
    ----------
    poses
        On the rig, by the sensor's frame.
    fields_rad
        Whole angles down and along that a camera's image spans, by the camera's frame.
    records
        Types of the records in the log that tells it, by their topics.
    """

    poses: Mapping[str, QuaternionPose] = field(default_factory=dict)
    fields_rad: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    records: Mapping[str, str] = field(default_factory=dict)

    def pose(self, sensor: str) -> QuaternionPose:
        """Of a sensor by the name that its topics begin with. Raises InputError where none is."""
        expected = "/tf_static, or as NAME = [x, y, z, qw, qx, qy, qz]"
        return self.poses[self._known(sensor, self.poses, "pose on the rig", expected)]

    def field_rad(self, sensor: str) -> tuple[float, float]:
        """Of a camera, as `pose`."""
        expected = "sensor_msgs/CameraInfo, or as [field_deg] NAME = [down, along]"
        return self.fields_rad[self._known(sensor, self.fields_rad, "field", expected)]

    def check(self) -> None:
        """Raise InputError unless all is known of the sensors of the log's records."""
        for topic, kind in self.records.items():
            sensor = sensor_of(topic)
            self.pose(sensor)
            if kind == SPI:
                self.field_rad(sensor)

    def _known(self, sensor: str, told: Collection[str], what: str, expected: str) -> str:
        frames = self._frames(sensor)
        for frame in frames:
            if frame in told:
                return frame
        known, names = ", ".join(sorted(told)) or "none", " or ".join(map(repr, frames))
        raise InputError(
            f"--motion radar: the {what} of {sensor!r} is unknown (known: {known}): expected it by "
            f"the name {names} in the log's {expected} in the file of --rig"
        )

    def _frames(self, sensor: str) -> list[str]:
        """Names that a sensor's frame may have: of further sources of a log their own, and the
        sensor's where the log has but one of it.
        """
        first, _, rest = sensor.strip("/").partition("/")
        name = rest.rpartition("/")[2]
        alike = [topic for topic in self.records if sensor_of(topic).rpartition("/")[2] == name]
        return [first, name] if name and len(alike) < 2 else [first]


def sensor_of(topic: str) -> str:
    """What the topics of a sensor begin with, from that of its records."""
    return topic.rpartition("/")[0] or "/sensor"


def read_mounting(path: str | Path) -> Mounting:
    """From a TOML file: ``NAME = [x, y, z, qw, qx, qy, qz]`` of each sensor, and a table
    ``[field_deg]`` of ``NAME = [down, along]`` of cameras.

    Raises InputError naming the file, the key and the value.
    """
    poses, fields = dict[str, QuaternionPose](), dict[str, tuple[float, float]]()
    for name, values in read_toml(path).items():
        try:
            if name == _FIELDS:
                fields = _angles(values)
                continue
            numbers = _finite(values, 7, "x, y, z, qw, qx, qy, qz")
            poses[name] = QuaternionPose.from_numbers(numbers)
        except InputError as error:
            raise InputError(f"{path}: {name}: {error}") from error
    return Mounting(poses, fields)


def logged_mounting(path: str | Path, ending: Ending | None = None) -> Mounting:
    """From a log's static transforms of the rig and its cameras' sensor_msgs/CameraInfo.

    ``ending`` is filled in, see `read_messages`. Raises InputError for a broken message, naming it.
    """
    poses, fields = dict[str, QuaternionPose](), dict[str, tuple[float, float]]()
    records = dict[str, str]()
    for number, logged in enumerate(read_messages(path, ending or Ending())):
        try:
            if logged.schema.name in (SPI, RADAR):
                records[logged.topic] = logged.schema.name
            elif logged.topic == "/tf_static" and logged.schema.name == TRANSFORMS.name:
                for _, parent, child, pose in transforms(Reader(logged.message.data)):
                    if parent == "rig":
                        poses[child] = pose
            elif logged.schema.name == CAMERA_INFO.name:
                fields.update(_field(logged))
        except ValueError as error:  # InputError, and text that is no UTF-8
            raise InputError(f"{path}: message {number} on {logged.topic}: {error}") from error
    return Mounting(poses, fields, records)


def _angles(table: Any) -> dict[str, tuple[float, float]]:
    if not isinstance(table, dict):
        raise InputError(f"{table!r:.60}, expected a table of NAME = [down, along]")
    fields = {}
    for camera, values in table.items():
        try:
            down, along = np.radians(_finite(values, 2, "down, along")).tolist()
        except InputError as error:
            raise InputError(f"{camera}: {error}") from error
        if not (0 < down < np.pi and 0 < along < np.pi):
            raise InputError(f"{camera}: {values}, expected two angles between 0 and 180 degrees")
        fields[camera] = down, along
    return fields


def _finite(values: Any, n: int, names: str) -> list[float]:
    """A list of n finite numbers. Raises InputError for anything else."""
    numbers = values if isinstance(values, list) else []
    if len(numbers) != n or not all(
        type(one) in (int, float) and math.isfinite(one) for one in numbers
    ):
        raise InputError(f"{values!r:.80}, expected {n} finite numbers: {names}")
    return [float(one) for one in numbers]


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
    return {frame: (2 * math.atan(rows / 2 / k[4]), 2 * math.atan(columns / 2 / k[0]))}
