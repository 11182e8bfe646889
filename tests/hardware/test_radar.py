"""Radar processing on synthetic echoes, against closed forms and bounds.

Statistical bounds hold at a false-alarm rate of 1e-6 unless a test says otherwise.
"""

import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy import stats
from ugv_command import ugv

from hardware.errors import InputError
from hardware.radar import (
    Cfar,
    OfdmWaveform,
    cfar_factor,
    cfar_threshold,
    channel,
    detect,
    range_doppler,
)
from hardware.radar.windows import normalised_window
from hardware.records import (
    QuaternionPose,
    RadarFrontEnd,
    RadarRecord,
    read_radar_record,
    write_radar_record,
)

C = 299_792_458.0
HYBRID = OfdmWaveform(79e9, 4096, 976_562.5, 256, 39.0625e-6, 37, 1.024e-6)
SMALL = OfdmWaveform(79e9, 256, 15e6, 64, 39.0625e-6, 37, 0.1e-6)


def echo(wave: OfdmWaveform, range_m: float, rate: float, power_w: float = 1.0) -> np.ndarray:
    """The exact channel of one echo, straight from the definition."""
    f = wave.frequency_offsets_hz[:, None]
    delay = 2 / C * (range_m + rate * wave.slot_times_s)
    cycles = (wave.carrier_hz * delay) % 1.0 + (f * delay)
    return np.sqrt(power_w) * np.exp(-2j * np.pi * cycles)


def noise(wave: OfdmWaveform, power_w: float, rng: np.random.Generator) -> np.ndarray:
    shape = (wave.n_subcarriers, wave.n_slots, 2)
    return rng.normal(size=shape).view(np.complex128)[..., 0] * np.sqrt(power_w / 2)


def record_of(received: np.ndarray, wave: OfdmWaveform, scale: float) -> RadarRecord:
    """Counts of a received channel, as a front end would take them."""
    n = wave.n_subcarriers
    sent = received.T * wave.sent() / np.sqrt(n)
    time = np.fft.ifft(np.fft.ifftshift(sent, axes=1), axis=1) * n / scale
    iq = np.rint(np.stack([time.real, time.imag], axis=-1)).astype(np.int16)
    return RadarRecord(
        iq=iq[None, None, :, None],
        device_time_ns=np.zeros((1, 1, wave.n_slots), np.int64),
        flags=np.zeros((1, 1, wave.n_slots), np.uint8),
        carriers_hz=np.array([wave.carrier_hz]),
        transmitter=np.zeros(wave.n_slots, np.uint8),
        waveform=wave,
        front_end=RadarFrontEnd(scale, 1.0, antenna_gain_dbi=20.0, losses_db=0.0),
        device="test",
        pose=(QuaternionPose(),),
    )


# Waveform.


def test_the_figures_of_the_79_ghz_radar() -> None:
    assert HYBRID.bandwidth_hz == pytest.approx(4.0e9)
    assert HYBRID.range_cell_m == pytest.approx(37.5e-3, rel=1e-3)
    assert HYBRID.max_range_m == pytest.approx(153.5, abs=0.01)
    assert HYBRID.max_velocity_m_per_s == pytest.approx(24.3, abs=0.02)
    assert HYBRID.velocity_cell_m_per_s == pytest.approx(0.19, abs=1e-3)


@pytest.mark.parametrize("symbols", ["zadoff-chu", "flat"])
@pytest.mark.parametrize("n", [64, 63])
def test_sent_symbols_have_modulus_one(symbols, n: int) -> None:
    wave = replace(SMALL, n_subcarriers=n, symbols=symbols)
    np.testing.assert_allclose(np.abs(wave.sent()), 1, rtol=1e-12)


@pytest.mark.parametrize("n", [64, 63])
def test_zadoff_chu_is_flat_in_time_too(n: int) -> None:
    """A constant envelope: what lets the amplifier run at full power."""
    sent = replace(SMALL, n_subcarriers=n).sent()
    envelope = np.abs(np.fft.ifft(sent)) * np.sqrt(n)
    np.testing.assert_allclose(envelope, 1, rtol=1e-9)


def test_slot_gain_is_the_mean_over_the_repeats() -> None:
    """Against the sum of turning phasors, from standstill to the edge and at the poles."""
    repeats = np.arange(37) - 18
    for doppler in (0.0, 1e3, 12.8e3, HYBRID.subcarrier_spacing_hz):
        brute = np.exp(2j * np.pi * doppler * repeats * HYBRID.symbol_s).mean()
        assert HYBRID.slot_gain(np.array(doppler)) == pytest.approx(brute.real, abs=1e-9)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("carrier_hz", 0.0),
        ("carrier_hz", 1e9),
        ("n_slots", 0),
        ("repeats", 39),
        ("prefix_s", -1.0),
        ("slot_period_s", float("nan")),
        ("symbols", "random"),
    ],
)
def test_impossible_waveforms(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field if field != "repeats" else "slot_period_s"):
        replace(HYBRID, **{field: value})


