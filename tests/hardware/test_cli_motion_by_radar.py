"""``ugv process LOG --motion radar`` of logs that are whole, cut, damaged or not calibrated."""

import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from radar_cubes import MIMO, WIDE, Echo, cube
from spi_records import record_of, scene
from ugv_command import ugv

from hardware import PatternSet, cli
from hardware.recording import Log, read_messages, read_records, ros

N, FIELD = 8, (0.35, 0.35)
EXTRINSICS = {"spi": [0.0, 0, 0, 1, 0, 0, 0], "radar": [0.0, 0, -0.3, 1, 0, 0, 0]}
PLACES = "spi = [0, 0, 0, 1, 0, 0, 0]\nradar = [0, 0, -0.3, 1, 0, 0, 0]\n"
RIG = f"{PLACES}[field_deg]\nspi = [20, 20]\n"


def write(
    path: Path,
    topics: tuple[str, ...] = ("/radar/record", "/spi/record"),
    mounted: bool = True,
    bursts: int = 1,
) -> None:
    """A frame of 0.1 s, and one record of a radar within it."""
    patterns = PatternSet(N, N, N * N, "interleaved")
    light = patterns.signal(1e4 * scene(N, N).reshape(-1, 1))
    camera = record_of(light, patterns)
    camera.device_time_ns[:] = np.arange(len(light)) * (10**8 // len(light))
    pose = np.tile([0, 0, -0.3, 1, 0, 0, 0.0], (bursts, 1))
    radar = cube(WIDE, [Echo((7.0, 0.1, 0.0))], pose=pose, noise_w=1e-10, **MIMO)
    with Log(path, extrinsics=EXTRINSICS if mounted else None) as log:
        for topic in topics:
            made = radar if "radar" in topic else camera
            log.record(topic, made, host_ns=10**9, frame=topic.split("/")[-2])
        if mounted:
            info = ros.camera_info(FIELD, (N, N), 0, "spi")
            log.message("/spi/camera_info", ros.CAMERA_INFO, info, 10**9, 10**9)


def test_what_is_unknown_is_told_before_anything_is_written(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", mounted=False)
    out = tmp_path / "out.mcap"
    done = ugv("process", tmp_path / "run.mcap", "--motion", "radar", "-o", out)
    assert done.returncode == 2
    assert "the pose on the rig of '/radar' is unknown (known: none)" in done.stderr
    assert not out.exists()
    rig = tmp_path / "rig.toml"
    rig.write_text(PLACES)
    done = ugv("process", tmp_path / "run.mcap", "--motion", "radar", "-o", out, "--rig", rig)
    assert "the field of '/spi' is unknown (known: none)" in done.stderr
    assert not done.stdout
    assert not out.exists()


def test_a_log_of_two_sources_takes_the_file_of_the_docs(tmp_path: Path) -> None:
    """`ugv capture` puts the second source's topics under /source2."""
    write(tmp_path / "run.mcap", ("/source2/radar/record", "/spi/record"), mounted=False)
    (tmp_path / "rig.toml").write_text(RIG)
    arguments = ["--motion", "radar", "--rig", tmp_path / "rig.toml", "-o", tmp_path / "out.mcap"]
    done = ugv("process", tmp_path / "run.mcap", *arguments)
    assert done.returncode == 0, done.stderr
    assert "motion: not compensated" in done.stdout


def test_a_sensor_that_damage_hides_is_not_said_to_be_missing(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write(path, mounted=False)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    done = ugv("process", path, "--motion", "radar", "-o", tmp_path / "out.mcap")
    assert done.returncode == 2
    assert "no SpiRecord in it (it ends within a record), expected both sensors" in done.stderr


def test_the_word_radar_is_among_those_expected(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap")
    done = ugv("process", tmp_path / "run.mcap", "--motion", "radr", "-o", tmp_path / "out.mcap")
    assert done.stderr.startswith("ugv: error: --motion: 'radr': expected `estimate`")
    assert "`radar`" in done.stderr


def test_the_same_log_gives_the_same_bytes_however_long_it_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A machine on which a second passes from message to message."""
    source = tmp_path / "run.mcap"
    write(source)
    before, made = source.read_bytes(), []
    for name, slow in (("quick", False), ("slow", True)):
        if slow:
            monkeypatch.setattr("hardware.recording.log.time.monotonic", count().__next__)
        out = tmp_path / f"{name}.mcap"
        monkeypatch.setattr(
            sys, "argv", ["ugv", "process", str(source), "--motion", "radar", "-o", str(out)]
        )
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert not ended.value.code, capsys.readouterr().err
        made.append(out.read_bytes())
    assert made[0] == made[1]
    assert source.read_bytes() == before


def test_bursts_of_one_record_keep_their_times_without_a_clock(tmp_path: Path) -> None:
    """They came together, when the last had ended: each is as long before as its middle."""
    write(tmp_path / "run.mcap", bursts=3)
    done = ugv("process", tmp_path / "run.mcap", "-o", tmp_path / "out.mcap")
    assert done.returncode == 0, done.stderr
    stamps = [
        one.message.publish_time
        for one in read_messages(tmp_path / "out.mcap")
        if one.topic == "/radar/detections"
    ]
    (record,) = (
        one.record for one in read_records(tmp_path / "run.mcap") if one.topic == "/radar/record"
    )
    half_ns = round(1e9 * record.waveform.n_slots * record.waveform.slot_period_s / 2)
    begun = record.device_time_ns[:, 0, 0]
    assert stamps == (10**9 + begun - begun[-1] - half_ns).tolist()
    assert len(set(stamps)) == 3
