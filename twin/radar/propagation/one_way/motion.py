"""How rigid bodies move now, and how lengths and directions of straight ways between their points
change.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.scene import Scene, SceneObject, Target

Array = NDArray[np.float64]

#: Distances are taken to be no shorter where something is divided by them.
NEAREST_M = 1e-12


def lengthening(
    velocity: Array,
    direction: Array,
    length_m: Array | float,
    acceleration: Array | None = None,
) -> tuple[Any, Any]:
    """First and second derivative in time of the distance between two points.

    ``velocity`` (..., 3) of one relative to the other, ``direction`` (..., 3) the unit vector from
    the other to it, ``length_m`` (...) their distance, ``acceleration`` (..., 3) as ``velocity``,
    None for none: v . d in m/s, and |v - (v . d) d|^2 / r + a . d in m/s^2, both (...).
    """
    rate = np.sum(velocity * direction, axis=-1)
    across = velocity - rate[..., None] * direction
    faster = np.sum(across**2, axis=-1) / np.maximum(length_m, NEAREST_M)
    if acceleration is not None:
        faster = faster + np.sum(acceleration * direction, axis=-1)
    return rate, faster


def turning(velocity: Array, direction: Array, length_m: Array | float) -> Array:
    """Derivative in time of ``direction`` (..., 3), in 1/s; parameters as of `lengthening`."""
    across = velocity - np.sum(velocity * direction, axis=-1, keepdims=True) * direction
    rate_per_s: Array = across / np.maximum(length_m, NEAREST_M)[..., None]
    return rate_per_s


@dataclass(frozen=True, eq=False)
class RigidMotions:
    """How n rigid bodies move now, each (n, 3) in the world's axes.

    ``velocity_m_per_s`` and ``acceleration_m_per_s2`` of what of each is, or would be, at
    ``anchor_m`` (3,); ``spin_rad_per_s`` its angular velocity, ``spin_rate_rad_per_s2`` the
    derivative of that.
    """

    anchor_m: Array
    velocity_m_per_s: Array
    acceleration_m_per_s2: Array
    spin_rad_per_s: Array
    spin_rate_rad_per_s2: Array

    @staticmethod
    def of(items: Sequence[SceneObject], anchor_m: Array) -> "RigidMotions":
        """Those of objects."""
        velocity = np.array([item.velocity_m_per_s for item in items], float).reshape(-1, 3)
        acceleration, spin, spin_rate = (np.zeros_like(velocity) for _ in range(3))
        for number, item in enumerate(items):
            if item.motion is None:
                continue
            state = item.state
            (velocity[number],), (acceleration[number],) = state.at_world(anchor_m[None])
            spin[number] = state.angular_velocity_rad_per_s
            spin_rate[number] = state.angular_acceleration_rad_per_s2
        return RigidMotions(anchor_m, velocity, acceleration, spin, spin_rate)

    @property
    def are_uniform(self) -> bool:
        """Whether every body keeps its velocity and none turns."""
        others = self.acceleration_m_per_s2, self.spin_rad_per_s, self.spin_rate_rad_per_s2
        return not any(values.any() for values in others)

    def at(self, number: NDArray[np.integer] | int, places_m: Array) -> tuple[Array, Array]:
        """Velocity and acceleration of points (..., 3) relative to the anchor, (..., 3) each, of
        the bodies of these numbers (...).
        """
        spin, spin_rate = self.spin_rad_per_s[number], self.spin_rate_rad_per_s2[number]
        velocity = self.velocity_m_per_s[number] + np.zeros_like(places_m)
        acceleration = self.acceleration_m_per_s2[number] + np.zeros_like(places_m)
        if not self.are_uniform:
            around = np.cross(spin, places_m)
            velocity = velocity + around
            acceleration = acceleration + np.cross(spin_rate, places_m) + np.cross(spin, around)
        return velocity, acceleration


@dataclass(frozen=True, eq=False)
class PointMotion:
    """How a point and the axes around it move, (3,) each, as `RigidMotions`."""

    velocity_m_per_s: Array
    acceleration_m_per_s2: Array
    spin_rad_per_s: Array

    @staticmethod
    def still() -> "PointMotion":
        """Neither moves."""
        return PointMotion(np.zeros(3), np.zeros(3), np.zeros(3))

    @property
    def is_uniform(self) -> bool:
        """Whether it keeps its velocity, and the axes do not turn."""
        return not (self.acceleration_m_per_s2.any() or self.spin_rad_per_s.any())

    def mirrored(
        self, place: Array, point: Array, normal: Array, mirror: RigidMotions, number: int
    ) -> "PointMotion":
        """That of the image, of a point at ``place``, in a plane that moves with a body; ``point``
        and ``normal`` of the plane, all (3,) relative to the anchor.

        With s = (x - p) . n, x' = x - 2 s n is differentiated twice; the axes turn by
        2 (w - (w . n) n), w the mirror's angular velocity, and by their own mirrored.
        """
        moving, faster = mirror.at(number, point)
        velocity, acceleration = self.velocity_m_per_s, self.acceleration_m_per_s2
        rate = (velocity - moving) @ normal
        if mirror.are_uniform:
            return PointMotion(
                velocity - 2 * rate * normal,
                acceleration - 2 * (acceleration @ normal) * normal,
                self._mirrored_spin(normal),
            )
        spin, spin_rate = mirror.spin_rad_per_s[number], mirror.spin_rate_rad_per_s2[number]
        tilt = np.cross(spin, normal)
        more_tilt = np.cross(spin_rate, normal) + np.cross(spin, tilt)
        height = (place - point) @ normal
        rate += (place - point) @ tilt
        rate_change = (
            (acceleration - faster) @ normal
            + 2 * (velocity - moving) @ tilt
            + (place - point) @ more_tilt
        )
        return PointMotion(
            velocity - 2 * (rate * normal + height * tilt),
            acceleration - 2 * (rate_change * normal + 2 * rate * tilt + height * more_tilt),
            2 * (spin - (spin @ normal) * normal) + self._mirrored_spin(normal),
        )

    def _mirrored_spin(self, normal: Array) -> Array:
        spin: Array = 2 * (self.spin_rad_per_s @ normal) * normal - self.spin_rad_per_s
        return spin


def radar_motion(scene: Scene) -> PointMotion:
    """How the radar's antenna moves now."""
    if scene.rig.motion is None:
        return PointMotion.still()
    place, state = scene.rig.position_m + scene.rig.device("radar")[0], scene.rig.state
    (velocity,), (acceleration,) = state.at_world(place[None])
    return PointMotion(velocity, acceleration, state.angular_velocity_rad_per_s)


def target_motion(scene: Scene, target: Target) -> PointMotion:
    """How a declared target moves now: with the object that carries it, where that has a motion."""
    for item in scene.objects:
        if item.name == target.object and item.motion is not None:
            place = np.asarray(target.position_m, float)
            (velocity,), (acceleration,) = item.state.at_world(place[None])
            return PointMotion(velocity, acceleration, item.state.angular_velocity_rad_per_s)
    return PointMotion(np.asarray(target.velocity_m_per_s, float), np.zeros(3), np.zeros(3))


def relative_motion(scene: Scene, target: Target) -> tuple[Array, Array]:
    """Velocity and acceleration (3,) of a declared target, less those of the radar."""
    own, radar = target_motion(scene, target), radar_motion(scene)
    return (
        own.velocity_m_per_s - radar.velocity_m_per_s,
        own.acceleration_m_per_s2 - radar.acceleration_m_per_s2,
    )