# Map.


def test_demodulation_undoes_the_transmission() -> None:
    received = echo(SMALL, 3.3, 1.0, 1e-10)
    found = channel(record_of(received, SMALL, 1e-9))
    np.testing.assert_allclose(found, received, atol=4e-9)


@pytest.mark.parametrize("window", ["boxcar", "hann", "blackmanharris"])
def test_a_target_at_a_cells_centre_shows_its_power(window: str) -> None:
    rate = 5 * SMALL.velocity_cell_m_per_s
    image = range_doppler(echo(SMALL, 7 * SMALL.range_cell_m, rate, 2e-12), SMALL, window)
    row, column = np.unravel_index(np.argmax(image.power_w), image.power_w.shape)
    assert image.range_m[row] == pytest.approx(7 * SMALL.range_cell_m)
    assert image.range_rate_m_per_s[column] == pytest.approx(rate)
    # The target moves 0.6 % of a cell within the interval.
    assert image.power_w.max() == pytest.approx(2e-12, rel=1e-3)


def test_receding_is_positive() -> None:
    image = range_doppler(echo(SMALL, 3.0, 4.0), SMALL)
    column = np.argmax(image.power_w.max(axis=0))
    assert image.range_rate_m_per_s[column] == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize("window", ["boxcar", "blackmanharris"])
def test_noise_floor_is_noise_over_cells_times_the_windows_loss(window: str) -> None:
    rng = np.random.default_rng(1)
    image = range_doppler(noise(SMALL, 1.0, rng), SMALL, window)
    losses = [np.mean(normalised_window(window, n) ** 2) for n in (256, 64)]
    expected = np.prod(losses) / (256 * 64)
    assert image.noise_w == pytest.approx(expected, rel=0.08)
    assert image.power_w.mean() == pytest.approx(expected, rel=0.08)


@pytest.mark.quick(2)
@pytest.mark.parametrize("oversampling", [1, 2])
@pytest.mark.parametrize("n_channels", [1, 4])
@pytest.mark.parametrize("window", ["boxcar", "blackmanharris"])
def test_the_noise_floor_scatters_by_its_standard_error(
    window: str, n_channels: int, oversampling: int
) -> None:
    """Over 200 draws, each ratio known to 0.05: bounds three of those away."""
    rng, levels, stated = np.random.default_rng(2), [], []
    for _ in range(200):
        parts = np.array([noise(SMALL, 1.0, rng) for _ in range(n_channels)])
        image = range_doppler(parts, SMALL, window, oversampling=oversampling)
        levels.append(image.noise_w)
        stated.append(image.noise_error_w)
    assert 0.85 < np.std(levels) / np.mean(stated) < 1.15


# Detections.


@pytest.mark.quick(1)
@pytest.mark.parametrize("false_alarm", [1e-2, 1e-3, 1e-4])
def test_false_alarms_come_at_the_rate_asked_for(false_alarm: float) -> None:
    """Cells of 2^20 exponential ones above the threshold: a Poisson number, bounds at 1e-6."""
    power = np.random.default_rng(2).exponential(size=(4096, 256))
    above = np.count_nonzero(power > cfar_threshold(power, Cfar(false_alarm)))
    low, high = stats.poisson.ppf([5e-7, 1 - 5e-7], false_alarm * power.size)
    assert low <= above <= high


def test_cfar_factor_is_the_textbooks() -> None:
    """N (Pfa^(-1/n) - 1); towards many cells the fixed threshold -log Pfa."""
    assert cfar_factor(1e-6, 16) == pytest.approx(16 * (1e-6 ** (-1 / 16) - 1))
    assert cfar_factor(1e-6, 10**9) == pytest.approx(-np.log(1e-6), rel=1e-5)


