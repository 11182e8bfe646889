"""Images of direct sums: places, levels, resolution, walls, broken bursts; the commands."""

import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from radar_cubes import BAND, CARRIERS, MIMO, STEP, C, Echo, cube, peaks, track, two_cylinders
from ugv_command import ugv

from hardware.radar import OfdmWaveform
from hardware.radar.imaging import Wall, cross_resolution_m, image, one_way_m
from hardware.records import Flag, write_radar_record

DOWN, CROSS = np.linspace(0.5, 1.5, 101), np.linspace(-0.5, 0.5, 101)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (4e3, -7e3, 20.0)])
def test_a_point_is_at_its_place_with_its_power(origin) -> None:
    """Also far from the world's origin. The peak is the mean of all bursts' echoes."""
    place = np.array([0.93, 0.21, 0.0]) + origin
    record = cube(BAND, [Echo(tuple(place), 1e-9)], pose=track(33, 0.96, origin))
    found = image(record, DOWN, CROSS)
    np.testing.assert_allclose(peaks(found, 1)[0], [0.93, 0.21], atol=0.011)
    at = np.abs(found.value).max()
    assert 20 * np.log10(at / np.sqrt(1e-9)) == pytest.approx(0, abs=0.05)


def test_against_the_definition() -> None:
    """Sum over bursts and frequencies, each turned by the exact delay: within the tolerance."""
    record = cube(BAND, [Echo((0.9, 0.1, 0.0)), Echo((1.2, -0.2, 0.0))], pose=track(9, 0.5))
    found = image(record, DOWN[::20], CROSS[::20], tolerance=1e-3)
    from hardware.radar import channel

    exact = np.zeros((6, 6), dtype=complex)
    f = BAND.carrier_hz + BAND.frequency_offsets_hz
    for burst, pose in enumerate(record.pose):
        seen = channel(record, burst=burst)[:, 0]
        for i, down in enumerate(DOWN[::20]):
            for j, cross in enumerate(CROSS[::20]):
                delay = 2 / C * np.hypot(down, cross - pose[1])
                exact[i, j] += np.mean(seen * np.exp(2j * np.pi * f * delay)) / 9
    assert np.abs(found.value - exact).max() < 2e-3 * np.sqrt(1e-9)


def test_a_turned_vehicle_sees_left_on_its_left() -> None:
    poses = track(33, 0.96)
    turned = poses.copy()
    turned[:, :2] = poses[:, [1, 0]] * [-1, 1]  # drives along -x, looks along y
    turned[:, 3:] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    record = cube(BAND, [Echo((-0.2, 1.0, 0.0))], pose=turned)
    np.testing.assert_allclose(peaks(image(record, DOWN, CROSS), 1)[0], [1.0, 0.2], atol=0.011)


def test_several_antennas_add_up() -> None:
    """Two transmitters and two receivers, each with its own delay."""
    left = np.array([[0, 0, 0], [0, 0.3, 0]])
    record = cube(
        replace(BAND, n_slots=2),
        [Echo((1.0, -0.1, 0.0), 1e-9)],
        pose=track(17, 0.5),
        transmitter=(0, 1),
        transmitters_m=left,
        receivers_m=-left,
    )
    found = image(record, DOWN, CROSS)
    np.testing.assert_allclose(peaks(found, 1)[0], [1.0, -0.1], atol=0.011)
    assert 20 * np.log10(np.abs(found.value).max() / np.sqrt(1e-9)) == pytest.approx(0, abs=0.1)


def test_resolution_is_equations_6_and_7() -> None:
    """D lambda / (2 L) and c / (2 N df): 0.3 m down-range, 5 cm cross-range for the paper's."""
    record = cube(replace(BAND, carrier_hz=2.8e9), [Echo((0.9, 0, 0))], pose=track(5, 0.96))
    found = image(record, np.array([0.9]), np.array([0.0]))
    assert found.down_resolution_m == pytest.approx(0.2998, abs=1e-3)
    assert found.cross_resolution_m == pytest.approx(0.9 * C / 2.8e9 / 1.92, rel=1e-9)
    assert found.cross_resolution_m == pytest.approx(0.05, abs=1e-3)
    assert cross_resolution_m(0.9, 0.1, np.zeros((1, 3))) == np.inf


