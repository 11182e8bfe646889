"""The log: the same records bit for bit, opened by tools of others, whole up to the kill."""

import os
import signal
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.writer import Writer

from hardware import PatternSet, SpiRecord
from hardware.drivers.clock import ClockModel
from hardware.errors import InputError
from hardware.recording import Log, read_messages, read_records, recover, ros
from hardware.recording.kinds import KINDS, kind_of
from hardware.recording.reading import Ending
from hardware.records import QuaternionPose, RadarFrontEnd, RadarRecord
from hardware.sources import open_source, replay
from hardware.waveform import OfdmWaveform


def camera_record(seed: int = 0, patterns: PatternSet | None = None) -> SpiRecord:
    patterns = patterns or PatternSet(8, 8, 64)
    rng = np.random.default_rng(seed)
    n = patterns.n_exposures
    return SpiRecord(
        counts=rng.integers(0, 2**16, (n, 2), np.int32),
        device_time_ns=10**9 + 100_000 * np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32) + np.uint32(seed * n),
        flags=rng.integers(0, 16, n, np.uint8),
        patterns=patterns,
        integration_time_s=1 / 3e4,
        electrons_per_count=780.5,
        offset_counts=320.25,
        adc_bits=16,
        device="täst",
        pose=QuaternionPose(*rng.normal(size=7).tolist()),
    )


def radar_record(seed: int = 0) -> RadarRecord:
    rng = np.random.default_rng(seed)
    waveform = OfdmWaveform(79e9, 16, 1e6, 8, 4e-6, 3, 0.0)
    return RadarRecord(
        iq=rng.integers(-(2**15), 2**15, (2, 3, 8, 4, 16, 2), np.int16),
        device_time_ns=rng.integers(0, 2**60, (2, 3, 8)),
        flags=rng.integers(0, 8, (2, 3, 8), np.uint8),
        carriers_hz=79e9 + 16e6 * np.arange(3),
        transmitter=np.zeros(8, np.uint8),
        waveform=waveform,
        front_end=RadarFrontEnd(1e-9, 0.01, losses_db=1.5, receivers_m=rng.normal(size=(4, 3))),
        device="radar",
        pose=tuple(QuaternionPose(*numbers) for numbers in rng.normal(size=(2, 7)).tolist()),
    )


def assert_same(found: Any, expected: Any) -> None:
    """Every field of a record, to the bit and the type."""
    layout = kind_of(expected).layout
    for name, (dtype, _) in layout.arrays.items():
        here, there = (layout.value(record, name) for record in (found, expected))
        if name in layout.objects:
            assert here == there
            continue
        assert here.dtype == np.dtype(dtype)
        assert here.shape == there.shape
        assert here.tobytes() == there.astype(dtype).tobytes()
    assert getattr(found, layout.group) == getattr(expected, layout.group)
    for name in layout.settings:
        np.testing.assert_equal(layout.value(found, name), layout.value(expected, name))


RECORDS = [
    camera_record(),
    camera_record(1, PatternSet.of(4, 8, [0, 3, 7])),
    camera_record(2, PatternSet(1, 1, 1)),
    radar_record(),
]


@pytest.mark.parametrize("record", RECORDS, ids=["camera", "custom order", "one cell", "radar"])
def test_records_come_back_bit_for_bit(tmp_path: Path, record: Any) -> None:
    clock = ClockModel(1_700_000_000_000_000_001, -(2**40), 1e-5, 12.5)
    with Log(tmp_path / "run.mcap") as log:
        log.record("/sensor/record", record, host_ns=1_700_000_000_000_000_123, clock=clock)
        log.record("/sensor/record", record)
    first, second = read_records(tmp_path / "run.mcap")
    assert_same(first.record, record)
    assert_same(second.record, record)
    assert (first.topic, first.host_ns, first.clock) == (
        "/sensor/record",
        1_700_000_000_000_000_123,
        clock,
    )
    assert second.clock is None


def test_device_time_stands_on_the_hosts_clock(tmp_path: Path) -> None:
    clock = ClockModel(0, 5 * 10**9, 0.0, 1.0)
    record = replace(camera_record(), device_time_ns=7 * 10**9 + np.arange(128, dtype=np.int64))
    with Log(tmp_path / "run.mcap") as log:
        log.record("/spi/record", record, host_ns=3 * 10**9, clock=clock)
    message = next(read_messages(tmp_path / "run.mcap")).message
    assert (message.log_time, message.publish_time) == (3 * 10**9, 2 * 10**9)