def test_range_and_rate_errors_reach_the_cramer_rao_bound() -> None:
    """300 runs at 25 dB image SNR, rectangular window, anywhere in a cell: RMSE over bound.

    The relative spread of an RMSE from 300 runs is 4 %; allowed are 0.85 to 1.15, and the bias
    must be below 4 standard errors.
    """
    rng = np.random.default_rng(3)
    snr = 10**2.5
    errors = []
    for _ in range(300):
        where = rng.uniform(2, 5), rng.uniform(-5, 5)
        received = echo(SMALL, *where, power_w=snr / (256 * 64)) + noise(SMALL, 1.0, rng)
        image = range_doppler(received, SMALL, "boxcar")
        found = detect(received, SMALL, image, window="boxcar", at_most=1)[0]
        errors.append((found.range_m - where[0], found.range_rate_m_per_s - where[1]))
    bounds = (
        C / (4 * np.pi * SMALL.subcarrier_spacing_hz) * np.sqrt(6 / (snr * (256**2 - 1))),
        SMALL.wavelength_m / (4 * np.pi * SMALL.slot_period_s) * np.sqrt(6 / (snr * (64**2 - 1))),
    )
    for error, bound in zip(np.array(errors).T, bounds, strict=True):
        assert 0.85 < np.sqrt(np.mean(error**2)) / bound < 1.15
        assert abs(error.mean()) < 4 * bound / np.sqrt(300)


@pytest.mark.parametrize("rate", [-24.0, -10.0, 0.0, 20.0])
def test_a_fast_targets_migration_is_followed(rate: float) -> None:
    """20 m/s crosses 5 range cells in 10 ms: a plain FFT smears it, the refinement must not. Flat
    symbols: Doppler within them shifts nothing, and the channel here has none.
    """
    wave = replace(HYBRID, symbols="flat")
    received = echo(wave, 38.123, rate, 1e-12)
    image = range_doppler(received, wave, "boxcar")
    found = detect(received, wave, replace(image, noise_w=1e-20), window="boxcar", at_most=1)[0]
    assert found.range_m == pytest.approx(38.123, abs=1e-5)
    assert found.range_rate_m_per_s == pytest.approx(rate, abs=1e-4)
    assert 10 * np.log10(found.power_w / 1e-12) == pytest.approx(0, abs=0.05)


def test_two_targets_are_two_detections_strongest_first() -> None:
    rng = np.random.default_rng(5)
    received = echo(SMALL, 2.0, 1.0, 1e-2) + echo(SMALL, 4.0, -6.0, 1.0)
    received = received + noise(SMALL, 1.0, rng)
    found = detect(received, SMALL, range_doppler(received, SMALL))
    assert [round(d.range_m, 1) for d in found[:2]] == [4.0, 2.0]
    assert len(found) == 2


def test_silence_gives_no_detection() -> None:
    dark = np.zeros((256, 64), dtype=np.complex128)
    assert detect(dark, SMALL, range_doppler(dark, SMALL)) == []


def test_a_map_too_small_to_tell_the_noise_is_refused() -> None:
    with pytest.raises(ValueError, match="training"):
        cfar_threshold(np.ones((8, 8)), Cfar(1e-3))


# Record.


def test_radar_record_round_trip(tmp_path: Path) -> None:
    record = record_of(echo(SMALL, 3.0, 1.0, 1e-9), SMALL, 1e-9)
    write_radar_record(record, tmp_path / "r.h5")
    write_radar_record(record, tmp_path / "s.h5")
    assert (tmp_path / "r.h5").read_bytes() == (tmp_path / "s.h5").read_bytes()
    back = read_radar_record(tmp_path / "r.h5")
    np.testing.assert_array_equal(back.iq, record.iq)
    assert back.waveform == record.waveform
    assert back.iq.dtype == np.int16
    assert back.front_end.antenna_gain_dbi == 20.0
    assert np.isnan(back.front_end.leakage_delay_s)


def test_version_1_is_read_as_one_burst_of_one_antenna(tmp_path: Path) -> None:
    record = record_of(echo(SMALL, 3.0, 1.0, 1e-9), SMALL, 1e-9)
    write_radar_record(record, tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        for name in ("iq", "device_time_ns", "flags", "pose"):
            data = file[name][0][:, :, 0] if name == "iq" else file[name][0]
            del file[name]
            file[name] = data
        for name in ("carriers_hz", "transmitter", "transmitters_m", "receivers_m"):
            del file[name]
        for name in ("antenna_gain_dbi", "losses_db", "leakage_delay_s"):
            del file.attrs[name]
        file.attrs["schema_version"] = 1
    back = read_radar_record(tmp_path / "r.h5")
    for name in ("iq", "device_time_ns", "flags", "pose", "carriers_hz"):
        np.testing.assert_array_equal(getattr(back, name), getattr(record, name))
    assert np.array_equal(back.front_end.receivers_m, record.front_end.receivers_m)
    assert np.isnan(back.front_end.antenna_gain_dbi)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"carriers_hz": np.array([78e9])}, "does not begin"),
        ({"transmitter": np.ones(SMALL.n_slots, np.uint8)}, "transmitters_m holds 1"),
        ({"front_end": RadarFrontEnd(1.0, 1.0, receivers_m=np.zeros((2, 3)))}, "iq: shape"),
        ({"pose": np.zeros((1, 7))}, "pose: a ndarray, expected a tuple"),
        ({"pose": (QuaternionPose(),) * 2}, "pose: 2, expected one for each of 1"),
    ],
)
def test_a_record_that_contradicts_itself_is_refused(change, told) -> None:
    with pytest.raises(ValueError, match=told):
        replace(record_of(echo(SMALL, 3.0, 1.0, 1e-9), SMALL, 1e-9), **change)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("antenna_gain_dbi", np.inf),
        ("losses_db", -np.inf),
        ("leakage_delay_s", np.inf),
        ("transmit_power_w", 0.0),
    ],
)
def test_a_front_end_that_cannot_be_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        RadarFrontEnd(**{"root_watt_per_count": 1.0, "transmit_power_w": 1.0, field: value})