@pytest.mark.parametrize(
    ("pose", "antennas", "told"),
    [
        (track(1, 0.0), {}, "one burst: the image shows ranges, and the same in every direction"),
        (track(3, 0.0), {}, "3 bursts whose antenna does not move: the image shows ranges"),
        (track(1, 0.0), MIMO, "one burst: directions come from the 8 pairs of antennas alone"),
        (track(3, 1e-3), {}, "the track resolves 60 m across, more than the image's width"),
    ],
)
def test_what_an_image_without_a_track_shows_is_told(pose, antennas, told: str) -> None:
    record = cube(replace(BAND, n_slots=2), [Echo((0.9, 0.2, 0))], pose=pose, **antennas)
    found = image(record, DOWN, CROSS)
    assert told in found.warnings[-1]
    alike = np.ptp(np.abs(found.value[[0, 0], [0, 100]])) < 1e-3 * np.abs(found.value).max()
    assert alike or found.shows_directions
    assert not image(cube(BAND, [Echo((0.9, 0.2, 0))], pose=track(33, 0.96)), DOWN, CROSS).warnings


def test_the_wall_bends_rays_by_the_shortest_optical_way() -> None:
    """Fermat by brute force over where the ray enters and leaves the slab."""
    from scipy.optimize import minimize

    wall = Wall(0.4, 0.2, 5.0)
    antenna, cell = np.array([0.0, 0.3, 0.0]), np.array([1.5, -0.9, 0.0])

    def way(ends: np.ndarray) -> float:
        points = np.array([[0, 0.3], [0.4, ends[0]], [0.6, ends[1]], [1.5, -0.9]])
        legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return float(legs @ [1, np.sqrt(5), 1])

    shortest = minimize(
        way, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}
    )
    assert one_way_m(antenna, cell[None], wall)[0] == pytest.approx(shortest.fun, abs=1e-9)
    before = np.array([[0.3, 0.0, 0.0]])
    assert one_way_m(antenna, before, wall)[0] == pytest.approx(np.hypot(0.3, 0.3))


def test_focus_through_a_wall() -> None:
    """A wall of 20 cm, permittivity 5, sets an echo back by 25 cm ahead, and blurs it at an angle:
    unaccounted for, the peak stands 15 to 25 cm too far and below the focused one.
    """
    wall = Wall(0.3, 0.2, 5.0)

    def path_m(place, antenna):
        return one_way_m(antenna, np.atleast_2d(place), wall)

    record = cube(BAND, [Echo((1.0, 0.15, 0.0))], pose=track(33, 0.96), path_m=path_m)
    down = np.linspace(0.7, 1.7, 101)
    focused, ignored = image(record, down, CROSS, wall=wall), image(record, down, CROSS)
    np.testing.assert_allclose(peaks(focused, 1)[0], [1.0, 0.15], atol=0.011)
    assert 0.15 < peaks(ignored, 1)[0, 0] - 1.0 < 0.2 * (np.sqrt(5) - 1) + 0.01
    assert np.abs(ignored.value).max() < 0.95 * np.abs(focused.value).max()


@pytest.mark.parametrize(
    "values",
    [(1.0, -0.1, 4.0), (1.0, 0.1, 0.5), (1.0, np.inf, 4.0), (np.nan, 0.1, 4.0), (-1.0, 0.1, 4.0)],
)
def test_impossible_walls(values) -> None:
    with pytest.raises(ValueError, match=r"wall: (thickness|distance)"):
        Wall(*values)


def _copies(record, place_m: tuple[float, float]) -> list[tuple[float, float]]:
    """Distance from a point's place and level in dB of what its image shows beside it, by a scan of
    the whole image: the highest over down-range of each cross-range, with its own maxima.
    """
    down, cross = np.arange(0.4, 2.8, 0.02), np.arange(-1.4, 1.4, 0.005)
    height = np.abs(image(record, down, cross).value).max(axis=0)
    tops = 1 + np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] > height[2:]))
    own = tops[np.argmin(np.abs(cross[tops] - place_m[1]))]
    beside = [k for k in tops if k != own]
    return [(abs(cross[k] - cross[own]), 20 * np.log10(height[k] / height[own])) for k in beside]


