"""`twin drive`: one clock for both sensors, truth beside them, the same bytes after any kill."""

import hashlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hardware.errors import InputError
from hardware.files import hold
from hardware.processing import process
from hardware.radar.process import frames
from hardware.recording import Log, read_messages, read_records, recover
from hardware.records import RadarRecord, SpiRecord
from tests.twin.driven import CAMERA, FAST, RADAR, driven_scene, plan
from twin.camera.mounting import devices
from twin.camera.truth import render_truth
from twin.cli import app
from twin.drive import DeviceClock, Drive
from twin.drive import drive as drive_by
from twin.drive.log import MARKS, _Output
from twin.drive.sensors import CameraFrames
from twin.drive.truth import Mark, ObjectStates
from twin.drive.truth_samples import TruthSamples
from twin.fidelity import Accuracy, Tolerance, knobs_of
from twin.radar import load_radar
from twin.scene import Scene, Target, load_scene
from twin.scene.boxes import boxes_of
from twin.scene.mitsuba import mitsuba_scene

#: In this process: others take seconds to start.
drive = partial(drive_by, workers=0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a whole drive."""
    path = tmp_path_factory.mktemp("drive") / "whole.mcap"
    done = drive(plan(), path)
    assert done.complete
    assert (done.events, done.resumed) == (3 + 3 + 5, 0)
    return path


@pytest.mark.parametrize("fidelity", ["draft", Tolerance(distance_m=0.02), 0.5, None])
def test_an_accuracy_is_the_knobs_that_it_asks_for(fidelity: Accuracy | None) -> None:
    """Those of `twin.run`, a distance by the radar's bandwidth; they are in the log and its digest
    as if they had been given.
    """
    asked = plan(fidelity=fidelity)
    knobs = knobs_of(fidelity, RADAR.total_bandwidth_hz)
    assert asked.knobs == knobs
    assert asked.digest == plan(fidelity=knobs).digest != plan().digest


def test_an_accuracy_that_cannot_be_kept_is_refused_with_the_plan() -> None:
    for wrong, told in (
        ("fine", "fidelity: 'fine' is none of"),
        (Tolerance(distance_m=1e-6), "cannot be promised"),
        (Tolerance(psnr_db=0.1), "fidelity_for_scores"),
        ([1], r"tolerance: \[1\] of the noise: expected 0.0001 to 10"),
    ):
        with pytest.raises(InputError, match=told):
            plan(fidelity=wrong)


@pytest.mark.thorough
def test_a_log_cut_at_any_byte_is_gone_on_with_to_the_same_bytes(
    whole: Path, tmp_path: Path
) -> None:
    """What a kill leaves is the first bytes of the log: some of its header, a chunk, an index, the
    summary, or all but the end.
    """
    data = whole.read_bytes()
    rng = np.random.default_rng(0)
    cuts = [0, 5, 40, 200, *rng.integers(300, len(data), 4).tolist(), len(data) - 3]
    path = tmp_path / "cut.mcap"
    for size in cuts:
        path.write_bytes(data[:size])
        done = drive(plan(), path)
        assert done.complete
        assert path.read_bytes() == data, size
    assert done.resumed == done.events == 11  # only the footer was missing
    before = path.stat().st_mtime_ns
    again = drive(plan(), path)
    assert again.complete
    assert (again.events, again.computed_s, path.stat().st_mtime_ns) == (11, 0.0, before)


def test_bytes_damaged_behind_the_last_whole_event_do_not_matter(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Power loss may leave pages of zeros at the end of a file."""
    data = whole.read_bytes()
    path = tmp_path / "zeros.mcap"
    path.write_bytes(data[: len(data) // 2] + bytes(5000))
    assert drive(plan(), path).complete
    assert path.read_bytes() == data
    path.write_bytes(data[:-200] + bytes([data[-200] ^ 4]) + data[-199:])  # in the index
    assert drive(plan(), path).complete
    assert path.read_bytes() == data
    assert list(tmp_path.iterdir()) == [path]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("where", "before"), [(0.03, 0), (0.5, 6)])
def test_whole_events_behind_damage_stay_in_a_copy(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], where: float, before: int
) -> None:
    """They had been cut off without a word, and computed anew."""
    data, path = whole.read_bytes(), tmp_path / "run.mcap"
    at = round(where * len(data))
    damaged = data[:at] + bytes(200) + data[at + 200 :]
    path.write_bytes(damaged)
    done = drive(plan(), path)
    assert (done.complete, done.resumed) == (True, before)
    assert path.read_bytes() == data
    copy = tmp_path / "run-damaged.mcap"
    assert copy.read_bytes() == damaged
    (line,) = capsys.readouterr().err.splitlines()
    assert f"run.mcap: damaged behind {before} whole events, at byte " in line
    assert f"{10 - before} whole events of it are in {copy} still" in line


@pytest.mark.parametrize("where", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("damage", ["cut", "zeros"])
def test_a_recovered_log_is_gone_on_with_to_the_same_bytes(
    whole: Path, tmp_path: Path, where: float, damage: str
) -> None:
    """It has its footer, but not all events: those before the first loss count, what `recover`
    kept behind it is computed anew.
    """
    data, path = whole.read_bytes(), tmp_path / "recovered.mcap"
    at = round(where * len(data))
    path.write_bytes(data[:at])
    whole_before = sum(one.topic == MARKS for one in read_messages(path))
    path.write_bytes(data[:at] + (bytes(200) + data[at + 200 :]) * (damage == "zeros"))
    assert recover(path).ending.finished == (damage == "zeros")
    assert drive_log_about(path) == drive_log_about(whole)
    done = drive(plan(), path)
    assert (done.complete, done.resumed) == (True, whole_before)
    assert path.read_bytes() == data


def test_a_full_disk_names_the_log() -> None:
    """What is in memory goes to the system at the end: the error of it names no file by itself."""
    output = _Output(Path("/dev/full"))
    output.write(b"x")
    with pytest.raises(OSError, match="No space left") as caught:
        output.close()
    assert caught.value.filename == "/dev/full"


def test_a_drive_that_is_asked_to_end_is_gone_on_with(whole: Path, tmp_path: Path) -> None:
    over, path = threading.Event(), tmp_path / "stopped.mcap"

    def tell(reference_s: float) -> None:
        if reference_s > 0.015:
            over.set()

    done = drive(plan(), path, over=over, tell=tell)
    assert not done.complete
    assert 0 < done.events < 11
    assert len(list(read_records(path))) >= 1  # as any unfinished log
    again = drive(plan(), path)
    assert again.complete
    assert again.resumed == done.events
    assert path.read_bytes() == whole.read_bytes()


def test_what_a_time_allows_is_measured_once_in_a_drive(
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """`--within` would choose otherwise each time; the log has the knobs it was begun with."""
    import twin.trade
    from twin.trade.time_limit import TimedFidelity, TimedShare

    chosen = iter([4, 8, 16])

    def within(*_: object, fixed: dict[str, object], **__: object) -> TimedFidelity:
        knobs = FAST.with_(samples=next(chosen), motion_tolerance=None).with_(fixed)
        return TimedFidelity(knobs, TimedShare(0.2, 0.1), None)

    monkeypatch.setattr(twin.trade, "fidelity_within", within)
    small = tmp_path / "small.toml"
    small.write_text(
        'base = "workable"\n[emitter]\nrows = { value = 8, assumed = "small" }\n'
        'columns = { value = 8, assumed = "small" }\n'
        '[acquisition]\nn_patterns = { value = 64, assumed = "small" }\n'
    )
    path, uncut = tmp_path / "cut.mcap", tmp_path / "uncut.mcap"
    options = ["--radar", "none", "--system", str(small), "--duration", "40 ms", "--within", "1 s"]

    def run(out: Path, *more: str) -> str:
        app(["drive", "yard", "--out", str(out), *options, *more], standalone_mode=False)
        return capsys.readouterr().out

    run(uncut)
    path.write_bytes(uncut.read_bytes()[: uncut.stat().st_size // 2])
    assert "gone on with" in run(path)
    assert path.read_bytes() == uncut.read_bytes()
    with pytest.raises(InputError, match=r"log of another drive \(fidelity.motion_tolerance: "):
        run(path, "--motion-tolerance", "0.3")
    with pytest.raises(InputError, match=r"another drive \(.*fidelity.samples: 4, not 64"):
        drive(plan(fidelity=FAST.with_(samples=64)), whole)


def test_other_files_are_refused_and_left_as_they_are(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(whole.read_bytes()[:3000])
    for changes, told in (({"seed": 4}, "seed: 3, not 4"), ({"truth_period_s": 0.02}, "content")):
        with pytest.raises(InputError, match=f"log of another drive.*{told}"):
            drive(plan(**changes), path)
    path.write_bytes(b"something else")
    with pytest.raises(InputError, match="no log of a drive"):
        drive(plan(), path)
    assert path.read_bytes() == b"something else"
    path.unlink()
    with Log(path) as log:
        log.flush()
    with pytest.raises(InputError, match="no log of a drive"):
        drive(plan(), path)
    path.write_bytes(whole.read_bytes()[:3000])
    with path.open("rb") as file:
        hold(file)
        with pytest.raises(InputError, match="still being written"):
            drive(plan(), path)


def test_a_log_without_events_gives_way_to_another_drive(whole: Path, tmp_path: Path) -> None:
    """As a killed command leaves it that had still to start its processes."""
    first = next(read_messages(whole)).chunk
    assert first is not None
    path = tmp_path / "run.mcap"
    path.write_bytes(whole.read_bytes()[: first - 9])  # without the head of its first chunk
    assert drive(plan(seed=4), path).resumed == 0
    assert drive_log_about(path)["seed"] == "4"


def test_a_drive_that_fails_before_its_first_event_leaves_no_log(tmp_path: Path) -> None:
    """The log of a mistyped command stood in the way of the right one."""
    path = tmp_path / "run.mcap"
    with pytest.raises(InputError, match="can't be reached"):
        drive_by(plan(), path, scheduler="nonsense")
    assert not path.exists()


def test_what_is_no_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Errors of the system for these do not name the file."""
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(tmp_path / "nowhere")
    for path in (pipe, link, tmp_path, Path("/dev/null")):
        with pytest.raises(InputError, match=f"^{path}: .* expected a new"):
            drive(plan(), path)
    with pytest.raises(InputError, match=r"^--out: is empty"):
        app(["drive", "yard", "--out", ""], standalone_mode=False)


def test_bytes_that_this_software_would_not_write_are_told(whole: Path, tmp_path: Path) -> None:
    """As of another version of a library: the digest is right, a chunk is packed differently."""
    from mcap.writer import CompressionType, Writer

    path = tmp_path / "packed.mcap"
    with path.open("wb") as file:
        writer = Writer(file, 1 << 20, CompressionType.NONE)
        writer.start(profile="ros2", library="ugv")
        log = drive_log_about(whole)
        writer.add_metadata("about", log)
        ids: dict[str, int] = {}
        for logged in read_messages(whole):
            if logged.topic not in ids:
                schema = writer.register_schema(logged.schema.name, "ros2msg", logged.schema.data)
                ids[logged.topic] = writer.register_channel(logged.topic, "cdr", schema)
            message = logged.message
            writer.add_message(
                ids[logged.topic], message.log_time, message.data, message.publish_time, 0
            )
        writer.flush()
    before = path.read_bytes()
    with pytest.raises(InputError, match="written anew, it differs from byte"):
        drive(plan(), path)
    assert path.read_bytes() == before


def drive_log_about(path: Path) -> dict[str, str]:
    from twin.drive.log import _about

    found = _about(path)
    assert found is not None
    return found


def test_device_clocks_keep_nanoseconds_over_an_hour_of_100_ppm() -> None:
    """Against exact fractions: the reference at which a device has counted n ns, to half a ns."""
    clock = DeviceClock(1.5, 100.0)
    rate = 1 + Fraction(100, 10**6)
    for elapsed in (0, 1, 819_200_000, 3_600 * 10**9, 3_600 * 10**9 + 7):
        assert abs(clock.reference_ns(elapsed) - elapsed / rate) <= Fraction(51, 100)
    hour = 3_600 * 10**9
    assert hour - clock.reference_ns(hour) == pytest.approx(0.36e9, rel=2e-4)
    assert clock.model.device_ns(hour) == hour + 1_500_000_000 + 360_000_000
    steps = np.diff([clock.reference_ns(k * 12_800_000) for k in range(280_000, 281_250)])
    assert steps.min() >= 12_798_720 - 1
    assert steps.max() <= 12_798_720 + 1


def test_exposures_and_slots_stand_on_one_clock(whole: Path) -> None:
    """Device times follow each device's own clock; its model in the log gives the reference, on
    which the camera's 12.8 ms are 50 ppm shorter, the radar's 20 ms 30 ppm longer.
    """
    by_kind: dict[type, list] = {SpiRecord: [], RadarRecord: []}
    for received in read_records(whole):
        by_kind[type(received.record)].append(received)
    cameras, radars = by_kind[SpiRecord], by_kind[RadarRecord]
    assert (len(cameras), len(radars)) == (3, 3)
    assert [r.topic for r in (cameras[0], radars[0])] == ["/spi/record", "/radar/record"]
    for k, received in enumerate(cameras):
        times = received.record.device_time_ns
        assert times[0] == 2_000_000 + k * 12_800_000
        assert np.diff(times).tolist() == [100_000] * 127
        begun = received.clock.host_ns(int(times[0]))
        assert abs(begun - k * 12_800_000 / (1 + 50e-6)) <= 1
        assert received.record.sequence[0] == 128 * k
        assert received.host_ns >= received.clock.host_ns(int(times[-1]))
    for k, received in enumerate(radars):
        first = int(received.record.device_time_ns.flat[0])
        assert first == -1_000_000 + k * 20_000_000
        assert abs(received.clock.host_ns(first) - k * 20_000_000 / (1 - 30e-6)) <= 1
    marks = [Mark.unpack(m.message.data) for m in read_messages(whole) if m.topic == MARKS]
    assert [mark.event for mark in marks] == list(range(11))
    assert sorted(mark.end_ns for mark in marks) == [mark.end_ns for mark in marks]
    last = marks[-1]
    assert last.device_ns["camera"] == last.end_ns + 2_000_000 + round(50e-6 * last.end_ns)


@pytest.mark.whole
def test_the_world_moves_within_a_frame_where_that_is_asked_for() -> None:
    """Of a rig at 5 m/s the first exposures are those of a frame that stands where it began, the
    last ones those of a frame that stands where it ended.
    """
    fidelity = replace(FAST, noise="none", samples=64, motion_tolerance=None)
    slow = CAMERA.with_({"acquisition.pattern_period_s": 1e-2})
    moving, still = (
        CameraFrames(plan(fidelity=knobs, system=slow, duration_s=2.0, radar=None))
        for knobs in (replace(fidelity, motion_tolerance=0.1), fidelity)
    )
    moved = moving(0, 0).record.counts[:, 0]
    early, late = (still(0, at_ns).record.counts[:, 0] for at_ns in (0, 1_275_000_000))
    apart = np.abs(early - late).mean()
    assert np.abs(moved[:2] - early[:2]).mean() < 0.1 * apart
    assert np.abs(moved[-2:] - late[-2:]).mean() < 0.1 * apart


def test_frame_k_depends_on_seed_and_k_alone(whole: Path) -> None:
    third = [r.record for r in read_records(whole) if isinstance(r.record, SpiRecord)][2]
    event = [e for e in plan().events() if e.kind == "camera"][2]
    alone = CameraFrames(plan())(2, event.begin_ns).record
    np.testing.assert_array_equal(alone.counts, third.counts)
    np.testing.assert_array_equal(alone.device_time_ns, third.device_time_ns)
    other = CameraFrames(plan(seed=4))(2, event.begin_ns).record
    assert (other.counts != third.counts).any()


def test_truth_beside_the_records(whole: Path) -> None:
    """Poses, twists and boxes of all things against the scene and each other; the pose in a record
    is the rig's at the frame's beginning.
    """
    scene, states, stamps, depths = driven_scene(), {}, [], {}
    for logged in read_messages(whole):
        if logged.topic == "/truth/objects":
            states[logged.message.publish_time] = ObjectStates.unpack(logged.message.data)
        if logged.topic.startswith("/truth/camera/"):
            stamps.append(logged.message.publish_time)
        if logged.topic == "/truth/camera/depth":
            depths[logged.message.publish_time] = logged.message.data
    first = states[0]
    assert first.names[: 1 + len(scene.objects)] == ("rig", *(o.name for o in scene.objects))
    for row, item in enumerate(scene.objects, 1):
        corners = item.vertices_m[np.unique(item.geometry.faces)]
        np.testing.assert_allclose(first.boxes_m[row], [corners.min(0), corners.max(0)])
    np.testing.assert_allclose(first.twists[1:], 0)
    early, late = states[10_000_000], states[30_000_000]
    np.testing.assert_allclose(
        (late.poses[0, :3] - early.poses[0, :3]) / 0.02, early.twists[0, :3], atol=0.01
    )
    turn = (
        Rotation.from_quat(late.poses[0, [4, 5, 6, 3]])
        * Rotation.from_quat(early.poses[0, [4, 5, 6, 3]]).inv()
    )
    np.testing.assert_allclose(turn.as_rotvec() / 0.02, early.twists[0, 3:], atol=1e-3)
    record = next(r for r in read_records(whole) if isinstance(r.record, SpiRecord)).record
    assert record.pose.position_m == pytest.approx(scene.rig.position_m)
    assert len(stamps) == 6
    assert set(stamps) <= set(states)  # states at the time of every truth image
    for stamp_ns, message in depths.items():
        here = scene.after(1e-9 * stamp_ns)
        emitter, _, _ = devices(here, CAMERA)
        expected = render_truth(mitsuba_scene(here), emitter, CAMERA.image_shape).depth_m
        seen = np.frombuffer(message[-4 * 64 :], "<f4").reshape(8, 8)
        np.testing.assert_allclose(seen, expected, rtol=1e-5)


def antenna_m(scene: Scene) -> np.ndarray:
    """Place of the radar in the world."""
    return np.asarray(scene.rig.position_m) + scene.rig.device("radar")[0]


def test_a_target_is_where_the_truth_of_the_same_time_has_it(tmp_path: Path) -> None:
    """Detections, truth and pose of a burst are those of its middle, and stamped with it. By its
    beginning, 5 ms before, the target is 50 mm off.
    """
    at_m = antenna_m(driven_scene()) + [20.0, 0.0, 0.0]
    car = Target("car", tuple(at_m.tolist()), (15.0, 0, 0), 1e4, "of this test")
    scene = replace(driven_scene(), objects=(), targets=(car,))
    of = plan(
        scene=scene, system=None, radar=load_radar("hybrid-79"), duration_s=0.6, radar_period_s=0.3,
        fidelity=replace(FAST, noise="none"),
    )  # fmt: skip
    log, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    drive(of, log)
    bursts = list(read_records(log))
    assert len(bursts) == 2
    with Log(out) as processed:
        for received in bursts:
            process(received, processed)
    topics: dict[str, list[int]] = {}
    for path in (log, out):
        for logged in read_messages(path):
            topics.setdefault(logged.topic, []).append(logged.message.publish_time)
    for received in bursts:
        (frame,) = frames(received.record)
        middle_ns = received.clock.host_ns(frame.middle_ns)
        for topic in ("/truth/objects", "/tf", "/radar/detections"):
            assert min(abs(stamp - middle_ns) for stamp in topics[topic]) <= 1, topic
        then = scene.after(1e-9 * middle_ns)
        here_m = antenna_m(then)
        np.testing.assert_allclose(received.record.pose[0].position_m, here_m, atol=1e-6)
        range_m = np.linalg.norm(np.array(then.targets[0].position_m) - here_m)
        assert frame.detections[0].range_m == pytest.approx(range_m, abs=2e-3)


def test_states_at_many_times_are_those_of_the_scene_at_each() -> None:
    """Of what rolls, swings and is carried, of targets on it, and of boxes around it."""
    scene, times = load_scene("crossing"), np.array([0.0, 0.3, 33.3, 71.25])
    for seconds, found in zip(times.tolist(), ObjectStates.at(scene, times), strict=True):
        now = scene.after(seconds)
        bodies = [now.rig.state, *(item.state for item in now.objects)]
        assert found.names == ("rig", *(x.name for x in (*now.objects, *now.targets)))
        poses, twists = found.poses[: len(bodies)], found.twists[: len(bodies)]
        turns = Rotation.from_quat(poses[:, [4, 5, 6, 3]])
        for row, state in enumerate(bodies):
            np.testing.assert_allclose(poses[row, :3], state.pose.translation, atol=1e-11)
            assert (turns[row].inv() * state.pose.rotation).magnitude() < 1e-11
            rates = [*state.velocity_m_per_s, *state.angular_velocity_rad_per_s]
            np.testing.assert_allclose(twists[row], rates, atol=1e-9)
        boxes = found.boxes_m[1 : len(bodies)]
        np.testing.assert_allclose(boxes, boxes_of(now.objects), atol=1e-11)
        for row, target in enumerate(now.targets, len(bodies)):
            place = target.position_m
            np.testing.assert_allclose(found.poses[row], [*place, 1, 0, 0, 0], atol=1e-11)
            np.testing.assert_allclose(found.boxes_m[row], [place, place], atol=1e-11)
            rates = [*target.velocity_m_per_s, 0, 0, 0]
            np.testing.assert_allclose(found.twists[row], rates, atol=1e-9)


@pytest.mark.thorough
def test_samples_of_the_truth_do_not_depend_on_which_is_asked_for_first() -> None:
    crossing = plan(scene=load_scene("crossing"), duration_s=1.5)
    in_order = TruthSamples(crossing)
    messages = [in_order(number).pack(0) for number in range(151)]
    for first in (150, 70, 1):
        assert TruthSamples(crossing)(first).pack(0) == messages[first]


def test_the_vehicle_processes_the_log_and_reads_no_truth(whole: Path, tmp_path: Path) -> None:
    with Log(tmp_path / "processed.mcap") as log:
        for received in read_records(whole):
            summary = process(received, log)
            assert summary.lines
    topics = {logged.topic for logged in read_messages(tmp_path / "processed.mcap")}
    assert topics == {"/spi/image", "/radar/detections"}


def test_a_world_at_rest_is_rendered_once_and_its_noise_is_new(tmp_path: Path) -> None:
    still = plan(scene=load_scene("table1"), radar=None)
    frames = CameraFrames(still)
    first, second = (frames(k, 0).record for k in (0, 1))
    assert (first.counts != second.counts).any()
    np.testing.assert_array_equal(CameraFrames(still)(1, 0).record.counts, second.counts)
    assert drive(still, tmp_path / "still.mcap").complete


def test_a_world_at_rest_is_lit_by_the_sun_of_each_frame() -> None:
    scene, system = load_scene("table1"), CAMERA.with_({"sky": None})
    dusk = {"illuminance_lx": 300.0, "latitude_deg": 50.0, "north_azimuth_deg": 90.0}
    sunlit = replace(scene, sun=replace(scene.sun, **dusk))
    hours = (0, 1, 2, 12)
    first, second, third, night = (
        CameraFrames(plan(scene=sunlit, system=system, radar=None))(k, h * 3600 * 10**9).record
        for k, h in enumerate(hours)
    )
    assert len({float(np.mean(x.counts)) for x in (first, second, third, night)}) == 4
    assert night.counts.mean() < min(x.counts.mean() for x in (first, second, third))


def test_what_records_are_warned_of_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By sensor and kind: how many of this call, and the first in words."""
    bright = CAMERA.with_({"sky.illuminance_lx": 1e5})
    done = drive(plan(scene=load_scene("table1"), system=bright), tmp_path / "bright.mcap")
    told = {(one.sensor, one.kind): one for one in done.warned}
    saturated = told["camera", "saturated"]
    assert saturated.records == 3
    assert "exposures saturate the ADC" in saturated.words
    assert told["radar", "no-echo"].records == 3
    again = drive(plan(scene=load_scene("table1"), system=bright), tmp_path / "bright.mcap")
    assert again.warned == ()
    system = tmp_path / "bright.toml"
    system.write_text('base = "workable"\n[sky]\nilluminance_lx = { value = 1e5, assumed = "t" }\n')
    options = ["--radar", "none", "--duration", "1 s", "--fidelity", "draft"]
    files = ["--out", str(tmp_path / "told.mcap"), "--system", str(system)]
    app(["drive", "table1", *options, *files], standalone_mode=False)
    assert "camera: saturated: 1 record of this call, the first: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"duration_s": 0.0}, "duration: 0 s: expected a time above 0"),
        ({"duration_s": float("nan")}, "duration: nan s: expected a time above 0"),
        ({"duration_s": 0.0004}, "shorter than the first frame of every sensor"),
        ({"duration_s": 10.5}, "the trajectories of table1 end after 10 s"),
        ({"system": None, "radar": None}, "both are none"),
        ({"radar_period_s": 1e-4}, "expected at least a burst of hybrid-79"),
        ({"radar_period_s": 1e300}, r"radar period: 1e\+300 s: expected .*, up to 1e\+06 s"),
        ({"truth_period_s": 0.0}, "truth period: 0 s"),
        ({"truth_period_s": 1e300}, r"truth period: 1e\+300 s: expected .*, up to 1e\+06 s"),
        ({"seed": -1}, "seed: -1"),
    ],
)
def test_drives_that_cannot_be_are_refused_before_any_work(
    changes: dict[str, object], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        plan(**changes)


@pytest.mark.parametrize("values", [(0.0, 2e4), (float("nan"), 0.0), (0.0, float("inf"))])
def test_clocks_that_are_none_are_refused(values: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="expected a number from"):
        DeviceClock(*values)


def command(path: Path, *options: str) -> list[str]:
    scene = ["yard", "--radar", "none", "--fidelity", "draft", "--duration", "15 s"]
    return [sys.executable, "-m", "twin", "drive", *scene, "--out", str(path), *options]


def test_the_command_says_what_it_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    short = [*command(path)[3:], "--duration", "900 ms", "--camera-drift-ppm", "100"]
    app(short, standalone_mode=False)
    assert "11 events, 900 ms of 900 ms; computed at" in capsys.readouterr().out
    app(short, standalone_mode=False)
    assert "complete already, 11 events were there" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"log of another drive \(duration_s: 0.9, not 15.0\)"):
        app(command(path)[3:], standalone_mode=False)
    with pytest.raises(InputError, match="--motion-tolerance: 'little'"):
        app([*short, "--motion-tolerance", "little"], standalone_mode=False)
    with pytest.raises(InputError, match="nothing ends the motion of table1"):
        app(["drive", "table1", "--out", str(path)], standalone_mode=False)


@pytest.mark.parametrize(("radar", "period_s"), [("prototype", 0.12644), ("hybrid-79", 0.1)])
def test_a_burst_is_over_before_the_next(
    radar: str, period_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The default period, 100 ms, was refused for `prototype`."""
    planned: list[Drive] = []

    def recorded(plan: Drive, *_: object, **__: object) -> None:
        planned.append(plan)
        raise InputError("not driven")

    monkeypatch.setattr("twin.drive.drive", recorded)
    words = ["drive", "yard", "--radar", radar, "--duration", "1 s"]
    with pytest.raises(InputError, match="not driven"):
        app([*words, "--out", str(tmp_path / "run.mcap")], standalone_mode=False)
    assert planned[0].radar_period_s == pytest.approx(period_s)


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("content", "left"),
    [(b"", "the same command continues {}"), (None, "nothing half-written is left")],
)
def test_an_interrupted_command_says_what_continues_it(
    content: bytes | None, left: str, tmp_path: Path
) -> None:
    """A second Ctrl-C had said that nothing is left of a log with events."""
    path = tmp_path / "run.mcap"
    if content is not None:
        path.write_bytes(content)
    interrupted = (
        "import os, signal, twin.scene\n"
        "from twin.cli import main\n"
        "twin.scene.load_scene = lambda name: os.kill(os.getpid(), signal.SIGINT)\n"
        "main()\n"
    )
    words = [sys.executable, "-c", interrupted, *command(path)[3:]]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert done.stderr == f"twin: interrupted, {left.format(path)}\n"


@pytest.mark.slow
def test_killed_ten_times_at_random_and_gone_on_with(tmp_path: Path) -> None:
    whole, killed, rng = tmp_path / "whole.mcap", tmp_path / "killed.mcap", random.Random(5)
    begun = time.monotonic()
    subprocess.run(command(whole), check=True, capture_output=True)
    whole_s = time.monotonic() - begun
    for _ in range(10):
        process = subprocess.Popen(command(killed), stdout=subprocess.DEVNULL)
        time.sleep(rng.uniform(0.2, 0.6) * whole_s)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run(command(killed), check=True, capture_output=True)
    digests = {hashlib.sha256(path.read_bytes()).hexdigest() for path in (whole, killed)}
    assert len(digests) == 1
