"""Directions of arrays turned in the antenna's frame; what azimuth and elevation share."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hardware.errors import InputError
from hardware.radar.angles import direction
from hardware.radar.array_plane import ArrayPlane, virtual_array
from hardware.radar.burst import DemodulatedBurst, demodulate
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.process import process
from hardware.radar.settings import Processing
from tests.hardware.radar_cubes import WIDE, Echo, cube
from tests.hardware.test_radar_channel_noise import HALF_M, PLANAR, drawn

LINE = HALF_M * np.array([[0, i - 3.5, 0] for i in range(8)])
PLATE = HALF_M * np.array([[0, i - 1.5, k - 1.5] for i in range(4) for k in range(4)])
#: Of which azimuth and elevation err together.
SHEARED = PLATE @ np.array([[1, 0, 0], [0, 1, 0], [0, 0.8, 1]])
#: By which antennas are beside where they should be: up to 0.045 wavelengths.
BULGES = 0.045 * WIDE.wavelength_m * np.random.default_rng(2).uniform(-1, 1, (16, 3))


def turned(places_m: np.ndarray, **degrees: float) -> np.ndarray:
    """Receivers turned to the left (yaw), down (pitch) and about the boresight (roll)."""
    angles = [degrees.get(name, 0.0) for name in ("yaw", "pitch", "roll")]
    return Rotation.from_euler("ZYX", angles, degrees=True).apply(places_m)


def at_rest(**array) -> DemodulatedBurst:
    burst = demodulate(cube(replace(WIDE, n_slots=6), [Echo((4.0, 0, 0))], **array))
    return replace(burst, tdm_offset_s=np.zeros(len(burst.transmitter_m)))


def toward(azimuth_rad: float, elevation_rad: float) -> np.ndarray:
    level = np.cos(elevation_rad)
    return np.array(
        [level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad)]
    )


def phases(burst: DemodulatedBurst, angles: np.ndarray) -> np.ndarray:
    """Of a plane wave, from the places in three dimensions."""
    return 2 * np.pi * virtual_array(burst) @ toward(*angles) / burst.waveform.wavelength_m


def bounds_rad(burst: DemodulatedBurst, angles: np.ndarray, snr: float) -> np.ndarray:
    """Cramer-Rao bounds of azimuth and elevation, by differences of the model."""
    step = 1e-6 * np.eye(2)
    slope = (
        np.stack([phases(burst, angles + s) - phases(burst, angles - s) for s in step], 1) / 2e-6
    )
    slope -= slope.mean(axis=0)
    return np.sqrt(np.diag(np.linalg.inv(2 * snr * slope.T @ slope)))


@pytest.mark.quick(3)
@pytest.mark.parametrize(
    ("places_m", "degrees", "at_deg"),
    [
        (LINE, {"yaw": 15.0}, (22.0, 0.0)),
        (LINE, {"yaw": -40.0}, (5.0, 0.0)),
        (LINE, {"roll": 20.0}, (22.0, 0.0)),
        (LINE, {"roll": 90.0, "pitch": 12.0}, (0.0, -25.0)),
        (PLATE, {}, (55.0, 40.0)),
        (SHEARED, {}, (55.0, 40.0)),
        (SHEARED, {}, (-55.0, 40.0)),
        (PLATE, {"pitch": 10.0}, (20.0, 13.0)),
        (PLATE, {"yaw": 30.0, "pitch": -20.0, "roll": 35.0}, (-15.0, 30.0)),
        (PLANAR["receivers_m"] + PLATE[:4], {"yaw": 0.2}, (10.0, 0.0)),
        (LINE + BULGES[:8], {"yaw": 15.0}, (50.0, 0.0)),
        (LINE + BULGES[:8], {"yaw": 20.0, "roll": 30.0}, (-40.0, 0.0)),
        (PLATE + BULGES, {"yaw": 30.0, "pitch": -20.0}, (-15.0, 40.0)),
    ],
)
def test_directions_err_as_stated_and_as_the_bound(places_m, degrees, at_deg) -> None:
    """400 draws: the rms over the stated errors is 0.85 to 1.15 (four and a quarter standard
    errors of it, false alarm 2e-5 a figure), and of arrays in a plane the errors are the bound's.
    """
    burst = at_rest(receivers_m=turned(places_m, **degrees))
    plane, at, snr = ArrayPlane.of(burst), np.radians(at_deg), 10**2.5
    assert plane is not None
    rng, n = np.random.default_rng(3), len(places_m)
    noise, off, stated = ChannelNoise.white(n, 1.0), [], []
    for _ in range(400):
        amplitude = np.sqrt(snr) * np.exp(1j * phases(burst, at)) + drawn(rng, np.eye(n))
        way = direction(amplitude, burst, 0.0, noise, plane)
        off.append(np.array([way.azimuth_rad, way.elevation_rad]) - at)
        stated.append([way.azimuth_error_rad, way.elevation_error_rad])
    seen = ~np.isnan(off[0])
    assert seen.sum() == plane.seen.sum()
    over = np.sqrt(np.mean(np.square(np.array(off)[:, seen] / np.array(stated)[:, seen]), axis=0))
    np.testing.assert_allclose(over, 1.0, atol=0.15)
    if seen.all():
        np.testing.assert_allclose(np.median(stated, axis=0), bounds_rad(burst, at, snr), rtol=0.04)


@pytest.mark.parametrize("step_m", [1e-6, 5e-6, 2e-5, 1e-4])
def test_lines_of_rounded_places_are_lines(step_m: float) -> None:
    """Of 20 lines turned to all sides each is told as one angle, within its errors; places to 5
    micrometres had made an array in a plane of half of them.
    """
    rng = np.random.default_rng(7)
    for _ in range(20):
        yaw, roll = rng.uniform(-60, 60), rng.uniform(-35, 35)
        places_m = np.round(turned(LINE, yaw=yaw, roll=roll) / step_m) * step_m
        burst, at = at_rest(receivers_m=places_m), np.array([rng.uniform(-1, 1), 0.0])
        plane = ArrayPlane.of(burst)
        assert plane is not None
        assert plane.seen.tolist() == [True, False]
        amplitude = 10 * np.exp(1j * phases(burst, at)) + drawn(rng, np.eye(8))
        way = direction(amplitude, burst, 0.0, ChannelNoise.white(8, 1.0), plane)
        ways = [way, *way.alternatives]
        assert min(abs(w.azimuth_rad - at[0]) / w.azimuth_error_rad for w in ways) < 4.5


def test_of_lobes_that_are_alike_the_one_nearest_ahead_comes_first() -> None:
    """A line of antennas a wavelength apart, turned by 50 degrees: -10 degrees looks like 57.7,
    which is nearer to the line's own normal, and like its mirror image, -70.
    """
    burst = at_rest(receivers_m=turned(2 * LINE, yaw=50.0))
    amplitude = 30 * np.exp(1j * phases(burst, np.radians([-10.0, 0.0])))
    found = direction(amplitude, burst, 0.0, ChannelNoise.white(8, 1.0), ArrayPlane.of(burst))
    azimuths = [found.azimuth_rad, *(other.azimuth_rad for other in found.alternatives)]
    assert np.degrees(azimuths) == pytest.approx([-10.0, -70.0, 57.7], abs=0.2)


def test_a_lobe_behind_is_never_the_likeliest() -> None:
    """Antennas about a wavelength apart, turned by 50 degrees: a target at 40 degrees has a second
    lobe at 106, which noise raises above the first one in a part of the draws.
    """
    places_m = 2 * HALF_M * np.array([[0, y, 0] for y in (0.0, 1.02, 2.0, 3.05, 4.1)])
    burst = at_rest(receivers_m=turned(places_m, yaw=50.0))
    plane, rng = ArrayPlane.of(burst), np.random.default_rng(5)
    wave = np.exp(1j * phases(burst, np.radians([40.0, 0.0])))
    for _ in range(100):
        amplitude = 2 * wave + drawn(rng, np.eye(5))
        way = direction(amplitude, burst, 0.0, ChannelNoise.white(5, 1.0), plane)
        assert np.degrees(way.azimuth_rad) == pytest.approx(40.0, abs=25.0)


@pytest.mark.parametrize(("at_deg", "told_deg"), [(10.0, [10.0]), (-30.0, [-30.0, -60.0])])
def test_the_mirror_image_by_the_plane_is_an_alternative(at_deg: float, told_deg: list) -> None:
    """The plane of an array turned by 45 degrees to the left is at -45 degrees: 15 degrees on
    either side of it look alike; 10 degrees and -100, which is behind, do as well.
    """
    burst = at_rest(receivers_m=turned(PLATE, yaw=45.0))
    amplitude = 30 * np.exp(1j * phases(burst, np.radians([at_deg, 0.0])))
    found = direction(amplitude, burst, 0.0, ChannelNoise.white(16, 1.0), ArrayPlane.of(burst))
    azimuths = [found.azimuth_rad, *(other.azimuth_rad for other in found.alternatives)]
    assert np.degrees(azimuths) == pytest.approx(told_deg, abs=0.1)


def test_an_array_in_no_plane_ahead_tells_no_direction_with_a_warning() -> None:
    """Eight corners of a cube, and a plate that lies level: range and rate are told as ever."""
    corners = HALF_M * np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
    for places_m in (corners, turned(PLATE, pitch=80.0)):
        found = process(cube(WIDE, [Echo((4.0, 1.0, 0.5))], receivers_m=places_m, noise_w=1e-12))
        (target,) = found.detections
        assert np.isnan([target.azimuth_rad, target.elevation_rad]).all()
        assert target.range_m == pytest.approx(np.sqrt(17.25), abs=0.02)
        assert any("no plane that faces ahead" in text for text in found.warnings)
    for places_m in (turned(PLATE, pitch=10.0), np.zeros((2, 3))):
        found = process(cube(WIDE, [Echo((4.0, 1.0, 0.5))], receivers_m=places_m, noise_w=1e-12))
        assert not any("no plane" in text for text in found.warnings)


def test_a_record_of_a_tilted_array() -> None:
    """Spherical waves to every antenna; the array's curvature at 9 m is 0.01 rad of phase."""
    for degrees in ({"pitch": 10.0}, {"yaw": -25.0, "roll": 8.0}):
        at = np.radians([22.0, 13.0])
        places_m = turned(PLATE, **degrees)
        place = tuple(9.0 * toward(*at))
        record = cube(WIDE, [Echo(place)], receivers_m=places_m, noise_w=1e-11)
        (target,) = process(record).detections
        errors = target.azimuth_error_rad, target.elevation_error_rad
        assert target.azimuth_rad == pytest.approx(at[0], abs=4 * errors[0] + 1e-3)
        assert target.elevation_rad == pytest.approx(at[1], abs=4 * errors[1] + 1e-3)
        assert max(errors) < 0.03


@pytest.mark.parametrize("count", [0, 1, 2])
def test_several_targets_need_a_line_to_the_left(count: int) -> None:
    """Whatever the record holds: where all echoes fit one direction it had passed."""
    echoes = [Echo((4.0, 1.0, 0.0)), Echo((4.1232, -0.3, 0.0))][:count]
    record = cube(WIDE, echoes, receivers_m=turned(LINE, yaw=15.0), noise_w=1e-12)
    with pytest.raises(
        InputError, match="per_cell: 2: burst: its channels are no evenly spaced line to"
    ):
        process(record, how=Processing(per_cell=2))
