"""``[objects.NAME.motion]`` and ``[rig.motion]`` of a ``scene.toml``."""

from pathlib import Path

import numpy as np
from pydantic import StrictBool, model_validator
from scipy.spatial.transform import Rotation

from twin.files import InputError
from twin.motion import Motion, Outside, Rolling, Swinging, Trajectory, Turning
from twin.scene.pose_files import PoseTable, read_pose_csv, read_pose_log
from twin.toml import Finite, Positive, Strict

Vector = tuple[Finite, Finite, Finite]
#: A gap between two poses is taken for a fault if it is longer than so many of the usual ones.
GAP_STEPS = 10.0


#: Lengths of a direction: their squares are numbers.
_SHORTEST, _LONGEST = 1e-100, 1e100


def _check_direction(name: str, vector: Vector) -> None:
    if not _SHORTEST <= max(map(abs, vector)) <= _LONGEST:
        raise InputError(f"{name} = {vector}: expected a direction")


class TrajectorySettings(Strict):
    """Poses over time, from a file or given here."""

    file: str | None = None
    """CSV file with units in its header (`time_s,x_m,y_m,z_m` and `qw,qx,qy,qz` or
    `yaw_deg,pitch_deg,roll_deg`), or log (MCAP), beside the scene."""
    topic: str = "/tf"
    """Of a log: where the poses stand, as TFMessage, PoseStamped or Odometry."""
    child: str = "rig"
    """Of a log: the frame that they are of."""
    times_s: tuple[Finite, ...] | None = None
    """In place of a file: times of the poses, growing."""
    positions_m: tuple[Vector, ...] | None = None
    """Positions at these times."""
    yaw_deg: tuple[Finite, ...] | None = None
    """Turns about z; without any turn the object keeps that in which it is drawn."""
    pitch_deg: tuple[Finite, ...] | None = None
    """Turns about y, positive nose down."""
    roll_deg: tuple[Finite, ...] | None = None
    """Turns about x."""
    outside: Outside = "error"
    """Before the first and after the last pose: an error, `hold` the pose, `continue` at the
    velocity of the end, or `repeat`, where the last pose has to be the first."""
    start_s: Finite | None = None
    """Time of the first pose; default: as the poses say, of a log 0."""
    longest_gap_s: Positive | None = None
    """Longest time from one pose to the next; default: 10 times the median."""
    as_drawn: StrictBool = False
    """False: the poses are those of the object's own frame, the one of its mesh file. True: of a
    frame that carries the object, which at time 0 is where it is drawn."""

    @model_validator(mode="after")
    def _one_origin(self) -> "TrajectorySettings":
        given = (self.times_s, self.positions_m, self.yaw_deg, self.pitch_deg, self.roll_deg)
        if (self.file is None) == (self.times_s is None or self.positions_m is None):
            raise InputError("needs either `file` or `times_s` and `positions_m`")
        if self.file is not None and any(part is not None for part in given):
            raise InputError("poses stand in `file`: expected no `times_s`, `positions_m`, angles")
        lengths = {len(part) for part in given if part is not None}
        if len(lengths) > 1:
            raise InputError(f"lists of {sorted(lengths)} poses: expected as many of each")
        return self

    def _table(self, place: str, folder: Path) -> tuple[PoseTable, list[str]]:
        if self.file is None:
            return self._given(place), []
        path = folder / self.file
        if path.suffix.lower() == ".csv":
            return read_pose_csv(path)
        if path.suffix.lower() == ".mcap":
            return read_pose_log(path, self.topic, self.child)
        raise InputError(f"{place}.file = {self.file!r}: expected a .csv or .mcap file")

    def _given(self, place: str) -> PoseTable:
        times = np.array(self.times_s, dtype=np.float64)
        count = len(times)
        angles = [self.yaw_deg, self.pitch_deg, self.roll_deg]
        quaternions = None
        if any(part is not None for part in angles) and count:
            columns = [np.zeros(count) if part is None else np.array(part) for part in angles]
            turns = Rotation.from_euler("ZYX", np.stack(columns, axis=1), degrees=True)
            quaternions = turns.as_quat(scalar_first=True)
        first = float(times[0]) if count else 0.0
        return PoseTable(
            first_s=first,
            times_s=times - first,
            positions_m=np.array(self.positions_m, dtype=np.float64).reshape(-1, 3),
            quaternions=quaternions,
            labels=tuple(f"{place}: pose {number}" for number in range(count)),
        )

    def make(self, place: str, folder: Path, turn: Rotation) -> tuple[Trajectory, list[str]]:
        """The trajectory, and warnings of its file. ``turn`` is that of poses that tell none.

        Raises InputError naming file and line.
        """
        table, warnings = self._table(place, folder)
        count = len(table.times_s)
        quaternions = table.quaternions
        if quaternions is None:
            quaternions = np.tile(turn.as_quat(scalar_first=True), (count, 1))
        # A log's stamps count from 1970: its first pose is at time 0 unless the scene says else.
        of_log = self.file is not None and self.file.lower().endswith(".mcap")
        first = (0.0 if of_log else table.first_s) if self.start_s is None else self.start_s
        try:
            found = Trajectory(
                first + table.times_s, table.positions_m, quaternions, self.outside, table.labels
            )
        except InputError as error:
            message = str(error)  # begins with the pose's label, if it is about one
            told = message.removeprefix("trajectory: ")
            raise InputError(message if told == message else f"{place}: {told}") from None
        self._check_gaps(table)
        return found, warnings

    def _check_gaps(self, table: PoseTable) -> None:
        steps = np.diff(table.times_s)
        most = self.longest_gap_s or GAP_STEPS * float(np.median(steps))
        for number in np.flatnonzero(steps > most).tolist():
            usual = "" if self.longest_gap_s else f", {GAP_STEPS:g} usual steps"
            raise InputError(
                f"{table.labels[number + 1]}: {steps[number]:g} s after the pose before: expected "
                f"at most {most:g} s{usual}; longest_gap_s sets it"
            )


