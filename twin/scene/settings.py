"""``scene.toml``: what Mitsuba's XML has no place for: the rig and its track, the sun, motion, true
targets.
"""

from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError, model_validator

from twin.files import InputError
from twin.scene.model import (
    BRIGHTEST_LX,
    FASTEST_M_PER_S,
    Pose,
    RadarRole,
    Rig,
    Sun,
    Target,
    Track,
)
from twin.toml import Count, Finite, NonNegative, Positive, Strict, describe, read_toml

Vector = tuple[Finite, Finite, Finite]


class _Mount(Strict):
    offset_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: Finite = 0.0
    pitch_deg: Finite = 0.0
    roll_deg: Finite = 0.0

    def pose(self) -> Pose:
        return Pose(self.offset_m, self.yaw_deg, self.pitch_deg, self.roll_deg)


class _Rig(Strict):
    position_m: Vector
    yaw_deg: Finite = 0.0
    pitch_deg: Finite = 0.0
    roll_deg: Finite = 0.0
    emitter: _Mount = _Mount()
    detector: _Mount = _Mount(offset_m=(0.0, -0.05, 0.0))
    radar: _Mount = _Mount(offset_m=(0.0, 0.0, -0.3))


class _Sun(Strict):
    azimuth_deg: Finite
    elevation_deg: Annotated[Finite, Field(ge=-90, le=90)]
    illuminance_lx: Annotated[NonNegative, Field(le=BRIGHTEST_LX)]


_Speed = Annotated[Finite, Field(ge=-FASTEST_M_PER_S, le=FASTEST_M_PER_S)]


class _Object(Strict):
    velocity_m_per_s: tuple[_Speed, _Speed, _Speed] = (0.0, 0.0, 0.0)
    radar: RadarRole | None = None
    thickness_m: Positive | None = None


class _Track(Strict):
    step_m: Vector
    count: Count
    interval_s: Positive | None = None


class _Target(Strict):
    name: str
    object: str | None = None
    position_m: Vector
    rcs_m2: Positive
    rcs_source: str | None = None
    rcs_assumed: str | None = None

    @model_validator(mode="after")
    def _one_origin(self) -> "_Target":
        if (self.rcs_source is None) == (self.rcs_assumed is None):
            raise InputError("needs either `rcs_source` or `rcs_assumed`")
        return self


class SceneSettings(Strict):
    """Content of one ``scene.toml``."""

    description: str = ""
    rig: _Rig
    track: _Track | None = None
    sun: _Sun
    objects: dict[str, _Object] = {}
    targets: tuple[_Target, ...] = ()

    def make_rig(self) -> Rig:
        """The rig with its devices."""
        at = self.rig
        pose = Pose(at.position_m, at.yaw_deg, at.pitch_deg, at.roll_deg)
        return Rig(pose, at.emitter.pose(), at.detector.pose(), at.radar.pose())

    def make_track(self) -> Track | None:
        """Where the radar stops, if it does not stand still."""
        at = self.track
        return None if at is None else Track(at.step_m, at.count, at.interval_s)

    def make_sun(self) -> Sun:
        """The sun."""
        return Sun(self.sun.azimuth_deg, self.sun.elevation_deg, self.sun.illuminance_lx)

    def velocity(self, name: str | None) -> Vector:
        """Velocity of an object; zero unless it is named."""
        return self.objects[name].velocity_m_per_s if name in self.objects else (0.0, 0.0, 0.0)

    def radar_role(self, name: str) -> RadarRole | None:
        """What an object is to the radar, where the scene says so."""
        return self.objects[name].radar if name in self.objects else None

    def thickness_m(self, name: str) -> float | None:
        """Thickness of a sheet that the mesh shows from one side only."""
        return self.objects[name].thickness_m if name in self.objects else None

    def make_targets(self) -> tuple[Target, ...]:
        """True targets, moving with their objects."""
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
    try:
        settings = SceneSettings.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error)}") from error
    carried = {target.object for target in settings.targets}
    for name, item in settings.objects.items():
        if item.radar == "declared" and name not in carried:
            raise InputError(
                f"{path}: objects.{name}.radar = 'declared', but no target has it as its object"
            )
    named = {**{f"objects.{name}": name for name in settings.objects}}
    named |= {f"targets.{t.name}.object": t.object for t in settings.targets if t.object}
    for place, name in named.items():
        if name not in object_names:
            raise InputError(
                f"{path}: {place}: no shape has the id {name!r}; "
                f"there are {', '.join(sorted(object_names))}"
            )
    return settings
