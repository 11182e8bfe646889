"""The commands around the log, as a user runs them."""

import csv
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_records import radar_record
from radar_cubes import WIDE, Echo, cube
from ugv_command import SETTINGS, ugv

import hardware
from hardware import PatternSet, SpiRecord, own_patterns, reconstruct
from hardware.capture import capture
from hardware.drivers import SpiCamera, SpiSettings
from hardware.drivers.clock import ClockModel
from hardware.drivers.messages import State
from hardware.drivers.settings import read_settings, write_settings
from hardware.patterns import Patterns
from hardware.recording import Log, read_messages, read_records
from hardware.records import QuaternionPose, Shutter


def record(cells: np.ndarray, device: str = "camera") -> SpiRecord:  # type: ignore[type-arg]
    patterns = PatternSet(8, 8, 64)
    n = patterns.n_exposures
    return SpiRecord(
        counts=np.rint(patterns.signal(cells.reshape(64, 1)) + 50).astype(np.int32),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=2.0,
        offset_counts=50.0,
        adc_bits=24,
        device=device,
        pose=QuaternionPose(),
    )


def test_capture_process_info_recover_replay(firmware: Any, tmp_path: Path) -> None:
    settings, run = tmp_path / "camera.toml", tmp_path / "run.mcap"
    settings.write_text(SETTINGS)
    with firmware.running() as path:
        done = ugv("capture", path, "-o", run, "--settings", settings, "--records", "5")
    assert done.returncode == 0, done.stderr
    records = list(read_records(run))
    assert len(records) == 5
    expected = firmware.counts(PatternSet(8, 8, 64))
    for received in records:
        np.testing.assert_array_equal(received.record.counts, expected)  # type: ignore[union-attr]
        assert received.clock is not None
    out = tmp_path / "images.mcap"
    done = ugv("process", run, "-o", out, "--method", "zero-fill")
    assert done.returncode == 0, done.stderr
    images = [found for found in read_messages(out) if found.topic == "/spi/image"]
    assert len(images) == 5
    pixels = np.frombuffer(images[0].message.data[-4 * 128 :], "<f4").reshape(8, 16)
    picture = reconstruct(records[0].record, "zero-fill").picture  # type: ignore[arg-type]
    np.testing.assert_allclose(pixels, picture, rtol=1e-6, atol=1e-4)
    assert ugv("process", run, "--method", "zero-fill").returncode == 0
    assert (tmp_path / "run-processed.mcap").read_bytes() == out.read_bytes()
    exists = ugv("process", run, "--method", "zero-fill")
    assert exists.returncode == 2
    assert "run-processed.mcap: exists: expected a new log: name another by -o, or" in exists.stderr
    again = ugv("process", f"replay:{run}", "-o", tmp_path / "again.mcap", "--method", "zero-fill")
    assert again.returncode == 0, again.stderr
    assert len(list(read_messages(tmp_path / "again.mcap"))) == 5

    run.write_bytes(run.read_bytes()[:-50])
    assert "not finished" in ugv("info", run).stdout
    assert "10 messages" in ugv("recover", run).stdout
    said = ugv("info", run).stdout
    assert "not finished" not in said
    assert "/spi/record: 5 x ugv_msgs/msg/SpiRecord" in said
    assert ugv("replay", run, "--speed", "100").stdout.count("/spi/record") == 5


def test_exit_statuses_tell_what_became_of_a_damaged_log(tmp_path: Path) -> None:
    """1: done with what is whole, some is lost. 2: there is nothing to work on."""
    whole, run = tmp_path / "whole.mcap", tmp_path / "run.mcap"
    with Log(whole, flush_s=1e9) as log:
        for n in range(4):
            log.record("/spi/record", record(np.full(64, 9.0)), host_ns=n)
            log.flush()
    data = bytearray(whole.read_bytes())
    data[data.index(b"zstd") + 60] ^= 1
    run.write_bytes(data)
    for arguments in (
        ["info", run],
        ["replay", run],
        ["process", run, "-o", tmp_path / "out.mcap"],
        ["process", f"replay:{run}?pace=fast", "-o", tmp_path / "again.mcap"],
        ["capture", f"replay:{run}?pace=fast", "-o", tmp_path / "copy.mcap"],
        ["recover", run],
    ):
        done = ugv(*arguments)
        assert done.returncode == 1, done.stderr
        assert "2 messages" in done.stdout + done.stderr
        assert "Traceback" not in done.stderr
    assert len(list(read_records(run))) == len(list(read_records(tmp_path / "copy.mcap"))) == 3
    assert ugv("info", run).returncode == ugv("recover", run).returncode == 0
    assert (tmp_path / "run-damaged.mcap").read_bytes() == data

    empty, noise = tmp_path / "empty.mcap", tmp_path / "noise.mcap"
    empty.write_bytes(b"")
    noise.write_bytes(b"\x89MCAP0\r\n" + np.random.default_rng(0).bytes(20_000))
    for path in (empty, noise):
        for command in ("info", "replay", "recover", "export"):
            more = ["-o", tmp_path / "iq"] if command == "export" else []
            done = ugv(command, path, *more)
            assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "--out: is empty" in ugv("export", whole, "-o", "").stderr
    done = ugv("export", whole, "-o", tmp_path / "iq")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert not (tmp_path / "iq").exists()


