"""Calibration of both sensors against a reference target, and what it says of itself."""

import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from radar_cubes import Echo, calibrated, cube
from spi_records import record_of
from ugv_command import ugv

from hardware import PatternSet, SpiRecord, reconstruct
from hardware.calibration import (
    CalibrationTarget,
    CameraCalibration,
    RadarCalibration,
    read_calibration,
    write_calibration,
)
from hardware.radar.process import frames
from hardware.recording import Log, read_messages
from hardware.records import Flag, RadarRecord
from hardware.waveform import OfdmWaveform

TARGET = CalibrationTarget(distance_m=3.0, size=0.5)


def record(cells: np.ndarray, device: str = "camera") -> SpiRecord:  # type: ignore[type-arg]
    patterns = PatternSet(8, 8, 64)
    return replace(record_of(patterns.signal(cells.reshape(64, 1)), patterns), device=device)


# The camera.


def test_reflectance_comes_out_of_any_light_and_any_dark(tmp_path: Path) -> None:
    """Unequal cells, a dark image that is not zero; a surface twice as far away sends a quarter."""
    rng = np.random.default_rng(0)
    light, dark = rng.uniform(2000, 9000, 64), rng.uniform(0, 300, 64)
    albedo = rng.uniform(0.05, 0.9, 64)
    seen = [record(dark), record(dark + 0.5 * light), record(dark + albedo * light / 4)]
    made = CameraCalibration.of(seen[0], seen[1], TARGET)
    write_calibration(made, tmp_path / "camera.h5")
    loaded = read_calibration(tmp_path / "camera.h5", max_age_s=60)
    assert isinstance(loaded, CameraCalibration)
    image = reconstruct(seen[2], "zero-fill").image
    found = loaded.reflectance(image, seen[2], 6.0)
    np.testing.assert_allclose(found.ravel(), albedo, atol=0.01)  # counts are whole numbers
    with pytest.raises(ValueError, match="device: calibrated 'camera', measured 'other'"):
        loaded.reflectance(image, record(dark, "other"), 6.0)
    with pytest.raises(ValueError, match="no brighter"):
        CameraCalibration.of(seen[1], seen[0], TARGET)


def test_a_saturated_or_marked_exposure_is_refused() -> None:
    """The brightest exposure of a flat holds all its light: clipped to half, the plain transform
    takes the same from every cell, and later reflectances are too large without a trace.
    """
    dark, flat = record(np.full(64, 10.0)), record(np.full(64, 1000.0))
    top = 2**15 - 1
    clipped = replace(flat, counts=np.minimum(flat.counts, top), adc_bits=15)
    lost = np.sum(flat.counts > top) * (64000 - top) / 64
    image = reconstruct(clipped, "zero-fill").image
    assert image.mean() == pytest.approx(1000 - lost, rel=0.01)
    flags = flat.flags.copy()
    flags[[3, 5]] = Flag.LOST
    for spoilt, says in (
        (clipped, "^wall.mcap: 1 of 128 exposures stand at an end .* expected none"),
        (replace(flat, flags=flags), "^wall.mcap: 2 of 128 exposures are marked lost"),
    ):
        with pytest.raises(ValueError, match=says):
            CameraCalibration.of(dark, spoilt, TARGET, ("lid.mcap", "wall.mcap"))
        with pytest.raises(ValueError, match=says):
            CameraCalibration.of(spoilt, flat, TARGET, ("wall.mcap", "flat.mcap"))


