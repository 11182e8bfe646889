"""Tracks of radars over the records of a log: one tracker each, told how its antenna moves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar import Detection
from hardware.radar.tracking import TargetTrack, Tracker
from hardware.records import QuaternionPose

Array = NDArray[np.float64]


@dataclass
class _Radar:
    tracker: Tracker
    time_ns: int
    position_m: Array
    bursts: int = 1


class RadarTracks:
    """A tracker for each sensor. It begins anew where the sensor's clock runs back."""

    def __init__(self) -> None:
        self._radars: dict[str, _Radar] = {}

    def update(
        self, sensor: str, detections: Sequence[Detection], time_ns: int, pose: QuaternionPose
    ) -> list[TargetTrack]:
        """Take in the detections of a burst; the confirmed tracks.

        ``time_ns`` is the device's clock at the burst, ``pose`` the antenna's then. The antenna's
        velocity is the mean one since the burst before; so of the first burst, whose is unknown,
        no track begins.
        """
        last = self._radars.get(sensor)
        if last is None or time_ns <= last.time_ns:
            self._radars[sensor] = _Radar(Tracker(), time_ns, pose.position_m)
            return []
        elapsed_s = 1e-9 * (time_ns - last.time_ns)
        velocity = (pose.position_m - last.position_m)[:2] / elapsed_s
        last.time_ns, last.position_m = time_ns, pose.position_m
        last.bursts += 1
        return last.tracker.update(detections, elapsed_s, pose, velocity)

    def bursts_to_first(self, sensor: str) -> int:
        """How many more bursts a sensor needs before any track of it can be confirmed: the first
        one, of which no track begins, and as many as confirm one.
        """
        radar = self._radars.get(sensor)
        if radar is None:
            return 1 + Tracker.confirm
        return max(1 + radar.tracker.confirm - radar.bursts, 0)


def cloud(tracks: Sequence[TargetTrack]) -> dict[str, Array]:
    """Columns of a point cloud in the world's frame, (n_tracks,) each.

    ``x``, ``y`` and the velocity with their standard errors, NaN where no azimuth was ever
    measured; ``z`` NaN; ``range_m`` and ``range_rate_m_per_s`` from the antenna, NaN where there is
    a place; ``number`` of the target, ``hits`` and ``missed``.
    """
    placed = {name: np.full(len(tracks), np.nan) for name in ("x", "y", "z")}
    names = ("x", "y", "velocity_x_m_per_s", "velocity_y_m_per_s")
    errors = ("x_error_m", "y_error_m", "velocity_x_error_m_per_s", "velocity_y_error_m_per_s")
    columns = placed | {
        name: np.full(len(tracks), np.nan)
        for name in (*names[2:], *errors, "range_m", "range_rate_m_per_s")
    }
    for k, track in enumerate(tracks):
        if track.estimate.has_position:
            deviation = np.sqrt(np.diag(track.covariance))
            for name, error, value, own in zip(names, errors, track.state, deviation, strict=True):
                columns[name][k], columns[error][k] = value, own
        else:
            columns["range_m"][k], columns["range_rate_m_per_s"][k] = track.state
    for name in ("number", "hits", "missed"):
        columns[name] = np.array([getattr(track, name) for track in tracks], np.float64)
    return columns
