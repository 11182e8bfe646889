"""The scanning LIDAR: its noise against that of Hadamard patterns, its distances against the
Cramer-Rao bound, its light against closed forms.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from hardware import SpiRecord, read_record, write_record
from hardware.errors import InputError
from hardware.patterns import Patterns, PatternSet, RasterScan
from hardware.reconstruction import range_image, reconstruct
from hardware.reconstruction.gating import bounds, echo, share
from hardware.reconstruction.ranging import ECHO_CUT
from hardware.reconstruction.scanning import BACKGROUND_IN_IMAGE
from hardware.records import Flag, QuaternionPose, Shutter
from twin.camera.cell_noise import echo_noise
from twin.camera.chain import Chain, Powers
from twin.camera.light import render
from twin.detector import NoiseBudget
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.optics.hazards import hazards, least_margins
from twin.optics.radiometry import collection, mean_cos_power, wall_power_w
from twin.scene import Pose, Rig, Scene, SceneObject, Sun
from twin.system import System, load_system

#: A sixteenth of the cells, at the same energy a cell.
SMALL = {"emitter.rows": 16, "emitter.columns": 16, "acquisition.n_patterns": 256}
WIDTH_S = 10e-9
C = 299_792_458.0


def record_of(
    electrons: np.ndarray, patterns: Patterns, shutters: tuple[Shutter, ...] = (Shutter(),)
) -> SpiRecord:
    n = patterns.n_exposures * len(shutters)
    return SpiRecord(
        counts=np.rint(electrons).astype(np.int32).reshape(n, -1),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=30,
        device="test",
        pose=QuaternionPose(),
        shutters=shutters,
        pulse_width_s=WIDTH_S if shutters[0].gated else 0.0,
    )


def gates(n: int) -> tuple[Shutter, ...]:
    return tuple(Shutter(gate_delay_s=k * WIDTH_S, gate_width_s=WIDTH_S) for k in range(n))


def small(**changes: object) -> System:
    return load_system("lidar-scan").with_(SMALL | changes)


def image_noise(patterns: Patterns, cells: np.ndarray, read_e: float) -> float:
    """Root mean square error of plain inverses of 40 records, Poisson light and a read noise."""
    rng, off = np.random.default_rng(3), []
    for _ in range(40):
        light = rng.poisson(patterns.signal(cells)) + rng.normal(0, read_e, patterns.n_exposures)
        image = reconstruct(record_of(light + 1e5, patterns), "zero-fill").image
        off.append(image.ravel() - cells)
    return float(np.sqrt(np.mean(np.square(off))))


def test_fellgett_noise_of_the_detector_and_of_the_light() -> None:
    """Noise per cell, all exposures alike and each cell lit as strongly: that of the detector s is
    s sqrt(2 / N) behind N differential Hadamard patterns and s sqrt(2) behind a scan, so patterns
    gain sqrt(N) (Fellgett); shot noise is sqrt(mean of the cells) behind patterns, the square root
    of its own light behind a scan: nothing is gained, and dark cells lose. 256 cells x 40 records
    hold both within 2.5 % at 3.5 standard errors.
    """
    n, read_e = 256, 300.0
    hadamard, scan = PatternSet(16, 16, n), RasterScan(16, 16, "differential")
    assert hadamard.n_exposures == scan.n_exposures
    dark = np.zeros(n)
    assert image_noise(hadamard, dark, read_e) == pytest.approx(read_e * np.sqrt(2 / n), rel=0.025)
    assert image_noise(scan, dark, read_e) == pytest.approx(read_e * np.sqrt(2), rel=0.025)
    cells = np.where(np.arange(n) % 4 == 0, 4e4, 0.0)  # a quarter of them lit
    lit = image_noise(hadamard, cells, 0.0)
    assert lit == pytest.approx(np.sqrt(cells.mean()), rel=0.025)
    # rms over the cells of sqrt(x): the same mean; but all of it in the cells that are lit.
    assert image_noise(scan, cells, 0.0) == pytest.approx(np.sqrt(cells.mean()), rel=0.035)
    rng = np.random.default_rng(0)
    alone = reconstruct(record_of(rng.poisson(scan.signal(cells)), scan), "zero-fill").image.ravel()
    assert not alone[cells == 0].any()
    budget = NoiseBudget(0.0, 0.0, 0.0, {"read noise": read_e})
    assert budget.pixel_noise_e(hadamard) == pytest.approx(read_e * np.sqrt(2 / n))
    assert budget.pixel_noise_e(scan) == pytest.approx(read_e * np.sqrt(2))


def test_bounds_of_two_gates_in_closed_form() -> None:
    """An echo that fills the share u of the later one of two gates of equal noise s, g1 = A (1 - u)
    and g2 = A u: A = g1 + g2 has the variance 2 s^2, t = w g2 / A the variance (w s / A)^2
    (u^2 + (1 - u)^2).
    """
    two = np.array([(0.0, WIDTH_S), (WIDTH_S, WIDTH_S)])
    u, amplitude, s = np.array([0.1, 0.3, 0.5, 0.9]), 5e4, 300.0
    variance = np.full((2, 4), s**2)
    of_amplitude, of_delay = bounds(np.full(4, amplitude), u * WIDTH_S, variance, two, WIDTH_S)
    np.testing.assert_allclose(of_amplitude, s * np.sqrt(2), rtol=1e-9)
    expected = WIDTH_S * s / amplitude * np.sqrt(u**2 + (1 - u) ** 2)
    np.testing.assert_allclose(of_delay, expected, rtol=1e-9)


def test_bounds_over_a_background_are_those_of_the_whole_information_matrix() -> None:
    rng = np.random.default_rng(5)
    six = np.array([(k * WIDTH_S, WIDTH_S) for k in range(6)])
    delay, amplitude = rng.uniform(0.5, 4.5, 20) * WIDTH_S, rng.uniform(1e3, 1e5, 20)
    variance = rng.uniform(1e4, 1e5, (6, 20))
    found = bounds(amplitude, delay, variance, six, WIDTH_S, background=True)
    for i in range(20):
        u, first = math.modf(delay[i] / WIDTH_S)
        response, slope = np.zeros(6), np.zeros(6)
        response[int(first)], response[int(first) + 1] = 1 - u, u
        slope[int(first)], slope[int(first) + 1] = -1 / WIDTH_S, 1 / WIDTH_S
        jacobian = np.stack([response, amplitude[i] * slope * WIDTH_S, np.ones(6)])
        covariance = np.linalg.inv(jacobian / variance[:, i] @ jacobian.T)
        assert found[0][i] == pytest.approx(math.sqrt(covariance[0, 0]), rel=1e-6)
        assert found[1][i] == pytest.approx(math.sqrt(covariance[1, 1]) * WIDTH_S, rel=1e-6)


def test_an_echo_over_an_unknown_background_reaches_its_bound() -> None:
    """2000 cells of one echo each over a background that is not known: amplitude and delay scatter
    as their Cramer-Rao bounds say, within the 1.6 % of that many draws and 3 %; without knowing of
    the background the delay would be far off.
    """
    n, rng = 2000, np.random.default_rng(1)
    twelve = np.array([(k * WIDTH_S, WIDTH_S) for k in range(12)])
    delay, amplitude = np.full(n, 4.3 * WIDTH_S), np.full(n, 3e4)
    background = rng.uniform(0, 2e4, n)
    mean = np.stack([amplitude * share(delay, *gate, WIDTH_S) for gate in twelve]) + background
    seen, errors = mean + rng.normal(0, 200.0, mean.shape), np.full(mean.shape, 200.0)
    found = echo(seen, errors, twelve, WIDTH_S, background=True)
    of_amplitude, of_delay = bounds(amplitude, delay, errors**2, twelve, WIDTH_S, background=True)
    assert (found.amplitude - amplitude).std() == pytest.approx(of_amplitude[0], rel=0.08)
    assert (found.delay_s - delay).std() == pytest.approx(of_delay[0], rel=0.08)
    assert abs((found.delay_s - delay).mean()) < 5 * of_delay[0] / math.sqrt(n)
    assert np.median(found.error_s) == pytest.approx(of_delay[0], rel=0.08)
    assert (found.confidence > 0.95).mean() > 0.99
    blind = echo(seen, errors, twelve, WIDTH_S)
    assert np.median(np.abs(blind.delay_s - delay)) > 10 * of_delay[0]


def test_the_bundled_lidar_has_the_power_the_pupil_and_the_rate_that_it_claims() -> None:
    """Mean power and pupil of `workable`, 64 x 64 cells at 2.5 kHz in 1.64 s (paper, section 1);
    class 1 margins by hand: 8 mJ against one pulse, 10 mW against all of the beam at rest.
    """
    lidar, camera = load_system("lidar-scan"), load_system("workable")
    assert lidar.mean_power_w == pytest.approx(camera.mean_power_w, rel=1e-9)
    assert lidar.frame_time_s == pytest.approx(4096 / 2500)
    pupils = [collection(system).pupil_diameter_m for system in (lidar, camera)]
    assert pupils[0] == pytest.approx(pupils[1], rel=2e-3)
    margins = {row.name: row.margin for row in hazards(lidar)}
    pulse_j = lidar.mean_power_w / 2500
    assert margins["laser, one pulse"] == pytest.approx(8e-3 / pulse_j, rel=1e-6)
    at_rest = margins["laser, 100 s, scanner at rest"]
    assert at_rest == pytest.approx(10e-3 / lidar.mean_power_w, rel=1e-6)
    # Swept over the field, as much of the mean power passes the aperture as its share of the field.
    seen = 2 * math.pi * (1 - math.cos(math.atan(1.75 / 100)))
    field = 4 * math.asin(math.sin(math.radians(10)) ** 2)
    swept = 10e-3 / (lidar.mean_power_w * seen / field)
    assert margins["laser, continuous, 100 s"] == pytest.approx(swept, rel=0.02)
    normal, fault = least_margins(lidar)
    assert normal.margin > 1 > fault.margin
    assert least_margins(camera)[1] is None


def wall(distance_m: float = 6.0) -> Scene:
    corners = np.array([[0, -50, -50], [0, 50, -50], [0, 50, 50], [0, -50, 50.0]])
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    item = SceneObject("wall", Geometry(corners + [distance_m, 0, 0], faces), "grey", 0.5)
    return Scene("wall", Path(), "", (item,), Rig(Pose((0.0, 0.0, 0.0))), Sun(180.0, 0.0, 1e5))


def half_paths_m() -> np.ndarray:
    rig = wall().rig
    baseline = rig.device("detector")[0] - rig.device("emitter")[0]
    centres = math.tan(math.radians(10)) * (1 - (2 * np.arange(16) + 1) / 16)
    left, up = np.broadcast_arrays(6 * centres, 6 * centres[:, None])
    points = np.stack([np.full_like(left, 6.0), left, up], axis=-1)
    ways = np.linalg.norm(points, axis=-1) + np.linalg.norm(points - baseline, axis=-1)
    return ways.ravel() / 2


def powers(system: System) -> tuple[Chain, Powers]:
    chain = Chain.of(system, wall().sun)
    fidelity = Fidelity(samples=64, max_depth=1)
    light = render(wall(), system, fidelity=fidelity, seed=np.random.SeedSequence(1))
    return chain, chain.powers(light)


def test_light_and_sun_of_the_scan_are_those_of_a_wall_in_closed_form() -> None:
    """All cells' echoes together are the all-lit wall of the closed form in pulses. The sun of a
    cell is its share of the field's, and a receiver of 3 x 3 cells and the same pupil has 9 times
    as much.
    """
    whole = {"filter.width_m": 60e-9}  # passes the line at every angle of the field
    one = small(**whole)
    n_3 = one.optics.f_number.value / 3
    three = small(**whole, **{"optics.receiver_cells": 3, "optics.f_number": n_3})
    chain, power = powers(one)
    wide_chain, wide = powers(three)
    assert one.time_of_flight is not None
    lit_w = wall_power_w(one, 0.5, 6.0) * one.time_of_flight.emitter_share
    assert power.cells_w.sum() == pytest.approx(lit_w, rel=1e-3)
    lens, tan = chain.lens, chain.lens.tan_half_field
    assert power.sun_of_cells_w is not None
    assert wide.sun_of_cells_w is not None
    sun = 0.5 / np.pi * mean_cos_power(4, tan, "square") * lens.field_area / 256
    sun_w = sun * lens.transmission * lens.pupil_area_m2 * chain.sky.sun_w_per_m2[0]
    assert power.sun_of_cells_w.mean() == pytest.approx(sun_w, rel=0.02)
    assert power.sun_w[0] == pytest.approx(power.sun_of_cells_w.mean(), rel=1e-6)
    pupils = wide_chain.lens.pupil_area_m2 / lens.pupil_area_m2
    ratio = wide.sun_of_cells_w.reshape(16, 16)[1:-1, 1:-1].mean() / pupils
    assert ratio == pytest.approx(9 * power.sun_of_cells_w.mean(), rel=0.03)


def test_distances_and_images_scatter_as_the_bounds_say() -> None:
    """Twelve scans of a wall at 6 m, 256 cells each, light so weak that noise is that of the gates:
    distances scatter by c / 2 of the bound, images by the noise that the capture's SNR claims. 3072
    draws tell 1.3 %.
    """
    weak = small(**{"emitter.radiant_intensity_w_per_sr": 2e6})
    chain, power = powers(weak)
    of_amplitude, of_delay = echo_noise(chain, power)
    distance, image, sure = [], [], []
    for seed in range(12):
        _, counts, flags = chain.measure_frame(power, rng=np.random.default_rng(seed))
        record = chain.record(wall().rig.pose, counts, flags)
        ranges = range_image(record)
        distance.append(ranges.distance_m[0].ravel())
        image.append(reconstruct(record, "zero-fill").image[0].ravel())
        sure.append((ranges.confidence[0] > 0.95).mean())
    assert np.mean(sure) > 0.99
    scatter = np.std(distance, axis=0, ddof=1) / (C / 2 * of_delay)
    assert np.sqrt(np.mean(scatter**2)) == pytest.approx(1.0, abs=0.08)
    scatter = np.std(image, axis=0, ddof=1) / of_amplitude
    assert np.sqrt(np.mean(scatter**2)) == pytest.approx(1.0, abs=0.08)
    off = np.mean(distance, axis=0) - half_paths_m()
    assert np.abs(np.median(off)) < 0.005


def test_the_capture_says_what_the_vehicle_finds() -> None:
    """SNR of the capture against the scatter found, and distances within what they claim."""
    taken = twin.capture(wall(), small(), seed=2, fidelity=Fidelity(samples=64, max_depth=1))
    found = twin.evaluate(small(), taken)
    assert found.ranges is not None
    assert found.ranges.sure_share == 1.0
    assert found.ranges.median_m < 5e-3
    assert "distances off by" in str(found)
    assert taken.record.device_time_ns[-1] == pytest.approx(255 * 400e3)
    assert np.ptp(taken.record.device_time_ns[:24]) == 0  # all gates of one pulse
    off = found.reconstructions[0].image[0] - taken.scene_e
    assert np.median(np.abs(off) / (taken.scene_e / taken.snr)) < 3


def test_what_lies_beyond_the_gates_is_named() -> None:
    """Gates up to 36 m; a wall at 35 m is seen, at 37 m it is not nothing that is there."""
    quick = Fidelity(samples=4, max_depth=1)
    assert not twin.capture(wall(35.0), small(), fidelity=quick).void
    beyond = twin.capture(wall(37.0), small(), fidelity=quick)
    assert beyond.void
    assert "beyond the last gate, at 37 m or more" in str(beyond.verdict)


def test_lost_exposures_leave_a_hole_in_image_and_distances(tmp_path: Path) -> None:
    taken = twin.capture(wall(), small(), seed=2, fidelity=Fidelity(samples=4, max_depth=1))
    flags = taken.record.flags.copy()
    flags[24 * 100 + 3] = Flag.LOST
    record = replace(taken.record, flags=flags)
    for image in (range_image(record).distance_m[0], reconstruct(record).image[0]):
        hole = np.flatnonzero(np.isnan(image.ravel()))
        assert hole.tolist() == [100]
    write_record(record.received, tmp_path / "scan.h5")
    again = read_record(tmp_path / "scan.h5")
    assert again.patterns == record.received.patterns
    assert again.patterns.count == 255


def test_an_echo_cut_off_by_the_rail_claims_no_more_than_its_gate() -> None:
    """Echoes ten times the converter's range at any place in their two gates, beside cells well
    within it: the first are off by decimetres and say so, the others are as exact as ever.
    """
    rng, n_gates = np.random.default_rng(0), 12
    distance_m = rng.uniform(3.0, 14.0, 256)
    bright = np.arange(256) % 4 == 0
    shares = np.stack(
        [share(2 * distance_m / C, k * WIDTH_S, WIDTH_S, WIDTH_S) for k in range(n_gates)], axis=1
    )
    full = 2**16 - 1
    electrons = 1000 + shares * np.where(bright, 10 * full, full / 2)[:, None]
    noisy = rng.poisson(electrons)
    record = replace(
        record_of(np.minimum(noisy, full), RasterScan(16, 16), gates(n_gates)), adc_bits=16
    )
    cut = (noisy >= full).any(axis=1)
    found = range_image(record)
    error = np.abs(found.distance_m.ravel() - distance_m)
    stated = found.standard_error_m.ravel()
    assert error[cut].max() > 0.4
    assert (error < 5 * stated).all()
    assert stated[cut].min() > 0.2
    assert stated[~cut].max() < 0.02
    assert found.warnings == (ECHO_CUT,)
    marked = replace(record, flags=np.repeat(np.where(cut, Flag.SATURATED, 0), n_gates))
    counts = np.minimum(record.counts, full - 1)  # a well that is full below the converter's end
    told = range_image(replace(marked, counts=counts.astype(record.counts.dtype)))
    np.testing.assert_allclose(told.standard_error_m.ravel()[cut], stated[cut], rtol=0.1)


def test_patterns_of_a_scan() -> None:
    scan, cells = RasterScan(4, 8, "differential"), np.arange(32.0)
    masks = scan.masks().reshape(scan.n_exposures, -1)
    np.testing.assert_array_equal(masks @ cells, scan.signal(cells))
    np.testing.assert_array_equal(scan.masks(slice(3, 9)), scan.masks()[3:9])
    assert scan.take(np.arange(32) % 2 == 0).cells.tolist() == list(range(0, 32, 2))
    plain = record_of(np.full(16, 50.0), RasterScan(4, 4))
    assert BACKGROUND_IN_IMAGE in reconstruct(plain, "zero-fill").warnings


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"acquisition.n_patterns": 255}, "n_patterns = 255: a raster scan lights every cell"),
        ({"acquisition.mode": "s-matrix"}, "acquisition.mode: 's-matrix'"),
        ({"time_of_flight.gate_delays_s": [0.0, 1e-8]}, "needs at least 4 gates"),
        ({"acquisition.order": "sequency"}, "scanned belongs to acquisition.order raster"),
        ({"optics.receiver_cells": 17}, "receiver_cells = 17: more than the field has"),
        ({"weather.part": "fog-200m"}, "weather: the light that air scatters"),
        ({"optics.field_stop": "matched", "optics.receiver_cells": 2}, "field_stop scanned"),
    ],
)
def test_scans_that_cannot_be_are_refused(changes: dict[str, object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        small(**changes)


@pytest.mark.parametrize(
    "arguments", [(3, 4), (4, 4, "reference"), (4, 4, "plain", (0, 0)), (4, 4, "plain", (16,))]
)
def test_patterns_that_are_no_scan_are_refused(arguments: tuple) -> None:
    with pytest.raises(InputError):
        RasterScan(*arguments)
