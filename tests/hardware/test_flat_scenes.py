"""Standard errors where a scene has no detail at all, so that noise is all that errors are of."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from spi_records import record_of

from hardware import Flag, PatternSet, reconstruct
from hardware.patterns import hadamard_rows
from hardware.reconstruction import Mixing
from hardware.reconstruction.noise import most_noise, most_scatter, scatter_of_flat_cells

FEW = {"whole": ("sequency", 64), "sequency": ("sequency", 23), "coarse": ("cake-cutting", 10)}


@pytest.mark.quick(3)
@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix"])
@pytest.mark.parametrize("which", FEW)
def test_errors_of_few_patterns_cover(mode: Any, which: str) -> None:
    """150 records of a wall: 93 % of the cells at least, and each cell in 85 %, lie within
    ``errors_in_95``. With the variance of the two to seven finest values itself, and without the
    noise of the constant that is taken from plain values, it had been 0.90 and 0.58, in the worst
    cells 0.23.
    """
    order, count = FEW[which]
    patterns, rng = PatternSet(8, 8, count, order, mode), np.random.default_rng(1)
    light = patterns.signal(np.full(64, 3e4)) + 1e6
    exact, within = reconstruct(record_of(light, patterns), "zero-fill").image[0], []
    for _ in range(150):
        found = reconstruct(
            record_of(light + 2000 * rng.normal(size=light.shape), patterns), "zero-fill"
        )
        assert found.standard_error is not None
        off = np.abs(found.image[0] - exact)
        within.append(off < found.errors_in_95 * found.standard_error[0])
    share = np.mean(within, axis=0)[np.isfinite(exact)]
    assert share.mean() > 0.93
    assert share.min() > 0.85


@pytest.mark.parametrize("count", [10, 64, 256])
def test_the_most_that_noise_can_be_is_wide_enough_for_few_values(count: int) -> None:
    """Normal numbers against 1.96 roots of it: 95 % by Student's distribution; 4000 draws know it
    to 0.4 %.
    """
    patterns, rng = PatternSet(16, 16, count, "sequency", "plain"), np.random.default_rng(2)
    most = most_scatter(rng.normal(size=(count, 4000)), patterns)
    inside = np.mean(np.abs(rng.normal(size=4000)) < 1.96 * np.sqrt(most))
    low, high = stats.binom.ppf([3e-7, 1 - 3e-7], 4000, 0.95) / 4000
    assert low < inside < high


@pytest.mark.parametrize(("rows", "columns"), [(1, 16), (4, 8), (16, 16)])
def test_flat_cells_tell_the_noise_beside_detail(rows: int, columns: int) -> None:
    """The median of the differences across blocks, by loops over them; wide enough for few blocks;
    never less for detail.
    """
    n, rng = rows * columns, np.random.default_rng(3)
    patterns = PatternSet(rows, columns, n, "sequency", "plain")
    matrix = hadamard_rows(patterns.indices, n).astype(float)
    noise = rng.normal(size=(n, 4000))
    cells = (matrix.T @ noise[:, :3]).reshape(rows, columns, 3) / n
    high, wide = min(rows, 2), min(columns, 2)
    across = [
        sum((-1) ** (i + j) * cells[r + i, c + j] for i in range(high) for j in range(wide))
        for r in range(0, rows, high)
        for c in range(0, columns, wide)
    ]
    size = np.median(np.abs(across), axis=0) / stats.norm.ppf(0.75) / np.sqrt(high * wide)
    most = scatter_of_flat_cells(noise, patterns)
    few = stats.t.ppf(0.975, 0.3675 * len(across)) / 1.96
    np.testing.assert_allclose(most[:3], n * (few * size) ** 2, rtol=1e-3)
    for found in (most, most_noise(noise, patterns)):
        inside = np.mean(np.abs(rng.normal(size=4000)) < 1.96 * np.sqrt(found))
        assert 0.93 < inside < 0.99
    detail = matrix @ rng.exponential(size=(n, 1))
    assert scatter_of_flat_cells(noise + detail, patterns).mean() > most.mean()


@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix"])
@pytest.mark.parametrize("what", ["stars", "boxes"])
def test_errors_of_complete_sets_are_of_the_noise_where_cells_are_flat(
    mode: Any, what: str
) -> None:
    """Sharp edges and bright cells, 16 x 16, noise of 0.6 % of the range: 93 % of the cells at
    least within ``errors_in_95``, which are at most 1.6 times too wide. The finest patterns hold
    the edges: with their scatter errors were 100 to 500 times too wide.
    """
    patterns, rng = PatternSet(16, 16, 256, "sequency", mode), np.random.default_rng(4)
    off = []
    for _ in range(10):
        cells = np.full((16, 16), 200.0)
        for row, column in rng.integers(0, 12, (4, 2)):
            size = 1 if what == "stars" else rng.integers(2, 6)
            cells[row : row + size, column : column + size] = rng.uniform(2e3, 1e4)
        light = patterns.signal(cells.ravel()) + 1e6
        drawn = light + 500 * rng.normal(size=light.shape)
        found = reconstruct(record_of(drawn, patterns), "zero-fill")
        assert found.standard_error is not None
        off.append(((found.image - cells) / found.standard_error).ravel()[1:])
    assert np.mean(np.abs(off) < 1.96) > 0.93
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.1


def test_the_constant_of_plain_values_has_the_detail_of_the_finest() -> None:
    """The emitter's elements 0 and 1 light each other's cells by half: what is taken for background
    stands in both, and is off by the detail of the finest patterns; so is the error stated there,
    while all others have that of the noise.
    """
    matrix, cells = np.eye(256), np.full(256, 200.0)
    matrix[0, 1] = matrix[1, 0] = 0.5
    cells[[70, 101, 133]] = 1e5
    patterns = PatternSet(16, 16, 256, "sequency", "plain")
    light = patterns.signal(matrix @ cells) + 1e6
    light += np.random.default_rng(5).normal(0, 300, light.shape)
    found = reconstruct(record_of(light, patterns), "least-squares", mixing=Mixing(matrix, 16, 16))
    assert found.standard_error is not None
    off = np.abs(found.image[0].ravel() - cells) / found.standard_error[0].ravel()
    assert np.nanmax(off[:2]) < 3
    assert np.mean(off[2:] < found.errors_in_95) > 0.93


@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix"])
@pytest.mark.parametrize("lost", [5, 515])
def test_one_lost_pattern_leaves_a_bright_cell_bright(mode: Any, lost: int) -> None:
    """A scene as flat as noise: without one of 1024 patterns its only bright cell had had 3 % of
    its light, 25 standard errors too little.
    """
    patterns, cells = PatternSet(32, 32, 1024, "natural", mode), np.zeros(1024)
    cells[300] = 1e5
    light = (
        patterns.signal(cells)
        + 1e6
        + np.random.default_rng(1).normal(0, 300, 1024 + 2 * (mode == "reference"))
    )
    record = record_of(light, patterns)
    record.flags[lost] = Flag.LOST
    found = reconstruct(record, "lmmse")
    bright = found.image[0].ravel()[300]
    assert found.standard_error is not None
    error = found.standard_error[0].ravel()[300]
    assert bright == pytest.approx(1e5, rel=0.02)
    assert abs(bright - 1e5) < found.errors_in_95 * error < 2e4


@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix", "differential"])
def test_errors_hold_where_most_counts_are_alike(mode: Any) -> None:
    """A disc and white noise, cells of 1000 electrons, by a converter whose counts are 20 times the
    noise, so that nearly all exposures give one count: rounding takes the picture, and its errors
    are not spread evenly. 88 % of the cells within 1.96 in the mean over scenes and draws, where
    75 to 82 % had been.
    """
    step = 20.0
    rng, patterns = np.random.default_rng(11), PatternSet(16, 16, 256, mode=mode)
    down, along = np.mgrid[:16, :16]
    disc = 0.1 + 0.9 * ((along - 7) ** 2 + (down - 7.6) ** 2 < 16)
    within = []
    for scene in (disc, rng.random((16, 16))) * 12:
        cells = 1000.0 * scene.ravel()
        noise = 100 * np.sqrt(256) / (np.sqrt(2) if mode == "differential" else 2)
        light = patterns.signal(cells) + noise * step * rng.random() + 1e6
        light = light + noise * rng.normal(size=light.shape)
        counts = replace(
            record_of(light / (noise * step), patterns), electrons_per_count=noise * step
        )
        found = reconstruct(counts)
        off = (found.image[0].ravel() - cells) / found.standard_error[0].ravel()
        within.append(np.mean(np.abs(off[np.isfinite(off)]) < 1.96))
    assert np.mean(within) > 0.88
