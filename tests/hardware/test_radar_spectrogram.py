"""Spectrograms of one range against rates that are known at every time."""

import json
from pathlib import Path

import numpy as np
import pytest
from radar_cubes import WIDE, Echo, cube
from ugv_command import ugv

from hardware.errors import InputError
from hardware.radar import spectrogram
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
