"""A scene: its objects, the rig, the sun, true targets."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from twin.files import InputError
from twin.motion import Product, Still
from twin.scene.limits import LATEST_S, check
from twin.scene.materials import Material
from twin.scene.objects import IN_PLACE, SceneObject, Target
from twin.scene.rig import Pose, Rig, Track
from twin.scene.sun import Sun

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Described):
    """A validated scene. Scenes are equal that have the same name, path and content.

    ``materials`` are the rows that its objects use, by name; ``unknown_materials`` the names of
    those in whose place objects have the row `GENERIC`, by the object's name. ``warnings`` name
    everything that was defaulted, ``notes`` the rows of materials that take the place of bundled
    ones.
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
    unknown_materials: Mapping[str, str] = field(default_factory=dict)

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
            ``sun.azimuth_deg``, ``.elevation_deg``, ``.illuminance_lx``, ``.latitude_deg``,
            ``.north_azimuth_deg`` (the last two None for a sun that stands still);
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
        """The same scene later: all that moves has moved and turned, the rig on its trajectory and
        the sun in the sky too.

        A rig without a trajectory stands where it stood. Raises InputError for a time that a
        trajectory does not cover.
        """
        check("after", seconds, -LATEST_S, LATEST_S)
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
            sun=self.sun.after(seconds),
            objects=objects,
            targets=tuple(
                t.carried(*carriers[t.object]) if t.object in carriers else t.after(seconds)
                for t in self.targets
            ),
        )

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves but the rig and the sun."""
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
