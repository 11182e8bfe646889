"""Motion of a camera's image by a rig's poses and a radar's tracks, on frames rendered here ray by
ray, each exposure anew: a wall and a board in front of it, both with a pattern of their own.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hardware import PlaneMotion, reconstruct
from hardware.drivers.clock import ClockModel
from hardware.errors import InputError
from hardware.motion_of_tracks import MotionOfTracks
from hardware.patterns import PatternSet, hadamard_rows
from hardware.radar.tracking import TargetTrack
from hardware.reconstruction.motion.sightings import SupportedMotion
from hardware.recording import Received
from hardware.recording.mounting import RADAR, SPI, Mounting, read_mounting
from hardware.records import QuaternionPose, SpiRecord

N, FIELD = 32, (np.deg2rad(24.0), np.deg2rad(20.0))
FRAME_S, PERIOD_S = 0.8, 0.1
MOUNTING = Mounting(
    {"spi": QuaternionPose(0.0, 0.1, 0.0), "radar": QuaternionPose(0.2, 0.0, -0.3)},
    {"spi": FIELD},
)
ON_TIME = ClockModel(0, 0, 0.0, 0.0)


@dataclass(frozen=True)
class World:
    """A rig that drives along x at 1.2 m height, a wall across its way at 12 m, and a board."""

    rig_m_per_s: float = 0.0
    board_m: tuple[float, float] = (7.0, 0.4)
    board_m_per_s: float = 0.0
    has_board: bool = True

    def light(self, time_s: float) -> np.ndarray:
        """Of each cell (N, N) from 4 x 4 rays, at a time after the frame's middle."""
        part = (np.arange(4 * N) + 0.5) / (4 * N) * 2 - 1
        up, left = np.meshgrid(
            -np.tan(FIELD[0] / 2) * part, -np.tan(FIELD[1] / 2) * part, indexing="ij"
        )
        x, y = self.rig_m_per_s * time_s, 0.1
        found = np.zeros(up.shape)
        boards = [(12.0, 0.0, 0.0, np.inf, 3.0)]
        if self.has_board:
            at = self.board_m[1] + self.board_m_per_s * time_s
            boards.append((self.board_m[0], at, self.board_m[1], 0.6, 5.0))
        for where, at, start, half, waves in boards:
            depth = where - x
            across, high = depth * left + y - at, depth * up
            inside = (np.abs(across) < half) & ((np.abs(high + 0.2) < 0.7) | np.isinf(half))
            texture = 1 + 0.8 * np.sin(waves * (across + start)) * np.cos(1.3 * waves * high + 1)
            texture += 0.5 * ((across * 2).astype(int) % 2) + (0.0 if np.isinf(half) else 1.0)
            lit = texture / (depth**2 * (1 + left**2 + up**2))
            found = np.where(inside, lit, found)
        return 50 * found.reshape(N, 4, N, 4).mean(axis=(1, 3))

    def tracks(self, time_s: float, error: float = 0.1) -> tuple[TargetTrack, ...]:
        """Of the board, as a radar has them."""
        state = np.array(
            [
                self.board_m[0],
                self.board_m[1] + self.board_m_per_s * time_s,
                0.0,
                self.board_m_per_s,
            ]
        )
        return (TargetTrack(1, state, np.diag([1e-4, 1e-3, error**2, error**2]), 5, 0),)


def frame(
    world: World,
    clock: ClockModel = ON_TIME,
    order: str = "interleaved",
    noise: float = 0.02,
) -> SpiRecord:
    """A whole set, whose middle is at 0 of the host's clock, 1e9 s after its reference."""
    patterns = PatternSet(N, N, N * N, order)  # type: ignore[arg-type]
    rows, signs = patterns.exposures
    n = len(rows)
    since = (np.arange(n) - (n - 1) / 2) * FRAME_S / n
    moves = world.rig_m_per_s or world.board_m_per_s
    still = world.light(0.0).ravel()
    light = np.empty(n)
    for k, t in enumerate(since):
        cells = world.light(float(t)).ravel() if moves else still
        light[k] = cells[hadamard_rows(rows[k : k + 1], N * N)[0] * signs[k] > 0].sum()
    light += noise * np.sqrt(N * N / 2) * np.random.default_rng(1).normal(size=n)
    times = [clock.device_ns(round(1e9 * (10 + t - FRAME_S / n / 2))) for t in since]
    return SpiRecord(
        counts=np.rint(1e4 * light + 1e6).astype(np.int32)[:, None],
        device_time_ns=np.array(times),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=FRAME_S / n,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=31,
        device="by hand",
        pose=QuaternionPose(-world.rig_m_per_s * FRAME_S / 2, 0.0, 1.2),
    )


