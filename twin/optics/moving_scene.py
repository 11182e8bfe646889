"""A scene whose bodies move rigidly: every ray meets them where they are at its own instant.

The acceleration structure of a body is built once, in the body's own coordinates, and rays are
taken there: nothing is built anew, and rays of many instants share one kernel.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from twin.engine import check_scenes_of_a_kernel, mitsuba
from twin.transfer import aligned

Array = NDArray[np.float64]

#: Of a body's radius: rays pass the sphere around it that miss it in float32 too.
_MARGIN = 1e-3
#: Rotation and shift where there is no body.
_NOWHERE = np.eye(3)[None]


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
    instant, unless it is the scene `at` one: then all rays are of that one.

    Bodies that touch each other are a group. Rays that miss the sphere around a group or a body
    pass it by, and where all rays of a packet do, it costs nothing.

    Not a dataclass: Dr.Jit would traverse its fields at every loop.
    Raises EngineError for several bodies on CUDA, where a kernel traces one scene.
    """

    def __init__(self, bodies: Sequence[MovingBody]) -> None:
        check_scenes_of_a_kernel(len(bodies), "bodies that move are several")
        self._bodies = tuple(bodies)
        self._instant: int | None = None
        #: Largest coordinate of any body, at any instant, or more.
        self.extent_m = max(
            (
                float(np.abs(b.shifts_m).max() + np.linalg.norm(b.center_m) + b.radius_m)
                for b in bodies
            ),
            default=0.0,
        )
        self._placed = [_Placed(body, number) for number, body in enumerate(bodies)]
        self._n = len(bodies[0].shifts_m) if bodies else 1
        self._groups = [
            _Group([self._placed[i] for i in numbers], _sphere_around([bodies[i] for i in numbers]))
            for numbers in _touching(bodies)
        ]
        rotations = np.concatenate([body.rotations for body in bodies]) if bodies else _NOWHERE
        shifts = np.concatenate([body.shifts_m for body in bodies]) if bodies else _NOWHERE[0]
        self._turns = not (rotations == np.eye(3)).all()
        # Beside each other, a row of a rotation and its part of the shift: one gather.
        self._rows = _table(np.concatenate([rotations, shifts[..., None]], axis=-1).ravel())
        self._shifts = _table(np.pad(shifts, ((0, 0), (0, 1))).ravel())

    def at(self, instant: int) -> "MovingScene":
        """The same at one instant."""
        one = copy(self)
        one._instant = instant
        return one

    def body_met(self, ray: Any) -> tuple[Any, Any]:
        """Distance to the first surface along rays, infinite for none, and its body's number."""
        found, body = self._first_met(ray, coherent=True, active=True)
        return found.t, body

    def shapes(self) -> list[Any]:
        """Of all bodies, one after another."""
        return [shape for body in self._bodies for shape in body.scene.shapes()]

    def ray_intersect(
        self, ray: Any, flags: Any = None, coherent: Any = False, active: Any = True
    ) -> Any:
        """The nearest surface along rays, as `mi.Scene.ray_intersect`."""
        mi = mitsuba()
        flags = mi.RayFlags.All if flags is None else flags
        found, body = self._first_met(ray, coherent, active)
        pose = self._pose(body, self._number(ray))
        return pose.returned(found.compute_surface_interaction(pose.taken(ray), flags, active))

    def ray_test(self, ray: Any, coherent: Any = False, active: Any = True) -> Any:
        """Whether a surface is in the way of rays, as `mi.Scene.ray_test`."""
        instant = self._number(ray)

        def by_body(placed: _Placed, near: Any, blocked: Any) -> tuple[Any]:
            local = self._pose(placed.number, instant).taken(ray)
            here = placed.scene.ray_test(local, coherent=coherent, active=near & ~blocked)
            return (blocked | here,)

        (blocked,) = self._where_near(ray, instant, active, by_body, (mitsuba().Bool(False),))
        return blocked

    def _first_met(self, ray: Any, coherent: Any, active: Any) -> tuple[Any, Any]:
        """The nearest surface along rays, in the coordinates of its body, and the body's number."""
        mi, instant = mitsuba(), self._number(ray)
        found, body = dr.zeros(mi.PreliminaryIntersection3f, dr.width(ray)), mi.UInt32(0)
        found.t = mi.Float(dr.inf)

        def by_body(placed: _Placed, near: Any, found: Any, body: Any) -> tuple[Any, Any]:
            local = self._pose(placed.number, instant).taken(ray)
            local.maxt = dr.minimum(local.maxt, found.t)
            here = placed.scene.ray_intersect_preliminary(local, coherent=coherent, active=near)
            nearer = here.is_valid() & (here.t < found.t)
            found = dr.select(nearer, here, found)
            return found, dr.select(nearer, mi.UInt32(placed.number), body)

        found, body = self._where_near(ray, instant, active, by_body, (found, body))
        return found, body

    def _where_near(
        self,
        ray: Any,
        instant: Any,
        active: Any,
        by_body: Callable[..., tuple[Any, ...]],
        state: tuple[Any, ...],
    ) -> tuple[Any, ...]:
        """A state after ``by_body`` of each body that rays pass."""
        for group in self._groups:

            def by_group(near: Any, *state: Any, group: "_Group" = group) -> tuple[Any, ...]:
                for placed in group.placed:
                    work = partial(by_body, placed)
                    state = placed.sphere.where_near(ray, instant, near, work, state)
                return state

            state = group.sphere.where_near(ray, instant, active, by_group, state)
        return state

    def _pose(self, body: Any, instant: Any) -> "_Pose":
        """Of bodies at instants."""
        mi = mitsuba()
        at = instant + mi.UInt32(body) * dr.opaque(mi.UInt32, self._n)
        if not self._turns:
            x, y, z, _ = dr.gather(mi.Vector4f, self._shifts, at)
            return _Pose(None, mi.Vector3f(x, y, z))
        rows = [dr.gather(mi.Vector4f, self._rows, 3 * at + i) for i in range(3)]
        shift = mi.Vector3f(*(row.w for row in rows))
        return _Pose([mi.Vector3f(row.x, row.y, row.z) for row in rows], shift)

    def _number(self, ray: Any) -> Any:
        mi = mitsuba()
        if self._instant is None:
            return mi.UInt32(ray.time)
        return dr.opaque(mi.UInt32, self._instant)


