"""Noise as the record itself tells it, and what its patterns do not tell at all."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import fft, integrate, stats
from spi_records import record_of, scene

from hardware import PatternSet, SpiRecord, reconstruct
from hardware.reconstruction import METHODS, measurements, noise, range_image
from hardware.reconstruction.imaging import LEVEL_UNKNOWN
from hardware.records import Flag, Shutter

UNPAIRED = ("plain", "reference", "s-matrix")


def noisy(patterns: PatternSet, cells: np.ndarray, sigma: float, seed: int) -> SpiRecord:
    """A record of cells over a background, white noise of ``sigma`` in each exposure."""
    rng = np.random.default_rng(seed)
    electrons = patterns.signal(cells.ravel()) + 1e6
    return record_of(electrons + sigma * rng.normal(size=electrons.shape), patterns)


def flicker(rng: np.random.Generator, n: int, corner: float) -> np.ndarray:
    """White noise of variance 1 and 1/f noise that equals it at ``corner`` cycles an exposure."""
    frequency = np.fft.rfftfreq(n)
    density = np.sqrt(1 + corner / np.where(frequency > 0, frequency, np.inf))
    return np.fft.irfft(np.fft.rfft(rng.normal(size=n)) * density, n)


@pytest.mark.parametrize("corner", [0.0, 0.05, 0.3, 3.0])
def test_one_over_f_noise_is_not_overstated(corner: float) -> None:
    """The variance found is that of the pairs' differences, which are the values.

    48 records of 1024 pairs: the mean of each side has a standard error of 0.9 % at most, so that
    4.5 % are 3.5 of their difference. Successive sums alone come out 10 % high at a corner of 0.05,
    40 % at 0.3, 75 % at 3.
    """
    rng = np.random.default_rng(1)
    patterns = PatternSet(32, 32, 1024)
    found, true = [], []
    for _ in range(48):
        electrons = 1e6 + 1000 * flicker(rng, patterns.n_exposures, corner)
        record = record_of(electrons, patterns)
        found.append(measurements(record).noise_variance[0])
        true.append(np.mean((electrons[::2] - electrons[1::2]) ** 2))
    assert np.mean(found) == pytest.approx(np.mean(true), rel=0.045)


def test_what_a_pair_keeps_of_one_over_f_noise_is_its_spectrum_through_the_differences() -> None:
    """The three constants against the integrals of |response|^2 / f up to half a cycle."""

    def kept(response: Any) -> float:
        return integrate.quad(lambda f: response(np.pi * f) / f, 0, 0.5, limit=400)[0]

    of_a_pair = kept(lambda x: 4 * np.sin(x) ** 2)
    assert of_a_pair == pytest.approx(noise._IN_PAIR, rel=1e-7)
    for lag, found in ((1, noise._SUCCESSIVE), (noise._LAG, noise._APART)):
        by_lag = kept(lambda x, m=lag: 8 * np.cos(x) ** 2 * np.sin(2 * m * x) ** 2)
        assert found == pytest.approx(by_lag, rel=1e-7)


def detailed(side: int) -> np.ndarray:
    """Detail of all scales, 1/f^2 as in photographs, in whole even numbers; no cell is flat."""
    rng = np.random.default_rng(9)
    f = np.hypot(*np.meshgrid(np.arange(side), np.arange(side))) + 1e-9
    waves = fft.idctn(np.where(f > 0.5, rng.normal(size=(side, side)) / f, 0.0), norm="ortho")
    return np.asarray(2 * np.rint(5e4 * (waves - waves.min() + 0.1)))


@pytest.mark.parametrize("mode", [*UNPAIRED, "differential"])
@pytest.mark.parametrize("name", METHODS)
def test_full_sets_without_noise_are_inverted(name: str, mode: Any) -> None:
    """Every cell that is measured, over a background that stands in all exposures, whatever detail
    the picture has: as many atoms as OMP may choose are not enough for it.

    The finest patterns of unpaired sets hold detail too, which is not taken for noise: 2e-6 of the
    range is what the rounding of counts to whole electrons allows to smooth away. On ee37b06 plain
    sets are off by 0.1 (LMMSE, TV) to 0.2 of it (OMP), differential ones by 4e-3 (FISTA) and 2e-2.
    """
    patterns = PatternSet(16, 16, 256, "sequency", mode)
    cells = detailed(16)
    found = reconstruct(record_of(patterns.signal(cells.ravel()) + 1e6, patterns), name).image[0]
    measured = np.isfinite(found)
    assert measured.sum() == (255 if mode in ("plain", "s-matrix") else 256)
    np.testing.assert_allclose(found[measured], cells[measured], atol=2e-6 * np.ptp(cells))


@pytest.mark.parametrize("mode", UNPAIRED)
def test_noise_beside_detail_is_found(mode: Any) -> None:
    """Of a scene and of darkness, 20 %; a value holds twice an exposure's.

    Its scatter over records is 4.4 %, and 3.4 % are taken for detail (60 records each).
    """
    patterns = PatternSet(32, 32, 1024, "sequency", mode)
    for seed, cells in enumerate((scene(32, 32) / 100, np.zeros((32, 32)))):
        found = measurements(noisy(patterns, cells, 500.0, seed))
        assert np.sqrt(found.noise_variance[0]) == pytest.approx(2 * 500.0, rel=0.2)
        assert found.most_noise_variance[0] >= found.noise_variance[0]


def test_noise_that_cannot_be_told_from_detail_is_in_the_standard_error() -> None:
    """A full plain set with as little noise as its finest detail hides: nine of ten cells lie
    within two standard errors, though the image is not smoothed for it.
    """
    patterns = PatternSet(32, 32, 1024, "sequency", "plain")
    cells = scene(32, 32)
    found = reconstruct(noisy(patterns, cells, 20.0, 5))
    assert found.standard_error is not None
    off = np.abs(found.image - cells)[0].ravel()[1:]
    assert np.isnan(found.noise_electrons[0])
    assert found.most_noise_electrons[0] > 0.8 * 2 * 20.0  # scatter of 127 values: 6 %
    assert np.mean(off < 2 * found.standard_error[0].ravel()[1:]) > 0.9


@pytest.mark.parametrize("mode", UNPAIRED)
def test_an_image_that_is_not_smoothed_has_all_of_its_noise_in_its_error(mode: Any) -> None:
    """A dim wall, 8 x 8, under noise that its photons do not explain, as behind a dim phase of a
    lock-in measurement: 40 records. Errors were those of a smoothed image, 2 to 3 times too small.
    """
    patterns, wall = PatternSet(8, 8, 64, "sequency", mode), np.full(64, 100.0)
    off = []
    for seed in range(40):
        found = reconstruct(noisy(patterns, wall, 5000.0, seed), "lmmse")
        assert found.standard_error is not None
        off.append((found.image[0].ravel() - wall) / found.standard_error[0].ravel())
    within = np.array(off)[:, 1:]
    assert 0.7 < np.sqrt(np.mean(within**2)) < 1.1
    assert np.mean(np.abs(within) < 1.96) > 0.93


@pytest.mark.quick(2)
@pytest.mark.parametrize("mode", ["differential", "complementary"])
@pytest.mark.parametrize(("rows", "columns"), [(1, 2), (2, 2), (2, 4), (4, 8)])
def test_errors_of_as_few_pairs_as_cells_hold(mode: Any, rows: int, columns: int) -> None:
    """600 records: 92 to 98 % of the cells within `errors_in_95`. 1.96 standard errors, as if many
    pairs had told the noise, hold 67 % of two cells, 79 % of four and 89 % of eight.
    """
    patterns, rng = PatternSet(rows, columns, rows * columns, mode=mode), np.random.default_rng(3)
    within = []
    for seed in range(600):
        cells = rng.uniform(0, 1e4, (rows, columns))
        found = reconstruct(noisy(patterns, cells, 50.0, seed), "zero-fill")
        assert found.standard_error is not None
        within.append(np.abs(found.image - cells) < found.errors_in_95 * found.standard_error)
    assert 0.92 < np.mean(within) < 0.98


@pytest.mark.parametrize(("mode", "why"), [("s-matrix", "no pattern"), ("plain", "every pattern")])
def test_cells_on_which_all_patterns_agree_have_no_value(mode: Any, why: str) -> None:
    """Counted on the patterns themselves: one cell of a full set, a block of a coarse one."""
    for count, order, unknown in ((256, "sequency", 1), (64, "russian-dolls", 4)):
        patterns = PatternSet(16, 16, count, order, mode)
        masks = patterns.masks().astype(int)
        alike = np.ptp(masks[1:] if mode == "s-matrix" else masks, axis=0) == 0
        found = reconstruct(noisy(patterns, scene(16, 16), 0.0, 0))
        assert found.standard_error is not None
        np.testing.assert_array_equal(np.isnan(found.image[0]), alike)
        np.testing.assert_array_equal(np.isnan(found.standard_error[0]), alike)
        assert alike.sum() == unknown
        (warning,) = found.warnings
        assert warning.startswith(f"{unknown} of 256 cells have no value: what {why} lights")


@pytest.mark.parametrize("mode", UNPAIRED)
@pytest.mark.parametrize("step", [8, 30, 100])
def test_counts_that_agree_by_rounding_tell_no_noise_below_it(mode: Any, step: int) -> None:
    """A flat scene of 125 electrons a cell, noise of 1, 16 x 16, a count of 8 to 100 electrons: all
    exposures to half of the cells give the same one or two counts. In 40 records 95 % of the cells
    lie within what is stated, the references' own one among them (38 of 40 expected, 32 allowed:
    false-alarm rate 2e-4), and LMMSE, which smooths nothing away, tells of no smoothing.
    """
    patterns, cells = PatternSet(16, 16, 256, "sequency", mode), np.full(256, 125.0)
    common, within = patterns.common_cells.reshape(16, 16), []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        light = patterns.signal(cells) + rng.normal(size=patterns.n_exposures)
        counts = record_of(light / step + 64 + rng.random(), patterns)
        record = replace(counts, electrons_per_count=float(step), offset_counts=64.5)
        found = reconstruct(record, "zero-fill")
        assert found.standard_error is not None
        assert np.nanmin(found.standard_error) > 0
        assert not any("smoothing" in told for told in reconstruct(record).warnings)
        off = np.abs(found.image[0] - 125.0) / found.standard_error[0]
        within.append(off <= found.errors_in_95)
    measured = ~patterns.unmeasured_cells.reshape(16, 16)
    assert np.mean(np.array(within)[:, measured & ~common]) > 0.95
    if mode == "reference":
        assert np.sum(np.array(within)[:, common]) >= 32


def test_paired_sets_measure_every_cell() -> None:
    for mode in ("differential", "complementary", "reference"):
        assert not PatternSet(8, 8, 16, "sequency", mode).unmeasured_cells.any()


def test_the_references_noise_is_in_the_first_cells_error() -> None:
    """The first cell over its standard error, 200 records: chi-square, false-alarm rate 1e-6.

    All of the two references' noise meets that one cell: 22 times the error of any other here.
    """
    patterns = PatternSet(32, 32, 1024, "sequency", "reference")
    cells = scene(32, 32)
    z = []
    for seed in range(200):
        found = reconstruct(noisy(patterns, cells, 500.0, seed), "zero-fill")
        assert found.standard_error is not None
        z.append((found.image - cells)[0, 0, 0] / found.standard_error[0, 0, 0])
    low, high = stats.chi2.ppf([5e-7, 1 - 5e-7], 200) / 200
    assert low < np.mean(np.square(z)) < high


def test_warnings_tell_flags_and_unmeasured_cells() -> None:
    patterns = PatternSet(8, 8, 64, "sequency", "s-matrix")
    record = noisy(patterns, scene(8, 8), 0.0, 0)
    record.flags[3] = Flag.SATURATED
    assert len(reconstruct(record).warnings) == 2


@pytest.mark.parametrize("name", ["lmmse", "zero-fill", "tv"])
@pytest.mark.parametrize("mode", ["differential", "complementary"])
def test_the_level_that_no_pattern_tells_is_said_to_be_unknown(mode: Any, name: str) -> None:
    """Row 0 alone depends on the mean of the cells: without it the image is short of that mean, by
    no more than the standard error. On ee37b06 6000 e- are missing at a standard error of 0.1.
    """
    patterns = PatternSet(16, 16, 256, "sequency", mode)
    cells = detailed(16)
    lost = record_of(patterns.signal(cells.ravel()), patterns)
    lost.flags[0] |= Flag.LOST
    never = PatternSet.of(16, 16, patterns.indices[1:], mode)
    for record in (lost, record_of(never.signal(cells.ravel()), never)):
        found = reconstruct(record, name)
        off = cells - found.image[0]
        assert np.mean(found.image) == pytest.approx(0, abs=1e-6 * np.ptp(cells))
        np.testing.assert_allclose(off, cells.mean(), rtol=1e-3)
        assert LEVEL_UNKNOWN in found.warnings
        assert off.max() <= 1.001 * found.level_error_electrons[0]
        if found.standard_error is not None:
            assert (off <= 1.001 * found.standard_error[0]).all()
    assert reconstruct(record_of(patterns.signal(cells.ravel()), patterns)).warnings == ()


def test_the_all_lit_reference_stands_for_row_0() -> None:
    """A full reference set that has lost it is inverted as a whole one, to the rounding of counts;
    so are rows of which it was never one, up to what they do not show.
    """
    patterns = PatternSet(16, 16, 256, "sequency", "reference")
    cells = detailed(16)
    record = record_of(patterns.signal(cells.ravel()) + 1e6, patterns)
    record.flags[2] |= Flag.LOST
    found = reconstruct(record)
    np.testing.assert_allclose(found.image[0], cells, atol=2e-6 * np.ptp(cells))
    assert found.warnings == ("1 of 258 exposures are marked lost",)
    few = PatternSet.of(16, 16, (3, 7, 9), "reference")
    mean = reconstruct(record_of(few.signal(cells.ravel()) + 1e6, few)).image.mean()
    assert mean == pytest.approx(cells.mean(), rel=1e-6)


def test_distances_without_a_level_are_said_to_be() -> None:
    """Shutters at two megahertz with row 0 lost: the level of each is missing from its phasor."""
    patterns = PatternSet(8, 8, 64)
    n = 4 * patterns.n_exposures
    flags = np.zeros(n, np.uint8)
    flags[0] = Flag.LOST
    one = record_of(patterns.signal(np.full(64, 1000.0)), patterns)
    record = replace(
        one,
        counts=np.repeat(one.counts, 4, axis=0),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=flags,
        shutters=tuple(Shutter(2e6, k * np.pi / 2) for k in range(4)),
    )
    assert LEVEL_UNKNOWN in range_image(record).warnings
    assert LEVEL_UNKNOWN not in range_image(replace(record, flags=0 * flags)).warnings


def flat_spectra(rows: int, columns: int) -> dict[str, np.ndarray]:
    """Scenes whose detail falls more slowly than 1/f, 0 to 10 000 e- in whole even numbers."""
    down, along = np.mgrid[:rows, :columns]
    bright = (down == rows // 3) & (along == columns // 2)
    disc = (down / rows - 0.4) ** 2 + (along / columns - 0.5) ** 2 < 0.05
    board = (down // 2 + along // 2) % 2
    texture = np.random.default_rng(3).integers(0, 5001, (rows, columns)) / 5000
    scenes = {"bright cell": bright, "disc": disc, "checkerboard": board, "texture": texture}
    return {name: 2 * np.rint(5000 * cells) for name, cells in scenes.items()}


@pytest.mark.parametrize("mode", UNPAIRED)
@pytest.mark.parametrize("name", ["lmmse", "tv", "omp"])
def test_full_sets_of_scenes_as_flat_as_noise_are_not_smoothed(name: str, mode: Any) -> None:
    """Their photons explain a noise of some hundred electrons in a value, not what stands there: it
    is detail, each measured cell is exact to the rounding of counts, one electron, and no number is
    given for the noise. On ee37b06 a single bright cell loses 98 % of its 10 000.
    """
    for rows, columns in ((16, 16), (8, 32)):
        patterns = PatternSet(rows, columns, rows * columns, "sequency", mode)
        for scene_name, cells in flat_spectra(rows, columns).items():
            found = reconstruct(record_of(patterns.signal(cells.ravel()) + 50, patterns), name)
            off = np.abs(found.image[0] - cells)
            assert np.nanmax(off) < 1.0, scene_name
            assert np.isnan(found.noise_electrons).all()


def test_smoothing_that_takes_a_bright_cell_is_told() -> None:
    """Over so much background that its photons' noise is as large as the cell: what is smoothed
    away may be detail, and the record says so. Noise alone does not: one image of 100 000.
    """
    patterns = PatternSet(32, 32, 1024, "sequency", "plain")
    cells = np.zeros((32, 32))
    for light, told in ((0.0, False), (800.0, True)):
        cells[10, 10] = light
        found = reconstruct(noisy(patterns, cells, 1000.0, 6))
        assert np.isfinite(found.noise_electrons[0])
        assert any("smoothing moved 1 cells" in w for w in found.warnings) == told


@pytest.mark.parametrize("mode", ["differential", "complementary", *UNPAIRED])
@pytest.mark.parametrize("name", ["lmmse", "zero-fill"])
def test_no_error_is_0_without_evidence(mode: Any, name: str) -> None:
    """Few patterns tell no noise: no standard error. Counts that never change tell their rounding:
    an error that is no less than it.
    """
    few = PatternSet(8, 8, 2 if mode in ("plain", "s-matrix") else 1, "sequency", mode)
    found = reconstruct(record_of(few.signal(np.full(64, 100.0)), few), name)
    assert found.standard_error is not None
    assert np.isnan(found.standard_error).all()
    assert np.isnan(found.noise_electrons).all()
    assert any("noise and standard errors are unknown" in w for w in found.warnings)
    full = PatternSet(8, 8, 64, "sequency", mode)
    for count in (0, 65535):
        alike = record_of(np.full(full.n_exposures * full.n_arms, count), full)
        found = reconstruct(alike, name)
        assert found.standard_error is not None
        assert np.nanmin(found.standard_error) > 0
        assert any("same count in every exposure" in w for w in found.warnings)
