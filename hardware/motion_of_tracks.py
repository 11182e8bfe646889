"""How a camera's image moves by what the rig and a radar's tracks tell: proposals, which the
camera's own measurements must support (`hardware.reconstruction.motion.sightings`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import counted
from hardware.radar.tracking import TargetTrack
from hardware.reconstruction.motion.approach import PlaneMotion
from hardware.reconstruction.motion.model import Motion
from hardware.reconstruction.motion.sightings import (
    MOST_OBJECTS,
    Sighting,
    SupportedMotion,
    motion_by_sightings,
)
from hardware.reconstruction.motion.timing import middle_ns
from hardware.recording.mounting import Mounting
from hardware.recording.reading import Received
from hardware.records import QuaternionPose, SpiRecord
from hardware.rig_poses import KEPT_NS, RigPoses, RigState
from hardware.words_of_motion import Proposal, told

Array = NDArray[np.float64]

#: Tracks of one object: places apart by this at most, velocities by so many standard errors.
_APART_M, _ALIKE, _LEAST_ERROR_M_PER_S = 3.5, 2.0, 0.3
#: First box of an object: above and below the camera, and beside its tracks, m.
_ABOVE_M, _BELOW_M, _BESIDE_M = 0.6, 1.2, 0.4
#: Distances at which a background is looked for, m, and the least that an object may come to.
_BACKGROUNDS_M, _NEAREST_M = (5.0, 7.0, 10.0, 14.0, 20.0, 30.0), 0.5
#: Distances of backgrounds closer together than this share are one.
_APART_SHARE = 0.1
#: Tracks whose velocity or place is less sure than this say nothing.
_MOST_ERROR_M, _MOST_ERROR_M_PER_S = 1.0, 2.0
#: What an object moves by in half a frame, at least, cells.
_LEAST_CELLS = 0.25


@dataclass(frozen=True, eq=False)
class _View:
    """A camera at the middle of a frame: pose in the world, velocity (3,) and turn rate (3,) in its
    own frame, and how long the frame lasts before and after, s.
    """

    pose: QuaternionPose
    velocity_m_per_s: Array
    turn_rad_per_s: Array
    half_s: float


@dataclass
class MotionOfTracks:
    """Gathers poses of the rig and tracks of radars; then the motion within a camera's frame.

    Parameters
    ----------
    mounting
        Of the camera and the radars on the rig.
    """

    mounting: Mounting
    _poses: RigPoses = field(default_factory=RigPoses)
    _tracks: dict[str, list[tuple[int, tuple[TargetTrack, ...]]]] = field(default_factory=dict)

    def burst(
        self, sensor: str, stamp_ns: int, pose: QuaternionPose, tracks: Sequence[TargetTrack]
    ) -> None:
        """Take in a radar's burst: antenna's pose and confirmed tracks, at a time of the host."""
        mounted = self.mounting.pose(sensor)
        turn = pose.rotation * mounted.rotation.inv()
        place = pose.position_m - turn.apply(mounted.position_m)
        self._poses.add(sensor, stamp_ns, QuaternionPose.of(place, turn))
        history = self._tracks.setdefault(sensor, [])
        history.append((stamp_ns, tuple(tracks)))
        history[:] = [one for one in history if abs(stamp_ns - one[0]) < KEPT_NS]

    def supported(self, received: Received, sensor: str) -> tuple[SupportedMotion, str]:
        """The motion within a camera's frame that its measurements support, and what it is of.

        Raises InputError where the camera's mounting or field is unknown.
        """
        record = received.record
        assert isinstance(record, SpiRecord)
        mounted, angles = self.mounting.pose(sensor), self.mounting.field_rad(sensor)
        begin, middle, end = _times_ns(received, record)
        self._poses.add(sensor, begin, record.pose)
        rig = self._poses.within(begin, middle, end)
        view = _view(rig, mounted, 5e-10 * (end - begin))
        tracks, untold = self._tracks_at(begin, middle, end)
        shape = record.patterns.rows, record.patterns.columns
        sure = [one for one in tracks if _is_sure(one)]
        objects = _sightings([one for one in sure if not _stands(one)], view, angles, shape)
        standing = [one for one in sure if _stands(one)]
        backgrounds = _backgrounds(standing, view, angles) if rig.moves else ()
        found = motion_by_sightings(record, backgrounds, objects)
        proposal = Proposal(rig, len(tracks), min(len(objects), MOST_OBJECTS), untold)
        return found, told(found, proposal, view.velocity_m_per_s)

    def _tracks_at(self, begin: int, middle: int, end: int) -> tuple[list[TargetTrack], str]:
        """Tracks with a place as they are at the middle of the frame; why there are none."""
        found: list[TargetTrack] = []
        seen, placed = 0, 0
        for history in self._tracks.values():
            here = [one for one in history if begin <= one[0] <= end]
            if not here:
                continue
            stamp_ns, tracks = min(here, key=lambda one: -one[0])
            seen += len(tracks)
            for track in tracks:
                if track.estimate.has_position:
                    placed += 1
                    found.append(_back(track, 1e-9 * (middle - stamp_ns)))
        if not any(begin <= one[0] <= end for each in self._tracks.values() for one in each):
            return [], "no burst of a radar in the frame's time"
        if seen and not placed:
            alone = "has an azimuth: one antenna tells distances alone"
            return [], f"of {counted(seen, 'track')} none {alone}"
        return found, "" if seen else "no tracks in the frame's time"


def _view(rig: RigState, mounted: QuaternionPose, half_s: float) -> _View:
    """Of a camera that is mounted on the rig like this."""
    to_camera = mounted.rotation.inv()
    moving = rig.velocity_m_per_s + np.cross(rig.turn_rad_per_s, mounted.position_m)
    pose = QuaternionPose.of(
        rig.pose.position_m + rig.pose.rotation.apply(mounted.position_m),
        rig.pose.rotation * mounted.rotation,
    )
    return _View(pose, to_camera.apply(moving), to_camera.apply(rig.turn_rad_per_s), half_s)


def _times_ns(received: Received, record: SpiRecord) -> tuple[int, int, int]:
    """Beginning, middle and end of a frame on the host's clock."""
    first, last = int(record.device_time_ns[0]), int(record.device_time_ns[-1])
    device = first, middle_ns(record), last + round(1e9 * record.integration_time_s)
    if received.clock is None:  # it came when it was complete
        return tuple(received.host_ns + one - device[2] for one in device)  # type: ignore[return-value]
    return tuple(received.clock.host_ns(one) for one in device)  # type: ignore[return-value]


