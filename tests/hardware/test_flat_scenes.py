"""Standard errors where a scene has no detail at all, so that noise is all that errors are of."""

from typing import Any

import numpy as np
import pytest
from scipy import stats
from spi_records import record_of

from hardware import Flag, PatternSet, reconstruct
from hardware.reconstruction.noise import most_scatter

FEW = {"whole": ("sequency", 64), "sequency": ("sequency", 23), "coarse": ("cake-cutting", 10)}


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