def test_what_is_wrong_with_a_flat_and_where_surfaces_stand_is_told(tmp_path: Path) -> None:
    """Warnings of a reference stand in its file, and whatever uses it repeats them. Reflectance is
    that of surfaces at one distance, which is told: four times as much at twice the distance.
    """
    flat = record(np.full(64, 1000.0))
    late = replace(flat, device_time_ns=flat.device_time_ns + 500 * (flat.sequence > 64))
    for name, each in (("dark", record(np.full(64, 10.0))), ("flat", late), ("scene", flat)):
        with Log(tmp_path / f"{name}.mcap") as log:
            log.record("/spi/record", each, host_ns=0)
    dark, flat_log, scene = (tmp_path / f"{name}.mcap" for name in ("dark", "flat", "scene"))
    made, out = tmp_path / "camera.h5", tmp_path / "out.mcap"
    asked = ("--distance", "3", "--reflectance", "0.5")
    told = f"{flat_log}: 1 of 128 exposures begin 5.01e-07 s at worst after the one before"
    assert told in ugv("calibrate", "camera", dark, flat_log, "-o", made, *asked).stderr
    for more, distance, expected in ((), "3 m", 0.5), (("--distance", "6"), "6 m", 2.0):
        out.unlink(missing_ok=True)
        done = ugv("process", scene, "-o", out, "--calibration", made, *more)
        assert f"reflectance of surfaces at {distance}" in done.stdout
        assert f"{made}: calibration: {told}" in done.stderr
        [image] = [found for found in read_messages(out) if found.topic == "/spi/image"]
        pixels = np.frombuffer(image.message.data[-4 * 64 :], "<f4")
        np.testing.assert_allclose(pixels, expected, rtol=1e-3)
    done = ugv("process", scene, "-o", tmp_path / "new.mcap", "--distance", "6")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "--distance: is for a camera's --calibration" in done.stderr


# The radar.

#: Cells of 0.29 m up to 75 m.
WAVE = OfdmWaveform(79e9, 256, 2e6, 16, 2e-6, 1, 1e-6)
#: Two-way gain, where the records declare 40 dB, and what the cables add to ranges.
GAIN, OFFSET_M = 10**3.3, 0.12


def burst(
    range_m: float,
    rcs_m2: float,
    *more: Echo,
    sent_w: float = 0.01,
    offset_m: float = OFFSET_M,
    carrier_hz: float = 79e9,
    snr_db: float = 80.0,
    **options: float,
) -> RadarRecord:
    """A point by the radar equation, so far over the noise of its cell."""
    wave = replace(WAVE, carrier_hz=carrier_hz)
    received_w = sent_w * GAIN * wave.wavelength_m**2 * rcs_m2 / (4 * np.pi) ** 3 / range_m**4
    noise_w = received_w * 10 ** (-snr_db / 10) * wave.n_subcarriers * wave.n_slots
    echo = Echo((range_m + offset_m, 0.0, 0.0), received_w)
    made = cube(wave, [echo, *more], noise_w=noise_w, **options)  # type: ignore[arg-type]
    return calibrated(made, transmit_power_w=sent_w)


def calibration(*records: RadarRecord, distance_m: float = 10.0) -> RadarCalibration:
    """Against 5 m^2."""
    numbered = enumerate(records, 1)
    bursts = ((number, record, frame) for number, record in numbered for frame in frames(record))
    return RadarCalibration.of(bursts, CalibrationTarget(distance_m, 5.0))


