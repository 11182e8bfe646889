"""Rotation about a fixed axis: uniform, and to and fro."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from twin.motion.kinematics import Array, Kinematics, cross
from twin.motion.motion import Motion, cut

Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Turning(Motion):
    """Uniform rotation about ``axis`` through ``centre_m``, right-handed, from ``phase_rad`` on."""

    axis: Vector
    centre_m: Vector
    rate_rad_per_s: float
    phase_rad: float = 0.0

    @property
    def moves(self) -> bool:
        """Unless the rate is zero."""
        return self.rate_rad_per_s != 0

    @property
    def repeats_after_s(self) -> float | None:
        """Of one turn."""
        return 2 * math.pi / abs(self.rate_rad_per_s) if self.moves else None

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """An eighth of a turn apart."""
        if not self.moves:
            return np.array([start_s, end_s])
        return cut(start_s, end_s, math.pi / 4 / abs(self.rate_rad_per_s))

    def _at(self, times_s: Array) -> Kinematics:
        angle = self.phase_rad + self.rate_rad_per_s * times_s
        rate = np.full(len(times_s), self.rate_rad_per_s)
        return about_axis(self.axis, self.centre_m, angle, rate, np.zeros(len(times_s)))


@dataclass(frozen=True, eq=False)
class Swinging(Motion):
    """A pendulum's motion about ``axis`` through ``centre_m``: the angle is mean + amplitude
    sin(2 pi t / period + phase).
    """

    axis: Vector
    centre_m: Vector
    amplitude_rad: float
    period_s: float
    phase_rad: float = 0.0
    mean_rad: float = 0.0

    @property
    def moves(self) -> bool:
        """Unless the amplitude is zero."""
        return self.amplitude_rad != 0

    @property
    def repeats_after_s(self) -> float | None:
        """The period."""
        return self.period_s

    @property
    def sample_s(self) -> Array:
        """Of one period."""
        return self.period_s * np.arange(32) / 32

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """An eighth of a period apart, closer where it swings far."""
        return cut(start_s, end_s, self.period_s / 8 / max(1.0, abs(self.amplitude_rad)))

    def _at(self, times_s: Array) -> Kinematics:
        pulsation = 2 * math.pi / self.period_s
        # The whole periods first: far from time 0 the sine would lose their digits.
        phase = 2 * math.pi * np.fmod(times_s / self.period_s, 1.0) + self.phase_rad
        swing, speed = self.amplitude_rad * np.sin(phase), self.amplitude_rad * np.cos(phase)
        return about_axis(
            self.axis,
            self.centre_m,
            self.mean_rad + swing,
            pulsation * speed,
            -(pulsation**2) * swing,
        )


def about_axis(
    axis: Vector, centre_m: Vector, angle: Array, rate: Array, acceleration: Array
) -> Kinematics:
    """State of a frame turned about an axis through a point by angles (n,) in rad, whose first and
    second derivatives are given.
    """
    unit = np.asarray(axis, dtype=np.float64)
    unit = unit / np.linalg.norm(unit)
    centre = np.asarray(centre_m, dtype=np.float64)
    rotation = Rotation.from_rotvec(angle[:, None] * unit)
    arm = -rotation.apply(centre)  # from the centre to the frame's origin
    spin, change = rate[:, None] * unit, acceleration[:, None] * unit
    velocity = cross(spin, arm)
    return Kinematics(
        RigidTransform.from_components(centre + arm, rotation),
        velocity,
        spin,
        cross(change, arm) + cross(spin, velocity),
        change,
    )