def test_info_tells_of_sets_that_never_came(tmp_path: Path) -> None:
    """Flags are of exposures that are there. Of a drive of four sets the second and third are
    missing, by the device's own numbers; a device that starts anew, and wraps round, misses none.
    """
    made = record(np.full(64, 9.0))
    n = len(made.sequence)
    for starts, missing in (([0, 3 * n], 2 * n), ([0, n, 0, n], 0), ([2**32 - n, 0], 0)):
        run = tmp_path / f"{missing}-{len(starts)}.mcap"
        with Log(run) as log:
            for host_ns, start in enumerate(starts):
                numbers = (start + np.arange(n)).astype(np.uint32)
                log.record("/spi/record", replace(made, sequence=numbers), host_ns=host_ns)
        told = ugv("info", run).stdout
        assert "flags: none" in told
        expected = f"missing: {missing} exposures of /spi/record, between its records"
        assert (expected in told) is (missing > 0)
        assert ("missing" in told) is (missing > 0)


def test_an_unfinished_log_is_told_where_it_is_replayed_from(tmp_path: Path) -> None:
    """Cut at the end of a chunk nothing is lost: status 0, and what finishes the log is said."""
    run = tmp_path / "run.mcap"
    with Log(run, flush_s=1e9) as log:
        log.record("/spi/record", record(np.full(64, 9.0)), host_ns=0)
        log.flush()
        flushed = run.stat().st_size
    run.write_bytes(run.read_bytes()[:flushed])
    for command, source in (("process", run), ("capture", f"replay:{run}?pace=fast")):
        done = ugv(command, source, "-o", tmp_path / f"{command}.mcap")
        assert done.returncode == 0, done.stderr
        assert "not finished: it ends before its footer; `ugv recover" in done.stderr


def test_sources_at_once_keep_their_topics_and_their_records(firmware: Any, tmp_path: Path) -> None:
    """Two cameras and a log, all to the end of what was asked for; each camera is stopped."""
    (tmp_path / "camera.toml").write_text(SETTINGS)
    settings = read_settings(tmp_path / "camera.toml")
    with Log(tmp_path / "old.mcap") as log:
        log.record("/spi/record", record(np.full(64, 9.0)), host_ns=0)
    with firmware.running() as one, firmware.running() as two:
        with Log(tmp_path / "run.mcap") as log:
            urls = [one, two, f"replay:{tmp_path / 'old.mcap'}"]
            assert sum(1 for _ in capture(urls, log, settings, records=30)) == 30
        for path in (one, two):
            with SpiCamera(path, settings) as camera:
                assert camera.status().state == State.ARMED
    found = list(read_records(tmp_path / "run.mcap"))
    topics = Counter(received.topic for received in found)
    assert set(topics) == {"/spi/record", "/source2/spi/record", "/source3/spi/record"}
    assert topics["/source3/spi/record"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["capture", "/dev/none", "-o", "new.mcap"], "/dev/none: a camera needs settings"),
        (["info", "missing.mcap"], "missing.mcap"),
        (["recover", "missing.mcap"], "missing.mcap"),
        (["process", "missing.mcap", "-o", "new.mcap"], "missing.mcap"),
        (["capture", "replay:missing.mcap", "-o", "new.mcap"], "missing.mcap"),
    ],
)
def test_errors_are_one_line_and_leave_no_log(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(Path(hardware.__file__).parents[1]))
    done = ugv(*arguments)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert message in done.stderr
    assert not list(tmp_path.iterdir())


def test_each_burst_becomes_a_cloud_of_its_own_time(tmp_path: Path) -> None:
    """Two bursts, 0.5 m farther along each time: two clouds, stamped with the times of their
    middles on the host's clock, a target at 6.0 and 5.5 m.
    """
    pose = np.array([[0, 0, 0, 1, 0, 0, 0], [0.5, 0, 0, 1, 0, 0, 0.0]])
    made = cube(WIDE, [Echo((6.0, 0.0, 0.0))], pose=pose, noise_w=1e-10)
    with Log(tmp_path / "run.mcap") as log:
        log.record("/radar/record", made, host_ns=9, clock=ClockModel(0, -(10**9), 0.0, 1.0))
    done = ugv("process", tmp_path / "run.mcap", "-o", tmp_path / "out.mcap")
    assert done.returncode == 0, done.stderr
    assert "burst 0: 1 detections, the strongest at 6.0" in done.stdout
    assert "burst 1: 1 detections, the strongest at 5.5" in done.stdout
    clouds = [one.message for one in read_messages(tmp_path / "out.mcap")]
    half_ns = round(1e9 * made.waveform.n_slots * made.waveform.slot_period_s / 2)
    middles = made.device_time_ns[:, 0, 0] + 10**9 + half_ns
    assert [one.publish_time for one in clouds] == middles.tolist()


