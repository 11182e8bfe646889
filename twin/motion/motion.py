"""The interface of all motions, and those that others are built of."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from twin.files import InputError
from twin.motion.kinematics import Array, Kinematics, at_rest

_STATES_HELD, _MOST_HELD = 16, 4096  # states of what carries others, and times of each
EVER = (-math.inf, math.inf)


class Motion(ABC):
    """A moving frame. Subclasses are frozen dataclasses of what they depend on."""

    @abstractmethod
    def _at(self, times_s: Array) -> Kinematics:
        """State at times (n,) within ``span_s``."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which it is defined."""
        return EVER

    @property
    def moves(self) -> bool:
        """Whether its frame ever moves."""
        return True

    @property
    def repeats_after_s(self) -> float | None:
        """After which all comes round again, if it does."""
        return None

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """Times, both ends included, between which a polynomial of degree 15 follows it to
        rounding.
        """
        return np.array([start_s, end_s])

    @property
    def sample_s(self) -> Array:
        """Times, closely spaced, at which all that it does shows."""
        return np.zeros(1)

    def fastest(self, centre_m: ArrayLike, radius_m: float) -> float:
        """Bound of the speed of all points of a sphere in the frame, at `sample_s`, in m/s."""
        state = self.at(self.samples_s)
        velocity = state.of_points(np.reshape(centre_m, (1, 3)))[1][:, 0]
        turning = np.linalg.norm(state.angular_velocity_rad_per_s, axis=-1)
        return float((np.linalg.norm(velocity, axis=-1) + radius_m * turning).max())

    @property
    def samples_s(self) -> Array:
        """Those of `sample_s` at which it is defined."""
        first, last = self.span_s
        return np.unique(np.clip(self.sample_s, first, last))

    def at(self, times_s: ArrayLike) -> Kinematics:
        """State of the frame at one time, or at times (n,).

        Raises InputError for a time that is no finite number or outside ``span_s``.
        """
        times = np.asarray(times_s, dtype=np.float64)
        if times.ndim > 1:
            raise InputError(f"times of shape {times.shape}: expected one time or a row of them")
        first, last = self.span_s
        inside = np.isfinite(times) & (times >= first) & (times <= last)
        if not inside.all():
            wrong = float(np.atleast_1d(times)[~np.atleast_1d(inside)][0])
            raise InputError(f"motion: time {wrong:g} s: expected {first:g} to {last:g} s")
        found = self._at(np.atleast_1d(times))
        return found if times.ndim else found[0]

    def pose_at(self, times_s: ArrayLike) -> RigidTransform:
        """Pose of the frame at one time, or at times (n,)."""
        return self.at(times_s).pose

    def later(self, by_s: float) -> "Motion":
        """The same motion with time counted from ``by_s`` on."""
        return self if by_s == 0 or not self.moves else Later(self, by_s)

    def displaced(self, by: RigidTransform, at_s: float = 0.0) -> "Motion":
        """The same from a pose that differs by a transform of the world at one time.

        The way of a frame with a parent stays the same as seen from the parent.
        """
        return Product((Still(by), self))

    def path_bound_m(
        self, centre_m: ArrayLike, radius_m: float, start_s: float, end_s: float
    ) -> float:
        """No point of a sphere in the frame moves farther than this between any two times of an
        interval.

        The length of the centre's path plus that of a point at ``radius_m`` from it about the axis
        of rotation, by Gauss-Legendre integration of their speeds.
        """
        breaks = self.breaks_s(start_s, end_s)
        times, weights = (part.ravel() for part in gauss_nodes(breaks[:-1], breaks[1:]))
        state = self.at(times)
        _, velocity, _ = state.of_points(np.reshape(centre_m, (1, 3)))
        turning = np.linalg.norm(state.angular_velocity_rad_per_s, axis=-1)
        speed = np.linalg.norm(velocity[:, 0], axis=-1) + radius_m * turning
        return float(weights @ speed)

    def with_parent(self, name: str, motion: "Motion") -> "Motion":
        """The same carried by another motion of the parent of that name."""
        changed: dict[str, Any] = {}
        for field in fields(self):  # type: ignore[arg-type]  # all motions are dataclasses
            value = getattr(self, field.name)
            if isinstance(value, Motion):
                changed[field.name] = value.with_parent(name, motion)
            elif field.name == "parts":
                changed[field.name] = tuple(part.with_parent(name, motion) for part in value)
        return replace(self, **changed) if changed else self  # type: ignore[type-var]

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]


#: Nodes and weights on -1 to 1.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def gauss_nodes(start_s: ArrayLike, end_s: ArrayLike) -> tuple[Array, Array]:
    """Times and weights (n, 8) of integrals over intervals from ``start_s`` to ``end_s`` (n,)."""
    start, end = (np.asarray(side, dtype=np.float64)[:, None] for side in (start_s, end_s))
    half = (end - start) / 2
    return (start + end) / 2 + half * _NODES, half * _WEIGHTS


def cut(start_s: float, end_s: float, step_s: float) -> Array:
    """Both ends and all multiples of a step between them."""
    inner = step_s * np.arange(math.floor(start_s / step_s) + 1, math.ceil(end_s / step_s))
    inner = inner[(inner > start_s) & (inner < end_s)]
    return np.concatenate([[start_s], inner, [end_s]])


@dataclass(frozen=True, eq=False)
class Still(Motion):
    """A frame that stands at ``pose``."""

    pose: RigidTransform

    @property
    def moves(self) -> bool:
        """Never."""
        return False

    def _at(self, times_s: Array) -> Kinematics:
        return at_rest(self.pose, len(times_s))


