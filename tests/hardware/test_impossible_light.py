"""Records that contradict light: less than none, arms that are not equally sensitive."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import stdtrit
from spi_records import record_of, scene

from hardware import PatternSet, SpiRecord, reconstruct
from hardware.patterns import Patterns, RasterScan, own_patterns
from hardware.reconstruction import measurements, range_image
from hardware.reconstruction.noise import errors_of_few, freedom, freedom_of_successive
from hardware.reconstruction.unequal_arms import _slope
from hardware.records import Shutter
from hardware.sliding_images import SlidingImages

MODES: tuple[Any, ...] = ("differential", "complementary", "plain", "reference", "s-matrix")
LESS_THAN_NONE, UNEQUAL = "hold less than no light", "are not equally sensitive"
ARMS = PatternSet(8, 8, 64, mode="complementary")


def exposed(patterns: Patterns, seed: int = 1) -> np.ndarray:
    """Electrons of a picture over a background, with noise."""
    light = patterns.signal(scene(8, 8).ravel()).astype(float)
    return light + 1e4 + 20 * np.random.default_rng(seed).normal(size=light.shape)


def told(record: SpiRecord, what: str) -> list[str]:
    return [warning for warning in reconstruct(record, "least-squares").warnings if what in warning]


def sets() -> Iterator[Patterns]:
    yield from (PatternSet(8, 8, count, mode=mode) for mode in MODES for count in (32, 64))
    yield RasterScan(8, 8, "differential")
    yield own_patterns(np.concatenate([np.ones((1, 8, 8)), np.eye(64).reshape(64, 8, 8)]))


@pytest.mark.parametrize("patterns", list(sets()), ids=str)
def test_counts_that_fall_as_light_rises_are_told(patterns: Patterns) -> None:
    """Upside down, the light of all cells is negative in every mode; upright it is not told."""
    electrons = exposed(patterns)
    assert not told(record_of(electrons, patterns), LESS_THAN_NONE)
    (found,) = told(record_of(1e6 - electrons, patterns), LESS_THAN_NONE)
    together = float(re.findall(r"together (\S+) electrons", found)[0])
    assert together == pytest.approx(-scene(8, 8).sum(), rel=0.15)


def test_exposures_that_are_exchanged_are_told() -> None:
    """Those of each pair in time, and of the two arms."""
    pairs, arms = PatternSet(8, 8, 64), PatternSet(8, 8, 64, mode="complementary")
    in_turn = exposed(pairs).reshape(64, 2)[:, ::-1]
    for record in (record_of(in_turn, pairs), record_of(exposed(arms)[:, ::-1], arms)):
        (found,) = told(record, LESS_THAN_NONE)
        assert "exposures and those to their complements are exchanged" in found


@pytest.mark.parametrize("modulated", [False, True])
def test_nothing_is_told_of_phases(modulated: bool) -> None:
    """A phase shutter may give the difference of two taps."""
    patterns = PatternSet(8, 8, 64)
    record = record_of(1e6 - exposed(patterns), patterns)
    if modulated:
        record = replace(record, shutters=(Shutter(1e7, 0.0),))
    assert bool(told(record, LESS_THAN_NONE)) != modulated


def test_images_between_whole_sets_tell_it_too() -> None:
    patterns = PatternSet(8, 8, 64)
    record = record_of(1e6 - exposed(patterns), patterns)
    assert any(LESS_THAN_NONE in w for w in SlidingImages(8).update("/camera", record).warnings)


@pytest.mark.parametrize(
    "patterns", [PatternSet(8, 8, 64), RasterScan(8, 8, "differential")], ids=str
)
def test_range_images_tell_it_too(patterns: Patterns) -> None:
    """Of gates, in the words of the image of all of them; upright it is not told."""
    lit = exposed(patterns)
    electrons = np.stack([0.2 * lit, lit, 0.3 * lit], axis=1).reshape(-1, 1)
    gates = tuple(Shutter(gate_delay_s=d, gate_width_s=2e-8) for d in (1e-7, 1.2e-7, 1.4e-7))
    for counts, expected in ((electrons, False), (1e6 - electrons, True)):
        n = len(counts)
        record = replace(
            record_of(lit, patterns),
            counts=np.rint(counts).astype(np.int32),
            device_time_ns=np.arange(n, dtype=np.int64),
            sequence=np.arange(n, dtype=np.uint32),
            flags=np.zeros(n, np.uint8),
            shutters=gates,
            pulse_width_s=1e-8,
        )
        warnings = [w for w in range_image(record).warnings if LESS_THAN_NONE in w]
        assert bool(warnings) == expected
        assert set(warnings) <= set(reconstruct(record).warnings)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("count", [4, 17, 64])
def test_no_light_is_seldom_less_than_none(mode: Any, count: int) -> None:
    """20 000 images of background alone: as the limit itself, 3e-7, cannot be counted, those below
    Student's quantile of 1 % are: at most as many, and 3.5 of their standard deviation.
    """
    patterns, n = PatternSet(8, 8, count, mode=mode), 20_000
    rng = np.random.default_rng(2)
    electrons = 1e5 + 100 * rng.normal(size=(patterns.n_exposures, n * patterns.n_arms))
    measured = measurements(record_of(electrons, patterns))
    factor = 1.0 if mode in MODES[:2] else 1.5
    off = measured.values[0] / np.sqrt(factor * measured.most_noise_variance)
    degrees = freedom(patterns)
    assert np.count_nonzero(off < stdtrit(degrees, 0.01)) <= 200 + 3.5 * np.sqrt(200)
    assert not (off < -errors_of_few(degrees)).any()


def test_the_limit_is_that_of_normal_noise_for_many_and_infinite_for_none() -> None:
    assert errors_of_few(1e6) == pytest.approx(5.0, abs=1e-3)
    assert errors_of_few(0.0) == np.inf


def behind(first: float, second: float, sigma: float = 20.0, background: float = 500.0) -> Any:
    """Electrons of both arms of sensitivities that see a picture over a background."""
    lit, complement = np.hsplit(ARMS.signal(scene(8, 8).ravel()).reshape(64, 2) + background, 2)
    noise = sigma * np.random.default_rng(4).normal(size=(64, 2))
    return np.hstack([first * lit, second * complement]) + noise


@pytest.mark.parametrize(("first", "second"), [(1.0, 0.95), (1.0, 0.8), (0.9, 1.0), (1.0, 0.1)])
def test_arms_that_are_not_equally_sensitive_are_told(first: float, second: float) -> None:
    """Their ratio, and what they add to every measurement: the difference of their sensitivities
    times half the light of the picture and the background.
    """
    (found,) = told(record_of(behind(first, second), ARMS), UNEQUAL)
    weak = "second" if second < first else "first"
    number = r"(-?[\d.]+)"
    of, ratio, error, of_others, added, row, column, moved = re.findall(
        rf"the (\w+) {number} ± {number} times as much as the (\w+): .* they add {number} electrons"
        rf" .* in cell \({number}, {number}\), {number} electrons",
        found,
    )[0]
    assert (of, row, column) == (weak, "0", "0")
    assert of_others != weak
    true = min(first, second) / max(first, second)
    assert abs(float(ratio) - true) < 4 * float(error) < 0.02
    of_pair = (first - second) * (scene(8, 8).sum() / 2 + 500)
    assert float(added) == pytest.approx(of_pair, rel=4 * float(error) / (1 - true) + 0.01)
    off = reconstruct(record_of(behind(first, second), ARMS), "zero-fill").image[0, 0, 0]
    off -= (first + second) / 2 * scene(8, 8)[0, 0]
    assert float(moved) == pytest.approx(off, rel=4 * float(error) / (1 - true) + 0.02)


def test_equal_arms_are_not_told() -> None:
    """Over any background, where it drifts by 20 times the noise, and where a slow amplifier
    carries a tenth of each exposure into the next one.
    """
    equal = behind(1.0, 1.0)
    drift = np.linspace(0, 400, 64)[:, None]
    before = np.vstack([np.full((1, 2), 500.0), equal[:-1]])
    flagged = record_of(behind(1.0, 1.0, background=5e4), ARMS)
    flagged.counts[5:9] = 3, 400_000
    flagged.flags[5:9] = 1
    for record in (
        *(record_of(e, ARMS) for e in (equal, equal + drift, 0.9 * equal + 0.1 * before)),
        flagged,
    ):
        assert not told(record, UNEQUAL)


def test_differences_that_are_all_alike_tell_no_slope() -> None:
    """Sums that scatter beside them: its error is infinite, and dividing does not overflow."""
    sums, differences = 1e7 * np.random.default_rng(5).normal(size=(8, 2)), np.zeros((8, 2))
    differences[:, 1] = np.arange(8) % 2
    slope, error, least = _slope(sums, differences, 1 / 6)
    assert (slope[0], error[0], least[0]) == (0.0, np.inf, np.inf)
    assert np.isfinite([slope[1], error[1], least[1]]).all()


@pytest.mark.parametrize("count", [4, 16, 64])
@pytest.mark.parametrize("light", [0.0, 30.0, 1e4])
@pytest.mark.parametrize("noise", [(1.0, 1.0), (1.0, 0.4), (0.0, 1.0)])
def test_equal_arms_are_seldom_told(count: int, light: float, noise: tuple[float, float]) -> None:
    """20 000 images of arms of like and unlike noise, of no light, of as much in a value as its
    noise, and of much: none is told, and where noise is alike slopes lie beyond Student's quantile
    of 1 % in as many at most, and 3.5 of their standard deviation.
    """
    rng, n = np.random.default_rng(3), 20_000
    signal = light * rng.normal(size=(count, 1))
    lit, complement = (
        1e3 + sign * signal + 30 * sigma * rng.normal(size=(count, n))
        for sign, sigma in zip((1, -1), noise, strict=True)
    )
    slope, error, least = _slope(lit + complement, lit - complement, 1 / 6)
    assert not (np.abs(slope) > least).any()
    if noise[0] == noise[1]:
        far = stdtrit(freedom_of_successive(count) - 1, 0.995)
        assert np.count_nonzero(np.abs(slope) > far * error) <= 200 + 3.5 * np.sqrt(200)


@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix"])
def test_a_single_count_beyond_all_light_is_told(mode: Any) -> None:
    """One exposure of 64 with 1.2 times the light of all cells more: what sets that show nothing
    twice can tell of a wrong count. The picture as it is tells nothing, in 20 draws of its noise.
    """
    patterns, said = PatternSet(8, 8, 64, mode=mode), "larger than all light"
    for seed in range(20):
        light = exposed(patterns, seed)
        assert not told(record_of(light, patterns), said)
    wrong = exposed(patterns).reshape(-1)
    wrong[9] += 1.2 * scene(8, 8).sum()
    (warning,) = told(record_of(wrong, patterns), said)
    assert warning.startswith("1 of 64 measurements")


@pytest.mark.parametrize("mode", ["plain", "s-matrix"])
@pytest.mark.parametrize(
    "cells", [(131,), (17,), (17, 40), (3, 60, 200), (10, 43, 96, 134, 187)], ids=str
)
def test_few_bright_cells_in_the_dark_are_no_wrong_counts(mode: Any, cells: Any) -> None:
    """All finest values of a bright cell may be far from 0, and their mean from the constant: half
    of the records had the warning. At SNR 1e3.
    """
    patterns, light = PatternSet(16, 16, 256, mode=mode), np.zeros(256)
    light[list(cells)] = 1e4
    for seed in range(10):
        counts = patterns.signal(light).astype(float) + 1e3
        counts += 10 * np.random.default_rng(seed).normal(size=counts.shape)
        assert not told(record_of(counts, patterns), "larger than all light")


@pytest.mark.parametrize("kind", ["single cell", "stripes", "dark"])
def test_one_bright_cell_or_one_pattern_alone_is_no_wrong_count(kind: str) -> None:
    """Of scenes in which patterns tell as much as all light, or none is: no warning in 60 draws."""
    cells = np.zeros((8, 8))
    if kind == "single cell":
        cells[3, 4] = 5e3
    elif kind == "stripes":
        cells[:, ::2] = 5e3
    for seed in range(20):
        for mode in MODES[2:]:
            patterns = PatternSet(8, 8, 64, mode=mode)
            light = patterns.signal(cells.ravel()).astype(float) + 1e4
            light += 50 * np.random.default_rng(seed).normal(size=light.shape)
            assert not told(record_of(light, patterns), "larger than all light")


@pytest.mark.parametrize("mode", ["differential", "complementary", "reference", "plain"])
def test_noise_alone_is_told(mode: Any) -> None:
    """One image in 1000 without light is not told so, by chance; of 100 two are in 1 of 200."""
    patterns = PatternSet(16, 16, 256, "sequency", mode)
    rng = np.random.default_rng(3)
    assert sum(no_light(patterns, np.zeros(256), rng) for _ in range(100)) >= 98


@pytest.mark.parametrize("mode", ["differential", "complementary", "reference", "plain"])
def test_faint_light_is_not_told_as_none(mode: Any) -> None:
    """Even light of 10 standard errors of the sum of all cells, a cell of 10 of its own."""
    patterns = PatternSet(16, 16, 256, "sequency", mode)
    rng = np.random.default_rng(4)
    even, cell = np.full(256, 10 * 80.0 / 256), np.zeros(256)
    cell[100] = 10 * 80.0 / 16
    for cells in (even, cell):
        assert not any(no_light(patterns, cells, rng) for _ in range(20))


def no_light(patterns: PatternSet, cells: np.ndarray, rng: np.random.Generator) -> bool:
    """Whether an image is told to hold no light; a value's noise is 80 electrons at most."""
    light = 5000 + patterns.signal(cells)
    found = reconstruct(record_of(light + rng.normal(0, 40, light.shape), patterns), "zero-fill")
    return any("hold no light above their noise" in text for text in found.warnings)