def _back(track: TargetTrack, elapsed_s: float) -> TargetTrack:
    """A track at another time, at constant velocity."""
    step = np.kron([[1.0, elapsed_s], [0.0, 1.0]], np.eye(2))
    return replace(track, state=step @ track.state, covariance=step @ track.covariance @ step.T)


def _groups(tracks: Sequence[TargetTrack]) -> list[list[TargetTrack]]:
    """Tracks near the surest one of each group that move as it does."""
    groups: list[list[TargetTrack]] = []
    for track in sorted(tracks, key=lambda one: float(np.trace(one.covariance[2:, 2:]))):
        for group in groups:
            if _alike(track, group[0]):
                group.append(track)
                break
        else:
            groups.append([track])
    return groups


def _alike(one: TargetTrack, other: TargetTrack) -> bool:
    apart = one.state - other.state
    error = np.sqrt(np.diag(one.covariance + other.covariance)[2:] + _LEAST_ERROR_M_PER_S**2)
    return bool(np.hypot(*apart[:2]) < _APART_M and (np.abs(apart[2:]) < _ALIKE * error).all())


def _is_sure(track: TargetTrack) -> bool:
    errors = np.sqrt(np.diag(track.covariance))
    return bool(errors[:2].max() < _MOST_ERROR_M and errors[2:].max() < _MOST_ERROR_M_PER_S)


