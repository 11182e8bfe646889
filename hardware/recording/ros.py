"""Standard messages of ROS 2: images, point clouds, transforms."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.recording.cdr import Writer
from hardware.records.state import QuaternionPose

_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_RULE = "=" * 80 + "\n"
HEADER_PARTS = f"{_RULE}MSG: std_msgs/Header\n{_HEADER}{_RULE}MSG: builtin_interfaces/Time\n{_TIME}"


@dataclass(frozen=True)
class Definition:
    """Name and text of a message type, as ROS 2 writes them (ros2msg)."""

    name: str
    text: str


IMAGE = Definition(
    "sensor_msgs/msg/Image",
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
    f"uint32 step\nuint8[] data\n{HEADER_PARTS}",
)
POINTS = Definition(
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
    "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n"
    f"{HEADER_PARTS}{_RULE}MSG: sensor_msgs/PointField\nuint8 INT8=1\nuint8 UINT8=2\n"
    "uint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\n"
    "uint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n",
)
TRANSFORMS = Definition(
    "tf2_msgs/msg/TFMessage",
    "geometry_msgs/TransformStamped[] transforms\n"
    f"{_RULE}MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n"
    f"geometry_msgs/Transform transform\n{_RULE}MSG: geometry_msgs/Transform\n"
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    f"{_RULE}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{_RULE}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    f"{HEADER_PARTS}",
)
CAMERA_INFO = Definition(
    "sensor_msgs/msg/CameraInfo",
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n"
    "float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n"
    f"sensor_msgs/RegionOfInterest roi\n{_RULE}MSG: sensor_msgs/RegionOfInterest\n"
    "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
    f"{HEADER_PARTS}",
)
_FLOAT32 = 7


def put_header(writer: Writer, stamp_ns: int, frame: str) -> None:
    """The field ``header``. Times before 1970 or after 2038 are clipped."""
    seconds, rest = divmod(min(max(stamp_ns, 0), (2**31 - 1) * 10**9), 10**9)
    writer.number("int32", seconds)
    writer.number("uint32", rest)
    writer.text(frame)


def image(pixels: NDArray[np.floating], stamp_ns: int, frame: str) -> bytes:
    """Image of one channel, float32, from ``(rows, columns)``."""
    rows, columns = pixels.shape
    writer = Writer()
    put_header(writer, stamp_ns, frame)
    writer.number("uint32", rows)
    writer.number("uint32", columns)
    writer.text("32FC1")
    writer.number("uint8", 0)
    writer.number("uint32", 4 * columns)
    writer.array(np.frombuffer(pixels.astype("<f4").tobytes(), np.uint8))
    return writer.message


def points(columns: Mapping[str, NDArray[np.floating]], stamp_ns: int, frame: str) -> bytes:
    """Cloud of points, float32, from columns of equal length; x, y and z among them."""
    n = {len(values) for values in columns.values()}
    if len(n) != 1 or not {"x", "y", "z"} <= columns.keys():
        raise InputError(f"points: columns {', '.join(columns)} of lengths {sorted(n)}")
    table = np.stack([np.asarray(values, "<f4") for values in columns.values()], axis=1)
    writer = Writer()
    put_header(writer, stamp_ns, frame)
    writer.number("uint32", 1)
    writer.number("uint32", len(table))
    writer.number("uint32", len(columns))
    for place, name in enumerate(columns):
        writer.text(name)
        writer.number("uint32", 4 * place)
        writer.number("uint8", _FLOAT32)
        writer.number("uint32", 1)
    writer.number("bool", False)
    writer.number("uint32", 4 * len(columns))
    writer.number("uint32", table.nbytes)
    writer.array(np.frombuffer(table.tobytes(), np.uint8))
    writer.number("bool", bool(np.isfinite(table).all()))
    return writer.message


def camera_info(
    field_rad: tuple[float, float], shape: tuple[int, int], stamp_ns: int, frame: str
) -> bytes:
    """Pinhole camera whose image of rows and columns spans these whole angles down and along."""
    (rows, columns), writer = shape, Writer()
    down, along = (n / 2 / math.tan(angle / 2) for n, angle in zip(shape, field_rad, strict=True))
    put_header(writer, stamp_ns, frame)
    writer.number("uint32", rows)
    writer.number("uint32", columns)
    writer.text("plumb_bob")
    writer.array(np.zeros(5))
    k = [along, 0.0, columns / 2 - 0.5, 0.0, down, rows / 2 - 0.5, 0.0, 0.0, 1.0]
    projection = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    for value in (*k, *np.eye(3).ravel(), *projection):
        writer.number("float64", float(value))
    for _ in range(6):  # no binning, the whole image
        writer.number("uint32", 0)
    writer.number("bool", False)
    return writer.message


def transform(pose: QuaternionPose, stamp_ns: int, parent: str, child: str) -> bytes:
    """One transform: pose of the child in its parent."""
    writer = Writer()
    writer.number("uint32", 1)
    put_header(writer, stamp_ns, parent)
    writer.text(child)
    for value in (*pose[:3], pose.qx, pose.qy, pose.qz, pose.qw):
        writer.number("float64", value)
    return writer.message
