"""`ugv process --tracks` and `--image-every`: what one record after another adds up to."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from moving_scenes import AnalyticScene, moving_record, psnr
from radar_cubes import WIDE, Echo, cube
from ugv_command import ugv

from hardware import InputError, PatternSet, QuaternionPose, Shift, SpiRecord
from hardware.radar import Detection
from hardware.reconstruction import METHODS, measurements, reconstruct
from hardware.reconstruction.motion import Search
from hardware.recording import Log, read_messages
from hardware.records import Flag
from hardware.sliding_images import SlidingImages
from hardware.tracks import RadarTracks, cloud

STEP_NS = 10**8


def detection(range_m: float, azimuth_rad: float, rate: float) -> Detection:
    return Detection(
        range_m=range_m,
        range_rate_m_per_s=rate,
        power_w=1.0,
        snr_db=30.0,
        range_error_m=0.01,
        range_rate_error_m_per_s=0.05,
        azimuth_rad=azimuth_rad,
        azimuth_error_rad=0.005,
    )


def test_a_target_at_rest_stands_still_before_a_moving_antenna() -> None:
    """5 m/s ahead towards a post at 20 m: the post's own velocity is 0 within its error."""
    tracks = RadarTracks()
    for k in range(8):
        ahead = 20.0 - 0.5 * k
        found = [detection(ahead, 0.0, -5.0)]
        confirmed = tracks.update("/radar", found, k * STEP_NS, QuaternionPose(0.5 * k))
    (track,) = confirmed
    columns = cloud([track])
    assert columns["x"][0] == pytest.approx(20.0, abs=3 * columns["x_error_m"][0])
    speed, error = columns["velocity_x_m_per_s"][0], columns["velocity_x_error_m_per_s"][0]
    assert error < 0.5
    assert abs(speed) < 3 * error
    assert columns["hits"][0] == 7  # of the first burst the antenna's velocity is unknown


def test_sensors_are_followed_apart_and_anew_where_the_clock_runs_back() -> None:
    tracks = RadarTracks()
    for k in range(5):
        for sensor in ("/one", "/two"):
            found = [detection(10.0, 0.1, 0.0)] if sensor == "/one" else []
            confirmed = tracks.update(sensor, found, k * STEP_NS, QuaternionPose())
            assert len(confirmed) == (sensor == "/one" and k >= 3)
    assert not tracks.update("/one", [detection(10.0, 0.1, 0.0)], 0, QuaternionPose())


def test_without_an_azimuth_the_range_alone_is_told() -> None:
    tracks = RadarTracks()
    for k in range(4):
        found = [detection(10.0 - 0.1 * k, np.nan, -1.0)]
        confirmed = tracks.update("/radar", found, k * STEP_NS, QuaternionPose())
    columns = cloud(confirmed)
    assert np.isnan([columns[name][0] for name in ("x", "y", "velocity_x_m_per_s")]).all()
    assert columns["range_m"][0] == pytest.approx(9.7, abs=0.05)
    assert columns["range_rate_m_per_s"][0] == pytest.approx(-1.0, abs=0.1)
    assert {len(values) for values in cloud([]).values()} == {0}


def camera_record(number: int = 0, mode: str = "differential") -> SpiRecord:
    patterns = PatternSet(8, 8, 64, mode=mode)  # type: ignore[arg-type]
    cells = np.outer(np.hanning(8), np.hanning(8)).ravel() * 1e4
    n = patterns.n_exposures
    noise = np.random.default_rng(number).normal(scale=30.0, size=(n, 1))
    return SpiRecord(
        counts=np.rint(patterns.signal(cells[:, None]) + 1e4 + noise).astype(np.int32),
        device_time_ns=(number * n + np.arange(n, dtype=np.int64)) * 100_000,
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=31,
        device="camera",
        pose=QuaternionPose(),
    )


