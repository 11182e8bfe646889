"""Reconstructions from simulated counts, against closed forms and dense linear algebra."""

import numpy as np
import pytest
from scipy import fft, stats
from scipy.linalg import hadamard

from hardware import PatternSet, SpiRecord, reconstruct
from hardware.errors import InputError
from hardware.patterns import fwht
from hardware.reconstruction import METHODS, fits_in_memory, measurements
from hardware.reconstruction.methods.lmmse import lmmse_plan
from hardware.reconstruction.sensing import Sensing
from hardware.records import Flag, QuaternionPose

lmmse = METHODS["lmmse"]


def record_of(
    electrons: np.ndarray, patterns: PatternSet, electrons_per_count: float = 1.0
) -> SpiRecord:
    n = patterns.n_exposures
    counts = np.rint(electrons / electrons_per_count).astype(np.int32).reshape(n, -1)
    return SpiRecord(
        counts=counts,
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=electrons_per_count,
        offset_counts=0.0,
        adc_bits=31,
        device="test",
        pose=QuaternionPose(),
    )


def prior_image(rng: np.random.Generator, side: int = 32) -> np.ndarray:
    """A draw from the 1/f^2 prior itself, mean 0: cosine function k has k/2 cycles per image."""
    f2 = (np.arange(side)[:, None] ** 2 + np.arange(side) ** 2) / 4
    f2[0, 0] = np.inf
    return np.asarray(fft.idctn(rng.normal(size=(side, side)) / np.sqrt(f2), norm="ortho"))


@pytest.mark.parametrize(
    ("method", "mode"),
    [("zero-fill", "differential"), ("lmmse", "differential")],
)
@pytest.mark.parametrize(("rows", "columns"), [(16, 16), (64, 16), (1, 8)])
def test_a_full_noiseless_set_returns_the_image(method, mode, rows, columns) -> None:
    """Whole numbers of electrons, so that the counts hold the signal exactly."""
    patterns = PatternSet(rows, columns, rows * columns, "sequency", mode)
    image = 2.0 * np.random.default_rng(0).integers(0, 500, size=(rows, columns))
    found = reconstruct(record_of(patterns.signal(image.ravel()), patterns), method)
    np.testing.assert_allclose(found.image, image[None], atol=1e-9)


def test_plain_patterns_return_the_image_over_any_background() -> None:
    """Background is one constant in every value, as the light of the first cell is: the others are
    exact, and the first is not measured.
    """
    patterns = PatternSet(32, 32, 1024, "sequency", "plain")
    image = np.rint(1000 * (prior_image(np.random.default_rng(9)) + 3)) * 2
    for background in (0.0, 1e8):
        electrons = patterns.signal(image.ravel()) + background
        found = reconstruct(record_of(electrons, patterns), "zero-fill").image[0]
        np.testing.assert_allclose(found.ravel()[1:], image.ravel()[1:], atol=1e-6)
        assert np.isnan(found[0, 0])


@pytest.mark.parametrize("count", [5, 40, 64])
@pytest.mark.parametrize("order", ["natural", "sequency"])
def test_lmmse_is_the_dense_formula(count: int, order) -> None:
    """Fast path against C H^T (H C H^T + s I)^-1 y with every matrix written out."""
    rng = np.random.default_rng(count)
    patterns = PatternSet(8, 8, count, order)
    values = rng.normal(size=count) * 30
    s = 4.0
    f2 = (np.arange(8)[:, None] ** 2 + np.arange(8) ** 2) / 4
    f2[0, 0] = np.inf
    cosines = fft.dct(np.eye(8), norm="ortho", axis=0)
    both = np.kron(cosines, cosines)
    c = both.T @ np.diag(1 / f2.ravel()) @ both
    h = hadamard(64)[patterns.indices]
    y = np.where(patterns.indices == 0, 0.0, values)
    structure = np.trace(h @ c @ h.T)
    scale = max(np.sum(y**2) - count * s, np.sqrt(2 * count) * s) / structure
    dense = scale * c @ h.T @ np.linalg.solve(scale * h @ c @ h.T + s * np.eye(count), y)
    dense += values[patterns.indices == 0].sum() / 64
    cells, _ = lmmse(values, s, patterns)
    np.testing.assert_allclose(cells, dense, atol=1e-9)
    gain = scale * c @ h.T @ np.linalg.inv(scale * h @ c @ h.T + s * np.eye(count))
    posterior = np.trace(scale * c - gain @ h @ c * scale) / 64 + s / 64**2
    detail, noise = lmmse_plan(Sensing(patterns)).errors(s / scale)
    np.testing.assert_allclose(np.mean(scale * detail + s * noise), posterior, rtol=1e-4)


def test_mean_square_errors_are_the_errors_made() -> None:
    """On images drawn from the prior, squared error over that of detail and noise has mean 1.

    24 images of 1024 cells; cells are correlated, so the bound is wide: 0.85 to 1.15. A missing
    factor 2 in noise or prior leaves it.
    """
    rng = np.random.default_rng(3)
    for count in (200, 1024):
        patterns = PatternSet(32, 32, count)
        ratios = []
        for _ in range(24):
            image = 1000 * prior_image(rng)
            noise = 300.0
            y = fwht(image.ravel())[patterns.indices] + rng.normal(size=count) * noise
            plan = lmmse_plan(Sensing(patterns))
            detail, by_noise = plan.errors(noise**2 / 1000**2)
            cells = plan.image(y, noise**2 / 1000**2)
            expected = 1000**2 * detail + noise**2 * by_noise
            ratios.append(np.mean((cells - image.ravel()) ** 2 / expected))
        assert 0.85 < np.mean(ratios) < 1.15