@pytest.mark.parametrize(
    ("n_stops", "antennas"), [(5, {}), (9, {}), (4, {"receivers_m": np.array([[0, 0.02, 0]])})]
)
def test_copies_of_stops_too_far_apart_are_told(n_stops: int, antennas) -> None:
    """Stops 0.2 m apart at 60 mm of wavelength: an echo shows again 0.15 of its distance beside
    itself. Distance within a resolution cell and level within 1 dB of the image's own.
    """
    far = replace(BAND, carrier_hz=5e9)
    record = cube(
        far, [Echo((1.2, 0.0, 0.0))], pose=track(n_stops, 0.2 * (n_stops - 1)), **antennas
    )
    (warned,) = [
        text
        for text in image(record, np.linspace(1.0, 1.4, 21), np.linspace(-0.4, 0.4, 21)).warnings
        if "grating lobes" in text
    ]
    found = re.search(
        r"apart across the view, .* again (\d+) mm beside itself, at (-[\d.]+) dB", warned
    )
    distance_m, level_db = float(found[1]) / 1e3, float(found[2])
    seen = max(_copies(record, (1.2, 0.0)), key=lambda copy: copy[1])
    assert "stops lie up to 200 mm apart" in warned
    assert distance_m == pytest.approx(seen[0], abs=0.1)
    assert level_db == pytest.approx(seen[1], abs=1.0)


@pytest.mark.parametrize("step_wavelengths", [0.1, 0.25, 0.49])
def test_dense_tracks_have_no_copies_to_tell(step_wavelengths: float) -> None:
    step_m = step_wavelengths * C / BAND.carrier_hz
    record = cube(BAND, [Echo((1.0, 0.0, 0.0))], pose=track(17, 16 * step_m))
    assert not any("grating" in text for text in image(record, DOWN, CROSS).warnings)


def test_cells_beyond_what_subcarriers_tell_are_refused() -> None:
    """30 m by 5 MHz: a cell there shows what is 30 m nearer."""
    record = cube(BAND, [Echo((1.0, 0.0, 0.0))], pose=track(9, 0.4))
    image(record, np.array([29.9]), CROSS)
    with pytest.raises(ValueError, match=r"cells up to 30\.0\d m away, expected 0 to 29\.98"):
        image(record, np.array([29.0, 30.01]), np.array([0.0]))


def test_bursts_without_a_slot_are_left_out_of_the_image() -> None:
    """As of a record that never had the broken ones, at the end of the track and within it; the
    track's middle, from which cells count, stays where it is.
    """
    record = cube(BAND, [Echo((0.9, 0.0, 0.0))], pose=track(33, 0.96))
    record.flags[[0, 20, 32], 0, 0] = Flag.OVERRUN
    kept = [number for number in range(33) if number not in (0, 20, 32)]
    without = replace(
        record,
        iq=record.iq[kept],
        device_time_ns=record.device_time_ns[kept],
        flags=record.flags[kept],
        pose=tuple(record.pose[number] for number in kept),
    )
    found, expected = image(record, DOWN, CROSS), image(without, DOWN, CROSS)
    assert found.n_bursts == 30
    np.testing.assert_array_equal(found.value, expected.value)
    assert found.warnings == (
        *expected.warnings,
        "3 of 33 bursts left out (0, 20, 32), the first since: burst 0, step 0, slot 0: flagged "
        "as overrun (1 of 1 slots lost); too little is left without a loss",
    )
    record.flags[:, 0, 0] = Flag.OVERRUN
    with pytest.raises(ValueError, match="burst 0, step 0, slot 0: flagged as overrun"):
        image(record, DOWN, CROSS)


def test_what_is_left_of_a_burst_is_in_the_image() -> None:
    """At rest in each burst, at places of a track: with the part behind a lost slot of one burst
    the image is that of whole bursts to rounding.
    """
    wave = replace(BAND, n_slots=8, slot_period_s=1e-6)
    record = cube(wave, [Echo((0.9, 0.0, 0.0))], pose=track(9, 0.24))
    later = record.device_time_ns + 10**9 * np.arange(9)[:, None, None]  # between them it drives
    record = replace(record, device_time_ns=later)
    expected = image(record, DOWN, CROSS)
    record.flags[4, 0, 2], record.iq[4, 0, 2] = Flag.LOST, 0
    found = image(record, DOWN, CROSS)
    assert found.n_bursts == 9
    np.testing.assert_allclose(found.value, expected.value, atol=1e-3 * abs(expected.value).max())
    told = "burst 4, step 0, slot 2: flagged as lost (1 of 8 slots lost); processed are slots 3"
    assert found.warnings[0].startswith(told)


