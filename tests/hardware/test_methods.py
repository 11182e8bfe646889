"""Every registered method: limits, extremes, and what each of them minimises."""

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import fft, optimize

from hardware import PatternSet, SpiRecord, compiled, reconstruct
from hardware.patterns import fwht
from hardware.reconstruction import METHODS, Mixing, Sensing, measurements, method
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.dictionaries import haar_matrix, prior_deviation
from hardware.reconstruction.methods.lmmse import SubsetPlan, lmmse_blocks, lmmse_plan, mixed_plan
from hardware.reconstruction.methods.patches import sparse_patches
from hardware.reconstruction.methods.total_variation import total_variation
from hardware.reconstruction.prior import cell_variance, prior_spectrum, walsh_variance
from hardware.reconstruction.projection import projection
from hardware.reconstruction.pursuit import batch_omp
from hardware.records import Flag, QuaternionPose


@pytest.fixture(params=[pytest.param("compiled", marks=pytest.mark.library("numba")), "NumPy"])
def path(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both paths of everything that has a compiled one."""
    if request.param == "NumPy":
        monkeypatch.setattr(compiled, "available", lambda: False)


def record_of(electrons: np.ndarray, patterns: PatternSet, bits: int = 31) -> SpiRecord:
    n = patterns.n_exposures
    return SpiRecord(
        counts=np.rint(electrons).astype(np.int32).reshape(n, -1),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=bits,
        device="test",
        pose=QuaternionPose(),
    )


def scene(rows: int, columns: int) -> np.ndarray:
    """A bright box on a slope, whole even numbers."""
    picture = 200.0 * np.add.outer(np.arange(rows), np.arange(columns)) // 4 * 2
    picture[rows // 4 : rows // 2, columns // 4 : columns // 2] += 4000
    return picture


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


@pytest.mark.parametrize(
    ("rows", "columns", "mixed"), [(16, 8, False), (8, 32, False), (16, 8, True)]
)
def test_the_adjoint_is_the_transpose(path: None, rows: int, columns: int, mixed: bool) -> None:
    """<A x, y> = <x, A^T y>, and both equal the dense matrix."""
    rng = np.random.default_rng(1)
    patterns = PatternSet(rows, columns, 50)
    mixing = Mixing(rng.random((rows * columns, 60)), 6, 10) if mixed else None
    sensing = Sensing(patterns, mixing)
    x, y = rng.normal(size=sensing.n_cells), rng.normal(size=50)
    assert sensing.forward(x) @ y == pytest.approx(x @ sensing.adjoint(y))
    np.testing.assert_allclose(sensing.forward(x), sensing.matrix @ x, atol=1e-9)
    largest = np.linalg.norm(sensing.matrix, 2) ** 2
    assert sensing.largest_squared == pytest.approx(largest)


@pytest.mark.parametrize("shape", [(32, 32), (64, 16), (4, 64), (2, 8), (1, 16), (64, 64)])
@pytest.mark.parametrize("order", ["sequency", "natural", "custom"])
def test_walsh_blocks_are_the_dense_formula(shape: tuple[int, int], order: str) -> None:
    """Image, variance and scale of the blocks against dense eigenvectors, for any subset."""
    n = shape[0] * shape[1]
    count = max(3, n // 5)
    patterns = (
        PatternSet(*shape, count, order)
        if order != "custom"
        else PatternSet.of(*shape, np.random.default_rng(2).permutation(n)[:count].tolist())
    )
    sensing = Sensing(patterns)
    dense, blocks = mixed_plan(sensing), SubsetPlan(sensing, lmmse_blocks(sensing))
    y = np.random.default_rng(3).normal(size=count) * 100
    for ratio in (0.0, 0.3, 1e4):
        image = dense.image(y, ratio)
        np.testing.assert_allclose(blocks.image(y, ratio), image, atol=1e-6 * abs(image).max())
        (detail, noise), (expected, of_cells) = blocks.errors(ratio), dense.errors(ratio)
        np.testing.assert_allclose(detail, expected, rtol=1e-3, atol=1e-4 * expected.max())
        assert noise == pytest.approx(of_cells.mean(), rel=1e-3)
    assert blocks.scale(y, 1.0) == pytest.approx(dense.scale(y, 1.0))


def test_the_posterior_error_of_a_cell_covers_the_truth() -> None:
    """Images from the prior: 68.3 % of cells within one error, in each tenth of the errors.

    300 images of 256 cells with 30 patterns, whose errors differ by cell. Cells of an image are
    correlated; 300 independent ones alone allow 5 x 2.7 % at 3e-7.
    """
    rng = np.random.default_rng(4)
    patterns = PatternSet(16, 16, 30)
    spectrum = np.sqrt(prior_spectrum(16, 16))
    inside = []
    plan, ratio = lmmse_plan(Sensing(patterns)), (200 / 1000) ** 2
    detail, noise = plan.errors(ratio)
    error = np.sqrt(1000**2 * detail + 200**2 * noise)
    for _ in range(300):
        x = fft.idctn(rng.normal(size=(16, 16)) * spectrum, norm="ortho").ravel() * 1000
        y = fwht(x)[patterns.indices] + 200 * rng.normal(size=30)
        inside.append(np.abs(plan.image(y, ratio) - x) < error)
    share = np.mean(inside, axis=0)
    order = np.argsort(error)
    assert np.ptp(error) > 0.02 * error.mean()
    for tenth in np.array_split(share[order], 10):
        assert abs(tenth.mean() - 0.6827) < 0.135


def test_prior_variances_are_those_of_the_dense_covariance() -> None:
    spectrum = prior_spectrum(8, 4)
    basis = np.kron(*(fft.dct(np.eye(n), norm="ortho", axis=0) for n in (8, 4)))
    covariance = basis.T @ np.diag(spectrum.ravel()) @ basis
    h = Sensing(PatternSet(8, 4, 32, "natural")).matrix
    np.testing.assert_allclose(walsh_variance(8, 4), np.diag(h @ covariance @ h.T), atol=1e-9)
    np.testing.assert_allclose(cell_variance(8, 4), np.diag(covariance), atol=1e-12)
    for name, matrix in (("dct", dct_matrix), ("haar", haar_matrix)):
        basis = np.kron(matrix(8), matrix(4))
        expected = np.sqrt(np.maximum(np.diag(basis @ covariance @ basis.T), 0))
        np.testing.assert_allclose(prior_deviation(name, 8, 4).ravel(), expected, atol=1e-7)


def test_dictionaries() -> None:
    """SciPy's DCT; Haar by hand for 4; both orthonormal."""
    np.testing.assert_allclose(dct_matrix(8), fft.dct(np.eye(8), norm="ortho", axis=0), atol=1e-12)
    r = np.sqrt(0.5)
    by_hand = [[0.5, 0.5, 0.5, 0.5], [0.5, 0.5, -0.5, -0.5], [r, -r, 0, 0], [0, 0, r, -r]]
    np.testing.assert_allclose(haar_matrix(4), by_hand)
    for matrix in (dct_matrix(16), haar_matrix(16)):
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(16), atol=1e-12)


