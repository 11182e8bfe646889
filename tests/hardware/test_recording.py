"""The log: the same records bit for bit, opened by tools of others, replayed at its pace."""

import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_records import RECORDS, assert_same, camera_record, check_by_rosbags, written
from mcap.reader import SeekingReader

from hardware import PatternSet
from hardware.drivers.clock import ClockModel
from hardware.errors import InputError
from hardware.recording import Log, read_messages, read_records
from hardware.recording.kinds import KINDS
from hardware.sources import SourceError, open_source, replay


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


@pytest.mark.parametrize("drift", [-1.0, -3.0, np.inf, np.nan])
def test_a_clock_that_cannot_run_is_no_clock_of_a_record(drift: float) -> None:
    kind, record = KINDS[0], camera_record()
    message = kind.pack(record, 0, "camera", ClockModel(0, 0, drift, 1.0))
    with pytest.raises(InputError, match=r"clock_drift: .*: expected a number above -1"):
        kind.unpack(message)


def test_device_time_stands_on_the_hosts_clock(tmp_path: Path) -> None:
    clock = ClockModel(0, 5 * 10**9, 0.0, 1.0)
    record = replace(camera_record(), device_time_ns=7 * 10**9 + np.arange(128, dtype=np.int64))
    with Log(tmp_path / "run.mcap") as log:
        log.record("/spi/record", record, host_ns=3 * 10**9, clock=clock)
    message = next(read_messages(tmp_path / "run.mcap")).message
    assert (message.log_time, message.publish_time) == (3 * 10**9, 2 * 10**9)


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


def test_a_file_of_one_record_is_no_source(tmp_path) -> None:
    (path := tmp_path / "radar.h5").write_bytes(b"")
    with pytest.raises(SourceError, match=r"radar.h5: is a file, expected the URL of a sensor"):
        open_source(str(path))
