"""Where detections, targets and fields of view are, in the world and in the emitter's image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number, with_error
from hardware.radar import Detection
from twin.accuracy.interval import TWO_SIDED_95
from twin.camera.evaluation import Evaluation
from twin.radar import RadarDesign
from twin.radar.evaluation import RadarEvaluation
from twin.scene import Scene

Array = NDArray[np.float64]

#: Angles off the boresight at which a pattern's half-power width is looked for.
_ANGLES_RAD = np.radians(np.linspace(0.0, 90.0, 1801))
#: A surface is at a detection's range within this, or half a cell's own span of ranges if larger,
#: up to the second: what spans more is a border between two objects.
_NEAR_CELLS, _MOST_CELLS = 1.0, 8.0


@dataclass(frozen=True)
class Place:
    """A detection in the world.

    ``position_m`` (3,): by its own direction (``measured``), or where the array tells none, at its
    range towards the target that it is; None where neither is known.
    """

    detection: Detection
    label: str
    text: str
    target: str
    position_m: Array | None
    measured: bool


def half_width_rad(radar: RadarDesign, *, across: bool = True) -> float:
    """Angle off the boresight at which the antenna's gain, one way, is half of that ahead."""
    ahead, beside = np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)
    none = np.zeros_like(beside)
    direction = (ahead, beside, none) if across else (ahead, none, beside)
    gain = radar.antenna.gain(np.stack(direction, axis=-1))
    below = np.flatnonzero(gain < gain[0] / 2)
    return float(_ANGLES_RAD[below[0]]) if len(below) else float(_ANGLES_RAD[-1])


def radar_frame(scene: Scene) -> tuple[Array, Array]:
    """Antenna's place in the world (3,) and its axes as rows: ahead, left, up."""
    offset, axes = scene.rig.device("radar")
    return scene.rig.position_m + offset, axes


def places_of(scene: Scene, radar: RadarEvaluation) -> list[Place]:
    """All detections, strongest first."""
    origin, axes = radar_frame(scene)
    targets = {target.name: np.asarray(target.position_m) for target in scene.targets}
    found = []
    rows = zip(radar.detections, radar.matches, radar.further, strict=True)
    for row, (detection, match, part) in enumerate(rows):
        position, measured = None, False
        if np.isfinite(detection.azimuth_rad) and np.isfinite(detection.range_m):
            position = origin + detection.range_m * _direction(detection) @ axes
            measured = True
        elif match and np.isfinite(detection.range_m):
            towards = targets[match.name] - origin
            position = origin + detection.range_m * towards / np.linalg.norm(towards)
        name = match.name if match else f"part of {part.name}" if part else "other surface"
        label = match.name if match else ""
        found.append(
            Place(detection, label, f"{row}: {name}; {_told(detection)}", name, position, measured)
        )
    return found


def _direction(detection: Detection) -> Array:
    """Unit vector in the antenna's frame; level where the elevation is not measured."""
    azimuth, elevation = detection.azimuth_rad, np.nan_to_num(detection.elevation_rad)
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def _told(detection: Detection) -> str:
    parts = []
    for value, error, unit in (
        (detection.range_m, detection.range_error_m, "m"),
        (detection.range_rate_m_per_s, detection.range_rate_error_m_per_s, "m/s"),
    ):
        if np.isfinite(value):
            parts.append(with_error(value, TWO_SIDED_95 * error, unit))
    if np.isfinite(detection.azimuth_rad):
        bearing = np.degrees([detection.azimuth_rad, detection.azimuth_error_rad])
        parts.append(with_error(bearing[0], TWO_SIDED_95 * bearing[1], "deg") + " to the left")
    return ", ".join([*parts, f"SNR {number(detection.snr_db)} dB"])


def in_image(scene: Scene, evaluation: Evaluation, points_m: Array) -> Array:
    """Places (n, 3) in the emitter's image, (n, 2): right and up, from -1 to 1 across the field;
    NaN behind it.
    """
    offset, axes = scene.rig.device("emitter")
    ahead, left, up = axes @ (points_m - scene.rig.position_m - offset).T
    half = np.tan(np.radians(evaluation.system.emitter.field_of_view_deg.value / 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = np.stack([-left / ahead, up / ahead], axis=-1) / half
    return np.where((ahead > 0)[:, None], seen, np.nan)


def surfaces_at_detections(scene: Scene, evaluation: Evaluation, radar: RadarEvaluation) -> Array:
    """SNR (dB) of the strongest detection at whose range each cell's true surface lies, on the grid
    of the truth; NaN where there is none.
    """
    depth_m = evaluation.capture.truth.depth_m
    rows, columns = depth_m.shape
    offset, axes = scene.rig.device("emitter")
    half = np.tan(np.radians(evaluation.system.emitter.field_of_view_deg.value / 2))
    left = half * (1 - (2 * np.arange(columns) + 1) / columns)
    up = half * (1 - (2 * np.arange(rows) + 1) / rows)
    depth = np.where(np.isfinite(depth_m), depth_m, np.nan)
    local = np.stack([depth, depth * left, depth * up[:, None]], axis=-1)
    points = local @ axes + scene.rig.position_m + offset
    ranges = np.linalg.norm(points - radar_frame(scene)[0], axis=-1)
    cell_m = radar.waveform.range_cell_m
    span_m = np.full_like(ranges, 0.0)
    for axis in (0, 1):
        if ranges.shape[axis] > 1:
            span_m = np.fmax(span_m, np.abs(np.gradient(ranges, axis=axis)))
    near_m = np.clip(span_m / 2, _NEAR_CELLS * cell_m, _MOST_CELLS * cell_m)
    found = np.full(ranges.shape, np.nan)
    for detection in radar.detections:
        at = np.abs(ranges - detection.range_m) <= near_m
        found[at] = np.fmax(found[at], detection.snr_db)
    return found
