"""Symbols of a user's own: sent, recorded, and divided by what the record says was sent."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from hardware import (
    InputError,
    Log,
    OfdmWaveform,
    process,
    read_radar_record,
    read_records,
    write_radar_record,
)
from hardware.drivers.radio.schedule import Schedule
from hardware.drivers.radio.setup import read_setup, write_setup
from twin import Fidelity, load_radar, load_scene, radar_capture
from twin.errors import InputError as TwinInputError

QUICK = Fidelity(radar="targets")
PHASES = np.exp(2j * np.pi * np.random.default_rng(0).random(4096))


def coded(waveform):
    return PHASES


@pytest.fixture(scope="module")
def record():
    radar = load_radar("hybrid-79").with_({"waveform.function": coded})
    return radar_capture(load_scene("yard"), radar, seed=1, fidelity=QUICK).record


def test_detections_are_those_of_the_bundled_symbols(record) -> None:
    """Random phases spread an echo as little as Zadoff and Chu's, once divided by: the same
    targets within a hundredth of a cell (36 mm), at the same level but for other noise.
    """
    radar = load_radar("hybrid-79")
    known = radar_capture(load_scene("yard"), radar, seed=1, fidelity=QUICK).record
    ours, theirs = (sorted(process(r).detections, key=lambda d: d.range_m) for r in (record, known))
    assert len(ours) == len(theirs) > 1
    for one, other in zip(ours, theirs, strict=True):
        assert one.range_m == pytest.approx(other.range_m, abs=4e-4)
        assert one.power_w == pytest.approx(other.power_w, rel=0.05)


def test_another_divisor_finds_none_of_them(record) -> None:
    """The vehicle divides by what the record says: told otherwise, echoes spread over all cells."""
    wrong = replace(record, waveform=replace(record.waveform, symbols="zadoff-chu"))
    powers = [max((d.power_w for d in process(r).detections), default=0.0) for r in (record, wrong)]
    assert powers[1] < 0.05 * powers[0]


def test_records_and_logs_hold_them(record, tmp_path: Path) -> None:
    path = tmp_path / "radar.h5"
    write_radar_record(record, path)
    again = read_radar_record(path)
    assert again.waveform == record.waveform
    assert hash(again.waveform) == hash(record.waveform)
    np.testing.assert_array_equal(again.waveform.sent(), PHASES)
    with Log(tmp_path / "log.mcap") as log:
        log.record("/radar/record", record)
    (received,) = read_records(tmp_path / "log.mcap")
    assert received.record.waveform == record.waveform
    with h5py.File(path, "r+") as file:
        file["waveform/own_symbols"][0] = file["waveform/own_symbols"][0][::-1]
    with pytest.raises(InputError, match=r"radar\.h5: symbols: their SHA-256 is"):
        read_radar_record(path)


def test_records_of_version_2_name_their_symbols(tmp_path: Path) -> None:
    path = tmp_path / "old.h5"
    radar = load_radar("hybrid-79")
    known = radar_capture(load_scene("yard"), radar, seed=1, fidelity=QUICK).record
    write_radar_record(known, path)
    with h5py.File(path, "a") as file:
        file.attrs["schema_version"] = 2
        del file["waveform"].attrs["digest"]
    assert read_radar_record(path).waveform == known.waveform


def test_a_radio_is_told_of_them(tmp_path: Path) -> None:
    radar = load_radar("prototype")
    own = np.exp(1j * np.arange(radar.ofdm.n_subcarriers) ** 2)
    np.save(tmp_path / "mine.npy", own.astype(np.complex64))
    coded = radar.with_({"waveform.symbols_file": str(tmp_path / "mine.npy")})
    schedule = Schedule(coded.ofdm, (coded.ofdm.carrier_hz,), 2e-3)
    front_end = radar_capture(load_scene("yard"), coded, fidelity=QUICK).record.front_end
    write_setup(schedule, front_end, tmp_path / "setup.json")
    again, _ = read_setup(tmp_path / "setup.json")
    assert again.waveform == coded.ofdm
    np.testing.assert_allclose(again.waveform.sent(), own, atol=1e-6)


@pytest.mark.parametrize(
    ("symbols", "told"),
    [
        (np.ones(5), "5, expected one for each of n_subcarriers, 4"),
        (np.array([1, 1, 2, 1]), "subcarrier 2 has the modulus 2, expected 1"),
        (np.array([1, np.nan, 1, 1]), "subcarrier 1 has the modulus nan"),
        (np.ones((4, 4)), r"shape \(4, 4\), expected complex"),
        ("qam", "'qam' is none of"),
        ("own", "'own' is none of"),
    ],
)
def test_what_are_no_symbols_is_told(symbols, told: str) -> None:
    with pytest.raises(InputError, match=f"symbols: .*{told}|symbols: {told}"):
        OfdmWaveform(79e9, 4, 250e3, 256, 20e-6, 4, 1e-6, symbols=symbols)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"waveform.symbols_file": "none.npy"}, r"symbols_file.*none\.npy: no such file"),
        ({"waveform.function": lambda waveform: np.ones(3)}, "3, expected one for each"),
        ({"waveform.function": lambda waveform: 2.0}, "function: .*expected complex numbers"),
        ({"waveform.symbols": None}, "needs one of symbols, symbols_file and function"),
    ],
)
def test_a_radar_says_what_is_wrong(changes, told: str) -> None:
    with pytest.raises(TwinInputError, match=told):
        load_radar("hybrid-79").with_(changes)
