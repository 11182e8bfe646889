"""Other directions that a record leaves open: lobes of the array that noise may have raised."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.processing import cloud
from hardware.radar.angles import Direction, direction, steering
from hardware.radar.array_plane import ArrayPlane, virtual_array
from hardware.radar.burst import DemodulatedBurst, demodulate
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.detection import Detection
from hardware.radar.output import table_rows
from hardware.radar.tracking import Tracker
from tests.hardware.radar_cubes import WIDE, Echo, cube
from tests.hardware.test_radar_channel_noise import HALF_M, PLANAR, drawn


def at_rest(**array) -> DemodulatedBurst:
    burst = demodulate(cube(replace(WIDE, n_slots=6), [Echo((4.0, 0, 0))], **array))
    return replace(burst, tdm_offset_s=np.zeros(len(burst.transmitter_m)))


def seen(burst: DemodulatedBurst, cosines: tuple[float, float], level_db: float, rng) -> Direction:
    """Of a target of this power over the noise in all channels together."""
    places = virtual_array(burst)[:, 1:] / burst.waveform.wavelength_m
    n = len(places)
    level = np.sqrt(10 ** (level_db / 10) / n)
    amplitude = level * steering(places, np.array(cosines)) + drawn(rng, np.eye(n))
    return direction(amplitude, burst, 0.0, ChannelNoise.white(n, 1.0), ArrayPlane.of(burst))


def off_lobes(
    found: Direction, burst: DemodulatedBurst, cosines: tuple[float, float]
) -> np.ndarray:
    """How far the direction and its alternatives are from the true one, in lobes."""
    extent = np.ptp(virtual_array(burst)[:, 1:], axis=0) / burst.waveform.wavelength_m
    cosines_found = np.array([(found.left, found.up), *found.others])
    return np.nanmax(np.abs(cosines_found - cosines) * extent, axis=1)


def test_grating_lobes_are_alternatives() -> None:
    """Antennas two wavelengths apart: directions whose cosines differ by a half are the same."""
    apart = {"receivers_m": HALF_M * np.array([[0, 4 * i, 0] for i in range(4)])}
    burst = at_rest(**apart)
    found = seen(burst, (0.1, 0.0), 40.0, np.random.default_rng(1))
    told = np.sort([found.left, *(left for left, _ in found.others)])
    np.testing.assert_allclose(told, [-0.9, -0.4, 0.1, 0.6], atol=0.02)
    azimuths = [found.azimuth_rad, *(one.azimuth_rad for one in found.alternatives)]
    np.testing.assert_allclose(np.sort(np.sin(azimuths)), told)


@pytest.mark.quick(1)
@pytest.mark.parametrize("level_db", [11.0, 14.0, 17.0, 25.0])
def test_the_true_direction_is_among_those_told(level_db: float) -> None:
    """1000 draws: the true lobe is missing in at most 6, a likelihood ratio of 1000 would leave
    less than 1 (false alarm 1e-4); the likeliest lobe alone is another one in some at 11 dB. Hence
    the first direction alone, where others are told, is no measurement of the direction.
    """
    burst, rng, cosines = at_rest(**PLANAR), np.random.default_rng(int(level_db)), (0.2, 0.1)
    draws = [seen(burst, cosines, level_db, rng) for _ in range(1000)]
    off = [off_lobes(found, burst, cosines) for found in draws]
    assert sum(one.min() > 0.5 for one in off) <= 6
    wrong = np.array([one[0] > 0.5 for one in off])
    told = np.array([bool(found.others) for found in draws])
    assert not (wrong & ~told).sum() > 3
    if level_db == 11.0:
        assert wrong.sum() > 20
    if level_db == 25.0:
        assert not wrong.any()
        assert not told.any()


def test_the_likeliest_comes_first() -> None:
    burst, rng = at_rest(**PLANAR), np.random.default_rng(3)
    places = virtual_array(burst)[:, 1:] / burst.waveform.wavelength_m
    for _ in range(20):
        amplitude = steering(places, np.array([0.2, 0.1])) + drawn(rng, np.eye(12))
        found = direction(amplitude, burst, 0.0, ChannelNoise.white(12, 1.0), ArrayPlane.of(burst))
        all_told = np.array([(found.left, found.up), *found.others])
        power = np.abs(steering(places, all_told).conj() @ amplitude)
        assert np.all(np.diff(power) < 0)


@pytest.mark.parametrize("axis", [1, 2])
@pytest.mark.parametrize("n_antennas", [2, 8])
@pytest.mark.parametrize("cosine", [0.97, -0.99])
def test_in_the_axis_of_the_array(axis: int, n_antennas: int, cosine: float) -> None:
    """Half a wavelength apart: the same lobe stands beyond the other end, at 0.97 - 2, where there
    is no direction, and is none of those told.
    """
    places = np.zeros((n_antennas, 3))
    places[:, axis] = HALF_M * np.arange(n_antennas)
    burst = at_rest(receivers_m=places)
    cosines = (cosine, 0.0) if axis == 1 else (0.0, cosine)
    found = seen(burst, cosines, 50.0, np.random.default_rng(1))
    assert (found.left, found.up)[axis - 1] == pytest.approx(cosine, abs=0.02)
    assert found.others == ()
    error_rad = found.azimuth_error_rad if axis == 1 else found.elevation_error_rad
    assert error_rad < 0.05


def test_a_target_in_the_axis_is_among_those_told() -> None:
    """Noise raises its lobe highest where no direction is, in about half of the draws: the one on
    the horizon stands for it. Its azimuth is off by what is stated, within a factor of 2.
    """
    burst = at_rest(receivers_m=HALF_M * np.array([[0, i, 0] for i in range(8)]))
    rng, cosines = np.random.default_rng(3), (0.999, 0.0)
    draws = [seen(burst, cosines, 17.0, rng) for _ in range(300)]
    assert all(off_lobes(one, burst, cosines).min() < 0.5 for one in draws)
    assert all(abs(left) <= 1 for one in draws for left, _ in [(one.left, 0), *one.others])
    near = [one for one in draws if one.left > 0]
    off = np.array([one.azimuth_rad - np.arcsin(0.999) for one in near])
    stated = np.array([one.azimuth_error_rad for one in near])
    assert 0.5 < np.sqrt(np.mean(off**2) / np.mean(stated**2)) < 2


def test_the_best_explains_most() -> None:
    """Of all directions told, at an SNR at which a grid alone often begins at another lobe."""
    burst, rng = at_rest(**PLANAR), np.random.default_rng(4)
    places = virtual_array(burst)[:, 1:] / burst.waveform.wavelength_m
    n = len(places)
    for _ in range(300):
        amplitude = steering(places, np.array([0.4, 0.2])) / np.sqrt(4) + drawn(rng, np.eye(n))
        found = direction(amplitude, burst, 0.0, ChannelNoise.white(n, 1.0), ArrayPlane.of(burst))
        told = np.array([(found.left, found.up), *found.others])
        beam = np.abs(steering(places, told).conj() @ amplitude) ** 2 / n
        power = np.vdot(amplitude, amplitude).real
        assert beam[0] >= beam.max() - 1e-3 * power - 0.1  # as likely, and nearer to the boresight
        assert np.all(np.diff(beam[1:]) <= 1e-9 * beam[0])
        assert np.all(np.sum(told**2, axis=1) <= 1 + 1e-9)


def test_of_no_array_there_are_none() -> None:
    assert ArrayPlane.of(at_rest()) is None


def ambiguous(**other) -> Detection:
    given = {
        "range_m": 5.0, "range_rate_m_per_s": 1.0, "power_w": 1.0, "snr_db": 20.0,
        "range_error_m": 0.01, "range_rate_error_m_per_s": 0.1, "azimuth_rad": 0.1,
        "azimuth_error_rad": 0.01, "azimuth_alternatives_rad": (-0.4,),
        "elevation_alternatives_rad": (float("nan"),),
    }  # fmt: skip
    return Detection(**given | other)


def test_they_are_printed_and_columns_of_the_cloud() -> None:
    clear = ambiguous(azimuth_alternatives_rad=(), elevation_alternatives_rad=())
    rows = list(table_rows([ambiguous(), clear]))
    assert rows[1].endswith("azimuth ambiguous, or -22.9 deg")
    columns = cloud([ambiguous(), clear])
    np.testing.assert_array_equal(columns["azimuth_alternatives"], [1, 0])
    np.testing.assert_array_equal(columns["azimuth_alternative_1_rad"], [-0.4, np.nan])
    np.testing.assert_array_equal(columns["elevation_alternative_1_rad"], [np.nan, np.nan])


def test_of_an_upright_array_elevations_are_printed() -> None:
    nan = float("nan")
    upright = replace(ambiguous(), azimuth_rad=nan, azimuth_alternatives_rad=(nan,) * 2)
    upright = replace(upright, elevation_alternatives_rad=(0.1, -0.2))
    assert "elevation ambiguous, or +5.7, -11.5 deg" in list(table_rows([upright]))[1]


def test_elevations_are_a_column_where_an_array_tells_them() -> None:
    """The command printed none. A detection without one has a dash."""
    line = ambiguous()
    plane = replace(line, elevation_rad=0.05, elevation_error_rad=0.01)
    plane = replace(plane, elevation_alternatives_rad=(0.2,))
    head, first, second = table_rows([plane, line])
    assert head.split()[3:6] == ["azimuth", "elevation", "SNR"]
    end = head.index("elevation") + len("elevation")
    assert first[:end].endswith("5.73 ± 0.57 deg  2.86 ± 0.57 deg")
    assert first.endswith("azimuth/elevation ambiguous, or -22.9/+11.5 deg")
    assert second[:end].endswith("deg                -")
    assert "elevation" not in "".join(table_rows([line]))


def test_a_track_does_not_begin_in_one_of_several_directions() -> None:
    """Once a clear detection has told where it is, an ambiguous one continues the track by the
    alternative that fits.
    """
    tracker = Tracker()
    tracker.update([ambiguous()], 0.1)
    (track,) = tracker.tracks
    assert not track.estimate.has_position
    clear = ambiguous(azimuth_rad=-0.4, azimuth_alternatives_rad=(), range_m=5.1)
    tracker.update([clear], 0.1)
    tracker.update([ambiguous(range_m=5.2)], 0.1)
    (track,) = tracker.tracks
    assert track.hits == 3
    assert np.arctan2(track.state[1], track.state[0]) == pytest.approx(-0.4, abs=0.05)


@pytest.mark.parametrize("apart", [1.0, 2.0])
def test_of_equal_directions_the_one_nearest_to_the_boresight_is_the_first(apart: float) -> None:
    """Antennas a wavelength and more apart, where rounding alone would decide."""
    line = {"receivers_m": HALF_M * np.array([[0, 2 * apart * i, 0] for i in range(4)])}
    burst, rng = at_rest(**line), np.random.default_rng(5)
    for _ in range(50):
        found = seen(burst, (0.1, 0.0), 20.0, rng)
        assert abs(found.left - 0.1) < 0.5 / apart / 4
        assert len(found.others) >= 2 * apart - 1
