"""A frame's way through given poses: splines of position and rotation."""

from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation, RotationSpline

from twin.files import InputError
from twin.motion.kinematics import Array, Kinematics
from twin.motion.motion import EVER, Motion

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

#: What is beyond the first and the last pose: an error, the pose held, on at the velocities of the
#: end, or again from the start.
Outside = Literal["error", "hold", "continue", "repeat"]

#: Between two poses the shorter way is taken; within this of half a turn both are as short.
HALF_TURN_MARGIN_RAD = np.radians(0.1)
#: Quaternions are taken for a fault if their norm is off 1 by more.
NORM_TOLERANCE = 1e-3
#: Poses that are nearer in time are taken for a fault.
NEAREST_S = 1e-9
#: A way that is repeated ends where it began within these.
CLOSED_M, CLOSED_RAD = 1e-6, 1e-6
Label = Callable[[int], str]
_SMOOTH_TURN_RAD = 0.5  # between breaks, so that Gauss-Legendre follows it to rounding
#: Poses beyond both ends of a closed way that the spline sees: each weighs 0.27 of the one before.
_WRAPPED = 28


@dataclass(frozen=True, eq=False)
class Trajectory(Motion):
    """Poses at times (n,), interpolated so that velocity and acceleration are continuous.

    Parameters
    ----------
    times_s
        (n,), at least two, growing.
    positions_m
        (n, 3); a cubic spline (not-a-knot; through two poses a straight line, three a parabola).
    quaternions
        (n, 4), real part first, from the frame to the world; a spline of rotations with continuous
        angular rate and acceleration (SciPy's `RotationSpline`; through two poses a constant
        rate). From one pose to the next it turns the shorter way.
    outside
        ``error``; ``hold``: stands at the first pose before, at the last after it, the velocity
        falls to zero at once; ``continue``: goes on at the velocity and the angular velocity of the
        end, both without a step; ``repeat``: starts again, both splines periodic; needs the last
        pose to be the first.

    Raises InputError for times that do not grow, what is no number, a quaternion whose norm is off
    1, a turn of 180 deg from one pose to the next, and an open way that should repeat. Messages
    name the pose by its place in ``labels``, by default its number.
    """

    times_s: Array
    positions_m: Array
    quaternions: Array
    outside: Outside = "error"
    labels: InitVar[Sequence[str] | None] = None

    def __post_init__(self, labels: Sequence[str] | None) -> None:
        label = list(labels).__getitem__ if labels else "trajectory: pose {}".format
        times, places, quaternions = (
            np.array(part, dtype=np.float64)
            for part in (self.times_s, self.positions_m, self.quaternions)
        )
        count = len(times) if times.ndim == 1 else 0
        if count < 2 or places.shape != (count, 3) or quaternions.shape != (count, 4):
            raise InputError(
                f"trajectory: {times.shape} times, {places.shape} positions, {quaternions.shape} "
                "quaternions: expected n, n x 3 and n x 4 with n of at least 2"
            )
        if self.outside not in get_args(Outside):
            known = ", ".join(get_args(Outside))
            raise InputError(f"trajectory: outside = {self.outside!r}: expected one of {known}")
        _check_numbers(times, places, quaternions, label)
        quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
        _check_turns(quaternions, label)
        for name, part in (
            ("times_s", times),
            ("positions_m", places),
            ("quaternions", quaternions),
        ):
            part.setflags(write=False)
            object.__setattr__(self, name, part)
        if self.outside == "repeat":
            self._check_closed(label(count - 1))

    @property
    def span_s(self) -> tuple[float, float]:
        """From the first to the last pose, or ever."""
        return (self.times_s[0], self.times_s[-1]) if self.outside == "error" else EVER

    @cached_property
    def moves(self) -> bool:
        """Unless all poses are the same."""
        turned = self._rotations[0].inv() * self._rotations
        return bool(np.ptp(self.positions_m, axis=0).any() or turned.magnitude().any())

    @property
    def repeats_after_s(self) -> float | None:
        """From the first pose to the last, if it repeats."""
        return float(np.ptp(self.times_s)) if self.outside == "repeat" else None

    @property
    def sample_s(self) -> Array:
        """Its own times, each step in four."""
        count = len(self.times_s)
        return np.interp(np.arange(4 * count - 3) / 4, np.arange(count), self.times_s)

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """Its own times, and more of them within a step that turns far."""
        turns = (self._rotations[:-1].inv() * self._rotations[1:]).magnitude()
        parts = np.maximum(1, np.ceil(turns / _SMOOTH_TURN_RAD)).astype(int)
        steps = np.repeat(np.diff(self.times_s) / parts, parts)
        knots = self.times_s[0] + np.concatenate([[0.0], np.cumsum(steps)])
        if self.outside == "repeat":
            length = self.times_s[-1] - self.times_s[0]
            turns = np.arange(
                np.floor((start_s - knots[0]) / length), np.ceil((end_s - knots[0]) / length) + 1
            )
            knots = (knots[:-1] + length * turns[:, None]).ravel()
        inner = knots[(knots > start_s) & (knots < end_s)]
        return np.concatenate([[start_s], inner, [end_s]])

    def _check_closed(self, place: str) -> None:
        off = float(np.linalg.norm(self.positions_m[-1] - self.positions_m[0]))
        turn = float((self._rotations[0].inv() * self._rotations[-1]).magnitude())
        if off > CLOSED_M or turn > CLOSED_RAD:
            raise InputError(
                f"{place}: to repeat, expected the first pose again; "
                f"it is {off:.3g} m and {np.degrees(turn):.3g} deg off"
            )

    @cached_property
    def _rotations(self) -> Rotation:
        return Rotation.from_quat(self.quaternions, scalar_first=True)

    @cached_property
    def _places(self) -> "CubicSpline":
        from scipy.interpolate import CubicSpline  # takes 0.15 s to import

        if self.outside != "repeat" or len(self.times_s) == 2:
            return CubicSpline(self.times_s, self.positions_m)
        closed = np.concatenate([self.positions_m[:-1], self.positions_m[:1]])
        return CubicSpline(self.times_s, closed, bc_type="periodic")

    @cached_property
    def _turns(self) -> RotationSpline:
        if self.outside != "repeat":
            return RotationSpline(self.times_s, self._rotations)
        # SciPy's spline knows no periodic ends: it sees the poses beyond both ends.
        steps = len(self.times_s) - 1
        at = np.arange(-_WRAPPED, steps + _WRAPPED + 1)
        times = self.times_s[at % steps] + (at // steps) * (self.times_s[-1] - self.times_s[0])
        return RotationSpline(times, self._rotations[at % steps])

    def _at(self, times_s: Array) -> Kinematics:
        first, last = self.times_s[0], self.times_s[-1]
        if self.outside == "repeat":
            return self._between(first + np.mod(times_s - first, last - first))
        state = self._between(np.clip(times_s, first, last))
        beyond = np.where(times_s < first, times_s - first, np.maximum(times_s - last, 0.0))
        if not beyond.any():
            return state
        return _held(state, beyond) if self.outside == "hold" else _continued(state, beyond)

    def _between(self, times_s: Array) -> Kinematics:
        rotation = self._turns(times_s)
        # SciPy's rates are in the axes of the body.
        return Kinematics(
            RigidTransform.from_components(self._places(times_s), rotation),
            self._places(times_s, 1),
            rotation.apply(self._turns(times_s, 1)),
            self._places(times_s, 2),
            rotation.apply(self._turns(times_s, 2)),
        )


def _check_numbers(times: Array, places: Array, quaternions: Array, label: Label) -> None:
    rows = np.column_stack([times, places, quaternions])
    for number in np.flatnonzero(~np.isfinite(rows).all(axis=1)).tolist():
        raise InputError(f"{label(number)}: {rows[number].tolist()}: expected numbers")
    for number in np.flatnonzero(np.diff(times) <= 0).tolist():
        raise InputError(
            f"{label(number + 1)}: time {times[number + 1]:.9g} s "
            f"{'repeats' if times[number + 1] == times[number] else 'runs backwards'}: "
            f"expected more than {times[number]:.9g} s"
        )
    for number in np.flatnonzero(np.diff(times) < NEAREST_S).tolist():
        step_s = times[number + 1] - times[number]
        raise InputError(
            f"{label(number + 1)}: {step_s:.2g} s after the pose before: expected at least "
            f"{NEAREST_S:g} s"
        )
    norms = np.linalg.norm(quaternions, axis=1)
    for number in np.flatnonzero(np.abs(norms - 1) > NORM_TOLERANCE).tolist():
        raise InputError(f"{label(number)}: quaternion of norm {norms[number]:.6g}: expected 1")


def _check_turns(quaternions: Array, label: Label) -> None:
    rotations = Rotation.from_quat(quaternions, scalar_first=True)
    turns = (rotations[:-1].inv() * rotations[1:]).magnitude()
    for number in np.flatnonzero(turns > np.pi - HALF_TURN_MARGIN_RAD).tolist():
        raise InputError(
            f"{label(number + 1)}: turned by {np.degrees(turns[number]):.2f} deg from "
            "the pose before: both ways round are as short, expected a pose in between"
        )


def _held(state: Kinematics, beyond_s: Array) -> Kinematics:
    within = (beyond_s == 0)[:, None]
    return Kinematics(
        state.pose,
        state.velocity_m_per_s * within,
        state.angular_velocity_rad_per_s * within,
        state.acceleration_m_per_s2 * within,
        state.angular_acceleration_rad_per_s2 * within,
    )


def _continued(state: Kinematics, beyond_s: Array) -> Kinematics:
    within = (beyond_s == 0)[:, None]
    on = beyond_s[:, None]
    turn = Rotation.from_rotvec(on * state.angular_velocity_rad_per_s)
    place = state.pose.translation + on * state.velocity_m_per_s
    return Kinematics(
        RigidTransform.from_components(place, turn * state.pose.rotation),
        state.velocity_m_per_s,
        state.angular_velocity_rad_per_s,
        state.acceleration_m_per_s2 * within,
        state.angular_acceleration_rad_per_s2 * within,
    )


def through(
    times_s: ArrayLike, positions_m: ArrayLike, rotations: Rotation, outside: Outside = "error"
) -> Trajectory:
    """A trajectory through positions (n, 3) and as many rotations."""
    return Trajectory(
        np.asarray(times_s), np.asarray(positions_m), rotations.as_quat(scalar_first=True), outside
    )
