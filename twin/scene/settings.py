"""``scene.toml``: what Mitsuba's XML has no place for: the rig and its track, the sun, motion, true
targets.
"""

from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError, model_validator

from twin.files import InputError
from twin.scene.limits import BRIGHTEST_LX, FASTEST_M_PER_S
from twin.scene.motion_settings import MotionSettings
from twin.scene.objects import RadarRole, Target
from twin.scene.rig import Pose, Rig, Track
from twin.scene.sun import Sun
from twin.toml import Count, Finite, NonNegative, Positive, Strict, describe, read_toml

Vector = tuple[Finite, Finite, Finite]


class _Mount(Strict):
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Place in the rig's frame: x forward, y left, z up."""
    yaw_deg: Finite = 0.0
    """Turn about z, positive to the left."""
    pitch_deg: Finite = 0.0
    """Turn about y, positive nose down."""
    roll_deg: Finite = 0.0
    """Turn about x."""

    def pose(self) -> Pose:
        return Pose(self.offset_m, self.yaw_deg, self.pitch_deg, self.roll_deg)


_Speed = Annotated[Finite, Field(ge=-FASTEST_M_PER_S, le=FASTEST_M_PER_S)]
_Velocity = tuple[_Speed, _Speed, _Speed]


class _Rig(Strict):
    position_m: Vector | None = None
    """Place of the rig in the scene: x forward, y left, z up; of one on a trajectory none. Default:
    that of a scene without a rig, if no angle and no motion is given either.
    """
    yaw_deg: Finite = 0.0
    """Turn about z, positive to the left."""
    pitch_deg: Finite = 0.0
    """Turn about y, positive nose down."""
    roll_deg: Finite = 0.0
    """Turn about x."""
    velocity_m_per_s: _Velocity = (0.0, 0.0, 0.0)
    """Velocity of the rig, in the scene or within its parent's frame."""
    parent: str | None = None
    """Id of the object that carries the rig."""
    motion: MotionSettings | None = None
    """How the rig moves beside a constant velocity."""
    emitter: _Mount = _Mount()
    """The pattern projector on the rig."""
    detector: _Mount = _Mount(offset_m=(0.0, -0.05, 0.0))
    """The camera's detector on the rig; without this table 5 cm to the right of its middle."""
    radar: _Mount = _Mount(offset_m=(0.0, 0.0, -0.3))
    """The radar on the rig; without this table 30 cm below its middle."""

    @model_validator(mode="after")
    def _one_place(self) -> "_Rig":
        turned = any((self.yaw_deg, self.pitch_deg, self.roll_deg))
        if self._on_way and (self.position_m is not None or turned):
            raise InputError(
                "its trajectory says where it is and where it looks: expected no `position_m` and "
                "no angles beside it, or `as_drawn` in the trajectory"
            )
        if not self.is_placed and (turned or self.moves):
            raise InputError("needs `position_m`, or `motion.trajectory` without `as_drawn`")
        return self

    @property
    def _on_way(self) -> bool:
        way = None if self.motion is None else self.motion.trajectory
        return way is not None and not way.as_drawn

    @property
    def is_placed(self) -> bool:
        """Whether it says where the rig is, by a position or a trajectory."""
        return self.position_m is not None or self._on_way

    @property
    def moves(self) -> bool:
        """Whether it is given a motion of its own or a parent's."""
        return any((*self.velocity_m_per_s, self.parent, self.motion))


class _Sun(Strict):
    azimuth_deg: Finite
    """Of the direction to the sun, from x towards y."""
    elevation_deg: Annotated[Finite, Field(ge=-90, le=90)]
    """Of the direction to the sun, above the horizon."""
    illuminance_lx: Annotated[NonNegative, Field(le=BRIGHTEST_LX)]
    """On a plane normal to the sun; a system's `sky` takes its place."""
    latitude_deg: Annotated[Finite, Field(ge=-90, le=90)] | None = None
    """Of the scene on the earth, positive north. With it the sun moves by 15 degrees an hour, from
    where it is given on, and brightens and darkens with its elevation in a clear sky. Default: it
    stands still.
    """
    north_azimuth_deg: Finite | None = None
    """Of true north in the scene, from x towards y; belongs to `latitude_deg`."""

    @model_validator(mode="after")
    def _is_one(self) -> "_Sun":
        try:
            self.sun()
        except InputError as error:
            raise InputError(str(error).removeprefix("scene.sun").lstrip(".: ")) from None
        return self

    def sun(self) -> Sun:
        return Sun(**self.model_dump())


class _Object(Strict):
    velocity_m_per_s: _Velocity = (0.0, 0.0, 0.0)
    """Velocity in the scene, or within its parent's frame."""
    parent: str | None = None
    """Id of the object that carries it: it moves and turns with that, and its own motion is that
    within the parent's frame."""
    motion: MotionSettings | None = None
    """How it moves beside a constant velocity."""
    radar: RadarRole | None = None
    """What the object is to the radar, in place of the rule's choice: mirror (`surface`), scatterer
    by physical optics (`optics`), scatterer by a table of its far field (`table`), a declared
    target (`declared`), or an obstacle only (`obstacle`).
    """
    thickness_m: Positive | None = None
    """Thickness of the sheet that an open mesh stands for. Default: that of the mesh, or an opaque
    one.
    """


