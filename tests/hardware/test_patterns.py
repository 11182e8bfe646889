"""Pattern sets and their fast transform, against SciPy's Hadamard matrix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.linalg import hadamard

from hardware import InputError, compiled
from hardware.patterns import ORDERS, PatternSet, fwht, fwht_in_place, hadamard_rows


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
        ("rows", (4.0, 4, 1)),
        ("columns", (4, "4", 1)),
        ("count", (4, 4, 1.5)),
        ("order", (4, 4, 1, "random")),
        ("mode", (4, 4, 1, "natural", "both")),
    ],
)
def test_bad_sets_name_the_field(field: str, arguments: tuple) -> None:
    with pytest.raises(InputError, match=f"^{field}: "):
        PatternSet(*arguments)


def pieces(pattern: np.ndarray) -> int:
    """Connected regions of equal sign, neighbours sharing an edge."""
    return int(ndimage.label(pattern > 0)[1] + ndimage.label(pattern < 0)[1])


def images_in(order: str, rows: int, columns: int) -> np.ndarray:
    patterns = PatternSet(rows, columns, rows * columns, order, "plain")
    return 2 * patterns.masks().astype(int) - 1


GRIDS = [(8, 8), (16, 4), (4, 16), (1, 8), (16, 1), (1, 1)]


@pytest.mark.parametrize(("rows", "columns"), [*GRIDS, (64, 16), (128, 16), (256, 16), (64, 64)])
@pytest.mark.parametrize("order", ORDERS)
def test_every_order_is_a_permutation_that_starts_with_the_mean(order, rows, columns) -> None:
    indices = PatternSet(rows, columns, rows * columns, order).indices
    np.testing.assert_array_equal(np.sort(indices), np.arange(rows * columns))
    assert indices[0] == 0


@pytest.mark.parametrize(("rows", "columns"), GRIDS)
def test_cake_cutting_counts_connected_pieces(rows: int, columns: int) -> None:
    found = [pieces(image) for image in images_in("cake-cutting", rows, columns)]
    assert found == sorted(found)


@pytest.mark.parametrize(("rows", "columns"), GRIDS)
def test_total_variation_is_that_of_the_shown_image(rows: int, columns: int) -> None:
    found = []
    for image in images_in("total-variation", rows, columns):
        down, along = np.zeros(image.shape), np.zeros(image.shape)
        down[:-1], along[:, :-1] = np.diff(image, axis=0), np.diff(image, axis=1)
        found.append(np.hypot(down, along).sum())
    assert (np.diff(found) > -1e-9).all()


@pytest.mark.parametrize(("rows", "columns"), GRIDS)
def test_walsh_counts_changes_from_cell_to_cell(rows: int, columns: int) -> None:
    flat = images_in("walsh", rows, columns).reshape(rows * columns, -1)
    changes = (np.diff(flat, axis=1) != 0).sum(axis=1)
    np.testing.assert_array_equal(changes, np.arange(rows * columns))


def changes_of(order: str, rows: int, columns: int) -> list[tuple[int, int]]:
    """Sign changes down the rows and along the columns, counted on the images."""
    return [
        (int((np.diff(i[:, 0]) != 0).sum()), int((np.diff(i[0]) != 0).sum()))
        for i in images_in(order, rows, columns)
    ]


def test_orders_by_hand() -> None:
    """4 x 4, as (changes down, changes along): JPEG's path; squares; dolls of 1, 2 and 4 cells."""
    assert changes_of("zigzag", 4, 4) == [
        (0, 0), (0, 1), (1, 0), (2, 0), (1, 1), (0, 2), (0, 3), (1, 2),
        (2, 1), (3, 0), (3, 1), (2, 2), (1, 3), (2, 3), (3, 2), (3, 3),
    ]  # fmt: skip
    assert [max(c) for c in changes_of("sequency-max", 4, 4)] == [0] + [1] * 3 + [2] * 5 + [3] * 7
    assert changes_of("russian-dolls", 4, 4) == [
        (0, 0), (1, 0), (0, 1), (1, 1),
        (2, 0), (3, 0), (2, 1), (3, 1),
        (0, 2), (0, 3), (1, 2), (1, 3),
        (2, 2), (3, 2), (2, 3), (3, 3),
    ]  # fmt: skip