@dataclass(frozen=True, eq=False)
class Straight(Motion):
    """A constant velocity, from the origin at time 0."""

    velocity_m_per_s: tuple[float, float, float]

    @property
    def moves(self) -> bool:
        """Unless the velocity is zero."""
        return any(self.velocity_m_per_s)

    def _at(self, times_s: Array) -> Kinematics:
        velocity = np.tile(np.asarray(self.velocity_m_per_s, float), (len(times_s), 1))
        zero = np.zeros_like(velocity)
        poses = RigidTransform.from_translation(times_s[:, None] * velocity)
        return Kinematics(poses, velocity, zero, zero, zero)


@dataclass(frozen=True, eq=False)
class Product(Motion):
    """Frames within frames, the outermost first: pose = first(t) second(t) ..."""

    parts: tuple[Motion, ...]

    @property
    def span_s(self) -> tuple[float, float]:
        """The times at which all parts are defined."""
        spans = [part.span_s for part in self.parts]
        return max(first for first, _ in spans), min(last for _, last in spans)

    @property
    def moves(self) -> bool:
        """Whether any part does."""
        return any(part.moves for part in self.parts)

    @property
    def repeats_after_s(self) -> float | None:
        """That of the only part that moves."""
        moving = [part for part in self.parts if part.moves]
        return moving[0].repeats_after_s if len(moving) == 1 else None

    @property
    def sample_s(self) -> Array:
        """Those of all parts."""
        return np.unique(np.concatenate([part.sample_s for part in self.parts]))

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """Those of all parts."""
        return np.unique(np.concatenate([part.breaks_s(start_s, end_s) for part in self.parts]))

    def displaced(self, by: RigidTransform, at_s: float = 0.0) -> Motion:
        """See `Motion.displaced`."""
        first, *others = self.parts
        if not isinstance(first, Parent):
            return super().displaced(by, at_s)
        carrier = first.pose_at(at_s)
        return Product((first, Still(carrier.inv() * by * carrier), *others))

    def _at(self, times_s: Array) -> Kinematics:
        place: RigidTransform | None = None  # of what stands before the first part that moves
        state: Kinematics | None = None
        for part in self.parts:
            if isinstance(part, Still):
                if state is not None:
                    state = state.carrying(part.pose)
                else:
                    place = part.pose if place is None else place * part.pose
            elif state is not None:
                state = state * part._at(times_s)
            else:
                state = part._at(times_s)
                state = state if place is None else state.carried_by(place)
        return at_rest(place, len(times_s)) if state is None else state


@dataclass(frozen=True, eq=False)
class Parent(Motion):
    """The motion of another object that carries this one, by its name."""

    name: str
    motion: Motion

    @property
    def span_s(self) -> tuple[float, float]:
        """The parent's."""
        return self.motion.span_s

    @property
    def moves(self) -> bool:
        """Whether the parent does."""
        return self.motion.moves

    @property
    def repeats_after_s(self) -> float | None:
        """The parent's."""
        return self.motion.repeats_after_s

    @property
    def sample_s(self) -> Array:
        """The parent's."""
        return self.motion.sample_s

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """The parent's."""
        return self.motion.breaks_s(start_s, end_s)

    def with_parent(self, name: str, motion: Motion) -> "Parent":
        """The same with another motion if it is the parent of that name."""
        given = motion if name == self.name else self.motion.with_parent(name, motion)
        return replace(self, motion=given)

    def _at(self, times_s: Array) -> Kinematics:
        # All that it carries asks for the same times. The tuple is replaced as a whole: threads may
        # share a scene.
        held: tuple[tuple[bytes, Kinematics], ...] = self.__dict__.get("_held", ())
        key = times_s.tobytes()
        for known, state in held:
            if known == key:
                return state
        state = self.motion._at(times_s)
        if len(times_s) <= _MOST_HELD:
            self.__dict__["_held"] = ((key, state), *held[: _STATES_HELD - 1])
        return state


@dataclass(frozen=True, eq=False)
class Later(Motion):
    """A motion with its time counted from ``by_s`` on."""

    motion: Motion
    by_s: float

    @property
    def span_s(self) -> tuple[float, float]:
        """That of the motion, on the new clock."""
        first, last = self.motion.span_s
        return first - self.by_s, last - self.by_s

    @property
    def repeats_after_s(self) -> float | None:
        """The motion's."""
        return self.motion.repeats_after_s

    @property
    def sample_s(self) -> Array:
        """Those of the motion, on the new clock."""
        return self.motion.sample_s - self.by_s

    def later(self, by_s: float) -> Motion:
        """From both times on."""
        return self.motion.later(self.by_s + by_s)

    def displaced(self, by: RigidTransform, at_s: float = 0.0) -> Motion:
        """See `Motion.displaced`."""
        return replace(self, motion=self.motion.displaced(by, at_s + self.by_s))

    def breaks_s(self, start_s: float, end_s: float) -> Array:
        """Those of the motion, on the new clock."""
        inner = self.motion.breaks_s(start_s + self.by_s, end_s + self.by_s)[1:-1] - self.by_s
        return np.concatenate([[start_s], inner, [end_s]])

    def with_parent(self, name: str, motion: Motion) -> Motion:
        """The parent's time is this one's."""
        return replace(self, motion=self.motion.with_parent(name, motion.later(-self.by_s)))

    def _at(self, times_s: Array) -> Kinematics:
        first, last = self.motion.span_s
        # Counted from elsewhere, the ends are off by rounding.
        return self.motion._at(np.clip(times_s + self.by_s, first, last))