class _Track(Strict):
    step_m: Vector
    """From one stop of the rig to the next."""
    count: Count
    """Stops."""
    interval_s: Positive | None = None
    """From the beginning of a burst to the next stop's. Default: as long as a burst takes."""


class _Target(Strict):
    name: str
    """As reports name it."""
    object: str | None = None
    """Object of the scene that the target moves with. Default: it stands still."""
    position_m: Vector
    """Where a radar should find it."""
    rcs_m2: Positive
    """Radar cross-section."""
    rcs_source: str | None = None
    """Where the cross-section was read."""
    rcs_assumed: str | None = None
    """Why this cross-section is assumed."""

    @model_validator(mode="after")
    def _one_origin(self) -> "_Target":
        if (self.rcs_source is None) == (self.rcs_assumed is None):
            raise InputError("needs either `rcs_source` or `rcs_assumed`")
        return self


class SceneSettings(Strict):
    """Content of one ``scene.toml``."""

    description: str = ""
    """What the scene is, in words."""
    rig: _Rig | None = None
    """Where the sensors are. Default: at the XML's camera, else where something can be seen."""
    track: _Track | None = None
    """Stops of the rig, of which the radar's images are made. Default: it stands still."""
    sun: _Sun | None = None
    """Where the sun stands and how bright it is. Default: high, to the right behind the rig."""
    objects: dict[str, _Object] = {}
    """By the id of a shape in `scene.xml`: what is not in the mesh."""
    targets: tuple[_Target, ...] = ()
    """True targets, with which detections are compared."""

    def rig_pose(self) -> Pose | None:
        """Where the rig is drawn; None where nothing says it."""
        at = self.rig
        if at is None or not at.is_placed:
            return None
        return Pose(at.position_m or (0.0, 0.0, 0.0), at.yaw_deg, at.pitch_deg, at.roll_deg)

    def make_rig(self, pose: Pose) -> Rig:
        """The rig with its devices at a pose."""
        at = self.rig
        if at is None:
            return Rig(pose)
        return Rig(pose, at.emitter.pose(), at.detector.pose(), at.radar.pose())

    def make_track(self) -> Track | None:
        """Where the radar stops, if it does not stand still."""
        at = self.track
        return None if at is None else Track(at.step_m, at.count, at.interval_s)

    def make_sun(self) -> Sun | None:
        """The sun; None where nothing says it."""
        at = self.sun
        return None if at is None else at.sun()

    def velocity(self, name: str | None) -> Vector:
        """Velocity of an object, as given; zero unless it is named."""
        return self.objects[name].velocity_m_per_s if name in self.objects else (0.0, 0.0, 0.0)

    def radar_role(self, name: str) -> RadarRole | None:
        """What an object is to the radar, where the scene says so."""
        return self.objects[name].radar if name in self.objects else None

    def thickness_m(self, name: str) -> float | None:
        """Thickness of a sheet that the mesh shows from one side only."""
        return self.objects[name].thickness_m if name in self.objects else None

    def make_targets(self) -> tuple[Target, ...]:
        """True targets, moving as straight as their objects do."""
        return tuple(
            Target(
                name=target.name,
                position_m=target.position_m,
                velocity_m_per_s=self.velocity(target.object),
                rcs_m2=target.rcs_m2,
                origin=target.rcs_source or f"assumed: {target.rcs_assumed}",
                object=target.object,
            )
            for target in self.targets
        )


def load_settings(path: Path, object_names: set[str]) -> SceneSettings:
    """Read and validate; names of objects must exist in the scene."""
    content = read_toml(path)
    try:
        settings = SceneSettings.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error, SceneSettings, content)}") from error
    if settings.track is not None and settings.rig is not None and settings.rig.moves:
        raise InputError(f"{path}: track: the rig moves by itself, expected one of both")
    carried = {target.object for target in settings.targets}
    for name, item in settings.objects.items():
        if item.radar == "declared" and name not in carried:
            raise InputError(
                f"{path}: objects.{name}.radar = 'declared', but no target has it as its object"
            )
    named = {**{f"objects.{name}": name for name in settings.objects}}
    named |= {f"objects.{n}.parent": o.parent for n, o in settings.objects.items() if o.parent}
    if settings.rig is not None and settings.rig.parent:
        named["rig.parent"] = settings.rig.parent
    named |= {f"targets.{t.name}.object": t.object for t in settings.targets if t.object}
    for place, name in named.items():
        if name not in object_names:
            raise InputError(
                f"{path}: {place}: no shape has the id {name!r}; "
                f"there are {', '.join(sorted(object_names))}"
            )
    return settings
