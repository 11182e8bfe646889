"""Tracks of detections over frames: a Kalman filter each, detections assigned by likelihood.

Assignment is SciPy's (linear_sum_assignment), by all that a detection measured: range, azimuth and
range rate, so that targets which meet at one place keep their tracks by their rates. Of a range
rate with alternatives, and of the azimuth that goes with it, a track takes what its own motion
leaves possible; while that is more than one, the range alone. The filter libraries that exist
(filterpy, Stone Soup) bring matplotlib, which has no place on the vehicle; Stone Soup judges the
filter in the tests.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.detection import Detection
from hardware.radar.filtering import (
    Antenna,
    Estimate,
    Measurement,
    Update,
    begun,
    expected,
    predicted,
    updated,
)
from hardware.records.state import QuaternionPose

Array = NDArray[np.float64]

#: Of one detection, likeliest first; more than one where its range rate is ambiguous.
Readings = tuple[Measurement, ...]

_NEVER = 1e9  # cost of a pair that is out of the question; far above any other


@dataclass(frozen=True)
class Track:
    """One target: its state, the state's covariance, its past.

    ``state`` is (x, y, vx, vy) in the world, m and m/s; or, of a target whose azimuth was never
    measured, (range, range rate) from the antenna. ``hits`` frames with a detection, ``missed``
    frames in a row without.
    """

    number: int
    state: Array
    covariance: Array
    hits: int
    missed: int

    @property
    def estimate(self) -> Estimate:
        """State and covariance."""
        return Estimate(self.state, self.covariance)

    def with_estimate(self, estimate: Estimate) -> "Track":
        """The same target in another state."""
        return replace(self, state=estimate.state, covariance=estimate.covariance)


@dataclass
class Tracker:
    """Keeps tracks over frames.

    Parameters
    ----------
    acceleration_m_per_s2, acceleration_s
        Root mean square that targets accelerate with, along each axis, and how long such an
        acceleration lasts at least; from frame to frame where these are farther apart.
    gate
        Probability that a track's own detection is let through.
    confirm, lose
        Hits that make a track a target, misses in a row that end it.
    first_speed_m_per_s
        Standard deviation of a target's speed across the line of sight before two frames tell it.
    """

    acceleration_m_per_s2: float = 3.0
    acceleration_s: float = 0.1
    gate: float = 0.999
    confirm: int = 3
    lose: int = 3
    first_speed_m_per_s: float = 10.0
    tracks: list[Track] = field(default_factory=list)
    _started: int = 0

    def update(
        self,
        detections: Sequence[Detection],
        elapsed_s: float,
        pose: QuaternionPose | None = None,
        velocity_m_per_s: Sequence[float] | Array = (0.0, 0.0),
    ) -> list[Track]:
        """Take in a frame; the confirmed tracks.

        Parameters
        ----------
        detections
            Of one burst. Those without a range are left out.
        elapsed_s
            Since the last frame.
        pose
            Antenna in the world; default: the origin, looking along x.
        velocity_m_per_s : (2,)
            Of the antenna in the world, to which range rates are relative.
        """
        from scipy.optimize import linear_sum_assignment

        antenna = _antenna(pose, velocity_m_per_s)
        seen = [_measurements(found) for found in detections]
        seen = [readings for readings in seen if readings[0].known[0]]
        moved = [self._predicted(track, elapsed_s) for track in self.tracks]
        updates = self._updates(moved, seen, antenna)
        cost = np.full((len(moved), len(seen)), _NEVER)
        for pair, (update, _) in updates.items():
            cost[pair] = update.cost
        pairs = zip(*(axis.tolist() for axis in linear_sum_assignment(cost)), strict=True)
        partner = {i: j for i, j in pairs if (i, j) in updates}
        kept: list[Track] = []
        for i, track in enumerate(moved):
            if i in partner:
                update, measured = updates[i, partner[i]]
                found = update.estimate
                if measured.known[1] and not found.placed:  # its first azimuth
                    found = begun(measured, antenna, self.first_speed_m_per_s)
                kept.append(replace(track.with_estimate(found), hits=track.hits + 1, missed=0))
            elif track.missed + 1 < self.lose and track.hits >= self.confirm:
                kept.append(replace(track, missed=track.missed + 1))
        free = sorted(set(range(len(seen))) - set(partner.values()))
        self.tracks = kept + [self._new(seen[j], antenna) for j in free]
        return [track for track in self.tracks if track.hits >= self.confirm]

    def _predicted(self, track: Track, elapsed_s: float) -> Track:
        return track.with_estimate(
            predicted(
                track.estimate,
                elapsed_s,
                self.acceleration_m_per_s2,
                self.acceleration_s,
                self.first_speed_m_per_s,
            )
        )

    def _updates(
        self, tracks: Sequence[Track], seen: Sequence[Readings], antenna: Antenna
    ) -> dict[tuple[int, int], tuple[Update, Measurement]]:
        """Updates of those pairs of track and detection that lie within the gate, each with the
        reading of the detection that it takes in.
        """
        from scipy.special import gammaincinv

        # Quantiles of chi-squared with 1, 2 and 3 degrees of freedom.
        limits = (2 * gammaincinv(np.arange(1, 4) / 2, self.gate)).tolist()
        ranges = np.array([(one[0].value[0], one[0].variance[0]) for one in seen]).reshape(-1, 2)
        found = {}
        for i, track in enumerate(tracks):
            for j in np.flatnonzero(_near(track.estimate, ranges, antenna, limits[-1])).tolist():
                pairs = [(updated(track.estimate, one, antenna), one) for one in seen[j]]
                fitting = [
                    pair for pair in pairs if pair[0].distance <= limits[pair[0].n_measured - 1]
                ]
                if len(fitting) > 1:  # still open
                    least = _range_alone(seen[j])
                    fitting = [(updated(track.estimate, least, antenna), least)]
                if fitting:
                    found[i, j] = fitting[0]
        return found

    def _new(self, readings: Readings, antenna: Antenna) -> Track:
        self._started += 1
        sure = readings[0] if len(readings) == 1 else _range_alone(readings)
        estimate = begun(sure, antenna, self.first_speed_m_per_s)
        return Track(self._started, estimate.state, estimate.covariance, 1, 0)


def _near(estimate: Estimate, ranges: Array, antenna: Antenna, limit: float) -> NDArray[np.bool_]:
    """Which ranges and variances (n, 2) a track may have, to spare the others the update.

    An error across the line of sight makes the range longer by its square over twice the range.
    """
    value, jacobian = expected(estimate.state, antenna)
    spread = float(jacobian[0] @ estimate.covariance @ jacobian[0])
    longer = limit * np.trace(estimate.covariance[:2, :2]) / (2 * value[0]) * estimate.placed
    reach = np.sqrt(limit * (spread + ranges[:, 1])) + longer
    return np.asarray(np.abs(ranges[:, 0] - value[0]) <= reach)


def _measurements(found: Detection) -> Readings:
    """What a detection may have measured, likeliest first: another range rate, where the record
    leaves some open, goes with another azimuth, which is not known.
    """
    error = np.array([found.range_error_m, found.azimuth_error_rad, found.range_rate_error_m_per_s])
    values = [(found.range_m, found.azimuth_rad, found.range_rate_m_per_s)]
    values += [(found.range_m, np.nan, rate) for rate in found.range_rate_alternatives_m_per_s]
    return tuple(Measurement(np.array(value), error) for value in values)


def _range_alone(readings: Readings) -> Measurement:
    """What all readings of a detection have in common."""
    return replace(readings[0], value=np.array([readings[0].value[0], np.nan, np.nan]))


def _antenna(pose: QuaternionPose | None, velocity_m_per_s: Sequence[float] | Array) -> Antenna:
    """The antenna in the plane, from its pose in space."""
    velocity = np.asarray(velocity_m_per_s, np.float64)
    if pose is None:
        return Antenna(np.zeros(2), np.array([1.0, 0.0]), velocity)
    ahead = pose.rotation.apply([1.0, 0.0, 0.0])[:2]
    return Antenna(pose.position_m[:2], ahead / np.linalg.norm(ahead), velocity)
