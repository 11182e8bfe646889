"""``ugv detect``, ``ugv process`` and ``ugv calibrate`` on the twin's radars: one pipeline."""

import csv
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from typer.testing import CliRunner

import twin
from hardware.cli import app
from hardware.radar import Detection
from hardware.recording import Log
from hardware.records import Flag
from hardware.records.radar import write_radar_record
from twin.fidelity import Fidelity
from twin.radar.acquisition import RadarCapture
from twin.radar.device.design import radar_names

decoder = pytest.importorskip("mcap_ros2.decoder")

NUMBERS = [field.name for field in fields(Detection) if field.type is float]
Seen = Callable[[str], tuple[dict[str, np.ndarray], dict[str, np.ndarray]]]


@cache
def capture(radar: str) -> RadarCapture:
    quick = Fidelity(radar="targets")
    return twin.radar_capture(
        twin.load_scene("yard"), twin.load_radar(radar), fidelity=quick, seed=1
    )


def ugv(*arguments: str | Path) -> str:
    done = CliRunner().invoke(app, [*map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def logged(radar: str, folder: Path) -> Path:
    with Log(folder / "run.mcap") as log:
        log.record("/radar/record", capture(radar).record, host_ns=0)
    return log.path


def clouds(path: Path) -> list[dict[str, np.ndarray]]:
    """Columns of every cloud in a log, as a ROS 2 tool decodes them."""
    found = []
    with path.open("rb") as file:
        reader = SeekingReader(file, decoder_factories=[decoder.DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages(topics=["/radar/detections"]):
            names = [field.name for field in message.fields]
            table = np.frombuffer(message.data, "<f4").reshape(-1, len(names))
            assert message.width == len(table)
            assert message.is_dense == np.isfinite(table).all()
            found.append(dict(zip(names, table.T, strict=True)))
    return found


def rows(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as file:
        table = list(csv.DictReader(file))
    return {name: np.array([float(row[name] or "nan") for row in table]) for name in NUMBERS}


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """What `ugv detect` lists of a radar's burst, and the cloud that `ugv process` makes of it."""

    @cache
    def run(radar: str) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        folder = tmp_path_factory.mktemp(radar)
        write_radar_record(capture(radar).record, folder / "radar.h5")
        ugv("detect", folder / "radar.h5")
        ugv("process", logged(radar, folder), "-o", folder / "out.mcap")
        (cloud,) = clouds(folder / "out.mcap")
        return rows(folder / "radar-detections.csv"), cloud

    return run


@pytest.mark.quick(1)
@pytest.mark.parametrize("radar", radar_names())
def test_both_commands_find_the_same(radar: str, seen: Seen) -> None:
    """Every detection of `ugv detect` is a point of `ugv process`, to float32's last bit, with all
    that is known of it; x, y and z are its range and angles, and NaN where there is no angle.
    """
    listed, cloud = seen(radar)
    assert set(cloud) >= {"x", "y", "z", *NUMBERS}
    for name in NUMBERS:
        np.testing.assert_array_equal(cloud[name], listed[name].astype(np.float32), err_msg=name)
    ranges, azimuth = listed["range_m"], listed["azimuth_rad"]
    np.testing.assert_allclose(cloud["x"], ranges * np.cos(azimuth), rtol=1e-6)
    np.testing.assert_allclose(cloud["y"], ranges * np.sin(azimuth), rtol=1e-6, atol=1e-6)
    assert np.isnan(cloud["z"]).all()  # none of these arrays reaches upwards
    assert np.isnan(cloud["y"]).all() == (len(capture(radar).record.front_end.receivers_m) == 1)
    nearest = min(target.range_m for target in capture(radar).truth)
    cell_m = twin.load_radar(radar).ofdm.range_cell_m / len(capture(radar).record.carriers_hz)
    assert np.abs(cloud["range_m"] - nearest).min() < cell_m / 4


def test_points_stand_where_the_targets_do(seen: Seen) -> None:
    """Twelve virtual antennas in a row: every visible target of the yard has a point in the plane
    within 5 sigma of the errors that the cloud itself claims, and 1 % of its range for its height.
    """
    _, cloud = seen("hybrid-79-mimo")
    for target in capture("hybrid-79-mimo").truth:
        way = np.radians(target.azimuth_deg)
        place = target.range_m * np.array([np.cos(way), np.sin(way)])
        off = np.hypot(cloud["x"] - place[0], cloud["y"] - place[1])
        error = np.hypot(cloud["range_error_m"], cloud["range_m"] * cloud["azimuth_error_rad"])
        assert (off < 5 * error + 0.01 * target.range_m).any(), target


def test_a_calibrated_range_and_cross_section_reach_both(tmp_path: Path) -> None:
    """The prototype's 25 steps against a reference declared 0.2 m too near and of 3 m^2.

    The reference itself then has just that range and cross-section, and both commands still agree.
    """
    write_radar_record(capture("prototype").record, tmp_path / "radar.h5")
    log, reference = logged("prototype", tmp_path), tmp_path / "reference.h5"
    nearest = min(target.range_m for target in capture("prototype").truth)
    asked = ("--distance", f"{nearest - 0.2}", "--cross-section", "3")
    ugv("calibrate", "radar", log, "-o", reference, *asked)
    ugv("detect", tmp_path / "radar.h5", "--calibration", reference)
    ugv("process", log, "-o", tmp_path / "out.mcap", "--calibration", reference)
    listed, (cloud,) = rows(tmp_path / "radar-detections.csv"), clouds(tmp_path / "out.mcap")
    for name in ("range_m", "rcs_m2"):
        np.testing.assert_array_equal(cloud[name], listed[name].astype(np.float32), err_msg=name)
    at = np.argmin(np.abs(listed["range_m"] - nearest + 0.2))
    assert listed["range_m"][at] == pytest.approx(nearest - 0.2, abs=1e-9)
    assert listed["rcs_m2"][at] == pytest.approx(3.0)


def test_a_cut_burst_is_told_of_by_both(tmp_path: Path) -> None:
    """Slots flagged as overrun: the same warning on standard error, whatever the command."""
    made = capture("hybrid-79-slow").record
    flags = made.flags.copy()
    flags[0, 0, 40] = Flag.OVERRUN
    cut = replace(made, flags=flags)
    write_radar_record(cut, tmp_path / "radar.h5")
    with Log(tmp_path / "run.mcap") as log:
        log.record("/radar/record", cut, host_ns=0)
    for said in (
        ugv("detect", tmp_path / "radar.h5"),
        ugv("process", log.path, "-o", tmp_path / "out.mcap"),
    ):
        assert "slot 40: flagged as overrun (" in said
        assert "slots lost); processed are slots 0 to 39" in said