class TurningSettings(Strict):
    """Uniform rotation."""

    axis: Vector = (0.0, 0.0, 1.0)
    """Direction of the axis in the scene as drawn; right-handed."""
    centre_m: Vector
    """A point of the axis, in the scene as drawn."""
    rate_deg_per_s: Finite
    """How fast it turns."""

    @model_validator(mode="after")
    def _check(self) -> "TurningSettings":
        _check_direction("axis", self.axis)
        return self

    def make(self) -> Turning:
        """The motion of the drawing."""
        return Turning(self.axis, self.centre_m, float(np.radians(self.rate_deg_per_s)))


class SwingingSettings(Strict):
    """A pendulum; the object is drawn at the angle 0."""

    axis: Vector
    """Direction of the axis in the scene as drawn; right-handed."""
    centre_m: Vector
    """A point of the axis, in the scene as drawn."""
    amplitude_deg: Finite
    """Largest angle from the mean: mean + amplitude sin(2 pi t / period + phase)."""
    period_s: Positive
    """Of one swing to and fro."""
    phase_deg: Finite = 0.0
    """Of the sine at time 0."""
    mean_deg: Finite = 0.0
    """Angle in the middle of the swing; the object is drawn at 0."""

    @model_validator(mode="after")
    def _check(self) -> "SwingingSettings":
        _check_direction("axis", self.axis)
        return self

    def make(self) -> Swinging:
        """The motion of the drawing."""
        amplitude, phase, mean = np.radians([self.amplitude_deg, self.phase_deg, self.mean_deg])
        return Swinging(
            self.axis, self.centre_m, float(amplitude), self.period_s, float(phase), float(mean)
        )


class RollingSettings(Strict):
    """A wheel on its parent, or on the object's own velocity."""

    radius_m: Positive
    """From the axle to the road."""
    centre_m: Vector
    """Middle of the wheel in the scene as drawn."""
    axis: Vector = (0.0, 1.0, 0.0)
    """Direction of the axle in the scene as drawn, to the left of where it rolls."""
    up: Vector = (0.0, 0.0, 1.0)
    """Away from the road, in the scene as drawn."""

    @model_validator(mode="after")
    def _check(self) -> "RollingSettings":
        _check_direction("axis", self.axis)
        _check_direction("up", self.up)
        if not np.cross(self.axis, self.up).any():
            raise InputError(f"axis = {self.axis}, up = {self.up}: expected two directions")
        return self

    def make(self, carrier: Motion) -> Rolling:
        """The motion of the drawing within its carrier."""
        return Rolling(carrier, self.axis, self.centre_m, self.radius_m, self.up)


_KINDS = ("trajectory", "turning", "swinging", "rolling")


class MotionSettings(Strict):
    """How an object moves, within its parent's frame if it has one: one of these."""

    trajectory: TrajectorySettings | None = None
    """Through poses at times."""
    turning: TurningSettings | None = None
    """Uniformly about an axis."""
    swinging: SwingingSettings | None = None
    """To and fro about an axis."""
    rolling: RollingSettings | None = None
    """Like a wheel, by the way that its parent or its own velocity takes it."""

    @model_validator(mode="after")
    def _one_kind(self) -> "MotionSettings":
        given = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            raise InputError(
                f"{' and '.join(given) or 'nothing'} given: expected one of {', '.join(_KINDS)}"
            )
        return self
