"""Tracks of detections over frames: a Kalman filter each, detections assigned by likelihood.

Assignment is SciPy's (linear_sum_assignment), by range, azimuth and range rate, so that targets
that meet at one position keep their tracks by their rates. If a range rate has alternatives, the
track uses the one, with its azimuth, that agrees with its own motion; while several agree, it uses
the range alone. Existing filter libraries (filterpy, Stone Soup) depend on matplotlib, which is not
installed on the vehicle; the tests compare the filter with Stone Soup.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, check_finite
from hardware.radar.detection import Detection
from hardware.radar.filtering import (
    AntennaState,
    Estimate,
    TargetMeasurement,
    Update,
    initial_estimate,
    measurement_model,
    predict_estimate,
    update_estimate,
)
from hardware.radar.track_readings import Readings, heading, readings
from hardware.records.state import QuaternionPose

Array = NDArray[np.float64]

_NEVER = 1e9  # cost of an impossible pair, far above any other


@dataclass(frozen=True)
class TargetTrack:
    """Track of one target: state, covariance and history.

    ``state`` is (x, y, vx, vy) along the ground in the world, m and m/s; or, of a target whose
    azimuth was never measured, (range, range rate) from the antenna. ``hits`` frames with a
    detection, ``missed`` frames in a row without.
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

    def with_estimate(self, estimate: Estimate) -> "TargetTrack":
        """The same target in another state."""
        return replace(self, state=estimate.state, covariance=estimate.covariance)


@dataclass
class Tracker:
    """Multi-target tracker.

    Parameters
    ----------
    acceleration_m_per_s2, acceleration_s
        Root mean square that targets accelerate with, along each axis, and how long such an
        acceleration lasts at least; from frame to frame where these are farther apart.
    gate
        Probability that a track's own detection is inside its gate.
    confirm, lose
        Hits that make a track a target, misses in a row that end it.
    first_speed_m_per_s
        Standard deviation of a new target's speed across the line of sight.
    """

    acceleration_m_per_s2: float = 3.0
    acceleration_s: float = 0.1
    gate: float = 0.999
    confirm: int = 3
    lose: int = 3
    first_speed_m_per_s: float = 10.0
    tracks: list[TargetTrack] = field(default_factory=list)
    _started: int = 0

    def update(
        self,
        detections: Sequence[Detection],
        elapsed_s: float,
        pose: QuaternionPose | None = None,
        velocity_m_per_s: Sequence[float] | Array = (0.0, 0.0),
    ) -> list[TargetTrack]:
        """Update the tracks with a frame; returns the confirmed ones.

        Parameters
        ----------
        detections
            Of one burst. Those without a range are left out.
        elapsed_s
            Since the last frame; InputError where it is negative or not finite.
        pose
            Antenna in the world; default: the origin, looking along x.
        velocity_m_per_s : (2,)
            Of the antenna in the world, to which range rates are relative.
        """
        from scipy.optimize import linear_sum_assignment

        check_finite("elapsed_s", elapsed_s)
        if elapsed_s < 0:
            raise InputError(f"elapsed_s: {elapsed_s!r:.60} is negative")
        pose = pose or QuaternionPose.from_numbers([0, 0, 0, 1, 0, 0, 0])
        antenna = AntennaState(
            np.asarray(pose.position_m)[:2],
            heading(pose.rotation),
            np.asarray(velocity_m_per_s, np.float64),
        )
        every = [readings(detection, pose.rotation) for detection in detections]
        ranged = [one for one in every if one[0].known[0]]
        predictions = [self._predicted(track, elapsed_s) for track in self.tracks]
        updates = self._updates(predictions, ranged, antenna)
        cost = np.full((len(predictions), len(ranged)), _NEVER)
        for pair, (update, _) in updates.items():
            cost[pair] = update.cost
        pairs = zip(*(axis.tolist() for axis in linear_sum_assignment(cost)), strict=True)
        partner = {i: j for i, j in pairs if (i, j) in updates}
        continued: list[TargetTrack] = []
        for i, track in enumerate(predictions):
            if i in partner:
                update, measured = updates[i, partner[i]]
                estimate = update.estimate
                if measured.known[1] and not estimate.has_position:  # its first azimuth
                    estimate = initial_estimate(measured, antenna, self.first_speed_m_per_s)
                continued.append(
                    replace(track.with_estimate(estimate), hits=track.hits + 1, missed=0)
                )
            elif track.missed + 1 < self.lose and track.hits >= self.confirm:
                continued.append(replace(track, missed=track.missed + 1))
        free = sorted(set(range(len(ranged))) - set(partner.values()))
        self.tracks = continued + [self._new(ranged[j], antenna) for j in free]
        return [track for track in self.tracks if track.hits >= self.confirm]

    def _predicted(self, track: TargetTrack, elapsed_s: float) -> TargetTrack:
        return track.with_estimate(
            predict_estimate(
                track.estimate,
                elapsed_s,
                self.acceleration_m_per_s2,
                self.acceleration_s,
                self.first_speed_m_per_s,
            )
        )

    def _updates(
        self, tracks: Sequence[TargetTrack], ranged: Sequence[Readings], antenna: AntennaState
    ) -> dict[tuple[int, int], tuple[Update, TargetMeasurement]]:
        """Updates of all pairs of track and detection within the gate, each with the measurement
        used.
        """
        from scipy.special import gammaincinv

        # Quantiles of chi-squared with 1, 2 and 3 degrees of freedom.
        limits = (2 * gammaincinv(np.arange(1, 4) / 2, self.gate)).tolist()
        ranges = np.array([(one[0].value[0], one[0].variance[0]) for one in ranged]).reshape(-1, 2)
        gated = {}
        for i, track in enumerate(tracks):
            for j in np.flatnonzero(_near(track.estimate, ranges, antenna, limits[-1])).tolist():
                pairs = [(update_estimate(track.estimate, one, antenna), one) for one in ranged[j]]
                fitting = [
                    pair for pair in pairs if pair[0].distance <= limits[pair[0].n_measured - 1]
                ]
                if len(fitting) > 1:  # still open
                    least = _common(ranged[j])
                    fitting = [(update_estimate(track.estimate, least, antenna), least)]
                if fitting:
                    gated[i, j] = fitting[0]
        return gated

    def _new(self, readings: Readings, antenna: AntennaState) -> TargetTrack:
        self._started += 1
        sure = _common(readings)
        estimate = initial_estimate(sure, antenna, self.first_speed_m_per_s)
        return TargetTrack(self._started, estimate.state, estimate.covariance, 1, 0)


def _near(
    estimate: Estimate, ranges: Array, antenna: AntennaState, limit: float
) -> NDArray[np.bool_]:
    """Coarse gate: which ranges and variances (n, 2) a track may have; others need no update.

    An error across the line of sight makes the range longer by its square over twice the range.
    """
    value, jacobian = measurement_model(estimate.state, antenna)
    spread = float(jacobian[0] @ estimate.covariance @ jacobian[0])
    longer = limit * np.trace(estimate.covariance[:2, :2]) / (2 * value[0]) * estimate.has_position
    reach = np.sqrt(limit * (spread + ranges[:, 1])) + longer
    return np.asarray(np.abs(ranges[:, 0] - value[0]) <= reach)


def _common(readings: Readings) -> TargetMeasurement:
    """The measurement of what all alternatives of a detection have in common."""
    values = np.stack([reading.value for reading in readings])
    return replace(
        readings[0], value=np.where((values == values[0]).all(axis=0), values[0], np.nan)
    )