def greedy(atoms: np.ndarray, y: np.ndarray, n_atoms: int) -> tuple[list[int], np.ndarray]:
    """Orthogonal matching pursuit as its definition says, least squares at each step."""
    chosen: list[int] = []
    x = np.zeros(0)
    residual = y
    for _ in range(n_atoms):
        chosen.append(int(np.argmax(np.abs(atoms.T @ residual))))
        x = np.linalg.lstsq(atoms[:, chosen], y, rcond=None)[0]
        residual = y - atoms[:, chosen] @ x
    return chosen, x


@pytest.mark.parametrize("seed", range(5))
def test_pursuit_is_its_definition(path: None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    atoms = rng.normal(size=(50, 200)) * rng.random(200)
    y = rng.normal(size=50)
    support, x = batch_omp(np.ascontiguousarray(atoms.T @ atoms), atoms.T @ y, 20)
    expected, coefficients = greedy(atoms, y, 20)
    np.testing.assert_array_equal(support, expected)
    np.testing.assert_allclose(x, coefficients, rtol=1e-8, atol=1e-10)


@pytest.mark.library("sklearn")
def test_pursuit_equals_scikit_learn(path: None) -> None:
    from sklearn import linear_model

    rng = np.random.default_rng(9)
    atoms = rng.normal(size=(64, 300))
    gram, correlations = atoms.T @ atoms, atoms.T @ rng.normal(size=64)
    support, x = batch_omp(gram, correlations, 16)
    theirs = linear_model.orthogonal_mp_gram(gram, correlations, n_nonzero_coefs=16)
    ours = np.zeros(300)
    ours[support] = x
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10 * abs(theirs).max())


def test_pursuit_stops_at_the_tolerance_and_at_dependent_atoms(path: None) -> None:
    rng = np.random.default_rng(10)
    atoms = rng.normal(size=(20, 30))
    atoms[:, 15:] = atoms[:, :15]  # each twice
    y = rng.normal(size=20)
    gram, correlations = np.ascontiguousarray(atoms.T @ atoms), atoms.T @ y
    support, _ = batch_omp(gram, correlations, 30)
    assert len(support) <= 15
    few, x = batch_omp(gram, correlations, 30, energy=float(y @ y), tolerance=0.5 * float(y @ y))
    left = y - atoms[:, few] @ x
    before = y - atoms[:, few[:-1]] @ np.linalg.lstsq(atoms[:, few[:-1]], y, rcond=None)[0]
    assert left @ left <= 0.5 * (y @ y) < before @ before