@pytest.mark.parametrize("delay_s", [1.5, -2, np.inf, "1 ns", True, None])
def test_a_leakage_delay_that_cannot_be_is_refused(delay_s: object) -> None:
    """In one line that names it and says what is expected; 1.5 may be nanoseconds."""
    told = re.escape(f"leakage_delay_s: {delay_s!r}, expected a finite number within +/- 1")
    with pytest.raises(InputError, match=f"^{told}$"):
        RadarFrontEnd(root_watt_per_count=1.0, transmit_power_w=1.0, leakage_delay_s=delay_s)


@pytest.mark.parametrize("command", ["detect", "image"])
def test_a_file_with_such_a_delay_is_refused(command: str, tmp_path: Path) -> None:
    """By its name, and once."""
    path = tmp_path / "r.h5"
    write_radar_record(record_of(echo(SMALL, 3.0, 1.0, 1e-9), SMALL, 1e-9), path)
    with h5py.File(path, "r+") as file:
        file.attrs["leakage_delay_s"] = 1.5
    done = ugv(command, path)
    told = "leakage_delay_s: 1.5, expected a finite number within +/- 1"
    assert (done.returncode, done.stderr) == (2, f"ugv: error: {path}: {told}\n")


def test_a_pattern_may_have_a_null_ahead() -> None:
    assert RadarFrontEnd(1.0, 1.0, antenna_gain_dbi=-np.inf).antenna_gain_dbi == -np.inf


def test_a_radar_record_is_no_optical_one(tmp_path: Path) -> None:
    from hardware import read_record

    write_radar_record(record_of(echo(SMALL, 3.0, 1.0, 1e-9), SMALL, 1e-9), tmp_path / "r.h5")
    with pytest.raises(ValueError, match="not a ugv-spi-record"):
        read_record(tmp_path / "r.h5")


# Long statistics.


@pytest.mark.slow
def test_rare_false_alarms_come_at_the_rate_asked_for() -> None:
    """1e-6 over 200 maps of 2^20 cells of exponential noise: 210 expected, bounds at 1e-6."""
    rng = np.random.default_rng(11)
    above = 0
    for _ in range(200):
        power = rng.exponential(size=(4096, 256))
        above += np.count_nonzero(power > cfar_threshold(power, Cfar(1e-6)))
    low, high = stats.poisson.ppf([5e-7, 1 - 5e-7], 1e-6 * 200 * 2**20)
    assert low <= above <= high


@pytest.mark.slow
@pytest.mark.parametrize("snr_db", [20, 30, 40])
def test_errors_reach_the_bound_from_20_db(snr_db: int) -> None:
    """2000 runs each; the relative spread of the RMSE is 1.6 %, allowed are 0.93 to 1.1.

    (At 17 dB a target between four cells of the unpadded map, 7.8 dB down, loses to noise.)
    """
    rng = np.random.default_rng(snr_db)
    snr = 10 ** (snr_db / 10)
    errors = []
    for _ in range(2000):
        where = rng.uniform(2, 5), rng.uniform(-5, 5)
        received = echo(SMALL, *where, power_w=snr / (256 * 64)) + noise(SMALL, 1.0, rng)
        image = range_doppler(received, SMALL, "boxcar")
        found = detect(
            received, SMALL, image, window="boxcar", false_alarm=1e-2, at_most=1, guard=(2, 2)
        )[0]
        errors.append((found.range_m - where[0], found.range_rate_m_per_s - where[1]))
    bounds = (
        C / (4 * np.pi * SMALL.subcarrier_spacing_hz) * np.sqrt(6 / (snr * (256**2 - 1))),
        SMALL.wavelength_m / (4 * np.pi * SMALL.slot_period_s) * np.sqrt(6 / (snr * (64**2 - 1))),
    )
    for error, bound in zip(np.array(errors).T, bounds, strict=True):
        assert 0.93 < np.sqrt(np.mean(error**2)) / bound < 1.1