def written(path: Path) -> Path:
    """A log with every type of message."""
    with Log(path) as log:
        log.record("/spi/record", RECORDS[0], host_ns=1_000)
        log.record("/radar/record", RECORDS[3], host_ns=2_000)
        pixels = np.arange(12.0).reshape(3, 4)
        log.message("/spi/image", ros.IMAGE, ros.image(pixels, 5, "spi"), 3_000, 5)
        columns = {"x": np.array([1.0, 2.0]), "y": np.zeros(2), "z": np.ones(2), "snr": np.ones(2)}
        cloud = ros.points(columns, 5, "radar")
        log.message("/radar/detections", ros.POINTS, cloud, 4_000, 5)
    return path


@pytest.mark.library("mcap_ros2")
def test_ros_tools_read_every_message(tmp_path: Path) -> None:
    """`mcap` with its ROS 2 decoder, which parses the definitions in the file."""
    from mcap_ros2 import decoder

    path = written(tmp_path / "run.mcap")
    with path.open("rb") as file:
        reader = SeekingReader(file, decoder_factories=[decoder.DecoderFactory()])
        found = {c.topic: m for _, c, _, m in reader.iter_decoded_messages()}
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics.message_count == 7  # two records with one and two poses
    camera = found["/spi/record"]
    assert camera.counts == RECORDS[0].counts.ravel().tolist()
    assert camera.counts_shape == [128, 2]
    assert camera.device_time_ns == RECORDS[0].device_time_ns.tolist()
    assert camera.integration_time_s == RECORDS[0].integration_time_s
    assert (camera.patterns_rows, camera.patterns_order) == (8, "sequency")
    assert (camera.device, camera.schema_version) == ("täst", 4)
    assert found["/radar/record"].iq == RECORDS[3].iq.ravel().tolist()
    image = found["/spi/image"]
    assert (image.height, image.width, image.encoding, image.step) == (3, 4, "32FC1", 16)
    assert np.frombuffer(image.data, "<f4").tolist() == list(range(12))
    cloud = found["/radar/detections"]
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "snr"]
    table = np.frombuffer(cloud.data, "<f4").reshape(2, 4)
    assert table.tolist() == [[1, 0, 1, 1], [2, 0, 1, 1]]
    (moved,) = found["/tf"].transforms
    pose = RECORDS[3].pose[1]
    assert moved.child_frame_id == "radar"
    assert (moved.transform.translation.x, moved.transform.rotation.w) == (pose.x_m, pose.qw)