def variation(picture: np.ndarray) -> float:
    """Isotropic total variation, forward differences."""
    down, along = np.zeros_like(picture), np.zeros_like(picture)
    down[:-1], along[:, :-1] = np.diff(picture, axis=0), np.diff(picture, axis=1)
    return float(np.sqrt(down**2 + along**2).sum())


@pytest.mark.parametrize("noise", [0.0, 400.0])
def test_total_variation_converges_to_the_least(path: None, noise: float) -> None:
    """Against SciPy's constrained minimiser on 8 x 8 cells; misfit within its bound."""
    rng = np.random.default_rng(5)
    sensing = Sensing(PatternSet(8, 8, 20))
    y = sensing.forward(scene(8, 8).ravel()) + noise * rng.normal(size=20)
    found = total_variation(y, noise**2, sensing, iterations=5000)[0]
    bound = 0.6 * 20 * noise**2
    misfit = float(np.sum((sensing.forward(found) - y) ** 2))
    assert misfit <= bound * (1 + 1e-6) + 1e-9
    a = sensing.matrix
    kind: dict[str, Any] = (
        {"type": "eq", "fun": lambda x: (a @ x - y) / 64, "jac": lambda x: a / 64}
        if noise == 0
        else {"type": "ineq", "fun": lambda x: (bound - np.sum((a @ x - y) ** 2)) / bound}
    )
    start = METHODS["lmmse"](y, noise**2, sensing)[0]
    if noise:
        start = projection(y[:, None], np.array([np.sqrt(bound)]), sensing)(start[:, None])[:, 0]
    best = optimize.minimize(
        lambda x: variation(x.reshape(8, 8)),
        start,
        constraints=[kind],
        method="SLSQP",
        options={"maxiter": 300},
    )
    # SLSQP meets kinks and stops above the least; the primal-dual result must not be above it.
    assert variation(found.reshape(8, 8)) <= best.fun * 1.002
    assert variation(found.reshape(8, 8)) < 0.98 * variation(start.reshape(8, 8))


def test_projections_agree_and_touch_the_bound(path: None) -> None:
    """A mixing of ones on the diagonal is the clean grid: exact transform against SVD."""
    rng = np.random.default_rng(6)
    patterns = PatternSet(8, 8, 30)
    x, y = rng.normal(size=(64, 1)), rng.normal(size=(30, 1)) * 8
    for radius in (0.0, 3.0, 1e6):
        grid = projection(y, np.array([radius]), Sensing(patterns))(x)
        mixed = projection(y, np.array([radius]), Sensing(patterns, Mixing(np.eye(64), 8, 8)))(x)
        np.testing.assert_allclose(mixed, grid, atol=1e-6)
    skewed = Sensing(patterns, Mixing(rng.random((64, 40)), 5, 8))
    start = rng.normal(size=(40, 1))
    moved = projection(y, np.array([2.0]), skewed)(start)
    assert np.linalg.norm(skewed.forward(moved) - y) == pytest.approx(2.0, rel=1e-6)
    step = (start - moved)[:, 0]  # optimality: the step is a multiple of A^T (A x - y)
    gradient = skewed.adjoint(skewed.forward(moved) - y)[:, 0]
    cosine = step @ gradient / np.linalg.norm(step) / np.linalg.norm(gradient)
    assert cosine == pytest.approx(1.0, abs=1e-6)


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


def test_sparse_patches_keep_means_and_what_is_large() -> None:
    """A flat picture at any threshold; any picture at none; less variation in between."""
    flat = np.full((16, 12), 7.0)
    np.testing.assert_allclose(sparse_patches(flat, 1e9), flat)
    picture = np.random.default_rng(14).normal(size=(16, 12))
    np.testing.assert_allclose(sparse_patches(picture, 0.0), picture, atol=1e-12)
    assert variation(sparse_patches(picture, 2.0)) < 0.5 * variation(picture)


def test_pursuit_weighs_atoms_by_the_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns normalised to one make it collapse, as they must not: at least 2 dB."""
    from hardware.reconstruction.methods import omp

    i, j = np.mgrid[:32, :32]
    picture = 1.0 * ((i - 12.3) ** 2 + (j - 14.1) ** 2 < 75)
    sensing = Sensing(PatternSet(32, 32, 64))
    y = sensing.forward(picture.ravel())
    weighted = np.mean((METHODS["omp"](y, 0.0, sensing)[0] - picture.ravel()) ** 2)
    norms = np.linalg.norm(sensing.matrix @ np.kron(dct_matrix(32), dct_matrix(32)).T, axis=0)
    naive = (1 / np.maximum(norms, 1e-9)).reshape(32, 32)
    naive[0, 0] = 0
    monkeypatch.setattr(omp, "prior_deviation", lambda *_: naive)
    omp.omp_plan.cache_clear()
    normalised = np.mean((METHODS["omp"](y, 0.0, sensing)[0] - picture.ravel()) ** 2)
    omp.omp_plan.cache_clear()
    assert 10 * np.log10(normalised / weighted) > 2


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
