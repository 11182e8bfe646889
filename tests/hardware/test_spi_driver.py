"""The camera's driver against the reference firmware: another implementation, on a real line."""

import socket
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import serial
from asking import asking
from line_bridge import bridged
from rfc2217_port import behind_rfc2217

from hardware import PatternSet, SpiRecord, reconstruct
from hardware.drivers import DeviceError, LinkError, Patience, SpiCamera, SpiSettings
from hardware.drivers.framing import Deframer, encode
from hardware.drivers.messages import (
    MODE_CODES,
    UPLOADED,
    Configure,
    Configured,
    Refusal,
    Refused,
    Upload,
    to_frame,
)
from hardware.drivers.request_client import RequestClient
from hardware.drivers.table import table_bytes
from hardware.records import Flag, QuaternionPose, Shutter

QUICK = Patience(reply_s=0.4, attempts=3, reconnect_s=5.0, between_attempts_s=0.05)
PATTERNS = PatternSet(8, 8, 64)
SETTINGS = SpiSettings(PATTERNS, 10e-6)


def test_records_are_what_the_device_measured(firmware: Any) -> None:
    pose = QuaternionPose(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
    settings = replace(SETTINGS, gain=1, pattern_period_s=25e-6, pose=pose)
    with firmware.running("--fast") as path, SpiCamera(path, settings, patience=QUICK) as camera:
        records = list(camera.records(sets=20))
        assert camera.clock is not None
        assert vars(camera.statistics) == {
            **dict.fromkeys(vars(camera.statistics), 0),
            "frames": 40,
        }
    assert len(records) == 20
    for number, record in enumerate(records):
        np.testing.assert_array_equal(record.counts, firmware.counts(PATTERNS, gain=1))
        np.testing.assert_array_equal(record.sequence, np.arange(128) + 128 * number)
        np.testing.assert_array_equal(np.diff(record.device_time_ns), 25_000)
        flags = np.zeros(128, np.uint8)
        flags[0] = Flag.RESET if number == 0 else 0
        np.testing.assert_array_equal(record.flags, flags)
        assert (record.electrons_per_count, record.offset_counts) == (0.5, 100.0)
        assert (record.integration_time_s, record.adc_bits) == (10e-6, 16)
        assert record.pose == pose
    assert records[1].device_time_ns[0] - records[0].device_time_ns[0] == 128 * 25_000


@pytest.mark.parametrize("mode", MODE_CODES)
@pytest.mark.parametrize("order", ["natural", "sequency", "walsh", "zigzag", "custom"])
def test_patterns_by_name_or_uploaded_are_the_same(firmware: Any, order: str, mode: Any) -> None:
    """Three that the firmware computes itself, with checksums that agree; two that it is sent."""
    patterns = (
        PatternSet.of(4, 8, [0, 31, 7, 12, 1], mode)
        if order == "custom"
        else PatternSet(4, 8, 20, order, mode)  # type: ignore[arg-type]
    )
    shutters = (Shutter(1e7), Shutter(1e7, 1.0))
    settings = SpiSettings(
        patterns, 10e-6, shutters=shutters, pulse_width_s=2e-8, exposures_per_frame=7
    )
    with firmware.running("--fast") as path:
        with SpiCamera(path, settings, patience=QUICK) as camera:
            named = camera.acquire()
        with SpiCamera(path, replace(settings, upload=True), patience=QUICK) as camera:
            uploaded = camera.acquire()
    expected = np.repeat(firmware.counts(patterns), 2, axis=0)
    np.testing.assert_array_equal(named.counts, expected)
    np.testing.assert_array_equal(uploaded.counts, expected)
    assert named.pulse_width_s == 2e-8


def test_an_earlier_portion_again_takes_nothing_away(firmware: Any) -> None:
    """PROTOCOL.md: a repeated portion does no harm, however late it comes."""
    patterns = PatternSet(4, 8, 8, "natural", "plain")
    table = table_bytes(patterns)
    configure = Configure(4, 8, 8, UPLOADED, MODE_CODES.index("plain"), 0, 0, 10e-6, 0.0)
    with firmware.running("--fast") as path, serial.Serial(path, timeout=2) as line:
        ask = asking(line)
        ask(configure)
        portions = [(0, 10), (10, 10), (0, 10), (20, len(table) - 20)]
        told = [ask(Upload(a, table[a : a + n])).table_bytes for a, n in portions]
    assert told == [10, 20, 20, len(table)]


def test_a_table_of_many_portions_is_uploaded(firmware: Any) -> None:
    patterns = PatternSet(16, 32, 200, "total-variation")
    with firmware.running("--fast") as path:
        with SpiCamera(path, SpiSettings(patterns, 1e-5), patience=QUICK) as camera:
            record = camera.acquire()
        expected = np.minimum(firmware.counts(patterns), 2**16 - 1)
        np.testing.assert_array_equal(record.counts, expected)


def test_saturation_is_flagged(firmware: Any) -> None:
    patterns = PatternSet(64, 64, 8, "natural", "plain")
    with (
        firmware.running("--fast") as path,
        SpiCamera(path, SpiSettings(patterns, 1e-5), patience=QUICK) as camera,
    ):
        record = camera.acquire()
    over = firmware.counts(patterns) > 2**16 - 1
    assert over.any()
    np.testing.assert_array_equal(record.flags & Flag.SATURATED > 0, over.any(axis=1))
    assert record.counts.max() == 2**16 - 1


def test_the_image_comes_out(firmware: Any) -> None:
    with firmware.running("--fast") as path, SpiCamera(path, SETTINGS, patience=QUICK) as camera:
        image = reconstruct(camera.acquire(), "zero-fill").image
    np.testing.assert_allclose(image[0].ravel(), (37 * np.arange(64)) % 97, atol=1e-9)


def test_a_reset_device_is_set_up_and_started_again(firmware: Any) -> None:
    """Sets before the reset and after it are whole; the first after it says that there was one.
    The one that was being measured is there as far as it had come.
    """
    with (
        firmware.running("--fast", "--reset-after", "33") as path,
        SpiCamera(path, SETTINGS, patience=QUICK) as camera,
    ):
        records = list(camera.records(sets=40))
        assert camera.statistics.restarts == 1
    resets = [number for number, r in enumerate(records) if (r.flags & Flag.RESET).any()]
    assert resets == [0, 17]
    assert len(records) == 41
    cut_off = records.pop(16)
    is_there = cut_off.flags & Flag.LOST == 0
    assert 0 < np.count_nonzero(is_there) < len(is_there)
    assert is_there.tolist() == sorted(is_there.tolist(), reverse=True)
    counts = firmware.counts(PATTERNS)
    np.testing.assert_array_equal(cut_off.counts, np.where(is_there[:, None], counts, 0))
    for record in records:
        np.testing.assert_array_equal(record.counts, counts)


@pytest.mark.parametrize(
    ("fault", "uploads"), [(("--reset-after", "33"), 2), (("--stall-after", "10"), 1)]
)
def test_a_table_is_sent_again_only_to_a_device_that_lost_it(
    firmware: Any, fault: tuple[str, str], uploads: int
) -> None:
    """A reset forgets it; one that was merely started anew holds it still."""
    settings = replace(SETTINGS, patterns=PatternSet.of(8, 8, range(40, 8, -1)))
    with (
        firmware.running("--fast", *fault) as path,
        SpiCamera(path, settings, patience=replace(QUICK, reconnect_s=1.0)) as camera,
    ):
        records = list(camera.records(sets=40 if uploads > 1 else 16))
        assert camera.statistics.restarts >= 1
        assert camera.statistics.uploads == uploads
    for record in records:
        np.testing.assert_array_equal(record.counts, firmware.counts(settings.patterns))


def test_a_device_that_falls_silent_is_started_again(firmware: Any) -> None:
    with (
        firmware.running("--fast", "--stall-after", "10") as path,
        SpiCamera(path, SETTINGS, patience=replace(QUICK, reconnect_s=1.0)) as camera,
    ):
        records = list(camera.records(sets=8))
        assert camera.statistics.restarts >= 1
    assert len(records) == 8


@pytest.mark.parametrize("cuts_bytes", [[20_000, 60_000], [20_000, 20_001, 20_002]])
def test_a_broken_line_is_opened_again_and_the_run_goes_on(
    firmware: Any, cuts_bytes: list[int]
) -> None:
    """What got lost between is named and marked; all else is as measured. Also where the new line
    breaks at its first bytes.
    """
    lost: list[range] = []
    with (
        firmware.running("--fast") as path,
        bridged(path) as bridge,
        SpiCamera(bridge.url, SETTINGS, on_loss=lost.append, patience=QUICK) as camera,
    ):
        bridge.cuts_bytes = list(cuts_bytes)
        records = list(camera.records(sets=400))
        assert camera.statistics.reconnects >= len(cuts_bytes)
        assert camera.statistics.restarts == 0
        n_lost = camera.statistics.lost
    missing = {number for numbers in lost for number in numbers}
    assert n_lost == len(missing)
    check_against(firmware, records, missing)
    whole = {record.sequence[0] // 128 for record in records}
    assert whole == {n // 2 for n in range(800)} - {
        n for n in range(400) if {2 * n, 2 * n + 1} <= missing
    }


def test_a_port_behind_rfc2217_is_as_good_as_the_terminal_itself(firmware: Any) -> None:
    """Through pyserial's own server, cut once: opened again, counts those of the device."""
    slow = replace(SETTINGS, pattern_period_s=1e-4)  # 2.6 s, longer than a new line takes
    lost: list[range] = []
    with (
        firmware.running() as path,
        behind_rfc2217(path, hang_up_after_bytes=40_000) as url,
        SpiCamera(url, slow, on_loss=lost.append, patience=QUICK) as camera,
    ):
        records = list(camera.records(sets=200))
        assert camera.statistics.reconnects >= 1
        assert camera.statistics.restarts == 0
    check_against(firmware, records, {number for numbers in lost for number in numbers})
    assert 20 <= len(records) <= 200


def check_against(firmware: Any, records: list[SpiRecord], missing: set[int]) -> None:
    expected = firmware.counts(PATTERNS)
    for record in records:
        number = int(record.sequence[0]) // 128
        for place in (0, 1):
            part = slice(64 * place, 64 * place + 64)
            if 2 * number + place in missing:
                assert (record.flags[part] == Flag.LOST).all()
            else:
                assert not (record.flags[part] & Flag.LOST).any()
                np.testing.assert_array_equal(record.counts[part], expected[part])


def test_spoiled_bytes_are_lost_frames_and_nothing_else(firmware: Any) -> None:
    rng = np.random.default_rng(0)

    def spoil(data: bytes) -> bytes:
        spoiled = bytearray(data)
        if rng.random() < 0.3 and spoiled:
            at = int(rng.integers(len(spoiled)))
            spoiled[at] ^= 1 << int(rng.integers(8))
        return bytes(spoiled)

    lost: list[range] = []
    with firmware.running("--fast") as path, bridged(path) as bridge:
        stubborn = replace(QUICK, reply_s=0.2, attempts=20)
        with SpiCamera(bridge.url, SETTINGS, on_loss=lost.append, patience=stubborn) as camera:
            bridge.spoil = spoil
            records = list(camera.records(sets=300))
            assert camera.statistics.rejected > 0
    missing = {number for numbers in lost for number in numbers}
    assert missing
    check_against(firmware, records, missing)


def test_a_slow_consumer_makes_the_device_drop_whole_frames(firmware: Any) -> None:
    """In real time: the line fills up, the device says what it did not send."""
    lost: list[range] = []
    settings = replace(SETTINGS, pattern_period_s=20e-6)
    with (
        firmware.running() as path,
        SpiCamera(path, settings, on_loss=lost.append, patience=QUICK) as camera,
    ):
        records = []
        for record in camera.records():
            records.append(record)
            if len(records) == 2:
                time.sleep(1.0)
            if any((r.flags & Flag.OVERRUN).any() for r in records):
                break
    missing = {number for numbers in lost for number in numbers}
    assert missing
    check_against(firmware, records, missing)


def test_lost_patterns_are_left_out_of_the_image() -> None:
    """The image is that of the patterns that arrived, as if the others had not been asked for."""
    cells = np.random.default_rng(0).integers(0, 500, (64, 1))
    n = PATTERNS.n_exposures
    record = SpiRecord(
        counts=PATTERNS.signal(cells).astype(np.int32),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=PATTERNS,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=24,
        device="test",
        pose=QuaternionPose(),
    )
    assert record.received is record
    flags, counts = record.flags.copy(), record.counts.copy()
    flags[[5, 40, 41]], counts[[5, 40, 41]] = Flag.LOST, 0
    gappy = replace(record, flags=flags, counts=counts)
    kept = [k for k in range(64) if k not in (2, 20)]
    expected = PatternSet.of(8, 8, PATTERNS.indices[kept])
    assert gappy.received.patterns == expected
    found = reconstruct(gappy, "zero-fill")
    assert found.warnings == ("3 of 128 exposures are marked lost",)
    H = np.array([[(-1) ** int(i & j).bit_count() for j in range(64)] for i in expected.indices])
    np.testing.assert_allclose(found.image[0].ravel(), H.T @ (H @ cells[:, 0]) / 64)
    with pytest.raises(ValueError, match="flags: exposures are lost"):
        reconstruct(replace(record, flags=np.full(n, Flag.LOST, np.uint8)))
    left_out = reconstruct(gappy.received, "zero-fill")
    np.testing.assert_array_equal(left_out.image, found.image)
    (told,) = left_out.warnings
    assert told.startswith("4 of 128 exposures that the device numbered are not in the record")


# What goes wrong before anything is measured.


def test_no_line_and_no_answer_are_told_apart(firmware: Any) -> None:
    brief = Patience(reply_s=0.05, attempts=2, reconnect_s=0.1)
    with pytest.raises(LinkError, match="/dev/no-such-line"):
        SpiCamera("/dev/no-such-line", SETTINGS, patience=brief)
    with pytest.raises(ValueError, match="no-scheme"):
        SpiCamera("no-scheme://x", SETTINGS, patience=brief)
    with pytest.raises(TimeoutError, match="no answer to Identify after 2 attempts"):
        SpiCamera("loop://", SETTINGS, patience=brief)


def test_a_device_may_take_a_second_for_configure() -> None:
    """As the protocol grants it; a request sent again before would find it at the first still."""
    made = Configured(512, 64, 1, 16384, 1, 80e-6, 100e-6, 1.0, 0.0)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            host, _ = server.accept()
            with host:
                frame = next(iter(Deframer().feed(host.recv(4096))))
                time.sleep(0.7)
                host.sendall(encode(to_frame(made, frame.tag)))
                host.recv(1)

        device = threading.Thread(target=answer, daemon=True)
        device.start()
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        client = RequestClient(url, patience=Patience(attempts=1), baud=115200)
        assert client.ask(Configure(16, 16, 256, 1, 0, 0, 0, 80e-6, 0.0), Configured) == made
        client.close()
        device.join()


def test_a_busy_device_says_so() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def refuse() -> None:
            host, _ = server.accept()
            with host:
                (request,) = Deframer().feed(host.recv(100))
                refused = Refused(Refusal.BUSY, "another host is connected")
                host.sendall(encode(to_frame(refused, request.tag)))

        thread = threading.Thread(target=refuse)
        thread.start()
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(DeviceError, match="another host is connected"):
            SpiCamera(url, SETTINGS, patience=QUICK)
        thread.join()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gain": 7}, "gain: no such step"),
        ({"integration_time_s": 5.0}, "integration_time_s: outside"),
        ({"pattern_period_s": 1e-6}, "pattern_period_s: shorter"),
        ({"patterns": PatternSet(128, 64, 4)}, "8192 cells"),
    ],
)
def test_what_the_device_cannot_do_is_refused(
    firmware: Any, change: dict[str, Any], message: str
) -> None:
    with (
        firmware.running("--fast") as path,
        SpiCamera(path, replace(SETTINGS, **change), patience=QUICK) as camera,
        pytest.raises(DeviceError, match=message),
    ):
        camera.acquire()


@pytest.mark.parametrize(
    "change",
    [
        {"integration_time_s": 0.0},
        {"integration_time_s": float("nan")},
        {"pattern_period_s": -1.0},
        {"gain": 256},
        {"exposures_per_frame": -1},
        {"gain": 1.5},
        {"shutters": ()},
        {"shutters": (Shutter(float("nan")),)},
        {"shutters": (Shutter(gate_delay_s=-1e-9, gate_width_s=1e-9),)},
        {"shutters": ((1e7, 0.0),)},
        {"pose": (0.0,) * 6},
    ],
)
def test_settings_that_no_device_takes(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(change))}: "):
        replace(SETTINGS, **change)