def _touching(bodies: Sequence[MovingBody]) -> list[list[int]]:
    """Numbers of bodies, by group: those whose spheres touch at the first instant; one around the
    origin, where rays begin, is one of its own.
    """
    if not bodies:
        return []
    place = np.array([body.center_m @ body.rotations[0].T + body.shifts_m[0] for body in bodies])
    radius = np.array([body.radius_m for body in bodies])
    apart = np.linalg.norm(place[:, None] - place, axis=-1) > radius[:, None] + radius
    inside = np.linalg.norm(place, axis=1) <= radius
    touch = ~(apart | inside[:, None] | inside)
    _, label = connected_components(touch, directed=False)
    return [np.flatnonzero(label == i).tolist() for i in np.unique(label)]


def _sphere_around(bodies: Sequence[MovingBody]) -> "_Sphere":
    """Around bodies at all instants."""
    places = np.array([body.rotations @ body.center_m + body.shifts_m for body in bodies])
    radii = np.array([body.radius_m for body in bodies])[:, None]
    low, high = (places - radii[..., None]).min(axis=0), (places + radii[..., None]).max(axis=0)
    middle = (low + high) / 2
    return _Sphere(middle, (np.linalg.norm(places - middle, axis=-1) + radii).max(axis=0))


class _Sphere:
    """Around something at all instants."""

    def __init__(self, middle_m: Array, radius_m: Array) -> None:
        # Of one around the origin most rays begin within it.
        self._always = bool((np.linalg.norm(middle_m, axis=1) <= radius_m).any())
        reach2 = np.square(radius_m * (1 + _MARGIN))
        self._table = _table(np.concatenate([middle_m, reach2[:, None]], axis=1).ravel())

    def where_near(
        self,
        ray: Any,
        instant: Any,
        active: Any,
        work: Callable[..., tuple[Any, ...]],
        state: tuple[Any, ...],
    ) -> tuple[Any, ...]:
        """``work`` of what is active and a state, where rays pass the sphere; else the state."""
        if self._always:
            return work(active, *state)
        mi = mitsuba()
        x, y, z, reach2 = dr.gather(mi.Vector4f, self._table, instant)
        near = active & _passes(ray, mi.Point3f(x, y, z), reach2)
        found: tuple[Any, ...] = dr.if_stmt((near, *state), near, work, lambda near, *state: state)
        return found


@dataclass(frozen=True, eq=False)
class _Group:
    """Bodies with a sphere around them."""

    placed: "Sequence[_Placed]"
    sphere: _Sphere


class _Placed:
    """A body's surfaces, in its own coordinates, and a sphere around it."""

    def __init__(self, body: MovingBody, number: int) -> None:
        self.scene, self.number = body.scene, number
        middle = body.rotations @ body.center_m + body.shifts_m
        self.sphere = _Sphere(middle, np.full(len(middle), body.radius_m))


def _passes(ray: Any, middle: Any, reach2: Any) -> Any:
    """Whether rays, of length 1, pass a sphere, and do not have it behind them."""
    to_middle = middle - ray.o
    along, distance2 = dr.dot(to_middle, ray.d), dr.squared_norm(to_middle)
    return (distance2 - dr.square(along) <= reach2) & ((along > 0) | (distance2 <= reach2))


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

    def _turned(self, value: Any) -> Any:
        if self.rows is None:
            return value
        vector = mitsuba().Vector3f(value)
        return type(value)(*(dr.dot(row, vector) for row in self.rows))


def _table(column: Array) -> Any:
    return mitsuba().Float(aligned(column.astype(np.float32)))
