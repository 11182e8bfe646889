"""The Kalman filter of one track: range, azimuth and range rate of a target that moves in a plane.

Targets move straight in the plane, and are measured along and across the line of sight: the state
is predicted in the plane's axes, and updated in range, azimuth, range rate and speed across (such
coordinates: Aidala and Hammel, IEEE Trans. Autom. Control 28, 1983), where the measurement is
linear. An update linearised in the plane's axes takes the arc of equal range to be straight, and
turns the small error of the range into one of the azimuth: at 60 m with errors of 3 mm and 100 mrad
37 % of places were within their 95 % intervals.

A target whose azimuth was never measured has a state of range and range rate alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_ERROR = 1e-9  # m, rad and m/s: a standard error of 0 would make the covariance singular


@dataclass(frozen=True, eq=False)
class AntennaState:
    """Position (2,), boresight (2,) and velocity (2,) of the radar in the plane."""

    place_m: Array
    ahead: Array
    velocity_m_per_s: Array


@dataclass(frozen=True, eq=False)
class TargetMeasurement:
    """Range (m), azimuth (rad) and range rate (m/s), (3,), and their standard errors, (3,).

    Components without a finite value and error were not measured.
    """

    value: Array
    error: Array

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which of the three were measured."""
        return np.asarray(np.isfinite(self.value) & np.isfinite(self.error))

    @property
    def variance(self) -> Array:
        """Squared standard errors; infinite where nothing was measured."""
        return np.where(self.known, np.maximum(self.error, _LEAST_ERROR) ** 2, np.inf)


@dataclass(frozen=True, eq=False)
class Estimate:
    """State and covariance: (x, y, vx, vy) in the world, or range and rate from the antenna."""

    state: Array
    covariance: Array

    @property
    def has_position(self) -> bool:
        """Whether the position in the plane is known, not only the range."""
        return len(self.state) == 4


@dataclass(frozen=True, eq=False)
class Update:
    """Estimate from prediction and measurement, and their agreement.

    ``distance`` is the squared Mahalanobis distance, chi-squared with ``n_measured`` degrees of
    freedom for the track's own target; ``cost`` twice the negative logarithm of the measurement's
    likelihood, less a constant.
    """

    estimate: Estimate
    distance: float
    cost: float
    n_measured: int


def initial_estimate(
    measured: TargetMeasurement, antenna: AntennaState, speed_m_per_s: float
) -> Estimate:
    """Estimate from one measurement, in which the range must be known.

    ``speed_m_per_s``: standard deviation of the velocity where nothing is measured of it, so always
    across the line of sight. With an azimuth the moments are those of the converted measurement to
    second order in its error (Lerro and Bar-Shalom, IEEE Trans. Aerosp. Electron. Syst. 29, 1993).
    """
    range_m, azimuth, rate = measured.value
    variance = measured.variance
    if not measured.known[2]:
        rate, variance[2] = 0.0, speed_m_per_s**2
    if not measured.known[1]:
        return Estimate(np.array([range_m, rate]), np.diag(variance[[0, 2]]))
    left = np.array([-antenna.ahead[1], antenna.ahead[0]])
    sight = np.cos(azimuth) * antenna.ahead + np.sin(azimuth) * left
    across = np.array([-sight[1], sight[0]])
    turn = np.zeros((4, 4))  # by range, azimuth, range rate, speed across
    turn[:2, 0], turn[:2, 1] = sight, range_m * across
    turn[2:, 1], turn[2:, 2], turn[2:, 3] = rate * across, sight, across
    covariance = turn @ np.diag([*variance, speed_m_per_s**2]) @ turn.T
    along = np.outer(sight, sight)
    covariance[:2, :2] += range_m**2 * variance[1] ** 2 / 2 * along
    covariance[2:, 2:] += (speed_m_per_s**2 * variance[1] + rate**2 * variance[1] ** 2 / 2) * along
    state = np.concatenate(
        [antenna.place_m + range_m * sight, antenna.velocity_m_per_s + rate * sight]
    )
    return Estimate(state, covariance)


