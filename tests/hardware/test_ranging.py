"""Distance images from phase shutters or gates, against light simulated from the definition."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ugv_command import ugv

from hardware import PatternSet, SpiRecord, reconstruct, write_record
from hardware.reconstruction import METHODS, range_image
from hardware.reconstruction.gating import echo
from hardware.reconstruction.ranging import AT_RAIL, ECHO_CUT, PHASES_CUT, PULSE_UNKNOWN
from hardware.records import Flag, QuaternionPose, Shutter
from hardware.waveform import C_M_PER_S

TWO = (10e6, 13e6)


def scene(side: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Light of each cell, e-, and its distance, m: a near box before a slanted wall."""
    light = np.full((side, side), 4e5)
    distance = np.add.outer(np.zeros(side), np.linspace(30.0, 34.0, side))
    distance[side // 4 : side // 2, side // 4 : side // 2] = 21.0
    light[side // 4 : side // 2, side // 4 : side // 2] = 8e5
    return light, distance


def record_of(
    cells: np.ndarray, shutters: Sequence[Sequence[float]], patterns: PatternSet
) -> SpiRecord:
    """``cells`` (n_shutters, n_cells) over the sun, which is the same in every shutter."""
    electrons = np.stack([patterns.signal(c) for c in cells], axis=1) + 1e6
    n = electrons.size
    return SpiRecord(
        counts=np.rint(electrons).astype(np.int32).reshape(n, 1),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=31,
        device="test",
        pose=QuaternionPose(),
        shutters=tuple(Shutter(*numbers) for numbers in shutters),
    )


def lock_in(
    frequencies: tuple[float, ...], n_phases: int, noise: float = 0.0, count: int = 256
) -> SpiRecord:
    """Phase shutters (1 + contrast cos(2 pi f tau - phase)) / 2, contrast 0.8."""
    light, distance = scene()
    steps = [(f, p) for f in frequencies for p in 2 * np.pi * np.arange(n_phases) / n_phases]
    tau = 2 * distance.ravel() / C_M_PER_S
    cells = [light.ravel() * (1 + 0.8 * np.cos(2 * np.pi * f * tau - p)) / 2 for f, p in steps]
    shutters = [(f, p) for f, p in steps]
    record = record_of(np.array(cells), shutters, PatternSet(16, 16, count))
    draw = np.random.default_rng(0).normal(size=record.counts.shape) * noise
    return replace(record, counts=np.rint(record.counts + draw).astype(np.int32))


@pytest.mark.parametrize("n_phases", [3, 4, 5])
@pytest.mark.parametrize("method", METHODS)
def test_taps_give_amplitude_and_distance_beyond_one_wrap(method: str, n_phases: int) -> None:
    """All patterns, no noise: 10 MHz alone repeats every 15 m, with 13 MHz every 150 m.

    Counts are whole electrons: 1e-6 of the light, 5 um. Pursuit takes 3/4 as many atoms as
    measurements, and sparse methods shrink: they come within 0.5 m where they unwrap surely.
    """
    light, distance = scene()
    found = range_image(lock_in(TWO, n_phases), method)
    assert found.longest_m == pytest.approx(C_M_PER_S / 2e6)
    if method in ("zero-fill", "lmmse", "tv", "tv-joint"):
        np.testing.assert_allclose(found.distance_m[0], distance, atol=1e-4)
        np.testing.assert_allclose(found.amplitude[0], 0.4 * light, rtol=1e-4)
    else:
        assert np.median(np.abs(found.distance_m[0] - distance)) < 0.5


def test_the_sign_of_the_phase_is_that_of_depth() -> None:
    """One frequency, a distance within its range: conjugated it would come out at 15 m less d."""
    f, patterns = 10e6, PatternSet(8, 8, 64)
    phases = np.pi / 2 * np.arange(4)
    tau = 2 * 4.0 / C_M_PER_S
    cells = np.outer((1 + np.cos(2 * np.pi * f * tau - phases)) / 2, np.full(64, 1e6))
    shutters = [(f, phase) for phase in phases.tolist()]
    found = range_image(record_of(cells, shutters, patterns), "zero-fill")
    np.testing.assert_allclose(found.distance_m, 4.0, atol=1e-4)


def test_standard_errors_are_the_errors_made() -> None:
    """Zero-fill of all patterns: the noise found in the record explains the errors.

    256 cells in two phases' worth of independent noise: the ratio's standard deviation is 4.4 % and
    that of the noise found in the record about 5 %; bounds at five of both.
    """
    _, distance = scene()
    found = range_image(lock_in(TWO, 4, noise=6e4), "zero-fill")
    right = np.abs(found.distance_m[0] - distance) < 5
    assert found.confidence.mean() == pytest.approx(right.mean(), abs=0.05)
    ratio = (found.distance_m[0] - distance)[right] / found.standard_error_m[0][right]
    assert 0.7 < np.sqrt(np.mean(ratio**2)) < 1.3


def test_an_image_of_a_record_with_taps_is_their_sum() -> None:
    record = lock_in(TWO, 4)
    light, _ = scene()
    np.testing.assert_allclose(reconstruct(record, "zero-fill").image[0], 4 * light, rtol=1e-4)
    parts = [reconstruct(part, "zero-fill").image for part in record.by_shutter]
    np.testing.assert_allclose(sum(parts), reconstruct(record, "zero-fill").image, rtol=1e-9)


def gated(delays_s: np.ndarray, width_s: float, pulse_s: float, stated: bool = True) -> SpiRecord:
    """Rectangular pulses: a gate takes the part of each that comes back while it is open."""
    light, distance = scene()
    tau = 2 * distance.ravel() / C_M_PER_S
    overlap = [np.minimum(tau + pulse_s, d + width_s) - np.maximum(tau, d) for d in delays_s]
    cells = light.ravel() * np.maximum(overlap, 0) / pulse_s
    shutters = [(0.0, 0.0, d, width_s) for d in delays_s]
    record = record_of(cells, shutters, PatternSet(16, 16, 256))
    return replace(record, pulse_width_s=pulse_s) if stated else record


@pytest.mark.parametrize("pulse_s", [20e-9, 5e-9])
def test_neighbouring_gates_tell_where_in_them_an_echo_lies(pulse_s: float) -> None:
    """Gates of 20 ns side by side: 3 m thick each. Pulses as long leave the ratio of two gates at
    every distance, to the rounding of counts; pulses of 5 ns at some, and elsewhere 15 ns open.
    """
    light, distance = scene()
    width = 20e-9
    found = range_image(gated(np.arange(15) * width, width, pulse_s), "zero-fill")
    error = found.distance_m[0] - distance
    open_m = C_M_PER_S / 2 * (width - pulse_s)
    assert np.abs(error).max() <= open_m / 2 + 1e-3
    assert (np.abs(error) < 2 * found.standard_error_m[0] + 1e-5).all()
    np.testing.assert_allclose(found.amplitude[0], light, rtol=1e-3)
    assert (found.confidence > 0.99).all()
    assert found.longest_m == pytest.approx(15 * width * C_M_PER_S / 2)
    if pulse_s == width:
        assert found.standard_error_m.max() < 1e-3


def test_an_echo_is_not_taken_for_the_middle_of_its_gate() -> None:
    """A pulse of 20 ns whose echo begins with the gate fills it: c x 20 ns / 4 nearer than the
    gate's middle, 1.5 m. One gate alone leaves 40 ns of beginnings, so an error of 1.73 m.
    """
    gate = np.array([[2 * 20.0 / C_M_PER_S, 20e-9]])
    found = echo(np.array([[1e5]]), np.array([[10.0]]), gate, 20e-9)
    assert found.delay_s * C_M_PER_S / 2 == pytest.approx(20.0, abs=1e-6)
    assert found.error_s * C_M_PER_S / 2 == pytest.approx(1.73, abs=0.01)


@pytest.mark.quick(3)
@pytest.mark.parametrize(
    ("every_s", "width_s", "pulse_s"),
    [
        (20e-9, 20e-9, 20e-9),  # side by side
        (10e-9, 20e-9, 20e-9),  # half over each other
        (5e-9, 50e-9, 10e-9),  # ten at a time
        (40e-9, 20e-9, 20e-9),  # gaps
        (60e-9, 60e-9, 20e-9),  # pulses that fit in
    ],
)
@pytest.mark.parametrize("snr", [10.0, 1000.0])
def test_claimed_errors_of_gates_cover(
    every_s: float, width_s: float, pulse_s: float, snr: float
) -> None:
    """4000 echoes anywhere among gates: of those surer than 99 %, 68 and 95 % lie within one and
    two standard errors; where a gap or an open gate leaves a box instead of a normal, 57.7 and
    100 %. Standard deviation of both shares 0.7 %: bounds at five of it.
    """
    rng = np.random.default_rng(7)
    delays = np.arange(20) * every_s
    tau = rng.uniform(width_s, delays[-1], 4000)
    gates = np.stack([delays, np.full(20, width_s)], axis=1)
    images = np.stack(
        [
            np.maximum(np.minimum(tau + pulse_s, d + w) - np.maximum(tau, d), 0) / pulse_s
            for d, w in gates
        ]
    )
    errors = np.full(images.shape, 1 / snr)
    found = echo(images + errors * rng.normal(size=images.shape), errors, gates, pulse_s)
    sure = found.confidence > 0.99
    assert sure.mean() > 0.5
    z = np.abs((found.delay_s - tau) / found.error_s)[sure]
    assert np.mean(z < 1) > 0.577 - 0.035
    assert np.mean(z < 2) > 0.954 - 0.035
    if every_s < width_s or width_s == every_s == pulse_s:
        assert np.mean(z < 1) < 0.683 + 0.06
        assert np.abs(np.mean((found.delay_s - tau)[sure])) < 0.1 * width_s / snr + 1e-11


def test_two_surfaces_in_a_cell_widen_the_claim() -> None:
    """Half the light from 30 m, half from 36 m: no single echo explains three gates."""
    width = 20e-9
    gates = np.stack([np.arange(15) * width, np.full(15, width)], axis=1)

    def seen(distance_m: float) -> np.ndarray:
        tau = 2 * distance_m / C_M_PER_S
        first, last = np.maximum(tau, gates[:, 0]), np.minimum(tau + width, gates.sum(axis=1))
        return np.maximum(last - first, 0) / width

    errors = np.full((15, 1), 1e-3)
    one = echo(seen(30.0)[:, None], errors, gates, width)
    two = echo((seen(30.0) + seen(36.0))[:, None] / 2, errors, gates, width)
    assert two.error_s > 30 * one.error_s
    assert one.confidence > 0.99
    assert two.confidence < 0.01


@pytest.mark.parametrize("frequencies", [[10e6], [10e6, 11e6]])
def test_a_saturated_record_tells_no_distance(frequencies: list[float]) -> None:
    """Every exposure full: the counts hold the rail alone."""
    record = lock_in(tuple(frequencies), 4)
    full = np.full_like(record.counts, 2**record.adc_bits - 1)
    found = range_image(replace(record, counts=full), "zero-fill")
    assert not found.confidence.any()
    assert np.isinf(found.standard_error_m).all()
    assert found.warnings == (AT_RAIL,)
    marked = replace(record, flags=np.full_like(record.flags, Flag.SATURATED))
    assert not range_image(marked, "zero-fill").confidence.any()


@pytest.mark.parametrize("rail", [0.97, 0.6, 0.45, 0.3])
def test_patterns_whose_gates_are_cut_claim_no_more_than_the_gate(rail: float) -> None:
    """Gates of 20 ns, a converter that ends at these parts of the largest count: one exposure is
    cut at 0.97, most of two gates at 0.3. The wall's echoes fall there, the box's do not. The wall
    had been off by 0.05 to 1.2 m in cells sure of less than that.
    """
    _, distance = scene()
    width = 20e-9
    record = gated(np.arange(15) * width, width, width)
    counts = np.minimum(record.counts, int(rail * record.counts.max()))
    is_cut = (counts < record.counts).any(axis=1)
    cut = replace(record, counts=counts, flags=np.where(is_cut, Flag.SATURATED, 0).astype(np.uint8))
    found = range_image(cut, "zero-fill")
    assert found.warnings == (ECHO_CUT,)
    error, stated = np.abs(found.distance_m[0] - distance), found.standard_error_m[0]
    wall = distance > 25
    sure = found.confidence[0] > 0.95
    assert error[wall & sure].max() > 0.04
    assert (error[sure] < 2 * stated[sure] + 1e-5).all()
    assert stated[wall].min() > 1.0
    assert sure[~wall].all()
    assert stated[~wall].max() < 1e-3


def test_patterns_whose_phases_are_cut_tell_no_distance() -> None:
    """One exposure of 2048, all cells lit, is 10 % over the rail: cells were off by up to 0.22 m
    without a word.
    """
    record, (_, distance) = lock_in((10e6,), 4), scene()
    full = int(record.counts.max() * 0.9)
    cut = replace(record, counts=np.minimum(record.counts, full))
    is_cut = (cut.counts < record.counts).any(axis=1)
    assert is_cut.sum() == 1
    marked = replace(cut, flags=np.where(is_cut, Flag.SATURATED, 0).astype(np.uint8))
    found = range_image(marked, "zero-fill")
    assert np.abs(found.distance_m[0] - distance).max() > 0.2
    assert found.warnings == (PHASES_CUT,)
    assert not found.confidence.any()
    assert np.isinf(found.standard_error_m).all()


def test_a_pulse_that_is_not_stated_may_be_any() -> None:
    """Records of schema version 2: errors cover pulses from nothing to the gate's length."""
    _, distance = scene()
    width = 20e-9
    errors = []
    for pulse in (1e-12, 10e-9, 20e-9):
        found = range_image(gated(np.arange(15) * width, width, pulse, stated=False), "zero-fill")
        errors.append((found.distance_m[0] - distance) / found.standard_error_m[0])
        assert found.warnings == (PULSE_UNKNOWN,)
    assert np.sqrt(np.mean(np.square(errors))) < 1.1
    assert np.abs(errors).max() < 2.2


def test_light_outside_all_gates_has_no_distance() -> None:
    found = range_image(gated(np.array([1e-6, 2e-6]), 1e-8, 1e-8), "zero-fill")
    assert not found.confidence.any() or np.abs(found.amplitude).max() < 1.0


def test_noise_alone_is_no_echo() -> None:
    """4096 cells without light in 15 gates: a hundredth at most is surer than 95 %."""
    rng = np.random.default_rng(3)
    gates = np.stack([np.arange(15) * 2e-8, np.full(15, 2e-8)], axis=1)
    found = echo(rng.normal(size=(15, 4096)), np.ones((15, 4096)), gates, 2e-8)
    assert np.mean(found.confidence > 0.95) < 0.01


@pytest.mark.parametrize(
    ("shutters", "complaint"),
    [
        ([()], "shutters: expected the phases"),
        ([(1e7,), (0.0, 0.0, 1e-8, 1e-8)], "shutters: expected the phases"),
        (np.array([[1e7, 0, 0, 0], [1e7, np.pi, 0, 0]]), "at least three"),
        (np.array([[1e7, 1.0, 0, 0]] * 3), "at least three"),
        (np.array([[1e7, p, 0, 0] for p in (0, 2, 4)] + [[2e7, 0, 0, 0]]), "2e.07 Hz, at least"),
    ],
)
def test_shutters_that_tell_no_distance_are_refused(
    shutters: Sequence[Sequence[float]], complaint: str
) -> None:
    cells = np.ones((len(shutters), 16))
    with pytest.raises(ValueError, match=complaint):
        range_image(record_of(cells, shutters, PatternSet(4, 4, 16)), "zero-fill")


@pytest.mark.parametrize(
    ("record", "line"),
    [
        (lock_in(TWO, 4), "8 phases at 10 MHz, 13 MHz, distances up to 149.9 m: 21.00 m to "),
        (gated(np.arange(15) * 2e-8, 2e-8, 2e-8), "15 gates, distances up to 44.97 m: 21.00 m to "),
    ],
)
def test_the_command_shows_and_stores_distances(
    record: SpiRecord, line: str, tmp_path: Path
) -> None:
    path = tmp_path / "frame.h5"
    write_record(record, path)
    done = ugv("reconstruct", path, "--method", "zero-fill")
    assert done.returncode == 0, done.stderr
    assert line in done.stdout
    expected = range_image(record, "zero-fill")
    with np.load(tmp_path / "frame-zero-fill.npz") as stored:
        np.testing.assert_allclose(stored["distance_m"], expected.distance_m)
        np.testing.assert_allclose(stored["amplitude"], expected.amplitude)
        assert stored["distance_confidence"].shape == (1, 16, 16)
