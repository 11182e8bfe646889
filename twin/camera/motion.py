"""What moves during a frame, as the camera sees it: rigid bodies in the coordinates of its rig.

The rig stands still in these coordinates, which are those of a still frame at its start, and the
world moves around it.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.camera.swept import covers, image_points
from twin.engine import mitsuba
from twin.motion.polynomials import Polynomials
from twin.optics.devices import CellGrid, Device, primary_rays
from twin.optics.moving_scene import MovingBody, MovingScene
from twin.optics.ray_sets import RowRays
from twin.scene import Scene
from twin.scene.mitsuba import mitsuba_scene

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Times at which it is asked what moves alike, and how fast.
_LOOKS = 17
#: Of the time between looks: how much later it is looked where things go.
_SOON = 1e-3
#: Of what a body is wide, the way from one instant to the next on which no cell misses it.
_OWN_WIDTH = 0.5
#: Over a cell's or a metre's, what a body is wide at least, so that nothing is infinitely thin.
_THINNEST = 1e-3
#: Times at which all motions are asked for once; where that needs more, each time is.
_MOST_ASKED = 8192
#: Of a motion between its breaks, the last terms of its polynomial at most, m or of a turn.
_LAST_M = 1e-8
#: A rotation that is less is none.
_TURN_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class _Body:
    """Objects that move as one: a scene of them alone in its own coordinates, which are those of
    the frame's start, the corners of a box around them, (8, 3), and the number of the first.
    """

    alone: Scene
    corners_m: Array
    first: int

    @cached_property
    def scene(self) -> Any:
        """Of Mitsuba."""
        return mitsuba_scene(self.alone)

    @property
    def center_m(self) -> Array:
        return np.asarray(self.corners_m.mean(axis=0))

    @property
    def radius_m(self) -> float:
        return float(np.linalg.norm(self.corners_m - self.center_m, axis=1).max())

    def placed(self, moves: Array) -> Array:
        """The corners at all motions, (n_objects, n, 4, 4), (n, 8, 3)."""
        own = moves[self.first]
        return np.asarray(self.corners_m @ np.swapaxes(own[:, :3, :3], 1, 2) + own[:, None, :3, 3])


class WorldInMotion:
    """The world around a rig, from a frame's start to its end.

    Raises InputError for a trajectory that ends before the frame does.
    """

    def __init__(self, scene: Scene, duration_s: float) -> None:
        self.scene, self.duration_s = scene, duration_s
        self.looks_s = np.linspace(0, duration_s, _LOOKS)
        self._alike = [[number] for number in range(len(scene.objects))]
        self._looks = self._moves(self.looks_s)
        alike: dict[bytes, list[int]] = {}
        for number, moves in enumerate(self._looks):
            alike.setdefault(np.round(moves, 12).tobytes(), []).append(number)
        self._alike = list(alike.values())

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing moves, seen from the rig."""
        return bool((self._looks == np.eye(4)).all())

    @property
    def turns(self) -> bool:
        """Whether the rig does."""
        rig = self.scene.rig
        if not rig.moves:
            return False
        turns = rig.course.pose_at(np.linspace(0, self.duration_s, _LOOKS)).rotation
        return bool((rig.pose.rotation.inv() * turns).magnitude().max() > _TURN_RAD)

    def moves(self, times_s: Array) -> Array:
        """Motion of each object since the start, (n_objects, n, 4, 4), seen from the rig."""
        if self._polynomials is None:
            return self._moves(times_s)
        return np.swapaxes(self._polynomials.at(times_s), 0, 1)

    @cached_property
    def _polynomials(self) -> Polynomials | None:
        """The same between times at which motions break; None where there are too many of them, or
        what moves is not as smooth in between as it says.
        """
        courses = [self.scene.rig.course, *(item.course for item in self.scene.objects)]
        ends = 0.0, self.duration_s
        breaks = np.unique(np.concatenate([ends, *(c.breaks_s(*ends) for c in courses if c.moves)]))
        if Polynomials.times(breaks) > _MOST_ASKED:
            return None
        found = Polynomials(breaks, lambda times: np.swapaxes(self._moves(times), 0, 1))
        return found if found.last <= _LAST_M else None

    def _moves(self, times_s: Array) -> Array:
        scene, place = self.scene, np.eye(4)
        place[:3, 3] = scene.rig.position_m
        back = np.linalg.inv(place)
        view = np.broadcast_to(np.eye(4), (len(times_s), 4, 4))
        if scene.rig.moves:
            poses = scene.rig.course.pose_at(times_s).as_matrix()
            # Of a still rig: the axes of the world, the origin where the rig is.
            view = back @ scene.rig.pose.transform.as_matrix() @ np.linalg.inv(poses) @ place
        found = np.tile(view, (len(scene.objects), 1, 1, 1))
        for rows in self._alike:
            item = scene.objects[rows[0]]
            if item.moves:
                since = item.course.pose_at(times_s).as_matrix() @ item.pose.inv().as_matrix()
                found[rows] = view @ (back @ since @ place)
        return found

    def sun_directions(self, times_s: Array) -> Array:
        """Unit vectors towards the sun, seen from the rig, (n, 3)."""
        direction, rig = self.scene.sun.direction, self.scene.rig
        if not rig.moves:
            return np.broadcast_to(direction, (len(times_s), 3))
        turns = rig.course.pose_at(times_s).rotation
        return np.asarray((rig.pose.rotation * turns.inv()).apply(direction))

    def scene_at(self, times_s: Array) -> MovingScene:
        """The scene with these instants, (n,), numbered."""
        moves = self.moves(times_s)
        poses = [(moves[b.first, :, :3, :3], moves[b.first, :, :3, 3]) for b in self.bodies]
        return MovingScene(
            [
                MovingBody(body.scene, body.center_m, body.radius_m, *pose)
                for body, pose in zip(self.bodies, poses, strict=True)
            ]
        )

    @cached_property
    def bodies(self) -> list[_Body]:
        """Objects that move alike, together."""
        return [self._body(numbers) for numbers in self._alike]

    def _body(self, numbers: Sequence[int]) -> _Body:
        objects = tuple(self.scene.objects[i] for i in numbers)
        box = np.array([item.box_m for item in objects]) - self.scene.rig.position_m
        low, high = box[:, 0].min(axis=0), box[:, 1].max(axis=0)
        pick = np.indices((2, 2, 2)).reshape(3, -1).T
        alone = replace(self.scene, objects=objects)
        return _Body(alone, np.where(pick, high, low), numbers[0])

    def seen(self, camera: Device, shape: tuple[int, int]) -> "Seen":
        """What a camera of that many cells sees of it at some times."""
        n_cells = shape[0] * shape[1]
        if not self.bodies:
            return Seen(math.inf, 0.0, np.zeros(n_cells), np.zeros(n_cells))
        mi = mitsuba()
        step = self.duration_s / (_LOOKS - 1)
        times = np.linspace(0, self.duration_s - _SOON * step, _LOOKS)
        ray, cos = primary_rays(CellGrid(camera, *shape), RowRays(0, shape[0], 1))
        dr.eval(ray, cos)
        number = dr.arange(mi.UInt32, _LOOKS * n_cells)
        cell = number % dr.opaque(mi.UInt32, n_cells)
        looking = mi.Ray3f(ray.o, dr.gather(mi.Vector3f, ray.d, cell))
        looking.time = mi.Float(number // dr.opaque(mi.UInt32, n_cells))
        met = self.scene_at(times).body_met(looking)
        dr.eval(met)
        distance, body = (np.array(x).reshape(_LOOKS, n_cells) for x in met)
        along = np.stack([*map(np.array, ray.d)], axis=1).astype(np.float64)
        moves = self.moves(np.concatenate([times, times + _SOON * step]))
        whose = np.array([b.first for b in self.bodies])
        fastest, brightening = 0.0, np.zeros(n_cells)
        for look in range(_LOOKS):
            hit = np.isfinite(distance[look])
            place = along[hit] * distance[look, hit, None]
            move = moves[:, look + _LOOKS] @ np.linalg.inv(moves[:, look])
            move = move[whose[body[look, hit].astype(int)]]
            here = place + camera.origin_m
            moved = np.einsum("nij,nj->ni", move[:, :3, :3], here) + move[:, :3, 3]
            passed = image_points(moved, camera) - image_points(here, camera)
            speed = np.linalg.norm(passed, axis=1) / (_SOON * step)
            fastest = max(fastest, float(speed.max(initial=0.0)))
            nearer = np.sum(place**2, axis=1) / np.sum((moved - camera.origin_m) ** 2, axis=1)
            rate = np.abs(nearer - 1) / (_SOON * step)
            brightening[hit] = np.maximum(brightening[hit], rate)
        depth = float((distance * np.array(cos)).min())
        rare = set(range(len(self.bodies))) - set(body[np.isfinite(distance)].tolist())
        unseen, speed_of_unseen = self._between_looks(sorted(rare), camera, shape)
        return Seen(depth, max(fastest, speed_of_unseen), brightening, unseen)

    def _between_looks(
        self, numbers: Sequence[int], camera: Device, shape: tuple[int, int]
    ) -> tuple[Array, float]:
        """Of bodies that are seen at no look: the light that cells may have of them, over that of
        the solid angle, 1/m^2, (n_cells,); and the largest speed of their middles in the image.
        """
        times = np.linspace(0, self.duration_s, 4 * _LOOKS)
        moves, fastest, light = self.moves(times), 0.0, np.zeros(shape)
        for body in (self.bodies[i] for i in numbers):
            if (moves[body.first] == moves[body.first, 0]).all():
                continue
            for one, other in itertools.pairwise(body.placed(moves)):
                middles = np.array([one.mean(axis=0), other.mean(axis=0)])
                covered = covers(np.concatenate([one, other]), 0.0, camera, camera, shape)
                if not covered.any():
                    continue
                near = float(np.linalg.norm(middles - camera.origin_m, axis=1).min())
                near = max(near - body.radius_m, _THINNEST)
                light[covered] = np.maximum(light[covered], 1 / (math.pi * near**2))
                # Of one around or beside the camera what is seen of it says how fast.
                ahead = (middles - camera.origin_m) @ camera.axes[0]
                if ahead.min() > body.radius_m:
                    passed = np.linalg.norm(np.diff(image_points(middles, camera), axis=0))
                    fastest = max(fastest, float(passed) / float(times[1]))
        return light.ravel(), fastest

    def overlooked(
        self,
        first_s: Array,
        last_s: Array,
        emitter: Device,
        detector: Device,
        shape: tuple[int, int],
    ) -> Flags:
        """Cells of an emitter which a body may pass from one time to another, (n, n_cells), without
        being in them at either: it goes farther than half of what it is wide.
        """
        found = np.zeros((len(first_s), *shape), dtype=bool)
        for one, other in self._placed_outside(first_s, last_s, emitter):
            flat = [image_points(x.reshape(-1, 3), emitter).reshape(-1, 8, 2) for x in (one, other)]
            for i in np.flatnonzero(_is_far(*flat)).tolist():
                around = np.concatenate([one[i], other[i]])
                found[i] |= covers(around, 0.0, emitter, detector, shape)
        return found.reshape(len(found), -1)

    def shadows_overlooked(self, first_s: Array, last_s: Array, least_m: float) -> Flags:
        """Whether a body of a radius of ``least_m`` and more goes farther from one time to another
        than half of what it is wide, (n,), so that its shadow may pass in between.
        """
        found = np.zeros(len(first_s), dtype=bool)
        for one, other in self._placed_outside(first_s, last_s, None, least_m):
            found |= _is_far(one, other)
        return found

    def _placed_outside(
        self, first_s: Array, last_s: Array, camera: Device | None, least_m: float = 0.0
    ) -> Iterator[tuple[Array, Array]]:
        """Corners of bodies that move, at two times each, (n, 8, 3); without those around a
        camera, of which something is always seen.
        """
        moves = self.moves(np.concatenate([first_s, last_s]))
        origin = np.zeros(3) if camera is None else camera.origin_m
        for body in self.bodies:
            around = np.linalg.norm(body.center_m - origin) <= body.radius_m
            if around or body.radius_m < least_m or (moves[body.first] == np.eye(4)).all():
                continue
            placed = body.placed(moves)
            yield placed[: len(first_s)], placed[len(first_s) :]

    def changes(
        self, times_s: Array, emitter: Device, detector: Device, shape: tuple[int, int]
    ) -> Flags:
        """Cells of an emitter whose direct light to a detector may change from each time to the
        next, (n - 1, n_cells): those in which a body that moves may be hit, or be in the way from
        what is behind it to the detector.
        """
        found = np.zeros((len(times_s) - 1, *shape), dtype=bool)
        ends, between = self.moves(times_s), self.moves((times_s[1:] + times_s[:-1]) / 2)
        for body in self.bodies:
            corners, halfway = body.placed(ends), body.placed(between)
            # What corners are off the straight line at half time they may be off elsewhere, twice.
            bend = np.linalg.norm(halfway - (corners[1:] + corners[:-1]) / 2, axis=-1).max(axis=1)
            rests = (corners[1:] == corners[:-1]).all(axis=(1, 2)) & (bend == 0)
            for i in np.flatnonzero(~rests).tolist():
                around = np.concatenate([corners[i], corners[i + 1]])
                found[i] |= covers(around, 2 * float(bend[i]), emitter, detector, shape)
        return found.reshape(len(found), -1)


@dataclass(frozen=True, eq=False)
class Seen:
    """What a camera sees of a world in motion.

    ``nearest_m``: distance along the boresight of the nearest surface. ``fastest_per_s``: largest
    speed of anything, on the plane at distance 1. ``brightening_per_s`` (n_cells,): by what share a
    cell's light grows as its surface comes nearer. ``unseen_per_m2`` (n_cells,): light that cells
    may have of bodies that are seen at none of the times looked at, over that of the solid angle.
    """

    nearest_m: float
    fastest_per_s: float
    brightening_per_s: Array
    unseen_per_m2: Array


def _is_far(one: Array, other: Array) -> Flags:
    """Whether bodies go farther than some of what they are wide along their way, (n,); ``one``,
    ``other``: their corners before and after it, (n, 8, 2 or 3).
    """
    way = (other - one).mean(axis=1)
    length = np.linalg.norm(way, axis=1)
    along = way / np.maximum(length, 1e-300)[:, None]
    width = np.ptp(np.einsum("nkj,nj->nk", one, along), axis=1)
    return np.asarray(length > _OWN_WIDTH * np.maximum(width, _THINNEST))