def test_radar_range_and_cross_section(tmp_path: Path) -> None:
    """By the radar equation, whatever is sent and declared since: a tenth of the power, an
    attenuator of 3 dB that the record tells. Where the gain is not known it is refused.
    """
    write_calibration(calibration(burst(10.0, 5.0)), tmp_path / "r.h5")
    made = read_calibration(tmp_path / "r.h5")
    assert isinstance(made, RadarCalibration)
    assert not made.warnings
    assert made.two_way_gain_db == pytest.approx(33, abs=4 * made.two_way_gain_error_db)
    assert made.two_way_gain_error_db < 0.01
    usual = burst(25.0, 0.7)
    less = replace(usual.front_end, losses_db=3.0, root_watt_per_count=0.7079 * 1e-8)
    full = replace(usual.front_end, root_watt_per_count=1e-8)
    attenuated = [replace(usual, front_end=end) for end in (full, less)]
    sizes = []
    for measured in (usual, burst(25.0, 0.7, sent_w=1e-3), *attenuated):
        made.check(measured)
        [frame] = frames(measured)
        [found] = frame.detections
        found = made.corrected(found, frame.waveform, measured.front_end)
        assert found.range_m == pytest.approx(25, abs=4 * found.range_error_m)
        sizes.append(found.rcs_m2)
    np.testing.assert_allclose(sizes[:2], 0.7, rtol=1e-3)
    assert sizes[3] == pytest.approx(sizes[2], rel=1e-3)
    # 12 m/s turn each of 37 repeats of 0.5 us by 2 v / lambda of a cycle a second: what the
    # Dirichlet kernel takes from their mean is put back.
    wave = replace(WAVE, repeats=37, slot_period_s=20e-6)
    x = np.pi * 2 * 12.0 / wave.wavelength_m / 2e6
    kept = np.sin(37 * x) / (37 * np.sin(x))
    [frame] = frames(usual)
    still = replace(frame.detections[0], range_rate_m_per_s=0.0)
    moving = replace(still, range_rate_m_per_s=12.0, power_w=still.power_w * kept**2)
    alike = [made.corrected(one, wave, usual.front_end).rcs_m2 for one in (still, moving)]
    assert alike[1] == pytest.approx(alike[0])
    with pytest.raises(ValueError, match=r"^carrier_hz: calibrated 79\.00 GHz, measured 24\.00"):
        made.check(burst(25.0, 0.7, carrier_hz=24e9))
    with pytest.raises(ValueError, match=r"^antenna_gain_dbi: calibrated 20, measured nan"):
        made.check(calibrated(usual, antenna_gain_dbi=float("nan")))
    with pytest.raises(ValueError, match="none within 1 m of the target at 20 m"):
        calibration(burst(10.0, 5.0), distance_m=20.0)


def test_errors_hold_those_of_the_calibration() -> None:
    """A reference of 22 dB, some 50 mm and 0.5 dB, for an echo of 80 dB whose own errors are a
    thousandth of that: over 20 references errors are as large as they are said to be.
    """
    measured = burst(25.0, 0.7)
    [frame] = frames(measured)
    pulls, warned = [], 0
    for seed in range(20):
        made = calibration(burst(10.0, 5.0, snr_db=22.0, seed=seed))
        found = made.corrected(frame.detections[0], frame.waveform, measured.front_end)
        pulls.append(
            (
                (found.range_m - 25) / found.range_error_m,
                10 * np.log10(found.rcs_m2 / 0.7) / (4.343 * found.rcs_error_m2 / found.rcs_m2),
            )
        )
        weak = made.two_way_gain_error_db > 0.5
        assert weak == any("the target's echo is weak" in told for told in made.warnings)
        warned += weak
    assert warned
    scatter = np.sqrt(np.mean(np.square(pulls), axis=0))
    np.testing.assert_allclose(scatter, 1, atol=0.5)  # 3 sigma of 20 draws


def test_all_bursts_of_a_reference_count() -> None:
    """Four alike: half of one's error. Three 0.3 m apart: their mean, and their scatter."""
    here = np.tile([0, 0, 0, 1.0, 0, 0, 0], (4, 1))
    four, one = calibration(burst(10.0, 5.0, pose=here)), calibration(burst(10.0, 5.0))  # type: ignore[arg-type]
    for name in ("range_offset_error_m", "two_way_gain_error_db"):
        assert getattr(four, name) == pytest.approx(getattr(one, name) / 2, rel=0.2)
    assert four.range_offset_m == pytest.approx(OFFSET_M, abs=4 * four.range_offset_error_m)
    assert not four.warnings
    apart = calibration(*(burst(10.0, 5.0, offset_m=offset_m) for offset_m in (0.0, 0.3, 0.6)))
    assert apart.range_offset_m == pytest.approx(0.3, abs=1e-3)
    assert apart.range_offset_error_m == pytest.approx(0.3, abs=1e-3)
    [told] = [warning for warning in apart.warnings if "range offsets of 3 bursts" in warning]
    assert "by more than their errors" in told


