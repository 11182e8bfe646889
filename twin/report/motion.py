"""What moves in a scene, how fast, and what that is in cells of a camera and of a radar."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from twin.motion import Motion
from twin.radar import RadarDesign
from twin.radar.micro_doppler import ranges_and_rates
from twin.scene import Pose, Scene, SceneObject
from twin.system import System

Array = NDArray[np.float64]

_INSTANTS = 17  # at which a frame and an interval are looked at
_MOST_SAMPLES = 257  # of a whole motion
_ROUNDING_DEG_PER_S = 1e-10  # a spline's rates are no nearer to 0
HEAD = (
    "what moves",
    "carried by",
    "m/s",
    "deg/s",
    "fastest point m/s",
    "cells a frame",
    "range rate m/s",
    "range cells",
    "Doppler cells",
)


@dataclass(frozen=True)
class MotionReport:
    """Motion of one object: its own in the world, and as the sensors see it, the rig's in it.

    ``speed_m_per_s`` is that of the middle of its box, now, and ``turning_deg_per_s`` its angular
    velocity, now; ``fastest_m_per_s`` the speed of its fastest point at any time of its motion.

    ``cells_per_frame``: the farthest that a point of it moves in the image within a frame; None
    outside the field, and without a camera. Of its points within a radar's interval:
    ``range_rates_m_per_s``, the least and the greatest; ``range_cells``, the most that one crosses;
    ``doppler_cells``, over which the rates spread. None without a radar.
    """

    name: str
    parent: str
    speed_m_per_s: float
    turning_deg_per_s: float
    fastest_m_per_s: float
    cells_per_frame: float | None = None
    range_rates_m_per_s: tuple[float, float] | None = None
    range_cells: float | None = None
    doppler_cells: float | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        """Of the table under `HEAD`."""
        rates = self.range_rates_m_per_s
        turning = self.turning_deg_per_s if self.turning_deg_per_s > _ROUNDING_DEG_PER_S else 0.0
        own = (self.speed_m_per_s, turning, self.fastest_m_per_s)
        seen = (self.range_cells, self.doppler_cells)
        return (
            self.name,
            self.parent,
            *(number(value, 3) for value in own),
            "" if self.cells_per_frame is None else number(self.cells_per_frame, 2),
            "" if rates is None else " to ".join(f"{rate:.2f}" for rate in rates),
            *("" if value is None else number(value, 2) for value in seen),
        )


def motion_reports(
    scene: Scene, system: System | None, radar: RadarDesign | None
) -> list[MotionReport]:
    """Of the rig and of all that moves; where the rig does, of what stands too, as far as it shows
    in the camera's image.
    """
    found = []
    if scene.rig.moves:
        found.append(_own("rig", "", scene.rig.course, np.zeros((1, 3))))
    for item in scene.objects:
        if not len(item.geometry.faces) or not (item.moves or scene.rig.moves):
            continue
        seen = _seen(item, scene, system, radar)
        if item.moves or seen.cells_per_frame is not None:
            found.append(seen)
    return found


def headline(scene: Scene, system: System | None, radar: RadarDesign | None) -> str:
    """The title of the table: frame and interval, and what of them the scene's motion covers."""
    last = scene.span_s[1]
    told = []
    if system is not None:
        told.append(f"a frame of {system.name}: {number(system.frame_time_s)} s")
    if radar is not None:
        told.append(f"an interval of {radar.name}: {number(radar.burst_s)} s")
    if np.isfinite(last):
        told.append(f"trajectories end after {number(last)} s")
    return "; ".join(told)


def _own(name: str, parent: str, course: Motion, points_m: Array) -> MotionReport:
    samples = course.samples_s
    if len(samples) > _MOST_SAMPLES:
        samples = samples[np.linspace(0, len(samples) - 1, _MOST_SAMPLES).astype(int)]
    fastest = max(
        float(np.linalg.norm(course.at(some).of_points(points_m)[1], axis=-1).max())
        for some in np.array_split(samples, max(1, len(samples) // 32))
    )
    now = course.at(0.0)
    middle = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    return MotionReport(
        name=name,
        parent=parent,
        speed_m_per_s=float(np.linalg.norm(now.of_points(middle[None])[1])),
        turning_deg_per_s=float(np.degrees(np.linalg.norm(now.angular_velocity_rad_per_s))),
        fastest_m_per_s=fastest,
    )


def _seen(
    item: SceneObject, scene: Scene, system: System | None, radar: RadarDesign | None
) -> MotionReport:
    points = item.geometry.vertices_m[item.geometry.shape.hull]
    found = _own(item.name, item.parent or "", item.course, points)
    if system is not None:
        cells = _cells_per_frame(item.course, points, scene, system)
        found = replace(found, cells_per_frame=cells)
    if radar is None:
        return found
    wave = radar.channel_waveform
    times = _instants(scene, radar.burst_s)
    ranges, rates = ranges_and_rates(item.course, points, scene, times)
    return replace(
        found,
        range_rates_m_per_s=(float(rates.min()), float(rates.max())),
        range_cells=float(np.ptp(ranges, axis=0).max()) / radar.range_cell_m,
        doppler_cells=float(np.ptp(rates)) / wave.velocity_cell_m_per_s,
    )


def _instants(scene: Scene, seconds: float) -> Array:
    return np.linspace(0.0, min(seconds, scene.span_s[1]), _INSTANTS)


def _cells_per_frame(course: Motion, points_m: Array, scene: Scene, system: System) -> float | None:
    """Farthest way (cells) of a point in the image from where it is first, while in the field."""
    times = _instants(scene, system.frame_time_s)
    place = course.at(times).of_points(points_m)[0]
    towards = _from_mount(scene, scene.rig.detector, times, place)
    emitter = system.emitter
    half = np.radians(emitter.field_of_view_deg.value) / 2
    size = max(emitter.rows.value, emitter.columns.value)
    with np.errstate(divide="ignore", invalid="ignore"):
        image = towards[..., 1:] / towards[..., :1] / np.tan(half) * size / 2
    inside = (towards[..., 0] > 0) & (np.abs(image) <= size / 2).all(axis=-1)
    if not inside.any():
        return None
    first = np.argmax(inside, axis=0)  # of each point, within the field
    image = np.where(inside[..., None], image, 0.0)
    start = np.take_along_axis(image, first[None, :, None], axis=0)
    return float(np.where(inside, np.linalg.norm(image - start, axis=-1), 0.0).max())


def _from_mount(scene: Scene, mount: Pose, times_s: Array, places_m: Array) -> Array:
    """Places (n, k, 3) of the world in the frame of a device on the rig, at times (n,)."""
    rig = scene.rig.course.pose_at(times_s)
    axes = (rig.rotation * mount.rotation).as_matrix()
    origin = rig.apply(np.asarray(mount.position_m))
    offset: Array = (places_m - origin[:, None]) @ axes
    return offset
