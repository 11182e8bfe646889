"""What leaving motion within an interval to one instant does to echoes: bounds by how far bodies
turn and how their ways bend.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.motion import (
    PointMotion,
    RigidMotions,
    lengthening,
    radar_motion,
)
from twin.scene import Scene, SceneObject, Target

Array = NDArray[np.float64]

#: Change of an echo over the angle by which its body turns, in rad: of dihedrals, boxes and balls
#: 0.1 to 1.5.
OVER_ANGLE = 1.5


@dataclass(frozen=True)
class Change:
    """What leaving motion within an interval to one instant does to the echo of an object, relative
    to it: by the phase beyond second order, by its level, and by the angle it turns; and what was
    found to change: its direct echo, or, at most, all reflections between its parts.
    """

    name: str
    bend_rad: float
    fades: float
    turned_rad: float
    changed: float = 0.0

    @property
    def error(self) -> float:
        """Phase, level and angle together, or what was found to change."""
        return max(self.bend_rad + self.fades + OVER_ANGLE * self.turned_rad, self.changed)


def times_within(scene: Scene, times_s: NDArray[np.floating]) -> Array:
    """Different times, those beyond the scene's trajectories at their ends."""
    times: Array = np.unique(np.clip(times_s.astype(np.float64), *scene.span_s))
    return times


def largest_change(scene: Scene, radar: RadarDesign, times_s: Array) -> Change | None:
    """The largest change within an interval, of an object or a declared target; None where nothing
    moves.
    """
    items = [item for item in scene.objects if item.moves or scene.rig.moves]
    antenna = _Antenna.of(scene, times_s)
    changes = [
        _change_of(antenna, item, radar, times_s) for item in items if len(item.geometry.faces)
    ]
    carriers = {item.name: item for item in items}
    changes += [
        _change_of_carried(antenna, target, carriers[target.object], radar, times_s)
        for target in scene.targets
        if target.object in carriers
    ]
    changes += [
        _change_of_target(antenna, target, radar, times_s)
        for target in scene.targets
        if target.object is None and (any(target.velocity_m_per_s) or scene.rig.moves)
    ]
    return max(changes, key=lambda change: change.error, default=None)


@dataclass(frozen=True, eq=False)
class _Antenna:
    """The radar's antenna: where it is and how it moves now, and at all times its place
    (n_times, 3) and the angle that the rig has turned by, at most.
    """

    place_m: Array
    motion: PointMotion
    places_m: Array
    turned_rad: float

    @staticmethod
    def of(scene: Scene, times_s: Array) -> "_Antenna":
        place: Array = np.asarray(scene.rig.position_m + scene.rig.device("radar")[0])
        rig, now = scene.rig.course.at(times_s), scene.rig.pose
        mounted = now.rotation.inv().apply(place - scene.rig.position_m)
        places = rig.of_points(mounted[None])[0]
        turned = (rig.pose.rotation * now.rotation.inv()).magnitude().max()
        return _Antenna(place, radar_motion(scene), places, float(turned))


def _change_of(antenna: _Antenna, item: SceneObject, radar: RadarDesign, times_s: Array) -> Change:
    """Of the way to the corners of the box of an object and back, and of the angles that it and the
    rig turn by.
    """
    own = item.course.at(times_s)
    low, high = item.geometry.vertices_m.min(axis=0), item.geometry.vertices_m.max(axis=0)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    places = item.pose.apply(corners) - antenna.place_m
    motion = RigidMotions.of([item], antenna.place_m).at(0, places)
    way = _along_ways(antenna, radar, times_s, own.of_points(corners)[0], places, motion)
    turned = (own.pose.rotation * item.pose.rotation.inv()).magnitude().max()
    return Change(item.name, *way, float(turned + antenna.turned_rad))


def _change_of_carried(
    antenna: _Antenna, target: Target, item: SceneObject, radar: RadarDesign, times_s: Array
) -> Change:
    """Of the way to a target that moves with an object, from whose mesh it may be far away."""
    place = np.asarray(target.position_m)[None]
    places = place - antenna.place_m
    motion = RigidMotions.of([item], antenna.place_m).at(0, places)
    exact = item.course.at(times_s).of_points(item.pose.inv().apply(place))[0]
    return Change(target.name, *_along_ways(antenna, radar, times_s, exact, places, motion), 0.0)


def _change_of_target(
    antenna: _Antenna, target: Target, radar: RadarDesign, times_s: Array
) -> Change:
    """Of the way to a target of its own velocity and back: it is a point."""
    velocity = np.asarray(target.velocity_m_per_s)
    place = np.asarray(target.position_m)
    exact = (place + times_s[:, None] * velocity)[:, None]
    motion = velocity, np.zeros(3)
    places = (place - antenna.place_m)[None]
    return Change(target.name, *_along_ways(antenna, radar, times_s, exact, places, motion), 0.0)


def _along_ways(
    antenna: _Antenna,
    radar: RadarDesign,
    times_s: Array,
    exact_m: Array,
    places_m: Array,
    motion: tuple[Array, Array],
) -> tuple[float, float]:
    """Of ways from the radar to points and back: phase beyond second order in time; and what levels
    change by, since the way grows and a slot's average takes more of a faster one. By the places of
    the points at all times (n_times, n, 3), from the radar now (n, 3), and their velocity and
    acceleration.
    """
    exact = np.linalg.norm(exact_m - antenna.places_m, axis=2)
    length, radar_moves = np.linalg.norm(places_m, axis=1), antenna.motion
    rate, faster = lengthening(
        motion[0] - radar_moves.velocity_m_per_s,
        places_m / np.maximum(length, 1e-12)[:, None],
        length,
        motion[1] - radar_moves.acceleration_m_per_s2,
    )
    since_s = times_s[:, None]
    bend_m = float(np.abs(exact - length - (rate + faster / 2 * since_s) * since_s).max())
    doppler_hz = 2 * np.stack([rate + 0 * since_s, rate + faster * since_s])
    kept = np.abs(radar.ofdm.slot_gain(doppler_hz / radar.ofdm.wavelength_m))
    averaged = np.abs(kept[1] - kept[0]) / kept.max(axis=(0, 1))
    spread = np.abs((length / np.maximum(exact, 1e-12)) ** 2 - 1)
    return 4 * np.pi * bend_m / radar.ofdm.wavelength_m, float((averaged + spread).max())
