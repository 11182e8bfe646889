"""The Kalman filter of one track: range, azimuth and range rate of a target that moves in a plane.

The measurement is not linear in position and velocity: rotating the line of sight by an azimuth
error of 0.4 degrees changes the range rate of a target that crosses at 3 m/s by 20 mm/s, several
times the error of the rate. So the update is the most probable state given the prediction and the
whole measurement, by Gauss-Newton: the iterated extended Kalman filter (Bell and Cathey, IEEE
Trans. Autom. Control 38, 1993). The covariance is linearised there.

A target whose azimuth was never measured has a state of range and range rate alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STEPS = 20  # of Gauss-Newton; from a fair prediction 3 to 5 suffice
_CONVERGED = 1e-9  # of the squared distance, from one step to the next
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
    """The most probable state given a prediction and a measurement."""
    used = measured.known & np.array([True, prior.has_position, True])
    weight = np.where(used, 1 / measured.variance, 0.0)
    information: Array = np.linalg.inv(prior.covariance).astype(np.float64)
    state = prior.state
    distance, off, jacobian = _residuals(state, prior, information, measured, weight, antenna)
    for _ in range(_STEPS):
        curved = information + jacobian.T @ (weight[:, None] * jacobian)
        slope = jacobian.T @ (weight * off) - information @ (state - prior.state)
        change, before = np.linalg.solve(curved, slope), distance
        for share in 0.5 ** np.arange(10):
            distance, off, jacobian = _residuals(
                state + share * change, prior, information, measured, weight, antenna
            )
            if distance <= before * (1 + _CONVERGED):
                break
        state = state + share * change
        if before - distance <= _CONVERGED * (1 + distance):
            break
    covariance = np.linalg.inv(information + jacobian.T @ (weight[:, None] * jacobian))
    shrunk = np.linalg.slogdet(prior.covariance)[1] - np.linalg.slogdet(covariance)[1]
    return Update(
        estimate=Estimate(state, (covariance + covariance.T) / 2),
        distance=distance,
        cost=float(distance + shrunk + np.sum(np.log(measured.variance[used]))),
        n_measured=int(used.sum()),
    )


def _residuals(
    state: Array,
    prior: Estimate,
    information: Array,
    measured: TargetMeasurement,
    weight: Array,
    antenna: AntennaState,
) -> tuple[float, Array, Array]:
    """Squared distance of a state from prediction and measurement, residual of the measurement
    (3,), 0 where it has no weight, and the Jacobian.
    """
    value, jacobian = measurement_model(state, antenna)
    off = np.where(weight > 0, measured.value - value, 0.0)
    off[1] = (off[1] + np.pi) % (2 * np.pi) - np.pi
    moved = state - prior.state
    return float(moved @ information @ moved + off @ (weight * off)), off, jacobian
