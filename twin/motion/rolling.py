"""Rolling without slipping: the way that the axle travels sets the angle."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.motion.kinematics import Array, Kinematics, cross
from twin.motion.motion import (
    Later,
    Motion,
    Parent,
    Product,
    Still,
    Straight,
    cut,
    gauss_nodes,
)
from twin.motion.turning import Vector, about_axis

_CHUNK_S = 64.0  # the angle is summed up over chunks of time of this length


@dataclass(frozen=True, eq=False)
class Rolling(Motion):
    """A wheel within the frame ``carrier``, turned by the way its axle travels over its radius.

    ``axis`` points to the left of where it rolls, ``up`` away from the road, ``centre_m`` is the
    middle of the wheel; all in the carrier's frame. What counts is the way along the wheel's own
    heading, so that the inner wheels of a bend turn slower, and backwards is negative. The rate is
    exact; the angle is its integral from time 0, or from the carrier's first time if that is later.
    """

    carrier: Motion
    axis: Vector
    centre_m: Vector
    radius_m: float
    up: Vector = (0.0, 0.0, 1.0)

    @property
    def span_s(self) -> tuple[float, float]:
        """The carrier's."""
        return self.carrier.span_s

    @property
    def moves(self) -> bool:
        """Whether the carrier does."""
        return self.carrier.moves

    @property
    def sample_s(self) -> Array:
        """The carrier's."""
        return self.carrier.sample_s

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """Those of the carrier, no farther apart than the angle allows."""
        breaks = self.carrier.breaks_s(start_s, end_s)
        # Forth and back as well.
        times, weights = gauss_nodes(breaks[:-1], breaks[1:])
        rates = self._rate(times.ravel())[0].reshape(times.shape)
        turns = np.sum(weights * np.abs(rates), axis=1)
        parts = np.maximum(1, np.ceil(turns / (math.pi / 4))).astype(int)
        pieces = [
            np.linspace(a, b, n, endpoint=False)
            for a, b, n in zip(breaks, breaks[1:], parts, strict=False)
        ]
        return np.concatenate([*pieces, [end_s]])

    def _at(self, times_s: Array) -> Kinematics:
        rate, change = self._rate(times_s)
        return about_axis(self.axis, self.centre_m, self._angle(times_s), rate, change)

    @cached_property
    def _heading(self) -> Array:
        heading = np.cross(self.axis, self.up)
        unit: Array = heading / np.linalg.norm(heading)
        return unit

    def _rate(self, times_s: Array) -> tuple[Array, Array]:
        """Angular velocity and acceleration about the axis, (n,) each."""
        state = self.carrier._at(times_s)
        _, velocity, acceleration = (
            part[:, 0] for part in state.of_points(np.reshape(self.centre_m, (1, 3)))
        )
        heading = state.pose.rotation.apply(self._heading)
        turning = cross(state.angular_velocity_rad_per_s, heading)
        along = np.sum(velocity * heading, axis=1)
        gaining = np.sum(acceleration * heading + velocity * turning, axis=1)
        return along / self.radius_m, gaining / self.radius_m

    def _angle(self, times_s: Array) -> Array:
        """Integral of the rate from time 0 to each time, (n,), in rad."""
        first, last = self.span_s
        start = min(max(0.0, first), last)
        if _is_steady(self.carrier):
            return self._rate(np.zeros(1))[0] * (times_s - start)
        period = self.carrier.repeats_after_s
        if period is not None:
            rounds = np.floor((times_s - start) / period)
            whole = self._integral(start, np.array([start + period]))
            return rounds * whole + self._integral(start, times_s - rounds * period)
        after = times_s >= start
        angle = np.empty(len(times_s))
        angle[after] = self._integral(start, times_s[after])
        angle[~after] = self._integral(start, times_s[~after], -1)
        return angle

    def _integral(self, start: float, times_s: Array, sense: int = 1) -> Array:
        """Of the rate from ``start`` to times that all lie after it, or before it."""
        chunks = np.abs(times_s - start).max(initial=0.0) / _CHUNK_S
        known, angles = self._table(start, sense, 2 ** math.ceil(math.log2(max(chunks, 1.0))))
        at = np.searchsorted(sense * known, sense * times_s, side="right") - 1
        at = np.maximum(at, 0)
        return angles[at] + self._steps(known[at], times_s)

    def _steps(self, start_s: Array, end_s: Array) -> Array:
        """Integrals of the rate over intervals within which the carrier moves smoothly, (n,)."""
        nodes, weights = gauss_nodes(start_s, end_s)
        rate = self._rate(nodes.ravel())[0].reshape(nodes.shape)
        return np.sum(weights * rate, axis=1)

    def _table(self, start: float, sense: int, chunks: int) -> tuple[Array, Array]:
        """Times from ``start`` on, one way, with the angle at each."""
        if (sense, chunks) not in self._tables:
            first, last = self.span_s
            end = min(max(start + sense * chunks * _CHUNK_S, first), last)
            low, high = sorted((start, end))
            # What comes after a time must not change the sum before it: chunks are always cut.
            own = cut(low, high, _CHUNK_S)
            times = np.union1d(own, self.carrier.breaks_s(low, high))[::sense]
            steps = self._steps(times[:-1], times[1:])
            self._tables[sense, chunks] = times, np.concatenate([[0.0], np.cumsum(steps)])
        return self._tables[sense, chunks]

    @cached_property
    def _tables(self) -> dict[tuple[int, int], tuple[Array, Array]]:
        return {}


def _is_steady(motion: Motion) -> bool:
    """Whether a frame moves straight on, so that what rolls on it turns at one rate."""
    if isinstance(motion, Product):
        return all(_is_steady(part) for part in motion.parts)
    if isinstance(motion, Parent | Later):
        return _is_steady(motion.motion)
    return isinstance(motion, Still | Straight)
