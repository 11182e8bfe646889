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
#: Cells that what is seen passes at most from one first instant to the next.
_STEP_CELLS = 2.0
_MOST_FIRST = 512
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
        self._looks = self.moves(self.looks_s)

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
        scene, place = self.scene, np.eye(4)
        place[:3, 3] = scene.rig.position_m
        back = np.linalg.inv(place)
        view = np.broadcast_to(np.eye(4), (len(times_s), 4, 4))
        if scene.rig.moves:
            poses = scene.rig.course.pose_at(times_s).as_matrix()
            # Of a still rig: the axes of the world, the origin where the rig is.
            view = back @ scene.rig.pose.transform.as_matrix() @ np.linalg.inv(poses) @ place
        found = np.tile(view, (len(scene.objects), 1, 1, 1))
        for row, item in enumerate(scene.objects):
            if item.moves:
                since = item.course.pose_at(times_s).as_matrix() @ item.pose.inv().as_matrix()
                found[row] = view @ (back @ since @ place)
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
        alike: dict[bytes, list[int]] = {}
        for number, moves in enumerate(self._looks):
            alike.setdefault(np.round(moves, 12).tobytes(), []).append(number)
        return [self._body(numbers) for numbers in alike.values()]

    def _body(self, numbers: Sequence[int]) -> _Body:
        objects = tuple(self.scene.objects[i] for i in numbers)
        box = np.array([item.box_m for item in objects]) - self.scene.rig.position_m
        low, high = box[:, 0].min(axis=0), box[:, 1].max(axis=0)
        pick = np.indices((2, 2, 2)).reshape(3, -1).T
        alone = replace(self.scene, objects=objects)
        return _Body(alone, np.where(pick, high, low), numbers[0])

    def seen(self, camera: Device, shape: tuple[int, int]) -> "Seen":
        """What a camera of that many cells sees of it at some times."""
        if not self.bodies:
            return Seen(math.inf, 0.0)
        mi, n_cells = mitsuba(), shape[0] * shape[1]
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
        fastest = 0.0
        for look in range(_LOOKS):
            hit = np.isfinite(distance[look])
            place = along[hit] * distance[look, hit, None] + camera.origin_m
            move = moves[:, look + _LOOKS] @ np.linalg.inv(moves[:, look])
            move = move[whose[body[look, hit].astype(int)]]
            moved = np.einsum("nij,nj->ni", move[:, :3, :3], place) + move[:, :3, 3]
            passed = image_points(moved, camera) - image_points(place, camera)
            speed = np.linalg.norm(passed, axis=1) / (_SOON * step)
            fastest = max(fastest, float(speed.max(initial=0.0)))
        depth = float((distance * np.array(cos)).min())
        return Seen(depth, max(fastest, self._fastest_middle(camera, shape)))

    def starts(
        self, camera: Device, shape: tuple[int, int]
    ) -> Iterator[tuple[Array, Array, Flags]]:
        """Of each body that moves: its motion at ``looks_s``, (n, 4, 4), its middle at the start,
        and the cells of a camera in which it may be seen there.
        """
        for body in self.bodies:
            moves = self._looks[body.first]
            if (moves != np.eye(4)).any():
                yield moves, body.center_m, covers(body.corners_m, 0.0, camera, camera, shape)

    def _fastest_middle(self, camera: Device, shape: tuple[int, int]) -> float:
        """Speed in the image of the middles of bodies that come into the field between looks."""
        times = np.linspace(0, self.duration_s, 4 * _LOOKS)
        moves, fastest = self.moves(times), 0.0
        for body in self.bodies:
            if (moves[body.first] == moves[body.first, 0]).all():
                continue
            for one, other in itertools.pairwise(body.placed(moves)):
                middles = np.array([one.mean(axis=0), other.mean(axis=0)])
                # Of one around the camera what is seen of it says how fast.
                near = np.linalg.norm(middles - camera.origin_m, axis=1).min() < 2 * body.radius_m
                if (
                    near
                    or not covers(np.concatenate([one, other]), 0.0, camera, camera, shape).any()
                ):
                    continue
                passed = np.linalg.norm(np.diff(image_points(middles, camera), axis=0))
                fastest = max(fastest, float(passed) / float(times[1]))
        return fastest

    def first_instants(self, seen: "Seen", camera: Device, rows: int) -> Array:
        """Instants, ascending, from the start to the end, so close that what is seen passes no more
        than some cells of a camera of so many rows in between.
        """
        cells = seen.fastest_per_s * self.duration_s * rows / (2 * camera.tan_half_field)
        n = math.ceil(min(cells / _STEP_CELLS, _MOST_FIRST))
        return np.linspace(0, self.duration_s, max(n, 1) + 1)

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


@dataclass(frozen=True)
class Seen:
    """What a camera sees of a world in motion.

    ``nearest_m``: distance along the boresight of the nearest surface. ``fastest_per_s``: largest
    speed of anything, on the plane at distance 1.
    """

    nearest_m: float
    fastest_per_s: float
