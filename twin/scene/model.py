"""What a scene is made of: objects with materials, the rig, the sun, true targets."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin.files import InputError
from twin.scene.materials import Material
from twin.scene.texture import Reflectance

Array = NDArray[np.float64]
RadarRole = Literal["surface", "optics", "table", "declared", "obstacle"]


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A rigid triangle mesh of one material.

    ``vertices_m`` (n, 3) in world coordinates; ``faces`` (m, 3) indices; ``uv`` (n, 2) or None;
    ``reflectance`` at 1550 nm: one number, or a texture looked up by ``uv``. ``radar`` overrides
    what the object is to a radar; ``thickness_m`` is that of an open mesh that stands for a sheet.
    """

    name: str
    vertices_m: Array
    faces: NDArray[np.integer]
    uv: Array | None
    material: str
    reflectance: Reflectance
    velocity_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radar: RadarRole | None = None
    thickness_m: float | None = None


@dataclass(frozen=True)
class Pose:
    """Position in metres and REP 103 angles: yaw about z, pitch about y (down), roll about x."""

    position_m: tuple[float, float, float]
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    @cached_property
    def rotation(self) -> Rotation:
        """From the posed frame to its parent."""
        angles = (self.yaw_deg, self.pitch_deg, self.roll_deg)
        return Rotation.from_euler("ZYX", angles, degrees=True)

    @staticmethod
    def from_axes(position_m: Array, forward: Array, up: Array) -> "Pose":
        """Pose that looks along ``forward`` with ``up`` as near to up as that allows."""
        x = forward / np.linalg.norm(forward)
        y = np.cross(up, x)
        y /= np.linalg.norm(y)
        matrix = np.column_stack([x, y, np.cross(x, y)])
        with warnings.catch_warnings():  # straight up or down: roll is 0 then, which is right
            warnings.simplefilter("ignore", UserWarning)
            yaw, pitch, roll = Rotation.from_matrix(matrix).as_euler("ZYX", degrees=True)
        px, py, pz = (float(p) for p in position_m)
        return Pose((px, py, pz), float(yaw), float(pitch), float(roll))


def parse_pose(text: str) -> Pose:
    """Pose from ``x,y,z[,yaw_deg[,pitch_deg[,roll_deg]]]``."""
    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
        if not 3 <= len(numbers) <= 6 or not all(map(math.isfinite, numbers)):
            raise ValueError
    except ValueError:
        raise InputError(
            f"pose: {text!r}: expected x,y,z[,yaw_deg[,pitch_deg[,roll_deg]]] in metres and degrees"
        ) from None
    return Pose((numbers[0], numbers[1], numbers[2]), *numbers[3:])


@dataclass(frozen=True)
class Rig:
    """The vehicle's sensors: one pose, and each device's offset and boresight in its frame."""

    pose: Pose
    emitter: Pose = Pose((0.0, 0.0, 0.0))
    detector: Pose = Pose((0.0, -0.05, 0.0))
    radar: Pose = Pose((0.0, 0.0, -0.3))

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
    """Track from ``dx,dy,dz,count[,interval_s]``."""
    try:
        words = text.replace(",", " ").split()
        numbers = [float(word) for word in (*words[:3], *words[4:])]
        count = int(words[3])
        if not (3 <= len(numbers) <= 4 and all(map(math.isfinite, numbers)) and count > 0):
            raise ValueError
        if len(numbers) == 4 and numbers[3] <= 0:
            raise ValueError
    except (ValueError, IndexError):
        raise InputError(
            f"track: {text!r}: expected dx,dy,dz,count[,interval_s] in metres and seconds"
        ) from None
    return Track((numbers[0], numbers[1], numbers[2]), count, *numbers[3:])


@dataclass(frozen=True)
class Sun:
    """Direction to the sun in world axes, and illuminance on a plane normal to it."""

    azimuth_deg: float
    elevation_deg: float
    illuminance_lx: float

    @property
    def direction(self) -> Array:
        """Unit vector towards the sun."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        flat = math.cos(elevation)
        return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


@dataclass(frozen=True)
class Target:
    """What a radar should find, with its declared cross-section and where that comes from.

    ``object`` names the mesh that carries it, if there is one.
    """

    name: str
    position_m: tuple[float, float, float]
    velocity_m_per_s: tuple[float, float, float]
    rcs_m2: float
    origin: str
    object: str | None = None

    def after(self, seconds: float) -> "Target":
        """The same target later."""
        place = np.asarray(self.position_m) + seconds * np.asarray(self.velocity_m_per_s)
        x, y, z = place.tolist()
        return replace(self, position_m=(x, y, z))


@dataclass(frozen=True)
class Scene:
    """A validated scene.

    ``materials`` are the rows that its objects use, by name; ``warnings`` name everything that was
    defaulted.
    """

    name: str
    path: Path
    description: str
    objects: tuple[SceneObject, ...]
    rig: Rig
    sun: Sun
    targets: tuple[Target, ...] = ()
    track: Track | None = None
    materials: Mapping[str, Material] = field(default_factory=dict)
    assumptions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def at(self, pose: Pose) -> "Scene":
        """The same scene seen from another pose."""
        return replace(self, rig=replace(self.rig, pose=pose))

    def after(self, seconds: float) -> "Scene":
        """The same scene later: everything that moves has moved, the rig stands where it stood."""
        if seconds == 0:
            return self
        return replace(
            self,
            objects=tuple(
                replace(o, vertices_m=o.vertices_m + seconds * np.asarray(o.velocity_m_per_s))
                for o in self.objects
            ),
            targets=tuple(t.after(seconds) for t in self.targets),
        )

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves but the rig."""
        velocities = [o.velocity_m_per_s for o in self.objects]
        return not np.any(velocities + [t.velocity_m_per_s for t in self.targets])

    @property
    def triangles(self) -> int:
        """Triangles in all objects."""
        return sum(len(o.faces) for o in self.objects)
