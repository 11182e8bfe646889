"""What stands in a scene: rigid bodies with a material, and declared targets."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from hardware.described import Described
from hardware.read_only import cached_read_only, read_only
from twin.files import InputError
from twin.geometry import Geometry
from twin.motion import Kinematics, Motion, Product, Still, Straight
from twin.scene.limits import FASTEST_M_PER_S, check, check_above_zero, check_vector
from twin.scene.texture import Reflectance, Texture

Array = NDArray[np.float64]
RadarRole = Literal["surface", "optics", "table", "declared", "obstacle"]
#: A geometry's own frame is the world's.
IN_PLACE = RigidTransform.identity()


@dataclass(frozen=True, eq=False, repr=False)
class SceneObject(Described):
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
            check(f"{place}.reflectance", self.reflectance, 0.0, 1.0)
        check_vector(f"{place}.velocity_m_per_s", self.velocity_m_per_s, FASTEST_M_PER_S)
        if self.radar is not None and self.radar not in get_args(RadarRole):
            known = ", ".join(get_args(RadarRole))
            raise InputError(f"scene.{place}.radar = {self.radar!r}: expected one of {known}")
        if self.thickness_m is not None:
            check_above_zero(f"{place}.thickness_m", self.thickness_m)

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_read_only
    def vertices_m(self) -> Array:
        """Of the geometry, in the world, (n, 3)."""
        in_place = np.array_equal(self.pose.as_matrix(), np.eye(4))
        return self.geometry.vertices_m if in_place else self._placed(slice(None))

    @cached_read_only
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

    @cached_read_only
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
        found = replace(
            self, pose=state.pose, motion=motion, parent=parent, velocity_m_per_s=(x, y, z)
        )
        vars(found)["state"] = read_only(
            state
        )  # of a limb's chain of motions it takes milliseconds
        return found

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
        check_vector(f"{place}.position_m", self.position_m)
        check_vector(f"{place}.velocity_m_per_s", self.velocity_m_per_s, FASTEST_M_PER_S)
        check_above_zero(f"{place}.rcs_m2", self.rcs_m2)

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
