"""Every registered method: limits, extremes, modes, and that it beats zero-fill."""

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from spi_records import record_of, scene

from hardware import PatternSet, reconstruct
from hardware.patterns import fwht
from hardware.reconstruction import METHODS, Sensing, measurements, method
from hardware.records import Flag


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("order", ["sequency", "zigzag", "natural"])
def test_all_patterns_without_noise_return_the_image(name: str, order: Any) -> None:
    """Every method agrees with the data, and nothing else agrees with all of them."""
    patterns = PatternSet(16, 8, 128, order)
    cells = scene(16, 8)
    found = reconstruct(record_of(patterns.signal(cells.ravel()), patterns), name).image[0]
    np.testing.assert_allclose(found, cells, atol=1e-6 * np.ptp(cells))


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("count", [1, 2, 20])
def test_few_patterns_keep_the_mean(name: str, count: int) -> None:
    """One pattern tells the mean and nothing else."""
    patterns = PatternSet(8, 8, count)
    cells = scene(8, 8)
    found = reconstruct(record_of(patterns.signal(cells.ravel()), patterns), name).image[0]
    assert found.mean() == pytest.approx(cells.mean())
    if count == 1:
        np.testing.assert_allclose(found, cells.mean())


@pytest.mark.parametrize("name", METHODS)
def test_saturated_records_are_finite_and_say_so(name: str) -> None:
    patterns = PatternSet(8, 8, 32)
    record = record_of(np.full(64, 2.0**10 - 1), patterns, bits=10)
    record.flags[:] = Flag.SATURATED
    found = reconstruct(record, name)
    assert np.isfinite(found.image).all()
    assert found.warnings == ("64 of 64 exposures are marked saturated",)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_number_is_refused(name: str, bad: float) -> None:
    patterns = PatternSet(8, 8, 32)
    values = np.ones(32)
    values[5] = bad
    with pytest.raises(ValueError, match=r"^values: hold what is not a number"):
        METHODS[name](values, 1.0, patterns)
    with pytest.raises(ValueError, match=r"^values: hold what is not a number"):
        METHODS[name](np.ones(32), bad, patterns)


@pytest.mark.parametrize("name", METHODS)
def test_values_that_do_not_fit_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"^values: 31, the pattern set has 32"):
        METHODS[name](np.ones(31), 1.0, PatternSet(8, 8, 32))


@pytest.mark.parametrize("field", ["offset_counts", "electrons_per_count", "pose"])
def test_a_record_holding_nan_is_refused(field: str) -> None:
    record = record_of(np.zeros(64), PatternSet(8, 8, 32))
    value = np.full(7, np.nan) if field == "pose" else float("nan")
    with pytest.raises(ValueError, match=f"^{field}: "):
        replace(record, **{field: value})


def test_a_pattern_set_that_does_not_fit_its_counts_is_refused() -> None:
    record = record_of(np.zeros(64), PatternSet(8, 8, 32))
    with pytest.raises(ValueError, match="expected"):
        replace(record, patterns=PatternSet(8, 8, 33))
    with pytest.raises(ValueError, match=r"^counts: 1 detectors, expected 2"):
        record_of(np.zeros(64), PatternSet(8, 8, 64, mode="complementary"))


@pytest.mark.parametrize("name", METHODS)
def test_scale_does_not_matter(name: str) -> None:
    """Ten thousand times the light and the noise: ten thousand times the image."""
    rng = np.random.default_rng(0)
    patterns = PatternSet(16, 16, 60)
    y = fwht(scene(16, 16).ravel())[patterns.indices] + 500 * rng.normal(size=60)
    small, large = (METHODS[name](y * s, (500 * s) ** 2, patterns)[0] for s in (1.0, 1e4))
    np.testing.assert_allclose(large, 1e4 * small, rtol=1e-6, atol=1e-3 * abs(large).max())


def images_with_threads(threads: int) -> dict[str, np.ndarray]:
    """Images of all quick methods, in a process whose BLAS has so many threads."""
    code = """
import sys, numpy as np
from hardware import PatternSet
from hardware.patterns import fwht
from hardware.reconstruction import METHODS
patterns, rng = PatternSet(64, 64, 1024), np.random.default_rng(0)
values = fwht(rng.random(4096) * 1e4)[patterns.indices] + 1e3 * rng.normal(size=1024)
quick = {name: m for name, m in METHODS.items() if not (m.slow or m.joint or "omp" in name)}
np.savez(sys.stdout.buffer, **{name: m(values, 1e6, patterns)[0] for name, m in quick.items()})
"""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    environment = os.environ | {name: str(threads) for name in names}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=True
    )
    with np.load(io.BytesIO(done.stdout)) as found:
        return dict(found)


