"""Spectrograms of one range against rates that are known at every time."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from radar_cubes import CARRIERS, STEP, WIDE, Echo, cube
from ugv_command import ugv

from hardware.errors import InputError
from hardware.radar import spectrogram, spectrogram_of_intervals
from hardware.recording import Log
from hardware.records import write_radar_record
from hardware.waveform import C_M_PER_S, OfdmWaveform

#: Of 79 GHz and 4 GHz of bandwidth, in 256 slots of 39 us.
WAVE = OfdmWaveform(79e9, 4096, 976562.5, 256, 39.0625e-6, 37, 1.024e-6)


def echo(range_of) -> np.ndarray:
    """Channel of a point at a range (n_slots,), of power 1."""
    delays = 2 * np.asarray(range_of) / C_M_PER_S
    frequency = WAVE.carrier_hz + WAVE.frequency_offsets_hz
    return np.exp(-2j * np.pi * (np.outer(frequency, delays) % 1.0))


@pytest.mark.parametrize("window", [None, 32, 33])
def test_a_constant_rate_has_its_power_at_all_times(window: int | None) -> None:
    """At the middle of a cell of rates: the power of the echo, to 0.3 dB, while it is there."""
    for cell in (0, 5, -9):
        length = window or WAVE.n_slots // 8
        rate = cell * WAVE.wavelength_m / (2 * length * WAVE.slot_period_s)
        seen = spectrogram(echo(9.0 + rate * WAVE.slot_times_s), WAVE, 9.0, window)
        peak = seen.power_w.argmax(axis=0)
        np.testing.assert_allclose(seen.range_rate_m_per_s[peak], rate, atol=1e-9)
        held = abs(rate * seen.time_s) < 0.1 * WAVE.range_cell_m  # elsewhere it has walked out
        assert np.all(abs(10 * np.log10(seen.power_w.max(axis=0)[held])) < 0.3)
        assert held.any()
        assert (np.diff(seen.range_rate_m_per_s) > 0).all()
        assert len(seen.time_s) == WAVE.n_slots - length + 1
        np.testing.assert_allclose(seen.time_s, -seen.time_s[::-1], atol=1e-12)


def test_a_rotor_draws_its_sine() -> None:
    """A point 2 cm from an axis that turns once in an interval: 12.6 m/s to and fro. The ridge is
    within a cell of a window's rates of the point's range rate at the window's middle.
    """
    turn = 2 * np.pi / (WAVE.n_slots * WAVE.slot_period_s)
    seen = spectrogram(echo(9.0 + 0.02 * np.sin(turn * WAVE.slot_times_s)), WAVE, 9.0, 16)
    ridge = seen.range_rate_m_per_s[seen.power_w.argmax(axis=0)]
    rate = 0.02 * turn * np.cos(turn * seen.time_s)
    assert rate.max() > 12
    assert abs(ridge - rate).max() < WAVE.wavelength_m / (2 * 16 * WAVE.slot_period_s)


def test_another_range_hears_nothing() -> None:
    seen = spectrogram(echo(np.full(WAVE.n_slots, 9.0)), WAVE, 9.0 + 20 * WAVE.range_cell_m)
    assert seen.power_w.max() < 1e-6


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"window_slots": 1}, "window_slots = 1, expected 2 to"),
        ({"window_slots": 10**6}, "window_slots"),
        ({"range_m": -1.0}, "range_m = -1"),
        ({"range_m": float("nan")}, "range_m = nan"),
        ({"channel": np.zeros((3, 4))}, "shape"),
    ],
)
def test_what_cannot_be_is_an_error(change, said: str) -> None:
    asked = {"channel": echo(np.full(WAVE.n_slots, 9.0)), "waveform": WAVE, "range_m": 9.0} | change
    with pytest.raises(InputError, match=said):
        spectrogram(**asked)


def test_the_command_tells_the_rates_of_a_range(tmp_path: Path) -> None:
    """Two points at one range that recede at +4 and -7 m/s, the second ten times as strong; and
    nothing at another range. The CSV holds what the function gives.
    """
    points = [Echo((9.0, 0, 0), 1e-10, (4.0, 0, 0)), Echo((9.0, 0, 0), 1e-9, (-7.0, 0, 0))]
    file = tmp_path / "radar.h5"
    write_radar_record(cube(WIDE, points, noise_w=1e-14), file)
    said = ugv("spectrogram", file, "--at", "900 cm", "--json")
    assert not said.returncode, said.stderr
    rates = [f["value"] for f in json.loads(said.stdout)["figures"] if "rate" in f["name"]]
    cell = WIDE.wavelength_m / (2 * 8 * WIDE.slot_period_s)
    assert np.allclose(rates, -7.0, atol=cell / 2)
    table = np.genfromtxt(tmp_path / "radar-spectrogram.csv", delimiter=",", skip_header=1)
    power = table[:, 1:].mean(axis=1)
    near = [power[abs(table[:, 0] - rate) < cell / 2].max() for rate in (4.0, -7.0)]
    assert abs(near[1] - near[0] - 10.0) < 1.5
    wrong = ugv("spectrogram", file, "--at", "9 m", "--burst", "3")
    assert wrong.returncode == 2
    assert "--burst 3: it holds 1" in wrong.stderr


def test_ranges_of_carrier_steps_are_told_to_hold_at_rest(tmp_path: Path) -> None:
    """5 m/s over 26 ms of retunes: the echo is some decimetres off the range that is looked at."""
    point = Echo((6.0, 0, 0), velocity_m_per_s=(5.0, 0, 0))
    file = tmp_path / "radar.h5"
    write_radar_record(cube(STEP, [point], carriers_hz=CARRIERS, leakage=(1e-7, 1.1e-9)), file)
    said = ugv("spectrogram", file, "--at", "6 m")
    assert "range: that of what does not move; carrier steps" in said.stderr
    write_radar_record(cube(WIDE, [point], noise_w=1e-14), file)
    assert "carrier steps" not in ugv("spectrogram", file, "--at", "6 m").stderr


@pytest.mark.library("PIL")
def test_the_command_draws_them(tmp_path: Path) -> None:
    """Brightest in the row of the rate, receding on top."""
    from PIL import Image

    file, png = tmp_path / "radar.h5", tmp_path / "seen.png"
    write_radar_record(cube(WIDE, [Echo((9.0, 0, 0), 1e-9, (7.0, 0, 0))], noise_w=1e-14), file)
    said = ugv("spectrogram", file, "--at", "9 m", "--png", png)
    assert not said.returncode, said.stderr
    picture = np.asarray(Image.open(png))
    assert picture.sum(axis=1).argmax() < len(picture) / 2


def test_a_span_of_ranges_hears_parts_at_all_of_them() -> None:
    """Two points 0.6 m apart that recede at +4 and -7 m/s, of equal power: one range hears one of
    them, a span both, each with its power to 1.5 dB.
    """
    both = echo(9.0 + 4.0 * WAVE.slot_times_s) + echo(9.6 - 7.0 * WAVE.slot_times_s)
    one, span = spectrogram(both, WAVE, 9.0, 64), spectrogram(both, WAVE, 9.3, 64, span_m=0.7)
    middle, cell = span.power_w.shape[1] // 2, WAVE.wavelength_m / (2 * 64 * WAVE.slot_period_s)
    for rate, heard_by_one in ((4.0, True), (-7.0, False)):
        near = abs(span.range_rate_m_per_s - rate) < cell
        assert abs(10 * np.log10(span.power_w[near, middle].max())) < 1.5
        assert (one.power_w[near, middle].max() > 0.5) == heard_by_one
    with pytest.raises(InputError, match="span_m = -1"):
        spectrogram(both, WAVE, 9.0, span_m=-1.0)


def swinging(time_s):
    """Range of a point that swings by 0.1 m once in 1.1 s, on what recedes at -3 m/s."""
    return 9.0 - 3.0 * time_s + 0.1 * np.sin(2 * np.pi * time_s / 1.1)


def test_several_intervals_show_a_swing() -> None:
    """Over 1.1 s in 23 intervals of 10 ms: within a cell of the rate of each, 0.57 m/s to and fro
    about -3 m/s, as the range is followed within its span.
    """
    times = 0.05 * np.arange(23)
    intervals = [(70.0 + t, echo(swinging(t + WAVE.slot_times_s)), WAVE) for t in times]
    seen = spectrogram_of_intervals(intervals, 9.0, range_rate_m_per_s=-3.0, span_m=0.5)
    np.testing.assert_allclose(seen.time_s, times, atol=1e-9)
    rate = -3.0 + 0.1 * 2 * np.pi / 1.1 * np.cos(2 * np.pi * times / 1.1)
    ridge = seen.range_rate_m_per_s[seen.power_w.argmax(axis=0)]
    assert np.ptp(rate) > 1.0
    cell = WAVE.wavelength_m / (2 * WAVE.n_slots * WAVE.slot_period_s)
    assert abs(ridge - rate).max() < cell
    assert abs(10 * np.log10(seen.power_w.max(axis=0))).max() < 3.0


def test_intervals_that_do_not_belong_together_are_an_error() -> None:
    still = echo(np.full(WAVE.n_slots, 9.0))
    short = replace(WAVE, n_slots=128)
    for intervals, said in (
        ([], "no interval"),
        ([(0.0, still, WAVE), (0.0, still, WAVE)], "do not ascend"),
        ([(1.0, still, WAVE), (0.5, still, WAVE)], "do not ascend"),
        ([(0.0, still, WAVE), (0.1, still[:, :128], short)], "interval 1 has another waveform"),
        ([(0.0, still, WAVE), (90.0, still, WAVE)], "range_m = -81"),
    ):
        with pytest.raises(InputError, match=said):
            spectrogram_of_intervals(intervals, 9.0, range_rate_m_per_s=-1.0)


def test_the_command_reads_a_log(tmp_path: Path) -> None:
    """Bursts of a drive one after another: a point that slows down from -7 to +4 m/s at one range;
    a burst by itself on request.
    """
    file = tmp_path / "drive.mcap"
    with Log(file) as log:
        for number, rate in enumerate((-7.0, -2.0, 4.0)):
            record = cube(WIDE, [Echo((9.0, 0, 0), 1e-9, (rate, 0, 0))], noise_w=1e-14)
            begun = replace(record, device_time_ns=record.device_time_ns + number * 10**8)
            log.record("/radar/record", begun, host_ns=number * 10**8)
    said = ugv("spectrogram", file, "--at", "9 m", "--span", "40 cm", "--json")
    assert not said.returncode, said.stderr
    rates = [f["value"] for f in json.loads(said.stdout)["figures"] if "rate" in f["name"]]
    np.testing.assert_allclose(rates, [-7.0, 4.0], atol=0.2)
    table = np.genfromtxt(tmp_path / "drive-spectrogram.csv", delimiter=",")
    np.testing.assert_allclose(table[0, 1:], [0.0, 0.1, 0.2], atol=1e-6)
    one = ugv("spectrogram", file, "--at", "9 m", "--burst", "1", "--json")
    rates = [f["value"] for f in json.loads(one.stdout)["figures"] if "rate" in f["name"]]
    cell = WIDE.wavelength_m / (2 * (WIDE.n_slots // 8) * WIDE.slot_period_s)
    np.testing.assert_allclose(rates, -2.0, atol=cell / 2)
    for more, said_of in (
        (("--burst", "3"), "it holds 3"),
        (("--window-slots", "16"), "expected a --burst"),
        (("--burst", "0", "--receding", "1 m/s"), "expected a log"),
    ):
        wrong = ugv("spectrogram", file, "--at", "9 m", *more)
        assert wrong.returncode == 2
        assert said_of in wrong.stderr


def test_noise_alone_shows_no_echo_as_often_as_stated() -> None:
    """150 spectrograms of white noise: the mean power is what `noise_w` says, within 5 %, and
    at most 1 % show an echo (1.5 expected at most; 8 come by a chance of 2e-4). An echo
    12 dB above what is told is shown by all of 40.
    """
    wave, rng = replace(WIDE, n_slots=32), np.random.default_rng(3)
    shape = (150, wave.n_subcarriers, wave.n_slots)
    noise = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) * np.sqrt(3.0 / 2)
    seen = [spectrogram(part, wave, 5.0, 8, span_m=0.02) for part in noise]
    one = [spectrogram(part, wave, 5.0, 8) for part in noise[:100]]
    assert np.mean([s.power_w.mean() for s in one]) == pytest.approx(
        np.mean([s.noise_w[0] for s in one]), rel=0.05
    )
    assert sum(s.shows_echo for s in seen) < 8
    level = np.log(seen[0].power_w.size * seen[0].n_ranges / 0.01) * seen[0].noise_w[0]
    frequency = wave.carrier_hz + wave.frequency_offsets_hz
    point = np.exp(-2j * np.pi * (frequency * 2 * 5.0 / C_M_PER_S % 1.0))[:, None]
    heard = [noise[k] + np.sqrt(16 * level) * point for k in range(40)]
    assert all(spectrogram(part, wave, 5.0, 8, span_m=0.02).shows_echo for part in heard)


@pytest.mark.parametrize("shape", [(8, 8), (16, 8), (16, 16)])
def test_noise_of_few_cells_shows_no_echo_either(shape: tuple[int, int]) -> None:
    """Of 1000 at most 1 %: more than 24 come by a chance of 4e-5. With the noise taken as known it
    was 27 of 8 x 8 cells.
    """
    wave, rng = replace(WIDE, n_subcarriers=shape[0], n_slots=shape[1]), np.random.default_rng(5)
    noise = rng.normal(size=(2, 1000, *shape))
    seen = [spectrogram(part, wave, 0.0, 2) for part in noise[0] + 1j * noise[1]]
    assert sum(s.shows_echo for s in seen) < 24


def test_windows_without_an_echo_tell_no_rate() -> None:
    """A point that is there for a seventh of the interval only, as a blade that flashes."""
    rng = np.random.default_rng(7)
    shape = WIDE.n_subcarriers, WIDE.n_slots
    noise = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)
    frequency = WIDE.carrier_hz + WIDE.frequency_offsets_hz
    slots = np.arange(WIDE.n_slots)
    way_m = 2 * (5.0 + 2.0 * slots * WIDE.slot_period_s)
    point = np.exp(-2j * np.pi * (frequency[:, None] * way_m / C_M_PER_S % 1.0))
    middle = WIDE.n_slots // 2
    is_there = np.abs(slots - middle) <= WIDE.n_slots // 14
    seen = spectrogram(noise + 3.0 * is_there * point, WIDE, 5.0)
    heard = np.isfinite(seen.ridge_m_per_s)
    assert 0.1 < heard.mean() < 0.5
    window = WIDE.n_slots // 8
    np.testing.assert_allclose(
        seen.ridge_m_per_s[heard],
        2.0,
        atol=WIDE.wavelength_m / (2 * window * WIDE.slot_period_s),
    )


def test_the_command_gives_no_rates_of_noise(tmp_path: Path) -> None:
    """An echo at 9 m: at 5 m there is none, and no range rate is told."""
    file = tmp_path / "radar.h5"
    write_radar_record(cube(WIDE, [Echo((9.0, 0, 0), 1e-10, (7.0, 0, 0))], noise_w=1e-11), file)
    for at, heard in (("9 m", True), ("5 m", False)):
        said = ugv("spectrogram", file, "--at", at, "--json")
        assert not said.returncode, said.stderr
        assert ("no echo is above the noise (in 1 % of" in said.stderr) != heard
        rates = [f["value"] for f in json.loads(said.stdout)["figures"] if "rate" in f["name"]]
        assert all((rate is not None) == heard for rate in rates)