def followed(
    world: World,
    record: SpiRecord,
    tracks: "tuple[TargetTrack, ...] | None" = None,
    clock: ClockModel = ON_TIME,
):
    """What is found of a frame, with bursts at their period around it."""
    motion = MotionOfTracks(MOUNTING)
    for t in np.arange(-0.45, 0.4, PERIOD_S):
        pose = QuaternionPose(world.rig_m_per_s * t + 0.2, 0.0, 0.9)
        motion.burst(
            "/radar",
            round(1e9 * (10 + t)),
            pose,
            world.tracks(float(t)) if tracks is None else tracks,
        )
    return motion.supported(Received("/spi/record", record, round(10.5e9), clock), "/spi")


def decibels(record: SpiRecord, world: World, motion: object = None) -> float:
    found = reconstruct(record, motion=motion).image[0] / 1e4  # type: ignore[arg-type]
    truth = world.light(0.0)
    return float(-10 * np.log10(np.mean((found - truth) ** 2) / np.ptp(truth) ** 2))


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.3)])
def test_a_plane_is_seen_as_its_points_are(turn: tuple[float, float, float]) -> None:
    """Points of a plane, moved and projected one by one."""
    from scipy.spatial.transform import Rotation

    motion, t = PlaneMotion(8.0, (-3.0, 1.0, 0.4), FIELD, turn), 0.4
    first = np.array([[8.0, 0.5, -0.6], [8.0, -1.0, 0.3]])
    then = first + t * np.array([-3.0, 1.0, 0.4])
    scale = N / 2 / np.tan(np.array(FIELD) / 2)

    def seen(points: np.ndarray) -> np.ndarray:
        return (N - 1) / 2 - scale * points[:, [2, 1]] / points[:, :1]

    places = seen(Rotation.from_rotvec(t * np.array(turn)).inv().apply(then))
    np.testing.assert_allclose(motion.sources(t, places, (N, N)), seen(first), atol=1e-9)
    expected = (first**2).sum(axis=1) / (then**2).sum(axis=1)
    np.testing.assert_allclose(motion.brightness(t, places, (N, N)), expected, rtol=1e-12)


def test_a_plane_that_is_reached_is_told() -> None:
    with pytest.raises(InputError, match="has reached"):
        PlaneMotion(2.0, (-5.0, 0.0, 0.0), FIELD).sources(0.4, np.zeros((1, 2)), (N, N))
    with pytest.raises(InputError, match="depth_m"):
        PlaneMotion(0.0, (-5.0, 0.0, 0.0), FIELD)


#: At least, of the loss in decibels, at a noise far below the edges that no box follows.
SHARE = {"a board crosses": 0.35, "the rig drives": 0.5, "both": 0.25}
MOVING = {
    "a board crosses": World(board_m_per_s=1.5),
    "the rig drives": World(rig_m_per_s=4.0, has_board=False),
    "both": World(rig_m_per_s=4.0, board_m_per_s=1.5),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[pytest.mark.slow] * (one != "the rig drives")) for one in MOVING],
)
def test_a_share_of_the_loss_is_regained(name: str) -> None:
    world = MOVING[name]
    record, still = frame(world), frame(replace(world, rig_m_per_s=0.0, board_m_per_s=0.0))
    found, told = followed(world, record)
    rest, static = decibels(still, world), decibels(record, world)
    compensated = decibels(record, world, found.motion)
    print(f"{name}: {static:.2f} -> {compensated:.2f} of {rest:.2f} dB, {told}")
    assert compensated - static > SHARE[name] * (rest - static)