def _stands(track: TargetTrack) -> bool:
    """Whether its velocity over the ground is none, within its errors: it is of the background,
    and moves in the image as the rig's poses tell, better than the track does.
    """
    error = np.sqrt(np.diag(track.covariance)[2:] + _LEAST_ERROR_M_PER_S**2)
    return bool((np.abs(track.state[2:]) < _ALIKE * error).all())


def _sightings(
    tracks: Sequence[TargetTrack],
    view: _View,
    field_rad: tuple[float, float],
    shape: tuple[int, int],
) -> tuple[Sighting, ...]:
    """Groups of tracks as boxes in the image, the nearest first."""
    found = [_sighting(group, view, field_rad, shape) for group in _groups(tracks)]
    seen = [one for one in found if one is not None]
    return tuple(sorted(seen, key=lambda one: one.motion.depth_m))


def _sighting(
    group: Sequence[TargetTrack],
    view: _View,
    field_rad: tuple[float, float],
    shape: tuple[int, int],
) -> Sighting | None:
    """None for what is not ahead all the time, not in the image at the middle of the frame, or as
    good as at rest.
    """
    back = view.pose.rotation.inv()
    states = np.array([one.state for one in group])
    level = np.zeros(len(group))
    places = back.apply(np.column_stack([states[:, :2], level + view.pose.z_m]) - view.pose[:3])
    weights = np.array([1 / np.trace(one.covariance[2:, 2:]) for one in group])
    mean = np.average(states[:, 2:], axis=0, weights=weights)
    velocity = back.apply([*mean, 0.0]) - view.velocity_m_per_s
    depth = float(places[:, 0].min())
    if depth - abs(velocity[0]) * view.half_s < _NEAREST_M:
        return None
    scale = np.array(shape) / 2 / np.tan(np.array(field_rad) / 2) / depth
    middle = (np.array(shape) - 1) / 2
    left, right = places[:, 1].max() + _BESIDE_M, places[:, 1].min() - _BESIDE_M
    edges = (
        float(middle[0] - scale[0] * _ABOVE_M),
        float(middle[1] - scale[1] * left),
        float(middle[0] + scale[0] * _BELOW_M),
        float(middle[1] - scale[1] * right),
    )
    if edges[3] < -0.5 or edges[1] > shape[1] - 0.5:
        return None
    if float(np.abs(velocity).max()) * view.half_s * scale.max() < _LEAST_CELLS:
        return None
    ahead, across, up = velocity.tolist()
    plane = PlaneMotion(depth, (ahead, across, up), field_rad, _three(view.turn_rad_per_s))
    return Sighting(edges, plane, float(1 / np.sqrt(weights.sum())))


def _backgrounds(
    standing: Sequence[TargetTrack], view: _View, field_rad: tuple[float, float]
) -> tuple[Motion, ...]:
    """What stands still, at some distance, and at those of the tracks that do."""
    velocity = _three(-view.velocity_m_per_s)
    nearest = abs(velocity[0]) * view.half_s + _NEAREST_M
    turn = _three(view.turn_rad_per_s)
    return tuple(
        PlaneMotion(depth, velocity, field_rad, turn)
        for depth in _distances(standing, view)
        if depth > nearest
    )


def _distances(standing: Sequence[TargetTrack], view: _View) -> list[float]:
    """Along the boresight, ascending, a share of each apart."""
    back = view.pose.rotation.inv()
    places = [[*one.state[:2], view.pose.z_m] for one in standing]
    told = back.apply(np.array(places).reshape(-1, 3) - view.pose[:3])[:, 0].tolist()
    found: list[float] = []
    for depth in sorted([*_BACKGROUNDS_M, *(one for one in told if one < _BACKGROUNDS_M[-1])]):
        if not found or depth > (1 + _APART_SHARE) * found[-1]:
            found.append(depth)
    return found


def _three(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z