@pytest.mark.parametrize("mode", ["differential", "reference"])
def test_after_a_whole_set_the_sliding_image_is_that_of_the_set(mode: str) -> None:
    record = camera_record(mode=mode)
    images = list(SlidingImages(24).update("/spi", record).images)
    assert len(images) == 3  # 24, 48 and all 64 patterns
    measured = measurements(record)
    values, variance = measured.values[:, 0], float(measured.noise_variance[0])
    expected = METHODS["lmmse"](values, variance, record.patterns)[0].reshape(8, 8)
    # The same estimator by other sums; with what a full set's plan rounds.
    np.testing.assert_allclose(images[-1][1][0], expected, atol=1e-3 * np.ptp(expected))
    per_pattern = 2 if mode == "differential" else 1
    head = record.patterns.n_exposures - 64 * per_pattern
    times = [time for time, _ in images]
    assert times == [record.device_time_ns[head + per_pattern * n - 1] for n in (24, 48, 64)]


@pytest.mark.parametrize("mode", ["plain", "s-matrix"])
def test_cells_that_no_exposure_tells_have_no_value(mode: str) -> None:
    """The first cell of a plain set or an S-matrix: lit always, or never."""
    record = camera_record(mode=mode)
    (*_, (_, images)) = SlidingImages(24).update("/spi", record).images
    np.testing.assert_array_equal(np.isnan(images[0]), np.isnan(reconstruct(record).image[0]))
    assert np.isnan(images).sum() == 1


def test_lost_patterns_are_passed_over() -> None:
    sliding = SlidingImages(64)
    ((_, whole),) = sliding.update("/spi", camera_record()).images
    flags = np.zeros(128, np.uint8)
    flags[40:48] = Flag.LOST
    ((_, after),) = sliding.update("/spi", replace(camera_record(1), flags=flags)).images
    assert np.abs(after - whole).max() < 0.05 * np.ptp(whole)
    with pytest.raises(InputError, match=r"^every: 0"):
        SlidingImages(0)


SIDE = 16
SCENE = AnalyticScene.of(3, SIDE, 40.0)


def moving_sets(right_cells: Callable[[float], float], mode: str = "differential"):
    """Three records, one after another, of a picture that moves, and its cells at a time, s."""

    def cells(time_s: float) -> np.ndarray:
        return SCENE.cells(SIDE, 0.3 * right_cells(time_s), right_cells(time_s))

    patterns = PatternSet(SIDE, SIDE, SIDE**2, "interleaved", mode=mode)  # type: ignore[arg-type]
    records = []
    for k in range(3):
        made = moving_record(
            lambda t, k=k: cells(t + k).ravel(), patterns, noise=0.01, seed=k, background=1e6
        )
        records.append(replace(made, device_time_ns=made.device_time_ns + k * 10**9))
    first = records[0].device_time_ns
    return records, cells, 5e-10 * (first[0] + first[-1])


def levels(right_cells: Callable[[float], float], motion: Any, every: int = 64) -> np.ndarray:
    """PSNR of the images of every record, dB, (n_records, n_images)."""
    records, cells, middle_s = moving_sets(right_cells)
    sliding, found = SlidingImages(every, motion), []
    for record in records:
        between = sliding.update("/spi", record).images
        found.append([psnr(x[0] / 1e5, cells(1e-9 * ns - middle_s)) for ns, x in between])
    return np.array(found)


@pytest.mark.parametrize("cells", [pytest.param(0.0, marks=pytest.mark.thorough), 4.0])
def test_a_shift_that_the_record_tells_is_the_prediction(cells: float) -> None:
    """Better by some 4 dB than where values age; of a scene at rest the images are the same."""
    aged, told = (levels(lambda t: cells * t, motion) for motion in (None, Search()))
    gain_db = (told - aged)[1:].mean()
    assert gain_db > 3 if cells else np.array_equal(told, aged)


@pytest.mark.thorough
def test_values_before_a_turn_moved_as_they_did_before() -> None:
    """Motion that is reversed between the second set and the third: where the new velocity was
    taken for the values before it, images were 7 to 11 dB worse than where values age.
    """
    there_and_back = lambda t: 6.0 * (t if t < 1.5 else 3.0 - t)  # noqa: E731
    aged, told = (levels(there_and_back, motion) for motion in (None, Search()))
    assert (told - aged)[2].min() > 2


