"""What a scene is made of: objects with materials, the rig, the sun, true targets."""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from hardware.formatting import number, quantity_text
from hardware.units import quantity
from twin.files import InputError
from twin.geometry import Geometry
from twin.motion import Kinematics, Motion, Product, Still, Straight
from twin.scene.materials import Material
from twin.scene.texture import Reflectance, Texture

Array = NDArray[np.float64]
RadarRole = Literal["surface", "optics", "table", "declared", "obstacle"]
#: Delays are computed to first order in v / c.
FASTEST_M_PER_S = 1e5
#: Above the atmosphere the sun gives some 1.3e5 lx.
BRIGHTEST_LX = 1e7
#: A vertex farther from the rig is taken for a fault of the file: float32 rays lose 0.3 % of the
#: light on a wall of half-size 1e4 m and 27 % on one of 1e6 m.
FARTHEST_M = 1e5

#: A rig farther from the origin is taken for a fault: float64 has steps of 0.1 um there.
FARTHEST_ORIGIN_M = 1e9
#: An angle beyond it is taken for a fault: float64 has steps of 1e-7 deg there.
MOST_TURN_DEG = 1e9
#: Thirty years: a time beyond it is taken for a fault.
LATEST_S = 1e9
#: A geometry's own frame is the world's.
IN_PLACE = RigidTransform.identity()


