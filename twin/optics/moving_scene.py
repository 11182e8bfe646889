"""A scene whose bodies move rigidly: every ray meets them where they are at its own instant.

The acceleration structure of a body is built once, in the body's own coordinates, and rays are
taken there: nothing is built anew, and rays of many instants share one kernel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.transfer import aligned

Array = NDArray[np.float64]

#: Of a body's radius: rays pass the sphere around it that miss it in float32 too.
_MARGIN = 1e-3


@dataclass(frozen=True, eq=False)
class MovingBody:
    """Surfaces that move as one rigid body.

    Parameters
    ----------
    scene
        Mitsuba scene of them, in the body's own coordinates.
    center_m, radius_m
        Of a sphere around them, in these coordinates.
    rotations, shifts_m
        From these coordinates to those of the rays, at each instant, (n, 3, 3) and (n, 3).
    """

    scene: Any
    center_m: Array
    radius_m: float
    rotations: Array
    shifts_m: Array


class MovingScene:
    """Stands for a Mitsuba scene wherever rays are traced. A ray's ``time`` is the number of its
    instant, unless ``instant`` is given: then all rays are of that one.

    Not a dataclass: Dr.Jit would traverse its fields at every loop.
    """

    def __init__(self, bodies: Sequence[MovingBody], instant: int | None = None) -> None:
        self._bodies = tuple(bodies)
        self._placed = [_Placed(body) for body in bodies]
        self._instant = instant

    def at(self, instant: int) -> "MovingScene":
        """The same at one instant."""
        return MovingScene(self._bodies, instant)

    def body_met(self, ray: Any) -> tuple[Any, Any]:
        """Distance to the first surface along rays, infinite for none, and its body's number."""
        mi, instant = mitsuba(), self._number(ray)
        distance, body = mi.Float(dr.inf), mi.UInt32(0)
        for number, placed in enumerate(self._placed):
            local = placed.pose(instant).taken(ray)
            met = placed.scene.ray_intersect_preliminary(local, coherent=True)
            nearer = met.is_valid() & (met.t < distance)
            distance, body = dr.select(nearer, met.t, distance), dr.select(nearer, number, body)
        return distance, body

    def shapes(self) -> list[Any]:
        """Of all bodies, one after another."""
        return [shape for body in self._bodies for shape in body.scene.shapes()]

    def ray_intersect(
        self, ray: Any, flags: Any = None, coherent: Any = False, active: Any = True
    ) -> Any:
        """The nearest surface along rays, as `mi.Scene.ray_intersect`."""
        mi, instant = mitsuba(), self._number(ray)
        flags = mi.RayFlags.All if flags is None else flags
        found, found_ray, found_pose = dr.zeros(mi.PreliminaryIntersection3f), mi.Ray3f(ray), _STILL
        found.t = mi.Float(dr.inf)
        for placed in self._placed:
            pose = placed.pose(instant)
            local = pose.taken(ray)
            local.maxt = dr.minimum(local.maxt, found.t)
            near = active & placed.is_near(local)
            met = placed.scene.ray_intersect_preliminary(local, coherent=coherent, active=near)
            nearer = met.is_valid() & (met.t < found.t)
            found = dr.select(nearer, met, found)
            found_ray = dr.select(nearer, local, found_ray)
            found_pose = found_pose.where_not(nearer, pose)
        hit = found.compute_surface_interaction(found_ray, flags, active)
        return found_pose.returned(hit)

    def ray_test(self, ray: Any, coherent: Any = False, active: Any = True) -> Any:
        """Whether a surface is in the way of rays, as `mi.Scene.ray_test`."""
        mi, instant = mitsuba(), self._number(ray)
        blocked = mi.Bool(False)
        for placed in self._placed:
            local = placed.pose(instant).taken(ray)
            near = active & ~blocked & placed.is_near(local)
            blocked |= placed.scene.ray_test(local, coherent=coherent, active=near)
        return blocked

    def _number(self, ray: Any) -> Any:
        mi = mitsuba()
        if self._instant is None:
            return mi.UInt32(ray.time)
        return dr.opaque(mi.UInt32, self._instant)


class _Placed:
    """A body with its poses on the engine's device."""

    def __init__(self, body: MovingBody) -> None:
        self.scene = body.scene
        mi = mitsuba()
        self._center = [dr.opaque(mi.Float, float(x)) for x in body.center_m]
        self._reach2 = dr.opaque(mi.Float, float(body.radius_m * (1 + _MARGIN)) ** 2)
        self._turns = not (body.rotations == np.eye(3)).all()
        self._rotation = [_table(x) for x in body.rotations.reshape(-1, 9).T if self._turns]
        self._shift = [_table(column) for column in body.shifts_m.T]

    def pose(self, instant: Any) -> "_Pose":
        """Of each ray, by its instant."""
        mi = mitsuba()
        shift = mi.Vector3f(*(dr.gather(mi.Float, x, instant) for x in self._shift))
        if not self._turns:
            return _Pose(None, shift)
        parts = [dr.gather(mi.Float, x, instant) for x in self._rotation]
        return _Pose([mi.Vector3f(*parts[3 * i : 3 * i + 3]) for i in range(3)], shift)

    def is_near(self, ray: Any) -> Any:
        """Whether rays pass the sphere around the body."""
        to_center = mitsuba().Vector3f(*self._center) - ray.o
        along = dr.dot(to_center, ray.d)
        return dr.squared_norm(to_center) - dr.square(along) <= self._reach2


class _Pose:
    """From a body's coordinates to those of the rays: rows of a rotation, or None; a shift."""

    def __init__(self, rows: list[Any] | None, shift: Any = 0.0) -> None:
        self.rows, self.shift = rows, shift

    def taken(self, ray: Any) -> Any:
        """Rays in the body's coordinates."""
        mi = mitsuba()
        local = mi.Ray3f(ray)
        origin, along = ray.o - self.shift, ray.d
        if self.rows is not None:
            one, two, three = self.rows
            origin, along = (
                one * v.x + two * v.y + three * v.z for v in (mi.Vector3f(origin), along)
            )
        local.o, local.d = mi.Point3f(origin), along
        return local

    def returned(self, hit: Any) -> Any:
        """A hit in the coordinates of the rays."""
        hit.n = self._turned(hit.n)
        frame = hit.sh_frame
        frame.s, frame.t, frame.n = (self._turned(x) for x in (frame.s, frame.t, frame.n))
        hit.sh_frame = frame
        hit.p = mitsuba().Point3f(self._turned(hit.p) + self.shift)
        return hit

    def where_not(self, is_other: Any, other: "_Pose") -> "_Pose":
        """The same, and another one where that is the nearer body's."""
        shift = dr.select(is_other, other.shift, self.shift)
        if self.rows is None and other.rows is None:
            return _Pose(None, shift)
        pairs = zip(self._all_rows(), other._all_rows(), strict=True)
        return _Pose([dr.select(is_other, b, a) for a, b in pairs], shift)

    def _all_rows(self) -> list[Any]:
        vector = mitsuba().Vector3f
        return self.rows or [vector(1, 0, 0), vector(0, 1, 0), vector(0, 0, 1)]

    def _turned(self, value: Any) -> Any:
        if self.rows is None:
            return value
        vector = mitsuba().Vector3f(value)
        return type(value)(*(dr.dot(row, vector) for row in self.rows))


_STILL = _Pose(None)


def _table(column: Array) -> Any:
    return mitsuba().Float(aligned(column.astype(np.float32)))