@pytest.mark.parametrize(("rows", "columns"), [(8, 8), (16, 4), (64, 16)])
def test_russian_dolls_hold_complete_smaller_sets(rows: int, columns: int) -> None:
    """A quarter of the patterns is all that an image of half the sides can be made of."""
    n = rows * columns
    small = images_in("russian-dolls", rows, columns)[: n // 4]
    blocks = small.reshape(n // 4, rows // 2, 2, columns // 2, 2)
    np.testing.assert_array_equal(blocks, blocks[:, :, :1, :, :1] + 0 * blocks)
    coarse = blocks[:, :, 0, :, 0].reshape(n // 4, -1)
    np.testing.assert_array_equal(coarse @ coarse.T, n // 4 * np.eye(n // 4))


@pytest.mark.parametrize("count", [1, 2, 3, 64, 100, 1000, 1024])
def test_interleaved_shows_the_first_of_sequency_low_and_high_in_turn(count: int) -> None:
    """The same rows, in another order; any eighth of the frame holds an eighth of each quarter of
    the ranks, to two rows.
    """
    sorted_rows = PatternSet(32, 32, count).indices
    shown = PatternSet(32, 32, count, "interleaved").indices
    assert shown[0] == 0
    np.testing.assert_array_equal(np.sort(shown), np.sort(sorted_rows))
    rank = np.argsort(sorted_rows)[np.searchsorted(np.sort(sorted_rows), shown)]
    for part in np.array_split(rank, 8):
        quarters = np.bincount(4 * part // count, minlength=4)
        assert np.abs(quarters - len(part) / 4).max() <= 4


@pytest.mark.parametrize(("rows", "columns"), [(8, 8), (16, 4)])
def test_prior_variance_falls(rows: int, columns: int) -> None:
    """Against the covariance written out, from its Fourier eigenvectors."""
    f2 = np.fft.fftfreq(rows, 1 / rows)[:, None] ** 2 + np.fft.fftfreq(columns, 1 / columns) ** 2
    f2[0, 0] = 1e-9
    fourier = np.kron(np.fft.fft(np.eye(rows)), np.fft.fft(np.eye(columns)))
    covariance = np.real(fourier.conj().T @ np.diag(1 / f2.ravel()) @ fourier)
    h = images_in("prior-variance", rows, columns).reshape(rows * columns, -1)
    variance = np.einsum("ij,jk,ik->i", h, covariance, h)
    assert (np.diff(variance) <= 1e-6 * variance[1]).all()


def test_rows_are_orthogonal() -> None:
    """H H^T = N I, in whole numbers."""
    h = hadamard_rows(np.arange(256), 256).astype(int)
    np.testing.assert_array_equal(h @ h.T, 256 * np.eye(256))
    np.testing.assert_array_equal(fwht(np.eye(256)), h)


@pytest.mark.library("numba")
@pytest.mark.parametrize("n", [1, 2, 8, 64, 512, 4096, 2**15])
@pytest.mark.parametrize("inner", [1, 3])
def test_compiled_and_array_transform_are_equal(n: int, inner: int, monkeypatch) -> None:
    """Whole numbers to the last bit; others within roundoff; in place."""
    rng = np.random.default_rng(n)
    whole = rng.integers(-(2**20), 2**20, size=(n, inner)).astype(float)
    other = rng.normal(size=(n, inner))
    monkeypatch.setattr(compiled, "available", lambda: True)
    fast = [fwht_in_place(x.copy(), repeated=True) for x in (whole, other)]
    changed = whole.copy()
    assert fwht_in_place(changed) is changed
    np.testing.assert_array_equal(changed, fast[0])
    monkeypatch.setattr(compiled, "available", lambda: False)
    np.testing.assert_array_equal(fwht(whole), fast[0])
    np.testing.assert_allclose(fwht(other), fast[1], atol=1e-12 * n)
    np.testing.assert_array_equal(fwht(fwht(whole)), n * whole)


def test_in_place_refuses_what_it_would_have_to_copy() -> None:
    for array in (np.zeros(8, np.float32), np.zeros((8, 4))[:, ::2]):
        with pytest.raises(ValueError, match=r"^array: .* expected C-contiguous float64"):
            fwht_in_place(array)


@pytest.mark.parametrize("mode", ["reference", "s-matrix", "complementary"])
def test_other_modes_light_what_their_masks_say(mode) -> None:
    patterns = PatternSet(4, 8, 20, "zigzag", mode)
    cells = np.random.default_rng(3).random((32, 2))
    masks = patterns.masks().reshape(patterns.n_exposures, -1).astype(float)
    expected = masks @ cells
    if mode == "complementary":
        expected = np.hstack([expected, (1 - masks) @ cells])
    np.testing.assert_allclose(patterns.signal(cells), expected, atol=1e-12)


def test_modes_by_hand() -> None:
    """Reference: all lit, all dark, then the patterns. S-matrix: its dark frame, cell 0 never lit,
    half of the other cells in each pattern, every pair of patterns sharing a quarter.
    """
    reference = PatternSet(4, 4, 16, "natural", "reference").masks().reshape(18, 16)
    assert reference[0].all()
    assert not reference[1].any()
    np.testing.assert_array_equal(reference[2:], hadamard(16) > 0)
    s = PatternSet(4, 4, 16, "natural", "s-matrix").masks().reshape(16, 16).astype(int)
    assert not s[0].any()
    assert not s[:, 0].any()
    np.testing.assert_array_equal(s[1:] @ s[1:].T, 4 * np.eye(15) + 4)


def test_any_subset() -> None:
    patterns = PatternSet.of(4, 4, [0, 7, 3], "plain")
    np.testing.assert_array_equal(patterns.indices, [0, 7, 3])
    np.testing.assert_array_equal(patterns.masks().reshape(3, 16), hadamard(16)[[0, 7, 3]] > 0)
    assert patterns == PatternSet.of(4, 4, np.array([0, 7, 3]), "plain")
    assert hash(patterns) == hash(PatternSet.of(4, 4, [0, 7, 3], "plain"))


@pytest.mark.parametrize(
    "arguments",
    [
        (4, 4, 2, "custom"),
        (4, 4, 2, "natural", "plain", (0, 1)),
        (4, 4, 2, "custom", "plain", (0, 1, 2)),
        (4, 4, 2, "custom", "plain", (1, 1)),
        (4, 4, 2, "custom", "plain", (1, 16)),
    ],
)
def test_bad_subsets_are_refused(arguments: tuple) -> None:
    with pytest.raises(ValueError, match=r"^subset: "):
        PatternSet(*arguments)


def test_an_s_matrix_needs_its_dark_frame() -> None:
    with pytest.raises(ValueError, match=r"^mode: 's-matrix' needs row 0"):
        PatternSet.of(4, 4, [1, 2], "s-matrix")


@pytest.mark.parametrize("row", [1.5, 1.0, np.float64(2), "3", None])
def test_rows_are_whole_numbers(row: object) -> None:
    """On ee37b06 1.5 is row 1."""
    with pytest.raises(ValueError, match=r"indices: .*, expected whole numbers"):
        PatternSet.of(8, 8, (0, row))  # type: ignore[arg-type]
    assert PatternSet.of(8, 8, np.array([0, 3], np.uint16)).subset == (0, 3)
