"""Truth of a drive as messages of its log, in topics that nothing on the vehicle reads."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from hardware.recording import ros
from hardware.recording.cdr import Reader, Writer
from hardware.recording.ros import HEADER_PARTS, Definition, put_header
from twin.camera.truth import Truth
from twin.motion import Kinematics, Product, Still, Straight
from twin.scene import Scene, SceneObject, Target

Array = NDArray[np.float64]

#: Frame of all poses and boxes.
WORLD = "world"

STATES = Definition(
    "ugv_msgs/msg/ObjectStates",
    "std_msgs/Header header\n"
    "# The rig, then the scene's objects, then its declared targets\n"
    "string[] names\n"
    "# Of each one's frame in the world: x y z (m), quaternion w x y z\n"
    "float64[] poses\n"
    "# Of the frame's origin, in the world's axes: velocity (m/s), turn rate (rad/s)\n"
    "float64[] twists\n"
    "# Along the world's axes: least, then largest x y z (m); of rig and targets their place\n"
    f"float64[] boxes\n{HEADER_PARTS}",
)
CLOCK = Definition(
    "ugv_msgs/msg/DriveClock",
    "std_msgs/Header header\n"
    "# What all messages since the last of these belong to, complete with this one\n"
    "uint64 event\nstring kind\nuint64 number\n"
    "# Beginning and end on the reference clock, and what the devices' clocks show at its end, ns\n"
    "int64 begin_ns\nint64 end_ns\nstring[] devices\nint64[] device_ns\n"
    f"{HEADER_PARTS}",
)


@dataclass(frozen=True, eq=False)
class ObjectStates:
    """Where all things are and how they move: ``names``, and for each of them ``poses`` (n, 7),
    ``twists`` (n, 6) and ``boxes_m`` (n, 2, 3), as `STATES` says.
    """

    names: tuple[str, ...]
    poses: Array
    twists: Array
    boxes_m: Array

    @classmethod
    def at(cls, scene: Scene, times_s: Array) -> "list[ObjectStates]":
        """All of a scene at each of some times (n,) from now on: many cost little more than one."""
        rig = scene.rig.course.at(times_s)
        names, poses, twists, boxes = ["rig"], [_poses(rig)], [_twists(rig)], [_points(rig)]
        carriers: dict[str, tuple[SceneObject, Kinematics]] = {}
        for item in scene.objects:
            state = item.course.at(times_s)
            if item.motion is not None:
                carriers[item.name] = item, state
            names.append(item.name)
            poses.append(_poses(state))
            twists.append(_twists(state))
            boxes.append(_boxes(item, state))
        for target in scene.targets:
            state = _target(target, carriers.get(target.object or ""), times_s)
            names.append(target.name)
            poses.append(_poses(state))
            twists.append(_twists(state) * [1, 1, 1, 0, 0, 0])
            boxes.append(_points(state))
        rows = zip(*(np.stack(part, axis=1) for part in (poses, twists, boxes)), strict=True)
        return [cls(tuple(names), *row) for row in rows]

    def pack(self, stamp_ns: int) -> bytes:
        """The message."""
        writer = Writer()
        put_header(writer, stamp_ns, WORLD)
        _put_texts(writer, self.names)
        for array in (self.poses, self.twists, self.boxes_m):
            writer.array(array.astype(np.float64))
        return writer.message

    @classmethod
    def unpack(cls, message: bytes) -> "ObjectStates":
        """From a message. Raises InputError where it ends too early."""
        reader = Reader(message)
        _skip_header(reader)
        names = _texts(reader)
        poses, twists, boxes = (reader.array("float64").astype(np.float64) for _ in range(3))
        return cls(names, poses.reshape(-1, 7), twists.reshape(-1, 6), boxes.reshape(-1, 2, 3))


@dataclass(frozen=True)
class Mark:
    """End of an event of a drive, as `CLOCK` says."""

    event: int
    kind: str
    number: int
    begin_ns: int
    end_ns: int
    device_ns: Mapping[str, int]

    def pack(self) -> bytes:
        """The message."""
        writer = Writer()
        put_header(writer, self.end_ns, WORLD)
        writer.number("uint64", self.event)
        writer.text(self.kind)
        writer.number("uint64", self.number)
        writer.number("int64", self.begin_ns)
        writer.number("int64", self.end_ns)
        _put_texts(writer, tuple(self.device_ns))
        writer.array(np.array(list(self.device_ns.values()), np.int64))
        return writer.message

    @classmethod
    def unpack(cls, message: bytes) -> "Mark":
        """From a message. Raises InputError where it ends too early."""
        reader = Reader(message)
        _skip_header(reader)
        event, kind, number = int(reader.number("uint64")), reader.text(), reader.number("uint64")
        begin_ns, end_ns = int(reader.number("int64")), int(reader.number("int64"))
        devices = _texts(reader)
        shown = reader.array("int64").tolist()
        return cls(
            event, kind, int(number), begin_ns, end_ns, dict(zip(devices, shown, strict=True))
        )


def images_of(truth: Truth, stamp_ns: int) -> dict[str, tuple[Definition, bytes]]:
    """Messages of a camera's truth by topic: albedo, and depth in metres along the boresight."""
    images = {"albedo": truth.albedo, "depth": truth.depth_m}
    return {
        f"/truth/camera/{name}": (ros.IMAGE, ros.image(image, stamp_ns, "camera"))
        for name, image in images.items()
    }


def _poses(state: Kinematics) -> Array:
    x, y, z, w = state.pose.rotation.as_quat().T
    return np.stack([*state.pose.translation.T, w, x, y, z], axis=1)


def _twists(state: Kinematics) -> Array:
    return np.concatenate([state.velocity_m_per_s, state.angular_velocity_rad_per_s], axis=1)


def _points(state: Kinematics) -> Array:
    """Boxes without extent, (n, 2, 3)."""
    return np.repeat(state.pose.translation[:, None], 2, axis=1)


def _boxes(item: SceneObject, state: Kinematics) -> Array:
    if not item.moves:
        return np.repeat(item.box_m[None], len(state.pose), axis=0)
    hull = item.geometry.vertices_m[item.geometry.shape.hull]
    turns, places = state.pose.rotation.as_matrix(), state.pose.translation
    corners = hull @ np.swapaxes(turns, 1, 2) + places[:, None]
    return np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)


def _target(
    target: Target, carrier: tuple[SceneObject, Kinematics] | None, times_s: Array
) -> Kinematics:
    """A target on its way, or where the object that carries it takes it."""
    place = np.asarray(target.position_m)
    if carrier is None:
        start = Still(RigidTransform.from_translation(place))
        return Product((Straight(target.velocity_m_per_s), start)).at(times_s)
    item, state = carrier
    there = RigidTransform.from_translation(item.pose.inv().apply(place))
    upright = RigidTransform.from_translation(state.carrying(there).pose.translation)
    return replace(state.carrying(there), pose=upright)


def _put_texts(writer: Writer, texts: tuple[str, ...]) -> None:
    writer.number("uint32", len(texts))
    for text in texts:
        writer.text(text)


def _texts(reader: Reader) -> tuple[str, ...]:
    return tuple(reader.text() for _ in range(int(reader.number("uint32"))))


def _skip_header(reader: Reader) -> None:
    reader.number("int32")
    reader.number("uint32")
    reader.text()
