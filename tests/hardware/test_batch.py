"""The batch algorithms over strict Array API arrays equal those that run one image at a time."""

from typing import Any

import numpy as np
import pytest

from hardware import PatternSet
from hardware.patterns import fwht
from hardware.reconstruction import METHODS
from hardware.reconstruction.pursuit import batch_omp

pytest.importorskip("array_api_compat")

from hardware.reconstruction import batch

LIBRARIES = ["numpy", "array_api_strict", pytest.param("torch", marks=pytest.mark.peers)]


@pytest.fixture(params=LIBRARIES)
def xp(request: pytest.FixtureRequest) -> Any:
    """NumPy; what refuses everything outside the standard; PyTorch by `make test-peers`."""
    return pytest.importorskip(request.param)


def numpy_of(array: Any) -> np.ndarray:
    return np.from_dlpack(array) if hasattr(array, "__dlpack__") else np.asarray(array)


def problem(patterns: PatternSet, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Measurements (count, 5) of smooth random pictures, a dark one among them."""
    rng = np.random.default_rng(0)
    cells = np.cumsum(rng.normal(size=(patterns.n_cells, 5)), axis=0)
    cells[:, 3] = 0
    values = fwht(cells)[patterns.indices]
    return values + noise * rng.normal(size=values.shape), np.full(5, noise**2)


def test_transform(xp: Any) -> None:
    x = np.random.default_rng(1).integers(-99, 99, size=(512, 3)).astype(float)
    np.testing.assert_array_equal(numpy_of(batch.batch_fwht(xp.asarray(x))), fwht(x))


@pytest.mark.parametrize("count", [100, 512])
@pytest.mark.parametrize("noise", [0.0, 50.0])
@pytest.mark.parametrize(
    ("name", "many"),
    [
        ("lmmse", batch.batch_lmmse),
        ("fista", batch.batch_fista),
        ("tv", batch.batch_total_variation),
    ],
)
def test_methods(xp: Any, name: str, many: Any, noise: float, count: int) -> None:
    """To 1e-6 of the picture: after many steps the order of sums shows."""
    patterns = PatternSet(32, 16, count)
    values, variance = problem(patterns, noise)
    found = numpy_of(many(xp.asarray(values), xp.asarray(variance), patterns))
    for image, y in zip(found.T, values.T, strict=True):
        alone = METHODS[name](y, noise**2, patterns)[0]
        np.testing.assert_allclose(image, alone, rtol=0, atol=1e-6 * (np.ptp(alone) + 1e-9))


@pytest.mark.parametrize("tolerance", [0.0, 5.0])
def test_pursuit(xp: Any, tolerance: float) -> None:
    """Same atoms, same coefficients, also where signals stop at different numbers of atoms."""
    rng = np.random.default_rng(2)
    atoms = rng.normal(size=(40, 120))
    signals = atoms[:, :3] @ rng.normal(size=(3, 6)) + 0.3 * rng.normal(size=(40, 6))
    signals[:, 4] = 0
    gram, correlations = atoms.T @ atoms, signals.T @ atoms
    energy = np.sum(signals**2, axis=0)
    support, x = batch.batch_pursuit(
        xp.asarray(gram),
        xp.asarray(correlations),
        12,
        energy=xp.asarray(energy),
        tolerance=tolerance,
    )
    support, x = numpy_of(support), numpy_of(x)
    lengths = set()
    for i in range(6):
        chosen, coefficients = batch_omp(
            gram, correlations[i], 12, energy=float(energy[i]), tolerance=tolerance
        )
        k = len(chosen)
        lengths.add(k)
        np.testing.assert_array_equal(support[i, :k], chosen)
        np.testing.assert_allclose(x[i, :k], coefficients, atol=1e-9)
        assert not x[i, k:].any()
    assert len(lengths) > 1
