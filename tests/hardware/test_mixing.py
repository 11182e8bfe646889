"""A calibrated mixing in place of a clean grid of cells."""

import numpy as np
import pytest
from scipy import fft
from spi_records import record_of, scene

from hardware import InputError, PatternSet, reconstruct
from hardware.reconstruction import Mixing, Sensing
from hardware.reconstruction.methods.lmmse import lmmse_plan
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