def _check(name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> None:
    """Raise InputError for what is no finite number between both ends."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and math.isfinite(value) and low <= value <= high):
        wanted = "a finite number" if high == math.inf else f"{low:g} to {high:g}"
        raise InputError(f"scene.{name} = {value!r:.60}: expected {wanted}")


def _check_above_zero(name: str, value: Any) -> None:
    _check(name, value)
    if value <= 0:
        raise InputError(f"scene.{name} = {value!r}: expected a number above 0")


def _check_vector(name: str, value: Any, most: float = math.inf) -> None:
    """Raise InputError for what is not three finite numbers of at most ``most``."""
    if isinstance(value, str) or np.shape(value) != (3,):
        raise InputError(f"scene.{name} = {value!r:.60}: expected three numbers")
    for part in value:
        _check(name, part, -most, most)


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A rigid body: a geometry of one material, and where it stands.

    ``reflectance`` at 1550 nm: one number, or a texture looked up by the geometry's ``uv``.
    ``radar`` overrides what the object is to a radar; ``thickness_m`` is that of an open mesh that
    stands for a sheet. ``pose`` leads from the geometry's own frame to the world.

    ``motion`` gives the pose at times from now on, of an object that does more than go straight on
    at ``velocity_m_per_s``; of one with a motion that is the velocity, now, of the middle of its
    box (`middle_m`). ``parent`` names the object that carries it. `following` sets all of these.
    """

    name: str
    geometry: Geometry
    material: str
    reflectance: Reflectance
    velocity_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radar: RadarRole | None = None
    thickness_m: float | None = None
    pose: RigidTransform = IN_PLACE
    motion: Motion | None = None
    parent: str | None = None

    def __post_init__(self) -> None:
        place = f"objects.{self.name}"
        if not isinstance(self.reflectance, Texture):
            _check(f"{place}.reflectance", self.reflectance, 0.0, 1.0)
        _check_vector(f"{place}.velocity_m_per_s", self.velocity_m_per_s, FASTEST_M_PER_S)
        if self.radar is not None and self.radar not in get_args(RadarRole):
            known = ", ".join(get_args(RadarRole))
            raise InputError(f"scene.{place}.radar = {self.radar!r}: expected one of {known}")
        if self.thickness_m is not None:
            _check_above_zero(f"{place}.thickness_m", self.thickness_m)

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def vertices_m(self) -> Array:
        """Of the geometry, in the world, (n, 3)."""
        in_place = np.array_equal(self.pose.as_matrix(), np.eye(4))
        return self.geometry.vertices_m if in_place else self._placed(slice(None))

    @cached_property
    def box_m(self) -> Array:
        """Least and largest coordinates of what the faces use, in the world, (2, 3)."""
        corners = self._placed(self.geometry.shape.hull)
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    @property
    def middle_m(self) -> Array:
        """Middle of the box around the geometry in its own frame, in the world, (3,)."""
        middle: Array = self.pose.apply(self.geometry.sphere[0])
        return middle

    @property
    def moves(self) -> bool:
        """Whether it ever moves."""
        return any(self.velocity_m_per_s) if self.motion is None else self.motion.moves

    @cached_property
    def course(self) -> Motion:
        """Its pose, velocity and acceleration at times in seconds from now on."""
        if self.motion is not None:
            return self.motion
        still = Still(self.pose)
        return Product((Straight(self.velocity_m_per_s), still)) if self.moves else still

    @cached_property
    def state(self) -> Kinematics:
        """How it moves now."""
        return self.course.at(0.0)

    def following(self, motion: Motion, parent: str | None = None) -> "SceneObject":
        """The same object where a motion of its frame in the world has it at time 0.

        Raises InputError for a velocity beyond `FASTEST_M_PER_S`.
        """
        state = motion.at(0.0)
        middle = state.pose.apply(self.geometry.sphere[0])
        x, y, z = state.at_world(middle)[0].tolist()
        return replace(
            self, pose=state.pose, motion=motion, parent=parent, velocity_m_per_s=(x, y, z)
        )

    def after(self, seconds: float) -> "SceneObject":
        """The same object later; itself if it does not move."""
        if not self.moves:
            return self
        if self.motion is None:
            return self.moved(seconds * np.asarray(self.velocity_m_per_s))
        return self.following(self.motion.later(seconds), self.parent)

    def moved(self, by_m: Sequence[float] | Array) -> "SceneObject":
        """The same object farther on by a vector (3,) of the world, and all of its way.

        What has a parent moves within the parent's frame.
        """
        shift = RigidTransform.from_translation(by_m)
        if self.motion is None:
            return replace(self, pose=shift * self.pose)
        return self.following(self.motion.displaced(shift), self.parent)

    def _placed(self, rows: slice | NDArray[np.integer]) -> Array:
        vertices: Array = self.pose.apply(self.geometry.vertices_m[rows])
        vertices.setflags(write=False)
        return vertices


@dataclass(frozen=True)
class Pose:
    """Position in metres and REP 103 angles: yaw about z, pitch about y (down), roll about x."""

    position_m: tuple[float, float, float]
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    def __post_init__(self) -> None:
        _check_vector("rig.position_m", self.position_m)
        for name in ("yaw_deg", "pitch_deg", "roll_deg"):
            _check(f"rig.{name}", getattr(self, name), -MOST_TURN_DEG, MOST_TURN_DEG)

    def __str__(self) -> str:
        x, y, z = (number(value, 6) for value in self.position_m)
        turns = ", ".join(
            f"{name} {number(value, 4)} deg"
            for name, value in (
                ("yaw", self.yaw_deg),
                ("pitch", self.pitch_deg),
                ("roll", self.roll_deg),
            )
            if value
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

    @cached_property
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


@dataclass(frozen=True)
class Sun:
    """Direction to the sun in world axes, and illuminance on a plane normal to it."""

    azimuth_deg: float
    elevation_deg: float
    illuminance_lx: float

    def __post_init__(self) -> None:
        _check("sun.azimuth_deg", self.azimuth_deg)
        _check("sun.elevation_deg", self.elevation_deg, -90.0, 90.0)
        _check("sun.illuminance_lx", self.illuminance_lx, 0.0, BRIGHTEST_LX)

    def __str__(self) -> str:
        turn = f"azimuth {number(self.azimuth_deg)} deg, elevation {number(self.elevation_deg)} deg"
        return f"{turn}, {quantity_text(self.illuminance_lx, 'lx')}"

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

    def __post_init__(self) -> None:
        place = f"targets.{self.name}"
        _check_vector(f"{place}.position_m", self.position_m)
        _check_vector(f"{place}.velocity_m_per_s", self.velocity_m_per_s, FASTEST_M_PER_S)
        _check_above_zero(f"{place}.rcs_m2", self.rcs_m2)

    def after(self, seconds: float) -> "Target":
        """The same target later."""
        place = np.asarray(self.position_m) + seconds * np.asarray(self.velocity_m_per_s)
        x, y, z = place.tolist()
        return replace(self, position_m=(x, y, z))

    def carried(self, then: SceneObject, now: SceneObject) -> "Target":
        """The same target on its object, which has moved on from where it was."""
        place = now.pose.apply(then.pose.inv().apply(np.asarray(self.position_m)))
        x, y, z = place.tolist()
        u, v, w = now.state.at_world(place)[0].tolist()
        return replace(self, position_m=(x, y, z), velocity_m_per_s=(u, v, w))


@dataclass(frozen=True, eq=False)
class Scene:
    """A validated scene. Scenes are equal that have the same name, path and content.

    ``materials`` are the rows that its objects use, by name; ``warnings`` name everything that was
    defaulted, ``notes`` the rows of materials that take the place of bundled ones.
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
    notes: tuple[str, ...] = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @cached_property
    def _content(self) -> tuple[str, Path, str]:
        from twin.digest import digest

        return self.name, self.path, digest(self)

    def with_(self, changes: Mapping[str, Any]) -> "Scene":
        """The same with some of its values changed, validated at once.

        Parameters
        ----------
        changes
            By dotted name: ``rig.x_m`` (y, z), ``rig.yaw_deg`` (pitch, roll);
            ``sun.azimuth_deg``, ``.elevation_deg``, ``.illuminance_lx``;
            ``objects.NAME.reflectance``, ``.shift_x_m`` (y, z; what it carries moves too),
            ``.velocity_m_per_s`` (of one without a motion), ``.radar``, ``.thickness_m``;
            ``targets.NAME.rcs_m2``. NAME may be ``*``: all of them.

        Raises InputError naming field, value and what was expected.

        >>> from twin.scene import load_scene
        >>> scene = load_scene("yard").with_({"sun.elevation_deg": 20, "rig.x_m": 1.5})
        >>> scene.sun.elevation_deg, scene.rig.pose.position_m[0]
        (20, 1.5)
        """
        from twin.scene.changes import changed

        return changed(self, changes)

    def at(self, pose: Pose) -> "Scene":
        """The same scene seen from another pose, at which the rig stands still."""
        return replace(self, rig=replace(self.rig, pose=pose, motion=None))

    def after(self, seconds: float) -> "Scene":
        """The same scene later: all that moves has moved and turned, the rig on its trajectory too.

        A rig without one stands where it stood. Raises InputError for a time that a trajectory does
        not cover.
        """
        _check("after", seconds, -LATEST_S, LATEST_S)
        if seconds == 0:
            return self
        first, last = self.span_s
        if not first <= seconds <= last:
            raise InputError(
                f"scene {self.name}: time {seconds:g} s from now on: its trajectories cover "
                f"{first:g} to {last:g} s"
            )
        objects = tuple(item.after(seconds) for item in self.objects)
        carriers = {
            then.name: (then, now)
            for then, now in zip(self.objects, objects, strict=True)
            if now.motion is not None
        }
        return replace(
            self,
            rig=self.rig.after(seconds),
            objects=objects,
            targets=tuple(
                t.carried(*carriers[t.object]) if t.object in carriers else t.after(seconds)
                for t in self.targets
            ),
        )

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves but the rig."""
        velocities = [t.velocity_m_per_s for t in self.targets]
        return not (np.any(velocities) or any(item.moves for item in self.objects))

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time from now on that all trajectories cover."""
        motions = [self.rig.motion, *(item.motion for item in self.objects)]
        return Product((Still(IN_PLACE), *(m for m in motions if m is not None))).span_s

    @property
    def triangles(self) -> int:
        """Triangles in all objects."""
        return sum(len(o.geometry.faces) for o in self.objects)
