"""Pattern sets and their fast transform, against SciPy's Hadamard matrix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import hadamard

from hardware.patterns import PatternSet, fwht, hadamard_rows


@pytest.mark.parametrize("n", [1, 2, 16, 256])
def test_fwht_is_the_sylvester_matrix(n: int) -> None:
    x = np.random.default_rng(n).normal(size=(n, 3))
    np.testing.assert_allclose(fwht(x), hadamard(n) @ x, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(hadamard_rows(np.arange(n), n), hadamard(n))


def test_fwht_of_integers_is_exact_and_its_own_inverse() -> None:
    """Additions in float64 lose nothing below 2**53; n x must come back to the last bit."""
    x = np.random.default_rng(1).integers(-(2**30), 2**30, size=4096)
    np.testing.assert_array_equal(fwht(fwht(x)), 4096.0 * x)


def test_fwht_leaves_its_input_alone() -> None:
    x = np.arange(8.0)
    fwht(x)
    np.testing.assert_array_equal(x, np.arange(8.0))


@pytest.mark.parametrize("n", [0, 3, 12])
def test_fwht_refuses_other_lengths(n: int) -> None:
    with pytest.raises(ValueError, match="power of two"):
        fwht(np.zeros(n))


sizes = st.sampled_from([1, 2, 4, 8, 16])


@given(
    rows=sizes,
    columns=sizes,
    order=st.sampled_from(["natural", "sequency"]),
    mode=st.sampled_from(["plain", "differential"]),
    data=st.data(),
)
def test_signal_is_the_sum_of_the_lit_cells(rows, columns, order, mode, data) -> None:
    """The fast path against the masks as a projector would show them, for any set."""
    count = data.draw(st.integers(1, rows * columns))
    patterns = PatternSet(rows, columns, count, order, mode)
    cells = np.random.default_rng(count).random(rows * columns)
    masks = patterns.masks().reshape(patterns.n_exposures, -1)
    np.testing.assert_allclose(patterns.signal(cells), masks @ cells, atol=1e-12)


@pytest.mark.parametrize(("rows", "columns"), [(8, 8), (4, 16), (16, 2)])
def test_sequency_order_counts_sign_changes_of_the_shown_images(rows: int, columns: int) -> None:
    """Counted on the two-dimensional patterns themselves, not on the formula that sorts them."""
    patterns = PatternSet(rows, columns, rows * columns, "sequency", "plain")
    images = 2 * patterns.masks().astype(int) - 1
    changes = (np.diff(images[:, 0, :]) != 0).sum(axis=1) + (np.diff(images[:, :, 0]) != 0).sum(1)
    assert (np.diff(changes) >= 0).all()
    assert sorted(patterns.indices) == list(range(rows * columns))


def test_masks_of_a_slice_are_those_of_the_whole_set() -> None:
    patterns = PatternSet(4, 8, 10)
    np.testing.assert_array_equal(patterns.masks(slice(3, 9)), patterns.masks()[3:9])


def test_complement_follows_its_pattern() -> None:
    masks = PatternSet(4, 4, 16).masks()
    np.testing.assert_array_equal(masks[0::2] + masks[1::2], 1)


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("rows", (60, 64, 1)),
        ("columns", (64, 0, 1)),
        ("count", (4, 4, 17)),
        ("count", (4, 4, 0)),
        ("order", (4, 4, 1, "random")),
        ("mode", (4, 4, 1, "natural", "both")),
    ],
)
def test_bad_sets_name_the_field(field: str, arguments: tuple) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        PatternSet(*arguments)
