"""A calibrated mixing in place of a clean grid of cells."""

from typing import Any

import numpy as np
import pytest
from scipy import fft
from spi_records import record_of, scene

from hardware import Flag, InputError, PatternSet, reconstruct
from hardware.reconstruction import Mixing, Sensing
from hardware.reconstruction.methods.lmmse import lmmse_plan, smoothed_away
from hardware.reconstruction.prior import prior_spectrum


@pytest.mark.parametrize("name", ["lmmse", "tv", "fista", "omp"])
def test_a_calibrated_mixing_beats_taking_the_leds_for_a_grid(name: str) -> None:
    """Unequal LEDs whose light overlaps: with the calibration less than 0.6 of the error."""
    rng = np.random.default_rng(7)
    patterns = PatternSet(16, 16, 200)
    distance = np.subtract.outer(np.arange(16), np.arange(16)) ** 2
    blur = np.exp(-distance / (2 * 0.8**2))
    matrix = np.kron(blur, blur) * rng.uniform(0.6, 1.4, (256, 1)) / blur.sum(1).max() ** 2
    cells = scene(16, 16).ravel()
    record = record_of(patterns.signal(matrix @ cells) + rng.normal(size=400) * 3, patterns)
    calibrated = reconstruct(record, name, mixing=Mixing(matrix, 16, 16)).image[0].ravel()
    naive = reconstruct(record, name).image[0].ravel()
    errors = [np.sqrt(np.mean((image - cells) ** 2)) for image in (calibrated, naive)]
    assert errors[0] < 0.6 * errors[1]


def test_lmmse_with_a_mixing_is_the_dense_formula() -> None:
    """Generalised least squares for the mean, written out: grid of 6 x 10 from 64 emitters."""
    rng = np.random.default_rng(8)
    mixing = Mixing(rng.random((64, 60)), 6, 10)
    sensing = Sensing(PatternSet(8, 8, 30), mixing)
    a, y, ratio = sensing.matrix, rng.normal(size=30) * 100, 0.7
    basis = np.kron(*(fft.dct(np.eye(n), norm="ortho", axis=0) for n in (6, 10)))
    c = basis.T @ np.diag(prior_spectrum(6, 10).ravel()) @ basis
    k = np.linalg.inv(a @ c @ a.T + ratio * np.eye(30))
    flat = a.sum(axis=1)
    mean = flat @ k @ y / (flat @ k @ flat)
    expected = mean + c @ a.T @ k @ (y - flat * mean)
    plan = lmmse_plan(sensing)
    np.testing.assert_allclose(plan.image(y, ratio), expected, atol=1e-8 * abs(expected).max())
    gain = c @ a.T @ k
    rest = 1 - gain @ flat
    variance = np.diag(c - gain @ a @ c) + rest**2 / (flat @ k @ flat)
    detail, noise = plan.errors(ratio)
    np.testing.assert_allclose(detail + ratio * noise, variance, rtol=1e-8)


@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix"])
def test_errors_of_a_lost_pattern_are_those_without_a_mixing(mode: Any) -> None:
    """A disc at an SNR of 2 in a cell, one of 256 patterns lost: errors by the identity as a mixing
    are those without one, and with unequal LEDs 93 % of the cells lie within ``errors_in_95``. They
    had been down to 0.27 of those without a mixing.
    """
    patterns = PatternSet(16, 16, 256, "sequency", mode)
    down, along = np.mgrid[:16, :16]
    cells = 1e5 * (np.hypot(down - 8, along - 8) < 4).ravel()
    within = []
    for seed in range(6):
        random = np.random.default_rng(seed)
        gains = np.diag(random.uniform(0.7, 1.3, 256))
        lost = random.integers(3, patterns.n_exposures)
        noise = 1e7 + 4e5 * random.normal(size=patterns.n_exposures)
        even, unequal = (
            record_of(patterns.signal(matrix @ cells) + noise, patterns)
            for matrix in (np.eye(256), gains)
        )
        even.flags[lost] = unequal.flags[lost] = Flag.LOST
        same = reconstruct(even, mixing=Mixing(np.eye(256), 16, 16)).standard_error
        np.testing.assert_allclose(same, reconstruct(even).standard_error, rtol=0.01)
        found = reconstruct(unequal, mixing=Mixing(gains, 16, 16))
        off = (found.image[0].ravel() - cells) / found.standard_error[0].ravel()
        within.append(np.mean(np.abs(off[np.isfinite(off)]) < found.errors_in_95))
    assert np.mean(within) > 0.93


@pytest.mark.parametrize("count", [256, 255, 230])
def test_what_smoothing_took_is_the_same_behind_the_identity(count: int) -> None:
    """Of all patterns and of sets that lack some, by the dense formula and by transforms: 1e-9.
    Behind a mixing it had been 0 of incomplete sets.
    """
    random = np.random.default_rng(3)
    kept = np.sort(random.permutation(np.arange(1, 256))[: count - 1]).tolist()
    patterns = PatternSet.of(16, 16, [0, *kept])
    values = random.normal(size=count)
    took = []
    for mixing in (None, Mixing(np.eye(256), 16, 16)):
        plan = lmmse_plan(Sensing(patterns, mixing))
        took.append(smoothed_away(plan, values, plan.image(values, 100.0), 0.5, 100.0))
    assert took[0] > 1e-4
    assert took[1] == pytest.approx(took[0], rel=1e-9)


def test_a_mixing_that_does_not_fit_is_refused() -> None:
    record = record_of(np.zeros(64), PatternSet(8, 8, 32))
    with pytest.raises(ValueError, match=r"^mixing: 32 emitters, the patterns have 64"):
        reconstruct(record, mixing=Mixing(np.ones((32, 64)), 8, 8))
    with pytest.raises(ValueError, match=r"^mixing: shape"):
        Mixing(np.ones((64, 63)), 8, 8)
    with pytest.raises(ValueError, match=r"^mixing: holds what is not a number"):
        Mixing(np.full((64, 64), np.nan), 8, 8)
    with pytest.raises(ValueError, match=r"needs a clean grid"):
        reconstruct(record, "zero-fill", mixing=Mixing(np.eye(64), 8, 8))


def test_a_matrix_in_a_mixings_place_is_refused() -> None:
    for given in (np.eye(64), np.eye(1), 3):
        with pytest.raises(InputError, match=r"^mixing: \w+, expected Mixing\(matrix"):
            Sensing(PatternSet(8, 8, 64), given)  # type: ignore[arg-type]