@pytest.mark.library("sigmf")
def test_export_writes_one_capture_a_step(tmp_path: Path) -> None:
    made = radar_record()
    with Log(tmp_path / "run.mcap") as log:
        log.record("/../radar/record", made)
    done = ugv("export", tmp_path / "run.mcap", "-o", tmp_path / "iq")
    assert done.returncode == 0, done.stderr
    names = sorted(path.name for path in (tmp_path / "iq").iterdir())
    assert names == ["radar-000000.sigmf-data", "radar-000000.sigmf-meta"]
    interleaved = np.moveaxis(made.iq, 3, 4).astype("<i2")  # receivers within each sample
    assert (tmp_path / "iq" / names[0]).read_bytes() == interleaved.tobytes()
    assert len(json.loads((tmp_path / "iq" / names[1]).read_text())["captures"]) == 6


def test_documents_hold_what_is_printed_and_written(tmp_path: Path) -> None:
    """`ugv info` of a log, and `ugv detect` of a record, whose CSV has the same columns."""
    with Log(tmp_path / "run.mcap") as log:
        log.record("/spi/record", record(np.full(64, 9.0)), host_ns=0)
        log.record("/radar/record", radar_record(), host_ns=10**9)
    content = json.loads(ugv("info", tmp_path / "run.mcap", "--json").stdout)
    counts = {topic["topic"]: topic["messages"] for topic in content["topics"]}
    assert counts["/spi/record"] == counts["/radar/record"] == 1
    assert not content["fault"]
    made = cube(WIDE, [Echo((6.0, 0.0, 0.0))], noise_w=1e-10)
    hardware.write_radar_record(made, tmp_path / "radar.h5")
    done = ugv("detect", tmp_path / "radar.h5", "--json")
    found = json.loads(done.stdout)["detections"]
    with (tmp_path / "radar-detections.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(found) == len(rows) >= 1
    assert list(found[0]) == list(rows[0])
    assert found[0]["range_m"] == float(rows[0]["range_m"])
    assert found[0]["azimuth_rad"] is None  # of one antenna
    assert rows[0]["azimuth_rad"] == ""


def test_settings_name_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(SETTINGS)
    assert read_settings(path).patterns == PatternSet(8, 8, 64)
    for broken, message in (
        (SETTINGS.replace("1e-5", "-1"), "integration_time_s: -1"),
        (SETTINGS.replace("1e-5", "true"), "integration_time_s: True, expected a number"),
        (SETTINGS.replace("integration_time_s = 1e-5", ""), "toml: integration_time_s: missing"),
        (SETTINGS.replace("rows = 8", ""), r"patterns\.rows: missing"),
        (SETTINGS.replace("rows = 8", 'rows = "8"'), r"patterns\.rows: '8', expected a whole"),
        (SETTINGS + "rate = 2", r"patterns\.rate: no such field, expected rows, columns"),
        ("integration_time_s = 1e-5", "patterns: missing: expected a table"),
        ('{"format": "ugv-radio-setup"}', "no valid TOML: .* expected a camera's settings"),
        ("[acquisition]", "acquisition: no such field, expected patterns, integration_time_s"),
        (SETTINGS.replace("rows = 8", "rows = 7"), "rows: 7"),
        ("colour = 1\n" + SETTINGS, "colour"),
        ("x", "camera.toml"),
    ):
        path.write_text(broken)
        with pytest.raises(ValueError, match=message):
            read_settings(path)


@pytest.mark.parametrize(
    "patterns",
    [
        PatternSet(8, 4, 16, "zigzag", "reference"),
        PatternSet.of(4, 4, [5, 0, 3], "plain"),
        own_patterns(np.arange(32).reshape(2, 4, 4) % 3 == 0, "plain"),
    ],
)
def test_settings_are_read_as_written(tmp_path: Path, patterns: Patterns) -> None:
    written = SpiSettings(
        patterns,
        1 / 3e6,
        pattern_period_s=1e-5 / 3,
        shutters=(Shutter(1e7, 0.1), Shutter(1e7, 2 / 3)),
        pulse_width_s=1e-8,
        pose=QuaternionPose(1, 2, 3),
        exposures_per_frame=64,
        upload=True,
    )
    write_settings(written, tmp_path / "camera.toml")
    assert vars(read_settings(tmp_path / "camera.toml")) == vars(written)


def test_a_negative_number_of_records_or_patterns_is_an_error(tmp_path: Path) -> None:
    """Records -1 never ended."""
    out = str(tmp_path / "run.mcap")
    for given in (
        ("capture", "replay:none.mcap", "-o", out, "--records", "-1"),
        ("process", "none.mcap", "-o", out, "--records", "-1"),
        ("process", "none.mcap", "-o", out, "--image-every", "-1"),
    ):
        ended = ugv(*given)
        assert ended.returncode == 2
        assert "-1 is not in the range x>=0" in ended.stderr
