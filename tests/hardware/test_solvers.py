"""What the methods minimise: against dense formulas, definitions and other solvers."""

from typing import Any

import numpy as np
import pytest
from scipy import fft, optimize
from spi_records import scene

from hardware import PatternSet
from hardware.patterns import fwht
from hardware.reconstruction import METHODS, Mixing, Sensing
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.dictionaries import haar_matrix, prior_deviation
from hardware.reconstruction.methods.lmmse import SubsetPlan, lmmse_blocks, lmmse_plan, mixed_plan
from hardware.reconstruction.methods.patches import sparse_patches
from hardware.reconstruction.methods.total_variation import total_variation
from hardware.reconstruction.prior import cell_variance, prior_spectrum, walsh_variance
from hardware.reconstruction.projection import projection
from hardware.reconstruction.pursuit import batch_omp


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


@pytest.mark.thorough
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
