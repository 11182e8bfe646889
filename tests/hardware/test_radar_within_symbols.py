"""Doppler within a symbol: records by definition, every sample taken at its own time."""

import numpy as np
import pytest
from scipy.constants import speed_of_light

from hardware.radar import OfdmWaveform
from hardware.radar.process import process
from hardware.radar.settings import Processing
from hardware.radar.windows import normalised_window
from hardware.radar.within_symbols import leaked_response
from hardware.records import QuaternionPose, RadarFrontEnd, RadarRecord

N, SPACING_HZ = 256, 400e3
RANDOM = np.exp(2j * np.pi * np.random.default_rng(0).random(N))
SYMBOLS = {"zadoff-chu": "zadoff-chu", "flat": "flat", "random": RANDOM}


def wave_of(symbols: str) -> OfdmWaveform:
    return OfdmWaveform(79e9, N, SPACING_HZ, 32, 20e-6, 2, 1e-6, symbols=SYMBOLS[symbols])


def samples(wave: OfdmWaveform, range_m: float, rate_m_per_s: float) -> np.ndarray:
    """Of an echo of unit amplitude, (n_slots, n_subcarriers); of every sample the channel is that
    of its own time, the mean over both repeats.
    """
    n = wave.n_subcarriers
    frequency_hz = wave.carrier_hz + wave.frequency_offsets_hz
    baseband = np.exp(
        2j * np.pi * np.outer(np.arange(n), wave.frequency_offsets_hz) / wave.bandwidth_hz
    )
    found = np.zeros((wave.n_slots, n), complex)
    for slot, middle in enumerate(wave.slot_times_s):
        for repeat in (-0.5, 0.5):
            times = middle + repeat * wave.symbol_s
            times = times + (np.arange(n) - (n - 1) / 2) / wave.bandwidth_hz
            delay_s = 2 * (range_m + rate_m_per_s * times) / speed_of_light
            channel = np.exp(-2j * np.pi * (np.outer(delay_s, frequency_hz) % 1.0))
            found[slot] += (channel * baseband) @ wave.sent() / np.sqrt(n) / 2
    return found


def record(wave: OfdmWaveform, received: np.ndarray) -> RadarRecord:
    return RadarRecord(
        iq=np.rint(np.stack([received.real, received.imag], -1)).astype(np.int16)[
            None, None, :, None
        ],
        device_time_ns=(20_000 * np.arange(wave.n_slots)).reshape(1, 1, -1),
        flags=np.zeros((1, 1, wave.n_slots), np.uint8),
        carriers_hz=np.array([wave.carrier_hz]),
        transmitter=np.zeros(wave.n_slots, np.uint8),
        waveform=wave,
        front_end=RadarFrontEnd(
            root_watt_per_count=1e-9, transmit_power_w=0.01, antenna_gain_dbi=20, losses_db=0
        ),
        device="by definition",
        pose=(QuaternionPose.from_numbers([0, 0, 0, 1, 0, 0, 0]),),
    )


@pytest.mark.quick(2)
@pytest.mark.parametrize("symbols", SYMBOLS)
@pytest.mark.parametrize("window", ["blackmanharris", "boxcar"])
def test_ranges_and_levels_of_what_is_fast(symbols: str, window: str) -> None:
    """Up to 40 m/s, which turns a symbol by 0.05 cycles: over the unambiguous range errors are
    below 0.001 cells, of which Zadoff-Chu symbols would be off by 0.05, and within 4.5 standard
    ones (false alarm 7e-6 each); levels are within 0.3 %.
    """
    wave = wave_of(symbols)
    rng = np.random.default_rng(3)
    for range_m in (3.0, 55.0, 150.0, 250.0, 330.0):
        rate = float(rng.uniform(20, 40) * rng.choice([-1, 1]))
        noise = rng.normal(0, 3, (2, wave.n_slots, N)) * [[[1]], [[1j]]]
        received = 2000 * samples(wave, range_m, rate) + noise.sum(axis=0)
        how = Processing(window=window)
        found = process(record(wave, received), how=how).detections[0]
        assert abs(found.range_m - range_m) < 4.5 * found.range_error_m
        assert abs(found.range_m - range_m) < 1e-3 * wave.range_cell_m
        slot_gain = float(wave.slot_gain(np.array(2 * rate / wave.wavelength_m)))
        assert found.power_w == pytest.approx((2000e-9 * slot_gain) ** 2, rel=3e-3)