def test_one_image_a_set_takes_patterns_at_their_own_times() -> None:
    """As whole sets do; patterns between two images were taken as of one time."""
    known = levels(lambda t: 4.0 * t, Shift(1.2, 4.0), every=256)
    assert known[:, 0].min() > 8 + levels(lambda t: 4.0 * t, None, every=256)[:, 0].max()


@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix"])
def test_motion_predicts_no_values_that_hold_a_mean_of_the_set(mode: str) -> None:
    """They were taken as of one time: images were up to 5 dB worse than where values age."""
    records, _, _ = moving_sets(lambda t: 4.0 * t, mode)
    told = SlidingImages(64, Shift(1.2, 4.0)).update("/spi", records[0])
    aged = SlidingImages(64).update("/spi", records[0])
    assert told.motion is None
    assert "motion: does not predict images between whole sets" in told.warnings[0]
    for (_, one), (_, other) in zip(told.images, aged.images, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("every", "motion", "told"),
    [(1.5, None, "every: 1.5"), (True, None, "every: True"), (8, (0, 4), r"motion: \(0, 4\)")],
)
def test_wrong_arguments_are_named(every: Any, motion: Any, told: str) -> None:
    with pytest.raises(InputError, match=told):
        SlidingImages(every, motion)


def test_the_command(tmp_path: Path) -> None:
    """Four bursts of a target that comes nearer: a track from the fourth on; four images a set."""
    with Log(tmp_path / "run.mcap") as log:
        for k in range(4):
            made = cube(WIDE, [Echo((6.0 - 0.1 * k, 0.0, 0.0))], noise_w=1e-10, seed=k)
            later = replace(made, device_time_ns=made.device_time_ns + k * STEP_NS)
            log.record("/radar/record", later, host_ns=1 + k)
        log.record("/spi/record", camera_record(), host_ns=9)
    out = tmp_path / "out.mcap"
    done = ugv("process", tmp_path / "run.mcap", "-o", out, "--tracks", "--image-every", "16")
    assert done.returncode == 0, done.stderr
    bursts = [line for line in done.stdout.splitlines() if "burst 0" in line]
    assert [line.rsplit(", ", 1)[1] for line in bursts] == [
        "0 tracks (needs 3 more bursts)",
        "0 tracks (needs 2 more bursts)",
        "0 tracks (needs 1 more burst)",
        "1 track",
    ]
    assert "/spi/record, record 1, 0.000 s: 4 images" in done.stdout
    topics = [one.topic for one in read_messages(out)]
    assert (topics.count("/radar/tracks"), topics.count("/spi/image")) == (4, 4)


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("motion", "told"),
    [
        ("radar", "--motion: radar: needs whole sets, expected no --image-every"),
        ("m.csv", "m.csv: its time 0 is the middle of a whole set, expected no --image-every"),
        ("m.toml", "m.toml: its time 0 is the middle of a whole set, expected no --image-every"),
        ("0,3", None),
        ("estimate", None),
    ],
)
def test_motions_between_whole_sets(motion: str, told: str | None, tmp_path: Path) -> None:
    """Now is no middle of a set: what changes over time, or where it stands, is refused."""
    with Log(tmp_path / "run.mcap") as log:
        log.record("/radar/record", cube(WIDE, [], noise_w=1e-10), host_ns=1)
        log.record("/spi/record", camera_record(), host_ns=9)
    (tmp_path / "m.csv").write_text("time_s,down_cells,right_cells\n-1,0,-2\n1,0,2\n")
    (tmp_path / "m.toml").write_text("background_cells_per_s = [0.0, 3.0]\n")
    given = str(tmp_path / motion) if "." in motion else motion
    command = ("process", tmp_path / "run.mcap", "-o", tmp_path / "out.mcap", "--motion", given)
    done = ugv(*command, "--image-every", "16")
    if told is None:
        assert done.returncode == 0, done.stderr
        assert "4 images" in done.stdout
    else:
        assert done.returncode == 2
        assert told in done.stderr