def test_a_cut_burst_of_an_antenna_that_drives_on_is_left_out() -> None:
    """12 m/s: from the middle of the burst to that of what is left, 5 slots of 1 ms, it is 60 mm,
    half a wavelength; its pose is that of the middle.
    """
    wave = replace(BAND, n_slots=16, slot_period_s=1e-3)
    record = cube(wave, [Echo((0.9, 0.0, 0.0))], pose=track(9, 9 * 0.204))
    record.flags[4, 0, 9] = Flag.LOST
    found = image(record, DOWN, CROSS)
    assert found.n_bursts == 8
    [told] = [warning for warning in found.warnings if "left out" in warning]
    assert "(4), the first since: burst 4, step 0, slot 9: flagged as lost (1 of 16 slots" in told
    assert told.endswith("mm from its pose")


def test_bursts_of_another_band_are_not_joined() -> None:
    """Carrier steps behind a lost slot: phases of the narrower band are relative to its middle. Of
    a single burst the band that is left makes the image.
    """
    pose = track(3, 0.05)
    record = cube(
        STEP, [Echo((4.0, 0, 0))], carriers_hz=CARRIERS, leakage=(1e-7, 1.1e-9), pose=pose
    )
    record.flags[1, 20, 3] = Flag.OVERRUN
    down_m = np.linspace(3.5, 4.5, 50)
    found = image(record, down_m, CROSS)
    assert found.n_bursts == 2
    told = "burst 1, step 20, slot 3: flagged as overrun (1 of 400 slots lost): its band is not"
    assert any(told in warning for warning in found.warnings)
    record.flags[[0, 2]] = Flag.LOST
    alone = image(record, down_m, CROSS)
    assert alone.down_resolution_m == pytest.approx(found.down_resolution_m * 25 / 20)


def test_phases_of_before_and_behind_a_reset_are_not_joined() -> None:
    """A reset may change the oscillator's phase: the image is of the longer part."""
    record = cube(BAND, [Echo((0.9, 0.0, 0.0))], pose=track(33, 0.96))
    record.flags[10, 0, 0] = Flag.RESET
    found = image(record, DOWN, CROSS)
    assert found.n_bursts == 22
    assert found.warnings[-1] == (
        "11 of 33 bursts left out (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, ...), the first since: burst 0: a "
        "reset is between it and most"
    )


# The paper's figure 3 b: two conducting cylinders of radius 40 mm, 15 cm apart, at 0.9 m.


@pytest.mark.parametrize("centre_ghz", [2.25, 2.5, 2.8])
def test_figure_3b_two_peaks_within_a_centimetre(centre_ghz: float) -> None:
    """Cross-range of both peaks; the exact echo of each cylinder, coupling left out."""
    found = image(
        two_cylinders(centre_ghz * 1e9), np.linspace(0.6, 1.2, 61), np.linspace(-0.3, 0.3, 301)
    )
    places = peaks(found, 2)
    np.testing.assert_allclose(np.sort(places[:, 1]), [-0.075, 0.075], atol=0.01)
    # Seen is the near face, 4 cm before the axis, smeared over 0.3 m.
    np.testing.assert_allclose(places[:, 0], 0.86, atol=0.08)


# Commands.


def test_ugv_detect_writes_what_it_finds(tmp_path) -> None:
    wave = OfdmWaveform(79e9, 256, 15e6, 32, 39.0625e-6, 37, 0.06e-6)
    record = cube(wave, [Echo((3.3, 0, 0), velocity_m_per_s=(2.0, 0, 0))], noise_w=1e-10)
    record.flags[0, 0, 30] = Flag.OVERRUN
    write_radar_record(record, tmp_path / "r.h5")
    done = ugv("detect", str(tmp_path / "r.h5"))
    assert done.returncode == 0, done.stderr
    assert "burst 0: 1 detections" in done.stdout
    assert "slot 30: flagged as overrun" in done.stderr
    with open(tmp_path / "r-detections.csv") as file:
        names, values = (line.strip().split(",") for line in file)
    row = dict(zip(names, values, strict=True))
    assert float(row["range_m"]) == pytest.approx(3.3, abs=0.01)
    assert float(row["range_rate_m_per_s"]) == pytest.approx(2.0, abs=0.05)