def test_images_are_the_same_bits_for_the_same_number_of_threads() -> None:
    """And within 1e-12 of their range for another: BLAS adds in another order."""
    one, again, two = (images_with_threads(n) for n in (1, 1, 2))
    for name, image in one.items():
        np.testing.assert_array_equal(again[name], image)
        np.testing.assert_allclose(two[name], image, rtol=0, atol=1e-12 * np.ptp(image))


def test_joint_columns_of_a_line_sensor_help_each_other() -> None:
    """16 LED rows, a column per detector, noise: TV across columns errs less."""
    rng = np.random.default_rng(11)
    patterns = PatternSet(16, 1, 16)
    picture = np.zeros((16, 64))
    for column in range(64):
        picture[5 + column // 16 : 11, column] = 3000
    electrons = patterns.signal(picture) + 2000 * rng.normal(size=(32, 64))
    record = record_of(electrons + 1e5, patterns)
    errors = {}
    for name in ("tv", "tv-joint"):
        found = reconstruct(record, name)
        assert found.image.shape == (64, 16, 1)
        errors[name] = np.mean((found.picture - picture) ** 2)
    assert errors["tv-joint"] < 0.7 * errors["tv"]


@pytest.mark.parametrize("mode", ["reference", "s-matrix", "complementary"])
@pytest.mark.parametrize("background", [0.0, 1e6])
def test_other_modes_return_the_image(mode: Any, background: float) -> None:
    """All patterns without noise, over any background; the S-matrix never lights cell 0, of which
    it therefore says nothing.
    """
    patterns = PatternSet(16, 8, 128, "sequency", mode)
    cells = scene(16, 8)
    record = record_of(patterns.signal(cells.ravel()) + background, patterns)
    expected = cells.copy()
    if mode == "s-matrix":
        expected[0, 0] = np.nan
    found = reconstruct(record, "zero-fill").image
    np.testing.assert_allclose(found, expected[None], atol=1e-6)


def test_an_s_matrix_subset_takes_its_total_from_the_finest_patterns() -> None:
    cells = scene(16, 16)
    patterns = PatternSet(16, 16, 128, "sequency", "s-matrix")
    record = record_of(patterns.signal(cells.ravel()) + 5e4, patterns)
    found = reconstruct(record, "lmmse").image[0].ravel()[1:]
    assert abs(found.mean() - cells.mean()) < 0.05 * cells.mean()
    assert np.corrcoef(found, cells.ravel()[1:])[0, 1] > 0.9


@pytest.mark.parametrize("mode", ["differential", "complementary"])
def test_noise_is_found_in_pairs(mode: Any) -> None:
    """Variance of a difference is twice that of an exposure, within 5 standard deviations."""
    rng = np.random.default_rng(12)
    patterns = PatternSet(32, 32, 1024, "sequency", mode)
    clean = patterns.signal(scene(32, 32).ravel())
    found = measurements(record_of(clean + 1e6 + 50 * rng.normal(size=clean.shape), patterns))
    assert found.values.shape == (1024, 1)
    ratio = found.noise_variance[0] / (2 * 50**2)
    assert abs(ratio - 1) < 5 * np.sqrt(3 / 1024)


@pytest.fixture
def mine() -> Iterator[str]:
    yield "mine"
    METHODS.pop("mine", None)


def test_a_method_is_one_decorated_function(mine: str) -> None:
    @method(mine)
    def back_projected(values: Any, noise_variance: float, sensing: Sensing) -> Any:
        """Adjoint only."""
        return sensing.adjoint(values), None

    record = record_of(np.arange(64.0), PatternSet(8, 8, 32))
    assert reconstruct(record, mine).standard_error is None
    assert METHODS[mine].summary == "Adjoint only."
    with pytest.raises(ValueError, match="registered twice"):
        method(mine)(back_projected)


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("name", ["lmmse", "fista", "tv", "patches"])
def test_methods_beat_zero_fill(path: None, name: str, noise: float) -> None:
    """Two discs, off the patterns' own edges, 128 of 1024 patterns: at least 0.5 dB."""
    rng = np.random.default_rng(13)
    i, j = np.mgrid[:32, :32]
    picture = (
        0.2 + 0.6 * ((i - 12.3) ** 2 + (j - 14.1) ** 2 < 75) + 0.2 * (np.hypot(i - 22, j - 24) < 5)
    )
    sensing = Sensing(PatternSet(32, 32, 128))
    variance = noise**2 * 1024
    y = sensing.forward(picture.ravel()) + np.sqrt(variance) * rng.normal(size=128)
    error = {
        n: np.mean((METHODS[n](y, variance, sensing)[0] - picture.ravel()) ** 2)
        for n in (name, "zero-fill")
    }
    assert 10 * np.log10(error["zero-fill"] / error[name]) > 0.5