def test_a_leaked_response_is_the_definition() -> None:
    """One slot about the interval's middle, all kinds of symbols."""
    for symbols in SYMBOLS:
        wave = OfdmWaveform(79e9, N, SPACING_HZ, 1, 20e-6, 1, 1e-6, symbols=SYMBOLS[symbols])
        n, offsets = wave.n_subcarriers, wave.frequency_offsets_hz
        times = (np.arange(n) - (n - 1) / 2) / wave.bandwidth_hz
        delay = 3e-7 + 2 * 35.0 / speed_of_light * times
        phase = np.outer(delay, wave.carrier_hz + offsets) % 1.0
        baseband = np.outer(np.arange(n), offsets) / wave.bandwidth_hz
        received = np.exp(2j * np.pi * (baseband - phase)) @ wave.sent()
        found = np.exp(-2j * np.pi * baseband).T @ received / n * wave.sent().conj()
        still = np.exp(-2j * np.pi * ((wave.carrier_hz + offsets) * 3e-7 % 1.0))
        response = leaked_response(wave, 3e-7, 2 * 35.0 / speed_of_light)
        # Within a symbol the band's edges migrate by 1e-4 of a cycle.
        np.testing.assert_allclose(response, found / still, atol=2e-4)


def test_two_fast_targets_near_each_other() -> None:
    """Two cells apart and split (`resolve`): both with their range and level, and no third one.
    Without correction ranges were off by 10 standard errors and more.
    """
    wave = wave_of("zadoff-chu")
    rng = np.random.default_rng(4)
    places = np.array([55.0, 55.0 + 2 * wave.range_cell_m])
    received = 2000 * sum(samples(wave, range_m, 35.0) for range_m in places)
    received = received + (rng.normal(0, 100, (2, wave.n_slots, N)) * [[[1]], [[1j]]]).sum(axis=0)
    found = process(record(wave, received), 0, Processing(resolve=True)).detections
    found = sorted(found, key=lambda detection: detection.range_m)
    assert len(found) == 2
    off = np.array([d.range_m for d in found]) - places
    assert (np.abs(off) < 4.5 * np.array([d.range_error_m for d in found])).all()
    assert (np.abs(off) < 0.01 * wave.range_cell_m).all()
    assert found[0].power_w == pytest.approx(found[1].power_w, rel=0.1)


def test_a_single_slot_says_what_rates_shift() -> None:
    wave = OfdmWaveform(79e9, N, SPACING_HZ, 1, 20e-6, 2, 1e-6)
    rng = np.random.default_rng(5)
    received = 2000 * samples(wave, 55.0, 20.0) + rng.normal(0, 3, (1, N))
    frame = process(record(wave, received))
    assert any("one slot tells no range rate" in warning for warning in frame.warnings)


def test_side_lobes_of_a_fast_echo() -> None:
    """Of a Zadoff-Chu symbol of 1 us, 20 m/s, 20 m away: 78 dB below it, 5 cells away."""
    wave = OfdmWaveform(79e9, 4096, 976_562.5, 64, 39.0625e-6, 37, 1.024e-6)
    response = leaked_response(wave, 2 * 20 / speed_of_light, 2 * 20 / speed_of_light)
    profile = np.abs(np.fft.fft(normalised_window("blackmanharris", 4096) * response))
    lobes_db = 20 * np.log10(profile / profile.max())
    assert lobes_db[[-5, 5]].max() == pytest.approx(-78, abs=1)
    assert lobes_db[5:-5].max() < -77