def test_a_reference_that_is_not_alone_or_saturated_is_told(tmp_path: Path) -> None:
    """A post of four times the power within the gate is taken for the target: both are named."""
    plain = burst(10.0, 5.0)
    [alone] = next(frames(plain)).detections
    post = Echo((10.9, 0.0, 0.0), 4 * alone.power_w)
    crowded = calibration(burst(10.0, 5.0, post, offset_m=-0.9))
    [told] = crowded.warnings
    assert "burst 0: 2 echoes within 1 m of the target, at 10.900 m" in told
    assert " 9.100 m" in told
    flags = plain.flags.copy()
    flags[0, 0, 3] = Flag.SATURATED
    iq = plain.iq.copy()
    iq[0, 0, 2, 0, :7, 0] = 32767
    for spoilt, says in (
        (replace(plain, flags=flags), "0 of 8192 samples .* 1 slots are flagged as saturated"),
        (replace(plain, iq=iq), "^burst 0: 7 of 8192 samples stand at the converter's rail"),
    ):
        with pytest.raises(ValueError, match=says):
            calibration(plain, spoilt)
    with Log(tmp_path / "run.mcap") as log:
        for host_ns, offset_m in enumerate((0.0, 0.3, 0.6)):
            log.record("/radar/record", burst(10.0, 5.0, offset_m=offset_m), host_ns=host_ns)
    asked = ("--distance", "10", "--cross-section", "5")
    done = ugv("calibrate", "radar", tmp_path / "run.mcap", "-o", tmp_path / "r.h5", *asked)
    assert "range offset 300 ± 300 mm; two-way gain 33.00" in done.stdout
    assert "dB, 7.00 dB less than the record declares" in done.stdout
    assert "run.mcap: range offsets of 3 bursts go from" in done.stderr


# Files of both.


def test_an_old_calibration_is_refused(tmp_path: Path) -> None:
    made = CameraCalibration.of(
        record(np.zeros(64)), record(np.full(64, 1e3)), CalibrationTarget(1.0, 1.0)
    )
    old = replace(made, made_ns=time.time_ns() - 40 * 86400 * 10**9)
    write_calibration(old, tmp_path / "old.h5")
    with pytest.raises(ValueError, match=r"old\.h5: 40 days old, at most 30 are allowed"):
        read_calibration(tmp_path / "old.h5", max_age_s=30 * 86400)
    with pytest.raises(ValueError, match=r"distance_m: 0\.0"):
        CalibrationTarget(0.0, 1.0)
    (tmp_path / "none.h5").write_bytes(b"none")
    with pytest.raises(ValueError, match=r"none\.h5"):
        read_calibration(tmp_path / "none.h5")


def test_files_of_the_first_version(tmp_path: Path) -> None:
    """The camera's are read as ones without warnings; a radar's held at one power and carrier."""
    dark, flat = record(np.zeros(64)), record(np.full(64, 1e3))
    write_calibration(CameraCalibration.of(dark, flat, TARGET), tmp_path / "camera.h5")
    write_calibration(calibration(burst(10.0, 5.0)), tmp_path / "radar.h5")
    for name in ("camera", "radar"):
        with h5py.File(tmp_path / f"{name}.h5", "r+") as file:
            file.attrs["schema_version"] = 1
            for added in ("warning_lines", "carrier_hz", "two_way_gain_db"):
                if added in file.attrs:
                    del file.attrs[added]
    assert not read_calibration(tmp_path / "camera.h5").warnings
    with pytest.raises(ValueError, match=r"radar\.h5: .* of version 1, .* calibrate anew"):
        read_calibration(tmp_path / "radar.h5")