def test_ugv_detect_takes_the_fastest_target_and_targets_of_a_cell(tmp_path) -> None:
    """35 m/s with slots that tell 24.3 m/s; two directions 20 deg apart in one cell."""
    wave = OfdmWaveform(79e9, 256, 15e6, 64, 39.0625e-6, 37, 0.06e-6)
    fast = Echo((3.3, 0, 0), velocity_m_per_s=(35.0, 0, 0))
    write_radar_record(cube(wave, [fast], noise_w=1e-10), tmp_path / "fast.h5")
    rates = []
    for fastest in ([], ["--fastest", "20 m/s"]):
        ugv("detect", str(tmp_path / "fast.h5"), *fastest)
        with open(tmp_path / "fast-detections.csv") as file:
            rates.append(float(dict(zip(*csv.reader(file), strict=True))["range_rate_m_per_s"]))
    span = 2 * wave.max_velocity_m_per_s
    np.testing.assert_allclose(rates, [35.0, 35.0 - span], atol=0.05)
    places = [3.3 * np.array([np.cos(a), np.sin(a), 0]) for a in np.radians([-10, 10])]
    both = [Echo(tuple(place), phase_rad=k) for k, place in enumerate(places)]
    write_radar_record(cube(wave, both, noise_w=1e-10, **MIMO), tmp_path / "two.h5")
    one, two = (ugv("detect", str(tmp_path / "two.h5"), *n) for n in ([], ["--per-cell", "2"]))
    assert "1 detections" in one.stdout
    assert "do not fit one direction" in one.stderr
    assert "2 detections" in two.stdout
    assert not two.stderr


@pytest.mark.library("PIL")
def test_ugv_image_writes_csv_and_png(tmp_path) -> None:
    from PIL import Image

    record = cube(BAND, [Echo((0.9, 0.2, 0))], pose=track(17, 0.96))
    write_radar_record(record, tmp_path / "r.h5")
    png = tmp_path / "i.png"
    done = ugv(
        "image", str(tmp_path / "r.h5"), "--near", "0.5", "--far", "1.5", "--width", "1",
        "--cells", "51", "--png", str(png),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "peak" in done.stdout
    table = np.genfromtxt(tmp_path / "r-image.csv", delimiter=",", skip_header=1)[:, 1:]
    assert np.unravel_index(table.argmax(), table.shape) == (20, 35)
    grey = np.asarray(Image.open(png))
    assert np.unravel_index(grey.argmax(), grey.shape) == (30, 15)  # far on top, left on the left


def test_ugv_image_of_one_burst_tells_a_range_and_no_direction(tmp_path) -> None:
    """Of one burst and one antenna every cell of a range is alike, so its peak has no place."""
    write_radar_record(cube(BAND, [Echo((0.9, 0.2, 0))]), tmp_path / "r.h5")
    done = ugv("image", str(tmp_path / "r.h5"))
    assert done.returncode == 0, done.stderr
    assert "1 burst; resolution 300 mm down-range (Eq. 7), none across" in done.stdout
    assert "inf" not in done.stdout
    (at,) = re.findall(r"at a range of ([\d.]+) m, in an unknown direction", done.stdout)
    assert float(at) == pytest.approx(np.hypot(0.9, 0.2), abs=0.02)
    assert "one burst: the image shows ranges, and the same in every direction" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["detect", "missing.h5"], "missing.h5: no such record"),
        (["image", "missing.h5", "--near", "3", "--far", "1"], "from 3 to 1 m"),
        (["image", "missing.h5", "--near", "-3", "--far", "-1"], "expected at least one cell, 0 m"),
        (
            ["calibrate", "radar", "x", "-o", "c.h5", "--distance", "2", "--cross-section", "0"],
            "--cross-section: 0, expected a number above 0",
        ),
        (["detect", "missing.h5", "--cfar", "so"], "none of ca, go, os"),
        (["detect", "missing.h5", "--per-cell", "0"], "per_cell: 0"),
        (["detect", "missing.h5", "--fastest", "-1"], "fastest_m_per_s: -1"),
    ],
)
def test_errors_are_one_line(arguments: list[str], told: str) -> None:
    done = ugv(*arguments)
    assert done.returncode == 2
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