def test_lmmse_beats_zero_fill_where_it_should() -> None:
    """Fewer patterns than cells, and noise: PSNR at least 1 dB higher on prior images."""
    rng = np.random.default_rng(4)
    patterns = PatternSet(32, 32, 128)
    errors = {"zero-fill": 0.0, "lmmse": 0.0}
    for _ in range(10):
        image = prior_image(rng).ravel()
        y = fwht(image)[patterns.indices] + rng.normal(size=128) * 30
        for name in errors:
            errors[name] += np.mean((METHODS[name](y, 900.0, patterns)[0] - image) ** 2)
    assert 10 * np.log10(errors["zero-fill"] / errors["lmmse"]) > 1.0


def test_sequency_order_carries_more_of_an_image() -> None:
    """The classic bug is an order that does not do what its name says: natural order loses."""
    rng = np.random.default_rng(6)
    images = np.stack([prior_image(rng).ravel() for _ in range(50)], axis=1)
    kept = {}
    for name in ("natural", "sequency"):
        patterns = PatternSet(32, 32, 64, name)
        kept[name] = np.sum(fwht(images)[patterns.indices] ** 2)
    assert kept["sequency"] > 1.5 * kept["natural"]


def test_noise_comes_out_of_the_record_itself() -> None:
    """Sum of pattern and complement is constant, so its scatter is the noise: a chi-square.

    Bounds at a false-alarm rate of 1e-6; successive differences have about 2/3 of the degrees of
    freedom. A linear drift of the sun by ten times the noise must not show.
    """
    rng = np.random.default_rng(7)
    patterns = PatternSet(64, 64, 2048)
    n, sigma = patterns.n_exposures, 1000.0
    drift = np.linspace(0, 10 * sigma, n)
    electrons = 1e7 + drift + patterns.signal(rng.random(4096) * 1e3) + rng.normal(size=n) * sigma
    found = measurements(record_of(electrons, patterns)).noise_variance[0]
    freedom = 2047 * 2 / 3
    low, high = stats.chi2.ppf([5e-7, 1 - 5e-7], freedom) / freedom
    assert low < found / (2 * sigma**2) < high


def test_detectors_do_not_mix() -> None:
    patterns = PatternSet(8, 8, 64)
    cells = 2.0 * np.random.default_rng(8).integers(0, 99, size=(64, 3))
    found = reconstruct(record_of(patterns.signal(cells), patterns), "zero-fill")
    np.testing.assert_allclose(found.image.reshape(3, 64).T, cells, atol=1e-9)


def test_a_dark_record_gives_a_dark_image() -> None:
    patterns = PatternSet(8, 8, 64)
    for method in METHODS:
        found = reconstruct(record_of(np.zeros(128), patterns), method)
        assert not found.image.any()
        assert found.standard_error is None or np.isfinite(found.standard_error).all()


def test_flags_become_warnings() -> None:
    patterns = PatternSet(4, 4, 16)
    record = record_of(patterns.signal(np.arange(16.0)), patterns)
    record.flags[3:5] = Flag.SATURATED
    assert reconstruct(record).warnings == ("2 of 32 exposures are marked saturated",)
    record.flags[:] = 0
    record.flags[[3, 7, 9]] = 16, 48, 32
    (told,) = reconstruct(record).warnings
    assert told == "flags of 3 exposures hold bits of unknown meaning (48), which are ignored"


def test_unknown_method_and_missing_reference_are_named() -> None:
    record = record_of(np.zeros(32), PatternSet(4, 4, 16))
    with pytest.raises(ValueError, match="method: 'magic' is none of"):
        reconstruct(record, "magic")


def test_a_set_whose_matrices_do_not_fit_is_refused() -> None:
    """A quarter of 1024 x 1024 patterns: blocks of 65 536 rows; all of them take no matrix."""
    large = PatternSet(1024, 1024, 2**18)
    assert not fits_in_memory("lmmse", large)
    assert fits_in_memory("zero-fill", large)
    assert fits_in_memory("lmmse", PatternSet(1024, 1024, 2**20))
    assert fits_in_memory("lmmse", PatternSet(64, 64, 1024))
    with pytest.raises(ValueError, match="GiB"):
        lmmse(np.zeros(large.count), 1.0, Sensing(large))


def test_patterns_that_light_all_cells_alike_are_an_error() -> None:
    """Of a plain set the all-lit pattern alone arrived: an image of NaN is none."""
    patterns = PatternSet(8, 8, 64, mode="plain")
    record = record_of(patterns.signal(np.full(64, 100.0)), patterns)
    record.flags[patterns.indices != 0] = Flag.LOST
    with pytest.raises(InputError, match="patterns: all alike, no cell has a value: 1 of"):
        reconstruct(record)
