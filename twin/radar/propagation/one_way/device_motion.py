"""Motions of points on the device, one element per ray; see `motion` for the same on the host."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from twin.radar.propagation.one_way.motion import NEAREST_M, PointMotion, RigidMotions
from twin.radar.scattering.arrays import Index, Mask, Real, Vector3
from twin.transfer import aligned

#: Numbers per point or body beyond its velocity, where any is other than zero.
_FURTHER = 6, 9


def lengthening(
    velocity: Vector3, direction: Vector3, length: Real, acceleration: Vector3 | None = None
) -> tuple[Real, Real]:
    """As `motion.lengthening`."""
    rate = dr.dot(velocity, direction)
    across = velocity - rate * direction
    faster = dr.squared_norm(across) / dr.maximum(length, NEAREST_M)
    if acceleration is not None:
        faster += dr.dot(acceleration, direction)
    return rate, faster


def turning(velocity: Vector3, direction: Vector3, length: Real) -> Vector3:
    """As `motion.turning`."""
    across = velocity - dr.dot(velocity, direction) * direction
    return across / dr.maximum(length, NEAREST_M)


@dataclass(frozen=True, eq=False)
class Moving:
    """How points move: ``velocity``; ``acceleration``, and the ``spin`` of the axes mirrored with
    them, None in a scene without either.
    """

    velocity: Vector3
    acceleration: Vector3 | None = None
    spin: Vector3 | None = None

    def columns(self) -> list[Any]:
        """All that is not None, in order."""
        parts = (self.velocity, self.acceleration, self.spin)
        return [axis for part in parts if part is not None for axis in part]

    @staticmethod
    def of_columns(columns: Sequence[Any], vector: Any) -> "Moving":
        """From these."""
        return Moving(*(vector(*columns[i : i + 3]) for i in range(0, len(columns), 3)))

    def lengthening(self, other: "Moving", direction: Vector3, length: Real) -> tuple[Real, Real]:
        """Of the way from ``other`` to this one; parameters as of `lengthening`."""
        acceleration = None
        if self.acceleration is not None and other.acceleration is not None:
            acceleration = self.acceleration - other.acceleration
        return lengthening(self.velocity - other.velocity, direction, length, acceleration)

    def turning(self, other: "Moving", direction: Vector3, length: Real) -> Vector3:
        """Of the direction from ``other``, an image, to this one, as its mirrored axes see it."""
        turn = turning(self.velocity - other.velocity, direction, length)
        return turn if other.spin is None else turn - dr.cross(other.spin, direction)


@dataclass(frozen=True, eq=False)
class MovingImages:
    """Motions of images: ``velocity`` (3 n), and ``further`` (6 n), acceleration and spin; None
    where nothing in the scene accelerates or turns.
    """

    velocity: Real
    further: Real | None = None

    @staticmethod
    def of(mi: Any, images: Sequence[PointMotion], accelerated: bool) -> "MovingImages":
        """On the device; ``accelerated``: whether anything in the scene accelerates or turns."""
        velocity = np.array([image.velocity_m_per_s for image in images])
        further = None
        if accelerated:
            rows = [[image.acceleration_m_per_s2, image.spin_rad_per_s] for image in images]
            further = mi.Float64(aligned(np.array(rows).ravel()))
        return MovingImages(mi.Float64(aligned(velocity.ravel())), further)

    def at(self, mi: Any, source: Index, active: Mask | bool = True) -> Moving:
        """Of images with these numbers."""
        velocity = gathered(mi, self.velocity, 3 * source, active)
        if self.further is None:
            return Moving(velocity)
        row = _FURTHER[0] * source
        more = (gathered(mi, self.further, row + i, active) for i in (0, 3))
        return Moving(velocity, *more)

    def on_host(self) -> tuple[Any, Any, Any]:
        """Velocity, acceleration and spin (n, 3) of all."""
        velocity = np.array(self.velocity).reshape(-1, 3)
        further = np.zeros((len(velocity), 2, 3))
        if self.further is not None:
            further = np.array(self.further).reshape(-1, 2, 3)
        return velocity, further[:, 0], further[:, 1]


@dataclass(frozen=True, eq=False)
class MovingBodies:
    """Motions of bodies by their numbers: ``velocity`` (3 n) of what is at the anchor, and
    ``further`` (9 n), acceleration, angular velocity and its derivative; None where nothing in the
    scene accelerates or turns.
    """

    velocity: Real
    further: Real | None = None

    @staticmethod
    def of(mi: Any, motions: RigidMotions, accelerated: bool) -> "MovingBodies":
        """On the device; ``accelerated``: whether anything in the scene accelerates or turns."""
        velocity = mi.Float64(aligned(motions.velocity_m_per_s.ravel()))
        if not accelerated:
            return MovingBodies(velocity)
        columns = (
            motions.acceleration_m_per_s2,
            motions.spin_rad_per_s,
            motions.spin_rate_rad_per_s2,
        )
        return MovingBodies(velocity, mi.Float64(aligned(np.hstack(columns).ravel())))

    def at(self, mi: Any, number: Index, place: Vector3) -> Moving:
        """Of points of bodies with these numbers; their ``spin`` is that of the body."""
        velocity = gathered(mi, self.velocity, 3 * number)
        if self.further is None:
            return Moving(velocity)
        acceleration, spin, spin_rate = self._further(mi, number)
        around = dr.cross(spin, place)
        acceleration += dr.cross(spin_rate, place) + dr.cross(spin, around)
        return Moving(velocity + around, acceleration, spin)

    def mirrored(
        self,
        mi: Any,
        number: Index,
        image: tuple[Vector3, Moving],
        point: Vector3,
        normal: Vector3,
    ) -> Moving:
        """Of the image of a point, a place and its motion, in the plane of a facet of these bodies,
        as `PointMotion.mirrored`.
        """
        place, moving = image
        own = self.at(mi, number, point)
        rate = dr.dot(moving.velocity - own.velocity, normal)
        if own.acceleration is None or moving.acceleration is None or moving.spin is None:
            return Moving(moving.velocity - 2 * rate * normal)
        _, spin, spin_rate = self._further(mi, number)
        tilt = dr.cross(spin, normal)
        more_tilt = dr.cross(spin_rate, normal) + dr.cross(spin, tilt)
        away = place - point
        height = dr.dot(away, normal)
        change = dr.dot(moving.acceleration - own.acceleration, normal) + dr.dot(away, more_tilt)
        change += 2 * dr.dot(moving.velocity - own.velocity, tilt)
        rate += dr.dot(away, tilt)
        turned = spin - dr.dot(spin, normal) * normal + dr.dot(moving.spin, normal) * normal
        return Moving(
            moving.velocity - 2 * (rate * normal + height * tilt),
            moving.acceleration - 2 * (change * normal + 2 * rate * tilt + height * more_tilt),
            2 * turned - moving.spin,
        )

    def _further(self, mi: Any, number: Index) -> list[Vector3]:
        row = _FURTHER[1] * number
        return [gathered(mi, self.further, row + i) for i in (0, 3, 6)]


def gathered(mi: Any, values: Any, index: Index, active: Mask | bool = True) -> Vector3:
    """Vectors of three numbers from an index on."""
    return mi.Vector3d(*(dr.gather(mi.Float64, values, index + i, active) for i in range(3)))
