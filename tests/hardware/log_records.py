"""Records and logs that the tests of the log write."""

from pathlib import Path
from typing import Any

import numpy as np

from hardware import PatternSet, SpiRecord
from hardware.recording import Log, ros
from hardware.recording.kinds import kind_of
from hardware.records import QuaternionPose, RadarFrontEnd, RadarRecord
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
