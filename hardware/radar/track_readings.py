"""What detections tell of targets along the ground, wherever the antenna is tilted to.

A detection's direction is in the antenna's frame. With an elevation it is turned into the world,
and range and rate are laid level. A line of antennas tells the cosine of its own axis alone: the
target is then taken to be at the antenna's height.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hardware.radar.detection import Detection
from hardware.radar.filtering import TargetMeasurement

Array = NDArray[np.float64]

#: Measurements of one detection, likeliest first; several where its range rate or direction is
#: ambiguous.
Readings = tuple[TargetMeasurement, ...]

_STEEP = 0.1  # least cosine of an elevation by which rates are divided
_STEP_RAD = 1e-6  # of differences, by which errors are turned


def heading(rotation: Rotation) -> Array:
    """Where an antenna looks along the ground, unit vector (2,)."""
    ahead = rotation.apply([1.0, 0.0, 0.0])[:2]
    return np.asarray(ahead / np.linalg.norm(ahead))


def readings(detection: Detection, rotation: Rotation) -> Readings:
    """Possible measurements of a detection, likeliest first: with an alternative range rate the
    azimuth is another one, which is not known. Azimuths are from the antenna's heading.

    Range and rate are those along the ground: r cos(el) of a range r, and the rate over cos(el) of
    a target that stays at its height. ``rotation``: of the antenna in the world.
    """
    directions = list(_directions(detection, rotation))
    made = [
        _measured(detection, direction, detection.range_rate_m_per_s) for direction in directions
    ]
    unknown = directions[0]._replace(azimuth_rad=np.nan)
    made += [
        _measured(detection, unknown, rate) for rate in detection.range_rate_alternatives_m_per_s
    ]
    return tuple(made)


class _Direction(NamedTuple):
    """Towards a target: from the heading, and above the ground; with their errors."""

    azimuth_rad: float
    azimuth_error_rad: float
    elevation_rad: float
    elevation_error_rad: float


def _measured(detection: Detection, direction: _Direction, rate: float) -> TargetMeasurement:
    level = max(float(np.cos(direction.elevation_rad)), _STEEP)
    slope = np.sin(direction.elevation_rad) * direction.elevation_error_rad
    error = [
        np.hypot(level * detection.range_error_m, detection.range_m * slope),
        direction.azimuth_error_rad,
        detection.range_rate_error_m_per_s / level,
    ]
    value = [level * detection.range_m, direction.azimuth_rad, rate / level]
    return TargetMeasurement(np.array(value), np.array(error))


def _directions(detection: Detection, rotation: Rotation) -> Iterator[_Direction]:
    """The direction of a detection, and those that it may have instead."""
    azimuths = detection.azimuth_rad, *detection.azimuth_alternatives_rad
    told = detection.azimuth_rad, detection.elevation_rad, detection.elevation_error_rad
    if not np.isfinite(told).all():
        for azimuth in azimuths:
            yield _at_own_height(azimuth, detection.azimuth_error_rad, rotation)
        return
    elevations = detection.elevation_rad, *detection.elevation_alternatives_rad
    errors = detection.azimuth_error_rad, detection.elevation_error_rad
    for azimuth, elevation in zip(azimuths, elevations, strict=True):
        yield _turned(azimuth, elevation, errors, rotation)


def _turned(
    azimuth_rad: float, elevation_rad: float, errors_rad: tuple[float, float], rotation: Rotation
) -> _Direction:
    """A direction in the antenna's frame as it is above the ground."""
    ends = np.array([azimuth_rad, elevation_rad]) + _STEP_RAD * np.array([[0, 0], [1, 0], [0, 1]])
    azimuth, elevation = ends.T
    level = np.cos(elevation)
    own = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    x, y, up = rotation.apply(own).T
    ahead = heading(rotation)
    around = np.arctan2(ahead[0] * y - ahead[1] * x, ahead[0] * x + ahead[1] * y)
    above = np.arcsin(np.clip(up, -1, 1))
    by_own = (np.stack([around, above])[:, 1:] - np.stack([around, above])[:, :1]) / _STEP_RAD
    turned = np.hypot(*(by_own * errors_rad).T)
    return _Direction(*map(float, (around[0], turned[0], above[0], turned[1])))


def _at_own_height(azimuth_rad: float, error_rad: float, rotation: Rotation) -> _Direction:
    """Where a target at the antenna's height has the cosine to the antenna's left that an azimuth
    without elevation stands for; the azimuth is unknown where none has.
    """
    left = rotation.apply([0.0, 1.0, 0.0])
    cosine, level = np.sin(azimuth_rad), float(np.hypot(left[0], left[1]))
    if not abs(cosine) < level:
        return _Direction(np.nan, np.nan, 0.0, 0.0)
    ahead = heading(rotation)
    to_left = np.arctan2(ahead[0] * left[1] - ahead[1] * left[0], ahead @ left[:2])
    across = np.sqrt(level**2 - cosine**2)
    to_line = np.arccos(cosine / level) * (1 if np.cos(azimuth_rad) >= 0 else -1)
    error = abs(np.cos(azimuth_rad)) * error_rad / across
    return _Direction(float(to_left - to_line), float(error), 0.0, 0.0)