@pytest.mark.library("mcap_ros2")
def test_sensors_stand_on_the_rig_where_their_place_is_known(tmp_path: Path) -> None:
    """Every frame has one parent: world -> rig from the camera's records, rig -> sensors fixed."""
    from mcap_ros2 import decoder

    extrinsics = {"spi": (0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0), "radar": (0, 0, 0, 0, 0, 0, 1)}
    path = tmp_path / "run.mcap"
    with Log(path, extrinsics=extrinsics) as log:
        log.record("/spi/record", RECORDS[0])
        log.record("/radar/record", RECORDS[3])
    tree = {}
    with path.open("rb") as file:
        reader = SeekingReader(file, decoder_factories=[decoder.DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(["/tf", "/tf_static"]):
            for moved in message.transforms:
                assert moved.child_frame_id not in tree
                tree[moved.child_frame_id] = (moved.header.frame_id, channel.topic)
    assert tree == {
        "rig": ("world", "/tf"),
        "spi": ("rig", "/tf_static"),
        "radar": ("rig", "/tf_static"),
    }
    with pytest.raises(ValueError, match="extrinsics: spi"):
        Log(tmp_path / "bad.mcap", extrinsics={"spi": (0, 0, 0)})
    assert not (tmp_path / "bad.mcap").exists()


def check_by_rosbags(path: Path) -> int:
    """Messages that `rosbags` decodes, by the definitions in the file."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    n = 0
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/spi/record":
                assert message.counts.size == np.prod(message.counts_shape)
            n += 1
    return n


@pytest.mark.library("rosbags")
def test_rosbags_reads_every_message(tmp_path: Path) -> None:
    assert check_by_rosbags(written(tmp_path / "run.mcap")) == 7


def test_schema_versions_stand_in_the_file(tmp_path: Path) -> None:
    """Another version is refused in words."""
    kind = KINDS[0]
    message = bytearray(kind.pack(RECORDS[0], 0, "spi", None))
    at = message.index(b"ugv-spi-record\0") + 16
    assert message[at] == 4
    message[at] = 99
    with pytest.raises(ValueError, match="ugv-spi-record of schema version 99"):
        kind.unpack(bytes(message))
    with pytest.raises(ValueError, match="too early"):
        kind.unpack(kind.pack(RECORDS[0], 0, "spi", None)[:-1])


def test_messages_of_an_older_schema_are_read() -> None:
    """Version 3 had no patterns of a user's own, version 2 no pulse width: a message packed without
    them comes back whole.
    """
    kind = KINDS[0]
    record = replace(RECORDS[0], pulse_width_s=2e-8)
    named = tuple(name for name in kind.layout.parameters if name != "digest")
    third = replace(kind.layout, version=3, parameters=named, group_arrays={})
    back, _ = kind.unpack(replace(kind, layout=third).pack(record, 0, "spi", None))
    assert back.pulse_width_s == 2e-8
    before = tuple(name for name in kind.layout.settings if name != "pulse_width_s")
    old = replace(kind, layout=replace(third, version=2, settings=before))
    back, _ = kind.unpack(old.pack(record, 0, "spi", None))
    assert back.pulse_width_s == 0.0
    assert back.patterns == record.patterns
    assert back.device == record.device
    np.testing.assert_array_equal(back.counts, record.counts)
    np.testing.assert_array_equal(back.shutters, record.shutters)


def test_a_log_is_never_written_over(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap")
    with pytest.raises(FileExistsError):
        Log(path)


# Cut short.


def test_every_cut_leaves_what_was_flushed_before_it(tmp_path: Path) -> None:
    """At any byte: the messages of whole chunks, then a file that others open."""
    path = tmp_path / "run.mcap"
    ends = []
    with Log(path, flush_s=1e9) as log:
        for seed in range(6):
            log.record("/spi/record", camera_record(seed), host_ns=seed)
            log.flush()
            ends.append(path.stat().st_size)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for size in {8, 9, 30, *ends, *(end - 1 for end in ends), *rng.integers(8, len(data), 30)}:
        cut = tmp_path / f"cut-{size}.mcap"
        cut.write_bytes(data[:size])
        n = sum(end <= size for end in ends)
        found = list(read_records(cut))
        assert n <= len(found) <= n + 1  # the chunk's index comes after its messages
        for seed, received in enumerate(found):
            assert_same(received.record, camera_record(seed))
        if not found:
            with pytest.raises(ValueError, match="no whole message"):
                recover(cut)
            assert cut.read_bytes() == data[:size]
            continue
        done = recover(cut)
        kept = done.kept
        assert (kept, done.ending.fault is None) == (2 * len(found), False)
        if done.original:  # within a chunk: its bytes are not thrown away
            assert done.original.read_bytes() == data[:size]
        assert (done.original is None) == (done.ending.lost_bytes == 0)
        with cut.open("rb") as file:
            assert SeekingReader(file).get_summary().statistics.message_count == kept  # type: ignore[union-attr]
        assert (recover(cut).kept, recover(cut).ending.fault) == (kept, None)


def of_chunks(path: Path, n: int = 4, patterns: PatternSet | None = None) -> list[tuple[int, int]]:
    """A log with one camera record in each of so many chunks; where each chunk's data begin, end.

    Found from the layout in the MCAP specification: opcode 6, length u64, then the content.
    """
    with Log(path, flush_s=1e9) as log:
        for seed in range(n):
            log.record("/spi/record", camera_record(seed, patterns), host_ns=seed)
            log.flush()
    data, at, chunks = path.read_bytes(), 8, []
    while at < len(data) - 8:
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at] == 6:
            chunks.append((at + 9, at + 9 + length))
        at += 9 + length
    assert len(chunks) == n
    return chunks


@pytest.mark.parametrize("broken", [0, 1, 3])
def test_a_broken_chunk_takes_none_of_the_others_with_it(tmp_path: Path, broken: int) -> None:
    """One bit of a chunk of four: the three others are read and recovered bit for bit, also where
    the first, in which the topics are defined, is the broken one; what is lost is told; the file
    as it was stays beside the recovered one.
    """
    path = tmp_path / "run.mcap"
    begin, end = of_chunks(path)[broken]
    data = bytearray(path.read_bytes())
    data[(begin + end) // 2] ^= 1
    path.write_bytes(data)
    rest = [seed for seed in range(4) if seed != broken]
    found = list(read_records(path))
    assert [received.host_ns for received in found] == rest
    for seed, received in zip(rest, found, strict=True):
        assert_same(received.record, camera_record(seed))
    done = recover(path)
    assert done.kept == 2 * 3  # a record and its pose
    assert (done.ending.lost_messages, done.ending.lost_bytes) == (2, end - begin)
    assert done.original == tmp_path / "run-damaged.mcap"
    assert done.original.read_bytes() == data
    with path.open("rb") as file:
        assert SeekingReader(file).get_summary().statistics.message_count == 6  # type: ignore[union-attr]
    assert [received.host_ns for received in read_records(path)] == rest
    again = recover(path)
    assert (again.kept, again.ending.fault, again.original) == (6, None, None)


@pytest.mark.parametrize("place", [0.1, 0.5, 0.99])
def test_a_log_without_summary_and_first_chunk_keeps_the_others(
    tmp_path: Path, place: float
) -> None:
    """Killed before its summary, and one bit of the chunk spoilt that alone defines the topics: the
    three other records come back bit for bit, with their topic where it can be unpacked still, and
    `recover` makes a log of them that names its topics itself.
    """
    path = tmp_path / "run.mcap"
    patterns = PatternSet(128, 128, 16384)  # zstd packs half a megabyte in several blocks
    chunks = of_chunks(path, patterns=patterns)
    begin, end = chunks[0]
    data = bytearray(path.read_bytes()[: chunks[-1][1]])
    data[begin + int(place * (end - begin))] ^= 1
    path.write_bytes(data)
    found = list(read_records(path, ending := Ending()))
    assert [received.host_ns for received in found] == [1, 2, 3]
    for seed, received in enumerate(found, 1):
        assert_same(received.record, camera_record(seed, patterns))
    assert ending.fault is not None
    assert ending.lost_bytes >= end - begin
    if place > 0.1:  # the first block, which holds the definitions, is whole
        assert {received.topic for received in found} == {"/spi/record"}
    done = recover(path)
    assert done.kept >= 3
    assert done.original == tmp_path / "run-damaged.mcap"
    again = Ending()
    assert [received.host_ns for received in read_records(path, again)] == [1, 2, 3]
    assert again.fault is None


def test_a_message_outside_chunks_is_covered_by_the_crc_of_the_data(tmp_path: Path) -> None:
    """As other writers may lay out a log; one bit of the payload, and the reader says so."""
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_data_crcs=True)
        writer.start()
        channel = writer.register_channel("/x", "cdr", writer.register_schema("x", "ros2msg", b""))
        writer.add_message(channel, 1, b"payload", 1)
        writer.finish()
    for data, fault in (
        (path.read_bytes(), None),
        (path.read_bytes().replace(b"payload", b"qayload"), "the CRC-32 of the data is another"),
    ):
        path.write_bytes(data)
        assert len(list(read_messages(path, ending := Ending()))) == 1
        assert ending.fault == fault


def test_another_damaged_original_is_not_written_over(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    begin, end = of_chunks(path)[1]
    data = bytearray(path.read_bytes())
    data[(begin + end) // 2] ^= 1
    for name in ("run-damaged.mcap", "run-damaged1.mcap"):
        path.write_bytes(data)
        assert recover(path).original == tmp_path / name


def test_a_file_of_which_nothing_is_whole_is_left_as_it_is(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).bytes(20_000)
    for data in (b"", b"\x89MCAP0\r\n" + noise):
        path = tmp_path / "run.mcap"
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"run\.mcap: no whole message in it"):
            recover(path)
        assert path.read_bytes() == data
        assert list(tmp_path.iterdir()) == [path]


def test_spoiled_bytes_end_the_log_with_a_reason(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap")
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for at in rng.integers(8, len(data), 200):
        spoiled = bytearray(data)
        spoiled[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(spoiled)
        messages = list(read_messages(path))
        assert len(messages) <= 7


def test_no_log_is_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"no log")
    with pytest.raises(ValueError, match=r"x\.mcap: no MCAP file"):
        list(read_records(tmp_path / "x.mcap"))
    with pytest.raises(FileNotFoundError):
        list(read_records(tmp_path / "missing.mcap"))


WRITER = """
import sys, time, itertools
sys.path.insert(0, {tests!r})
from test_recording import camera_record, Log
record = camera_record()
log = Log({path!r})
for n in itertools.count():
    log.record("/spi/record", record, host_ns=n)
    print(n, time.monotonic(), flush=True)
    time.sleep(0.002)
"""


def kill_once(folder: Path, wait_s: float) -> None:
    """Kill -9 while recording: what was logged a second before is there, and opens elsewhere."""
    path = folder / "run.mcap"
    program = WRITER.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        time.sleep(wait_s)
        process.send_signal(signal.SIGKILL)
        killed_s = time.monotonic()
        lines = [first, *process.stdout]
    due = [int(line.split()[0]) for line in lines
           if line.endswith(b"\n") and float(line.split()[1]) < killed_s - 1]  # fmt: skip
    kept = [received.host_ns for received in read_records(path)]
    assert kept == list(range(len(kept)))
    assert len(kept) > max(due, default=-1)
    if kept:
        done = recover(path)
        n = done.kept
        assert done.ending.fault is not None
        with path.open("rb") as file:
            assert sum(1 for _ in SeekingReader(file).iter_messages()) == n
        assert check_by_rosbags(path) == n
    path.unlink()


@pytest.mark.library("rosbags")
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX")
@pytest.mark.parametrize("times", [5, pytest.param(200, marks=pytest.mark.slow)])
def test_a_kill_takes_no_more_than_a_second(tmp_path: Path, times: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(times):
        kill_once(tmp_path, float(rng.uniform(0, 2.5)))


@pytest.mark.skipif(os.name != "posix", reason="locks and SIGKILL are POSIX")
def test_a_log_that_is_being_written_is_not_recovered(tmp_path: Path) -> None:
    """Another process writes: recovery refuses and leaves the file, reading loses nothing and does
    not advise it. Once the writer is killed the log is recovered.
    """
    path, ending = tmp_path / "run.mcap", Ending()
    program = WRITER.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        for _ in range(400):
            process.stdout.readline()
        file = path.stat().st_ino
        for out in (None, tmp_path / "copy.mcap"):
            with pytest.raises(InputError, match=r"run\.mcap: still being written"):
                recover(path, out)
        assert path.stat().st_ino == file
        assert list(read_records(path, ending))
        assert (ending.being_written, ending.lost) == (True, "")
        assert "recover" not in ending.advice(path)
        process.kill()
    assert recover(path).ending.fault


def test_a_writer_notices_that_its_log_is_gone(tmp_path: Path) -> None:
    """Removed or replaced: the next flush raises. Moved: it is written to its end, and told."""
    for change, at_flush in (("unlink", True), ("replace", True), ("rename", False)):
        path, other = tmp_path / f"{change}.mcap", tmp_path / "other.mcap"
        log = Log(path, flush_s=1e9)
        log.record("/spi/record", camera_record(), host_ns=0)
        if change == "unlink":
            path.unlink()
        elif change == "replace":
            other.write_bytes(b"")
            other.replace(path)
        else:
            path.rename(other)
        if at_flush:
            with pytest.raises(InputError, match="removed or replaced while it was written"):
                log.flush()
        else:
            log.flush()
        with pytest.raises(InputError, match="removed or replaced while it was written"):
            log.close()
    assert len(list(read_records(other))) == 1


@pytest.mark.slow
def test_memory_is_flat_over_many_frames(tmp_path: Path) -> None:
    """1e5 frames: what is held grows by less than 10 bytes a frame (indices of chunks)."""
    record = camera_record(patterns=PatternSet(2, 2, 4))
    tracemalloc.start()
    with Log(tmp_path / "run.mcap") as log:
        for n in range(100_000):
            log.record("/spi/record", record, host_ns=n)
            if n == 10_000:
                log.flush()
                before = tracemalloc.get_traced_memory()[0]
        log.flush()
        grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 10 * 90_000


# Replay.


def test_replay_keeps_the_pace_and_the_records(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Log(path) as log:
        for n in range(4):
            log.record("/spi/record", camera_record(n), host_ns=n * 10**8)
    begun = time.monotonic()
    for n, received in enumerate(open_source(f"replay:{path}")):
        assert time.monotonic() - begun >= 0.1 * n
        assert_same(received.record, camera_record(n))
    assert 0.3 <= time.monotonic() - begun < 3
    begun = time.monotonic()
    assert len(list(open_source(f"replay:{path}?pace=fast"))) == 4
    assert len(list(replay(path, speed=1e6))) == 4
    assert time.monotonic() - begun < 0.3


@pytest.mark.parametrize(
    ("url", "message"),
    [("replay:x.mcap?pace=slow", "pace=slow"), ("/dev/ttyACM9", "a camera needs settings")],
)
def test_sources_that_are_none(url: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        open_source(url)