def predict_estimate(
    estimate: Estimate,
    elapsed_s: float,
    acceleration_m_per_s2: float,
    acceleration_s: float,
    speed_m_per_s: float,
) -> Estimate:
    """Estimate after a time, at constant velocity but for acceleration along each axis.

    The acceleration's density is its mean square times how long it lasts, ``acceleration_s``, or
    the interval where that is longer; within it is free (the continuous white-noise model of
    Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    section 6.2.2).

    Without azimuth, the range rate of a target that crosses with ``speed_m_per_s`` changes by the
    square of the speed over the range per second, which is added to the acceleration.
    """
    t, axes, variance = elapsed_s, 2, acceleration_m_per_s2**2
    if not estimate.has_position:
        axes = 1
        variance += (speed_m_per_s**2 / max(abs(estimate.state[0]), 1e-3)) ** 2
    step = np.kron([[1.0, t], [0.0, 1.0]], np.eye(axes))
    density = variance * max(t, acceleration_s)
    noise = density * np.kron([[t**3 / 3, t**2 / 2], [t**2 / 2, t]], np.eye(axes))
    return Estimate(step @ estimate.state, step @ estimate.covariance @ step.T + noise)


def measurement_model(state: Array, antenna: AntennaState) -> tuple[Array, Array]:
    """Measurement (3,) of a target in a state, and its Jacobian (3, n_states).

    A state without a position has no azimuth: NaN.
    """
    if len(state) == 2:
        return np.array([state[0], np.nan, state[1]]), np.array([[1.0, 0], [0, 0], [0, 1]])
    off, velocity = state[:2] - antenna.place_m, state[2:] - antenna.velocity_m_per_s
    range_m = max(float(np.hypot(*off)), 1e-9)
    sight = off / range_m
    across = np.array([-sight[1], sight[0]])
    left = np.array([-antenna.ahead[1], antenna.ahead[0]])
    value = np.array([range_m, np.arctan2(off @ left, off @ antenna.ahead), velocity @ sight])
    jacobian = np.zeros((3, 4))
    jacobian[0, :2] = jacobian[2, 2:] = sight
    jacobian[1, :2] = across / range_m
    jacobian[2, :2] = (velocity @ across) / range_m * across
    return value, jacobian


def update_estimate(prior: Estimate, measured: TargetMeasurement, antenna: AntennaState) -> Update:
    """The estimate given a prediction and a measurement."""
    used = measured.known & np.array([True, prior.has_position, True])
    polar, turn = _along_sight(prior.state, antenna)
    covariance = turn @ prior.covariance @ turn.T
    rows = np.flatnonzero(used if prior.has_position else used[[0, 2]])
    residual = measured.value[used] - polar[rows]
    if used[1]:
        residual[1] = (residual[1] + np.pi) % (2 * np.pi) - np.pi
    spread = covariance[np.ix_(rows, rows)] + np.diag(measured.variance[used])
    gain = np.linalg.solve(spread, covariance[rows]).T
    rest = np.eye(len(polar))
    rest[:, rows] -= gain
    covariance = rest @ covariance @ rest.T + gain * measured.variance[used] @ gain.T
    state, back = _in_plane(polar + gain @ residual, antenna)
    covariance = back @ covariance @ back.T
    distance = float(residual @ np.linalg.solve(spread, residual))
    return Update(
        estimate=Estimate(state, (covariance + covariance.T) / 2),
        distance=distance,
        cost=distance + float(np.linalg.slogdet(spread)[1]),
        n_measured=int(used.sum()),
    )


def _along_sight(state: Array, antenna: AntennaState) -> tuple[Array, Array]:
    """Range, azimuth, range rate and speed across of a target in a state, and their Jacobian; a
    state without a position as it is.
    """
    if len(state) == 2:
        return state, np.eye(2)
    value, jacobian = measurement_model(state, antenna)
    off, velocity = state[:2] - antenna.place_m, state[2:] - antenna.velocity_m_per_s
    sight = off / max(float(np.hypot(*off)), 1e-9)
    across = np.array([-sight[1], sight[0]])
    of_across = np.concatenate([-(velocity @ sight) / value[0] * across, across])
    return np.append(value, velocity @ across), np.vstack([jacobian, of_across])


def _in_plane(polar: Array, antenna: AntennaState) -> tuple[Array, Array]:
    """The state of `_along_sight`, and its Jacobian."""
    if len(polar) == 2:
        return polar, np.eye(2)
    range_m, azimuth, rate, beside = polar
    left = np.array([-antenna.ahead[1], antenna.ahead[0]])
    sight = np.cos(azimuth) * antenna.ahead + np.sin(azimuth) * left
    across = np.array([-sight[1], sight[0]])
    moving = rate * sight + beside * across
    jacobian = np.zeros((4, 4))
    jacobian[:2, 0], jacobian[:2, 1] = sight, range_m * across
    jacobian[2:, 1] = rate * across - beside * sight
    jacobian[2:, 2], jacobian[2:, 3] = sight, across
    place = antenna.place_m + range_m * sight
    return np.concatenate([place, antenna.velocity_m_per_s + moving]), jacobian
