"""What leaving motion within an interval to one instant does to echoes: bounds by how far bodies
turn and how their ways bend.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.motion import RigidMotions, lengthening, radar_motion
from twin.scene import Scene, SceneObject

Array = NDArray[np.float64]

#: Change of an echo over the angle by which its body turns, in rad: of dihedrals, boxes and balls
#: 0.1 to 1.5.
OVER_ANGLE = 1.5


@dataclass(frozen=True)
class Change:
    """What leaving motion within an interval to one instant does to the echo of an object, relative
    to it: by the phase beyond second order, and by the angle it turns; and what was found to
    change: its direct echo, or, at most, all reflections between its parts.
    """

    name: str
    bend_rad: float
    turned_rad: float
    changed: float = 0.0

    @property
    def error(self) -> float:
        """Phase and angle together, or what was found to change."""
        return max(self.bend_rad + OVER_ANGLE * self.turned_rad, self.changed)


def times_within(scene: Scene, times_s: NDArray[np.floating]) -> Array:
    """Different times, those beyond the scene's trajectories at their ends."""
    times: Array = np.unique(np.clip(times_s.astype(np.float64), *scene.span_s))
    return times


def largest_change(scene: Scene, radar: RadarDesign, times_s: Array) -> Change | None:
    """The largest change within an interval; None where nothing moves."""
    items = [item for item in scene.objects if item.moves or scene.rig.moves]
    changes = [
        _change_of(scene, item, radar, times_s) for item in items if len(item.geometry.faces)
    ]
    return max(changes, key=lambda change: change.error, default=None)


def _change_of(scene: Scene, item: SceneObject, radar: RadarDesign, times_s: Array) -> Change:
    """Of the way to the corners of the box of an object and back, and of the angles that it and the
    rig turn by.
    """
    own, rig = item.course.at(times_s), scene.rig.course.at(times_s)
    low, high = item.geometry.vertices_m.min(axis=0), item.geometry.vertices_m.max(axis=0)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    here = scene.rig.position_m + scene.rig.device("radar")[0]
    mounted = scene.rig.pose.rotation.inv().apply(here - scene.rig.position_m)
    exact = np.linalg.norm(own.of_points(corners)[0] - rig.of_points(mounted[None])[0], axis=2)
    places = item.pose.apply(corners) - here
    length = np.linalg.norm(places, axis=1)
    moving, radar_moves = RigidMotions.of([item], here).at(0, places), radar_motion(scene)
    rate, faster = lengthening(
        moving[0] - radar_moves.velocity_m_per_s,
        places / np.maximum(length, 1e-12)[:, None],
        length,
        moving[1] - radar_moves.acceleration_m_per_s2,
    )
    parabola = length + (rate + faster / 2 * times_s[:, None]) * times_s[:, None]
    bend = float(np.abs(exact - parabola).max())
    turned = [
        (state.pose.rotation * now.rotation.inv()).magnitude().max()
        for state, now in ((own, item.pose), (rig, scene.rig.pose))
    ]
    return Change(item.name, 4 * np.pi * bend / radar.ofdm.wavelength_m, float(sum(turned)))
