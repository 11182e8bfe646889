"""Tracks of detections over frames: Kalman filters in the world, assignment by least distance.

Assignment is SciPy's (linear_sum_assignment). The filter is the textbook's linear one, on position
in the plane, with the covariance that the detection's own standard errors give, and its range rate
as a second, scalar update: a dozen lines. The filter libraries that exist (filterpy, Stone Soup)
bring matplotlib, which has no place on the vehicle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.detection import Detection

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """One target: state (x, y, vx, vy) in the world, m and m/s, its covariance (4, 4), its past.

    ``hits`` frames with a detection, ``missed`` frames in a row without.
    """

    number: int
    state: Array
    covariance: Array
    hits: int
    missed: int


@dataclass
class Tracker:
    """Keeps tracks over frames.

    Parameters
    ----------
    acceleration_m_per_s2
        Root mean square that targets accelerate with, white within an interval.
    gate
        Probability that a track's own detection is let through.
    confirm, lose
        Hits that make a track a target, misses in a row that end it.
    azimuth_error_rad
        Taken where a detection has no azimuth of its own: the antenna's half beam width.
    first_speed_m_per_s
        Standard deviation of a new target's speed across the line of sight.
    """

    acceleration_m_per_s2: float = 3.0
    gate: float = 0.999
    confirm: int = 3
    lose: int = 3
    azimuth_error_rad: float = 0.2
    first_speed_m_per_s: float = 10.0
    tracks: list[Track] = field(default_factory=list)
    _started: int = 0

    def update(
        self, detections: Sequence[Detection], elapsed_s: float, pose: Array | None = None
    ) -> list[Track]:
        """Take in a frame; the confirmed tracks.

        Parameters
        ----------
        detections
            Of one burst.
        elapsed_s
            Since the last frame.
        pose : (7,)
            Antenna in the world, as in a record; default: the origin, looking along x.

        The antenna's own motion must be small against the targets', or known and added to the
        detections' rates.
        """
        from scipy.optimize import linear_sum_assignment
        from scipy.stats import chi2

        seen = [self._placed(found, pose) for found in detections]
        moved = [self._predicted(track, elapsed_s) for track in self.tracks]
        limit = float(chi2.ppf(self.gate, 2))
        cost = np.array([[_distance(track, *place[:2]) for place in seen] for track in moved])
        cost = cost.reshape(len(moved), len(seen))
        free = set(range(len(seen)))
        kept: list[Track] = []
        pairs = zip(*linear_sum_assignment(np.minimum(cost, 10 * limit)), strict=True)
        partner = {i: j for i, j in pairs if cost[i, j] <= limit}
        for i, track in enumerate(moved):
            if i in partner:
                free.discard(partner[i])
                kept.append(_corrected(track, *seen[partner[i]]))
            elif track.missed + 1 < self.lose and track.hits >= self.confirm:
                kept.append(replace(track, missed=track.missed + 1))
        self.tracks = kept + [self._new(*seen[j]) for j in sorted(free)]
        return [track for track in self.tracks if track.hits >= self.confirm]

    def _placed(
        self, found: Detection, pose: Array | None
    ) -> tuple[Array, Array, Array, float, float]:
        """Place (2,), covariance (2, 2), line of sight (2,), rate and its error, in the world."""
        from scipy.spatial.transform import Rotation

        known = np.isfinite(found.azimuth_rad)
        azimuth = found.azimuth_rad if known else 0.0
        spread = found.azimuth_error_rad if known else self.azimuth_error_rad
        place, turn = np.zeros(2), np.eye(2)
        if pose is not None:
            place = pose[:2]
            ahead = Rotation.from_quat(pose[[4, 5, 6, 3]]).apply([1.0, 0.0, 0.0])
            ahead = ahead[:2] / np.linalg.norm(ahead[:2])
            turn = np.array([[ahead[0], -ahead[1]], [ahead[1], ahead[0]]])
        sight = turn @ np.array([np.cos(azimuth), np.sin(azimuth)])
        across = np.array([-sight[1], sight[0]])
        covariance = found.range_error_m**2 * np.outer(sight, sight)
        covariance += (found.range_m * spread) ** 2 * np.outer(across, across)
        return (
            place + found.range_m * sight,
            covariance,
            sight,
            found.range_rate_m_per_s,
            found.range_rate_error_m_per_s,
        )

    def _predicted(self, track: Track, elapsed_s: float) -> Track:
        """Constant velocity, with white acceleration."""
        t = elapsed_s
        step = np.eye(4) + t * np.eye(4, k=2)
        noise = np.kron([[t**4 / 4, t**3 / 2], [t**3 / 2, t**2]], np.eye(2))
        covariance = step @ track.covariance @ step.T + self.acceleration_m_per_s2**2 * noise
        return replace(track, state=step @ track.state, covariance=covariance)

    def _new(
        self, place: Array, covariance: Array, sight: Array, rate: float, rate_error: float
    ) -> Track:
        self._started += 1
        across = np.eye(2) - np.outer(sight, sight)
        speed = rate_error**2 * np.outer(sight, sight) + self.first_speed_m_per_s**2 * across
        whole = np.zeros((4, 4))
        whole[:2, :2], whole[2:, 2:] = covariance, speed
        return Track(self._started, np.concatenate([place, rate * sight]), whole, 1, 0)


def _distance(track: Track, place: Array, covariance: Array) -> float:
    """Squared Mahalanobis distance of a place from where the track is expected."""
    off = place - track.state[:2]
    return float(off @ np.linalg.solve(track.covariance[:2, :2] + covariance, off))


def _corrected(
    track: Track, place: Array, covariance: Array, sight: Array, rate: float, rate_error: float
) -> Track:
    """Place first, then the rate along the line of sight."""
    watch = np.eye(2, 4)
    state, spread = _kalman(track.state, track.covariance, place, watch, covariance)
    along = np.concatenate([np.zeros(2), sight])[None]
    state, spread = _kalman(state, spread, np.array([rate]), along, np.array([[rate_error**2]]))
    return replace(track, state=state, covariance=spread, hits=track.hits + 1, missed=0)


def _kalman(
    state: Array, spread: Array, seen: Array, watch: Array, noise: Array
) -> tuple[Array, Array]:
    """The linear update, in Joseph's form, which stays symmetric."""
    gain = np.linalg.solve(watch @ spread @ watch.T + noise, watch @ spread).T
    left = np.eye(len(state)) - gain @ watch
    return state + gain @ (seen - watch @ state), left @ spread @ left.T + gain @ noise @ gain.T
