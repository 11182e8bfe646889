"""Where the sensors stand and look: poses, the rig with its devices, a drive with stops."""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from hardware.formatting import number
from hardware.read_only import cached_read_only
from hardware.units import quantity
from twin.files import InputError
from twin.motion import Kinematics, Motion, Still
from twin.scene.limits import MOST_TURN_DEG, check, check_vector

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """Position in metres and REP 103 angles: yaw about z, pitch about y (down), roll about x."""

    position_m: tuple[float, float, float]
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        check_vector("rig.position_m", self.position_m)
        for name in ("yaw_deg", "pitch_deg", "roll_deg"):
            check(f"rig.{name}", getattr(self, name), -MOST_TURN_DEG, MOST_TURN_DEG)

    def __str__(self) -> str:
        x, y, z = (number(value, 6) for value in self.position_m)
        turns = ", ".join(
            f"{name} {number(value, 4)} deg"
            for name, value in (
                ("yaw", self.yaw_deg),
                ("pitch", self.pitch_deg),
                ("roll", self.roll_deg),
            )
            if abs(value) > 1e-9  # what rotations leave in float64
        )
        return f"x {x} m, y {y} m, z {z} m; {turns or 'looks along x'}"

    @cached_property
    def rotation(self) -> Rotation:
        """From the posed frame to its parent."""
        angles = (self.yaw_deg, self.pitch_deg, self.roll_deg)
        return Rotation.from_euler("ZYX", angles, degrees=True)

    @property
    def transform(self) -> RigidTransform:
        """From the posed frame to its parent."""
        return RigidTransform.from_components(np.asarray(self.position_m, float), self.rotation)

    @staticmethod
    def from_axes(position_m: Array, forward: Array, up: Array) -> "Pose":
        """Pose that looks along ``forward`` with ``up`` as near to up as that allows."""
        x = forward / np.linalg.norm(forward)
        y = np.cross(up, x)
        y /= np.linalg.norm(y)
        turn = Rotation.from_matrix(np.column_stack([x, y, np.cross(x, y)]))
        return Pose.of(RigidTransform.from_components(np.asarray(position_m), turn))

    @staticmethod
    def of(transform: RigidTransform) -> "Pose":
        """Pose of a frame from which a transform leads to the world."""
        with warnings.catch_warnings():  # straight up or down: roll is 0 then, which is right
            warnings.simplefilter("ignore", UserWarning)
            yaw, pitch, roll = transform.rotation.as_euler("ZYX", degrees=True)
        px, py, pz = transform.translation.tolist()
        return Pose((px, py, pz), float(yaw), float(pitch), float(roll))


_POSE = {"x": "m", "y": "m", "z": "m", "yaw": "deg", "pitch": "deg", "roll": "deg"}
_TRACK = {"dx": "m", "dy": "m", "dz": "m", "interval": "s"}


def parse_pose(text: str) -> Pose:
    """Pose from ``x,y,z[,yaw_deg[,pitch_deg[,roll_deg]]]``; each may say its unit.

    >>> parse_pose("1,0,120 cm,0.1 rad").position_m
    (1.0, 0.0, 1.2)
    """
    try:
        words = _words(text)
        if not 3 <= len(words) <= 6:
            raise ValueError
        numbers = _quantities(words, _POSE)
    except ValueError as error:
        part = f"{error}; " if isinstance(error, InputError) else ""
        raise InputError(
            f"pose: {text!r}: {part}expected x,y,z[,yaw_deg[,pitch_deg[,roll_deg]]] in metres and "
            "degrees"
        ) from None
    return Pose((numbers[0], numbers[1], numbers[2]), *numbers[3:])


def _quantities(words: Sequence[str], units: Mapping[str, str]) -> list[float]:
    """Numbers in their units. Raises InputError for the first part that is none."""
    numbers = []
    for word, (name, unit) in zip(words, units.items(), strict=False):
        try:
            numbers.append(quantity(word, unit, bare=True))
        except InputError as error:
            raise InputError(f"{name} = {word!r}: {error}") from None
    return numbers


def _words(text: str) -> list[str]:
    """What stands between commas, or between spaces before a number."""
    return re.split(r"\s*,\s*|\s+(?=[-+.\d])", text.strip())


@dataclass(frozen=True)
class Rig:
    """The vehicle's sensors: one pose, and each device's offset and boresight in its frame.

    ``motion`` gives the pose at times from now on, if the rig moves.
    """

    pose: Pose
    emitter: Pose = Pose((0.0, 0.0, 0.0))
    detector: Pose = Pose((0.0, -0.05, 0.0))
    radar: Pose = Pose((0.0, 0.0, -0.3))
    motion: Motion | None = None

    @property
    def moves(self) -> bool:
        """Whether it ever moves."""
        return self.motion is not None and self.motion.moves

    @cached_property
    def course(self) -> Motion:
        """Its pose, velocity and acceleration at times in seconds from now on."""
        if self.motion is not None:
            return self.motion
        return Still(self.pose.transform)

    @cached_read_only
    def state(self) -> Kinematics:
        """How it moves now."""
        return self.course.at(0.0)

    def following(self, motion: Motion) -> "Rig":
        """The same rig where a motion of its frame in the world has it at time 0."""
        return replace(self, pose=Pose.of(motion.pose_at(0.0)), motion=motion)

    def after(self, seconds: float) -> "Rig":
        """The same rig later; itself if it has no motion."""
        return self if self.motion is None else self.following(self.motion.later(seconds))

    def device(self, name: str) -> tuple[Array, Array]:
        """Origin (3,) in metres from the rig's position, and axes (3, 3) with the rows forward,
        left, up; both in world orientation.
        """
        mount: Pose = getattr(self, name)
        origin = self.pose.rotation.apply(np.asarray(mount.position_m))
        return origin, (self.pose.rotation * mount.rotation).as_matrix().T

    @property
    def position_m(self) -> Array:
        """Where the rig stands in the world."""
        return np.asarray(self.pose.position_m, dtype=np.float64)


@dataclass(frozen=True)
class Track:
    """A straight drive with stops, at each of which the radar takes one burst.

    The first stop is the rig's own pose. ``step_m`` is in the rig's frame; ``interval_s`` from the
    start of one burst to the next, by default as long as a burst takes.
    """

    step_m: tuple[float, float, float]
    count: int
    interval_s: float | None = None

    def poses(self, start: Pose) -> tuple[Pose, ...]:
        """Poses of the rig at all stops."""
        step = start.rotation.apply(np.asarray(self.step_m))
        places = np.asarray(start.position_m) + np.arange(self.count)[:, None] * step
        return tuple(replace(start, position_m=(x, y, z)) for x, y, z in places.tolist())


def parse_track(text: str) -> Track:
    """Track from ``dx,dy,dz,count[,interval_s]``; lengths and the time may say their unit."""
    try:
        words = _words(text)
        count = int(words[3])
        if len(words) > 5 or count < 1:
            raise ValueError
        numbers = _quantities((*words[:3], *words[4:]), _TRACK)
        if len(numbers) == 4 and numbers[3] <= 0:
            raise ValueError
    except (ValueError, IndexError) as error:
        part = f"{error}; " if isinstance(error, InputError) else ""
        raise InputError(
            f"track: {text!r}: {part}expected dx,dy,dz,count[,interval_s] in metres and seconds"
        ) from None
    return Track((numbers[0], numbers[1], numbers[2]), count, *numbers[3:])