def _proposed(
    monkeypatch: pytest.MonkeyPatch, world: World, tracks: tuple[TargetTrack, ...]
) -> tuple[list[float], list[float]]:
    """Distances of the backgrounds and of the objects that are proposed of a frame."""
    given: list[list[float]] = []

    def unsearched(_: SpiRecord, backgrounds: tuple, sightings: tuple) -> SupportedMotion:
        given.append([one.depth_m for one in backgrounds])
        given.append([one.motion.depth_m for one in sightings])
        return SupportedMotion(None, 0.0, 0)

    monkeypatch.setattr("hardware.motion_of_tracks.motion_by_sightings", unsearched)
    followed(world, frame(world), tracks)
    return given[0], given[1]


def test_what_stands_is_the_background_at_its_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two tracks 8.4 and 6 m away, at the frame's middle, the far one stands within its errors.

    The place of the near one is told 0.05 s before the middle or later: it moves by some cm.
    """
    world = World(rig_m_per_s=4.0, has_board=False)
    tracks = _false((8.4, 0.3, 0.1, -0.2), (6.0, 0.0, 0.0, 1.5))
    distances, objects = _proposed(monkeypatch, world, tracks)
    assert min(abs(one - 8.4) for one in distances) < 0.3
    assert objects == [pytest.approx(6.0, abs=0.3)]
    assert distances == sorted(distances)


def test_what_moves_is_no_background(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(rig_m_per_s=4.0, has_board=False)
    distances, objects = _proposed(monkeypatch, world, _false((8.4, 0.3, 0.0, 1.5)))
    assert distances == [5.0, 7.0, 10.0, 14.0, 20.0, 30.0]
    assert len(objects) == 1


def _false(*states: tuple[float, ...], error: float = 0.1) -> tuple[TargetTrack, ...]:
    covariance = np.diag([1e-4, 1e-3, error**2, error**2])
    return tuple(TargetTrack(k, np.array(s), covariance, 5, 0) for k, s in enumerate(states))


FALSE = {
    "a ghost that crosses": _false((7.0, 0.4, 0.0, 1.5)),
    "two over one cell": _false((7.0, 0.4, 0.0, 1.5), (7.1, 0.4, 0.0, -1.5)),
    "one that comes at us": _false((7.0, 0.4, -5.0, 0.0)),
    "unsure": _false((7.0, 0.4, 0.0, 1.5), error=1.9),
    "everywhere": _false(*((r, y, 0.0, v) for r, y, v in np.random.default_rng(3).normal(
        [8, 0, 0], [2, 1, 2], (4, 3)))),
    "without azimuth": (TargetTrack(1, np.array([7.0, -1.0]), np.eye(2), 5, 0),),
    "none": (),
}  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(one, marks=[pytest.mark.slow] * (one in ("everywhere", "two over one cell")))
        for one in FALSE
    ],
)
def test_what_rests_stays_as_it_is(name: str) -> None:
    """Whatever the radar says."""
    found, told = followed(World(), frame(World()), FALSE[name])
    assert found.motion is None, told
    assert told.startswith("motion: not compensated: ")


def test_sensors_that_know_no_pose_are_at_rest() -> None:
    """Records of devices hold the pose of the origin, of both: the radar's place on the rig must
    not become a motion of the rig, which hides the board's.
    """
    record = replace(frame(World()), pose=QuaternionPose())
    motion = MotionOfTracks(MOUNTING)
    for t in np.arange(-0.45, 0.4, PERIOD_S):
        motion.burst("/radar", round(1e9 * (10 + t)), QuaternionPose(), World().tracks(float(t)))
    found, told = motion.supported(Received("/spi/record", record, round(10.5e9), ON_TIME), "/spi")
    assert not found.tried
    assert "the rig is at rest, and of 1 track none moves in the image" in told


def test_patterns_from_coarse_to_fine_tell_nothing() -> None:
    world = World(board_m_per_s=1.5)
    found, told = followed(world, frame(world, order="sequency"))
    assert found.motion is None
    assert told == "motion: not compensated: this record can hardly show any"
    assert "from coarse to fine" in found.warnings[0]


@pytest.mark.slow
def test_clocks_apart_change_nothing() -> None:
    """The camera's clock is 3 s ahead and gains 100 ppm: on the host's clock all is as before."""
    world, clock = World(board_m_per_s=1.5), ClockModel(0, 3 * 10**9, 1e-4, 0.0)
    record = frame(world, clock)
    found, _ = followed(world, record, clock=clock)
    plain, _ = followed(world, frame(world))
    assert found.motion is not None
    assert found.evidence == pytest.approx(plain.evidence, abs=0.5)


def test_no_burst_within_the_frame_is_told() -> None:
    world = World()
    motion = MotionOfTracks(MOUNTING)
    motion.burst("/radar", 2 * 10**9, QuaternionPose(), world.tracks(0.0))
    received = Received("/spi/record", frame(world), round(10.5e9), ON_TIME)
    found, told = motion.supported(received, "/spi")
    assert found.motion is None
    assert "no burst of a radar in the frame's time" in told


@pytest.mark.parametrize(
    ("mounting", "expected"),
    [
        (Mounting({}, {"spi": FIELD}), "pose on the rig of '/spi' is unknown .known: none"),
        (Mounting(MOUNTING.poses), "field of '/spi' is unknown .known: none"),
        (Mounting(MOUNTING.poses, {"cam": FIELD}), "unknown .known: cam.: expected it by the name"),
    ],
)
def test_what_is_not_calibrated_is_told(mounting: Mounting, expected: str) -> None:
    received = Received("/spi/record", frame(World()), round(10.5e9), ON_TIME)
    with pytest.raises(InputError, match=expected):
        MotionOfTracks(mounting).supported(received, "/spi")


def test_mounting_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("spi = [0, 0.1, 0, 1, 0, 0, 0]\n[field_deg]\nspi = [24, 20]\n")
    found = read_mounting(path)
    assert found.poses == {"spi": MOUNTING.poses["spi"]}
    assert found.fields_rad["spi"] == pytest.approx(FIELD)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("spi = [0, 0, 0]", "rig.toml: spi: [0, 0, 0], expected 7 finite numbers: x, y, z, qw"),
        ('spi = "front"', "rig.toml: spi: 'front', expected 7 finite numbers"),
        ('spi = ["0", 0, 0, 1, 0, 0, 0]', "expected 7 finite numbers"),
        ("spi = [0, 0, 0, true, 0, 0, 0]", "expected 7 finite numbers"),
        ("spi = [nan, 0, 0, 1, 0, 0, 0]", "rig.toml: spi: [nan, 0"),
        ("[field_dg]\nspi = [20, 20]", "rig.toml: field_dg: {'spi': [20, 20]}, expected 7 finite"),
        ("[field_deg]\nspi = [20]", "field_deg: spi: [20], expected 2 finite numbers: down, along"),
        ("[field_deg]\nspi = [20, 20, 20]", "field_deg: spi: [20, 20, 20], expected 2 finite"),
        ("field_deg = [20, 20]", "field_deg: [20, 20], expected a table of NAME = [down, along]"),
        ("spi = [0, 0, 0, 0, 0, 0, 0]", "quaternion w x y z that is not 0"),
        ("spi = 3", "rig.toml: spi: "),
        ("[field_deg]\nspi = [20, 200]", "expected two angles between 0 and 180"),
        ("[field_deg]\nspi = 20", "rig.toml: field_deg: "),
        ("field_deg = 20", "rig.toml: field_deg: "),
    ],
)
def test_wrong_mountings_are_told(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        read_mounting(path)
    assert expected in str(raised.value)


@pytest.mark.parametrize("further", ["/source2", "/source3/front"])
def test_a_further_source_is_known_by_its_own_name_or_by_its_sensors(further: str) -> None:
    """As `ugv capture CAMERA RADAR` names topics; the file names the sensors."""
    topics = {"/spi/record": SPI, f"{further}/radar/record": RADAR}
    found = Mounting(MOUNTING.poses, MOUNTING.fields_rad, topics)
    found.check()
    assert found.pose(f"{further}/radar") == MOUNTING.poses["radar"]
    own = Mounting({**MOUNTING.poses, further.split("/")[1]: QuaternionPose(9.0)})
    assert own.pose(f"{further}/radar") == QuaternionPose(9.0)


def test_two_radars_are_not_taken_for_one() -> None:
    topics = {"/radar/record": RADAR, "/source2/radar/record": RADAR}
    found = Mounting(MOUNTING.poses, MOUNTING.fields_rad, topics)
    with pytest.raises(InputError, match=r"of '/source2/radar' is unknown \(known: radar, spi"):
        found.check()
