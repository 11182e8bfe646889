"""Patterns of a user's own: read, shown, recorded, logged, sent and inverted as they are."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from ugv_command import ugv

from hardware import (
    InputError,
    Log,
    OwnPatterns,
    own_patterns,
    read_record,
    read_records,
    reconstruct,
    write_record,
)
from hardware.drivers.settings import SpiSettings, read_settings
from hardware.drivers.table import patterns_in, table_bytes
from hardware.patterns import PatternSet, hadamard_rows
from hardware.reconstruction import METHODS
from hardware.reconstruction.sensing import Mixing, Sensing
from hardware.records import SpiRecord
from hardware.records.state import AT_ORIGIN
from hardware.sliding_images import SlidingImages

RNG = np.random.default_rng(0)
BITS = RNG.integers(0, 2, (96, 6, 10))
GREY = RNG.random((96, 6, 10))
MODES = ("differential", "plain", "reference")


def record_of(patterns, cells, background=1000.0, noise=0.0, seed=0):
    """What a camera of 1 electron a count sends of an image, in the same background throughout."""
    light = patterns.signal(np.asarray(cells, float).ravel()) + background
    light = light.reshape(patterns.n_exposures, -1)
    drawn = light + noise * np.random.default_rng(seed).standard_normal(light.shape)
    n = patterns.n_exposures
    return SpiRecord(
        counts=np.rint(drawn).astype(np.int32),
        device_time_ns=np.arange(n, dtype=np.int64) * 1000,
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=24,
        device="test",
        pose=AT_ORIGIN,
    )


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (BITS, BITS),
        (BITS.astype(bool), BITS),
        (2 * BITS - 1, BITS),
        ((255 * BITS).astype(np.uint8), BITS),
        (GREY, GREY),
        (2 * GREY - 1, GREY),
        (np.rint(65535 * GREY).astype(np.uint16), GREY),
    ],
)
def test_values_say_what_they_are(given: np.ndarray, expected: np.ndarray) -> None:
    lit = own_patterns(given).lit.reshape(expected.shape)
    np.testing.assert_allclose(lit, expected, atol=0.5 / 65535 + 1e-12)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (np.full((2, 4, 4), 7), "int64 from 7 to 7, expected 0 and 1"),
        (np.full((2, 4, 4), np.nan), "NaN"),
        (np.zeros((2, 4)), r"shape \(2, 4\), expected \(count, rows, columns\)"),
        (np.full((1, 2, 2), "a"), "expected numbers"),
        (np.zeros((0, 4, 4)), "expected numbers"),
    ],
)
def test_what_is_no_pattern_is_told(given: np.ndarray, told: str) -> None:
    with pytest.raises(InputError, match=told):
        own_patterns(given)
    with pytest.raises(InputError, match="own patterns are shown differential"):
        own_patterns(BITS, "s-matrix")


@pytest.mark.library("PIL")
def test_files_hold_the_same(tmp_path: Path) -> None:
    from PIL import Image

    np.save(tmp_path / "a.npy", BITS)
    np.savez(tmp_path / "a.npz", patterns=BITS, other=np.zeros(3))
    frames = [Image.fromarray((255 * one).astype(np.uint8)) for one in BITS]
    frames[0].save(tmp_path / "a.tiff", save_all=True, append_images=frames[1:])
    (tmp_path / "folder").mkdir()
    for n, frame in enumerate(frames):
        frame.save(tmp_path / "folder" / f"{n:03}.png")
    known = own_patterns(BITS)
    for name in ("a.npy", "a.npz", "a.tiff", "folder"):
        assert own_patterns(tmp_path / name) == known
    np.savez(tmp_path / "two.npz", a=BITS, b=BITS)
    (tmp_path / "text.npy").write_text("none")
    (tmp_path / "empty").mkdir()
    for name, told in (
        ("two.npz", "arrays a, b, expected one"),
        ("text.npy", "is no NumPy array"),
        ("empty", "no images"),
    ):
        with pytest.raises(InputError, match=f"{name}: {told}"):
            own_patterns(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"none\.npy"):
        own_patterns(tmp_path / "none.npy")


def test_hadamard_rows_given_as_an_array_are_what_their_name_says() -> None:
    """The same light in each exposure, the same measurements, the same image by least squares."""
    named = PatternSet(8, 8, 64, "natural")
    own = own_patterns(hadamard_rows(np.arange(64), 64), shape=(8, 8))
    cells = RNG.random(64)
    np.testing.assert_allclose(own.signal(cells), named.signal(cells), atol=1e-12)
    np.testing.assert_array_equal(own.masks(), named.masks())
    assert table_bytes(own) == table_bytes(named)
    values = Sensing(named).forward(cells)
    np.testing.assert_allclose(Sensing(own).forward(cells), values, atol=1e-12)
    for of in (named, own):
        found, error = METHODS["least-squares"](values, 4.0, of)
        np.testing.assert_allclose(found, cells, atol=1e-12)
        np.testing.assert_allclose(error, 2 / 8)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("stack", [BITS, GREY], ids=["binary", "grey"])
def test_enough_patterns_give_the_image_back(mode: str, stack: np.ndarray) -> None:
    """96 patterns of 60 cells: least squares is within its standard errors of the truth, whatever
    the background; of 60 normal errors the root mean square is 1 to four of its own deviations.
    """
    cells = 1e4 * RNG.random(60)
    record = record_of(own_patterns(stack, mode), cells, noise=20.0)
    patterns = record.patterns
    assert patterns.n_exposures == {"differential": 192, "plain": 96, "reference": 98}[mode]
    found = reconstruct(record, "least-squares").image[0].ravel()
    per_value = np.sqrt(2) if mode == "differential" else 2.0
    inverse = Sensing(patterns).pseudo_inverse
    error = per_value * 20.0 * np.sqrt(np.sum(inverse**2, axis=1))
    if mode == "reference":
        error = np.hypot(error, np.sqrt(2) * 20 * np.abs(inverse.sum(axis=1)))
    assert np.sqrt(np.mean(((found - cells) / error) ** 2)) == pytest.approx(1, abs=4 / 120**0.5)


@pytest.mark.parametrize("method", sorted(set(METHODS) - {"zero-fill", "least-squares"}))
def test_methods_with_a_prior_take_any_patterns(method: str) -> None:
    rows, columns = np.mgrid[:8, :8]
    cells = 1e4 * np.exp(-((rows - 4) ** 2 + (columns - 3) ** 2) / 8)
    record = record_of(own_patterns(RNG.integers(0, 2, (48, 8, 8))), cells, noise=5.0)
    image = reconstruct(record, method).image[0]
    assert np.corrcoef(image.ravel(), cells.ravel())[0, 1] > 0.9


def test_those_that_need_hadamard_rows_say_so() -> None:
    record = record_of(own_patterns(BITS), np.ones(60))
    with pytest.raises(InputError, match=r"'zero-fill' needs rows .* 'least-squares' inverts any"):
        reconstruct(record, "zero-fill")
    with pytest.raises(InputError, match="between whole sets need rows of the Hadamard matrix"):
        SlidingImages(4).update("camera", record)


def test_with_a_mixing_both_are_inverted() -> None:
    mixing = Mixing(np.eye(60) + 0.1 * RNG.random((60, 60)), 6, 10)
    cells = 1e4 * RNG.random(60)
    record = record_of(own_patterns(BITS), mixing.matrix @ cells)
    found = reconstruct(record, "least-squares", mixing=mixing).image[0].ravel()
    np.testing.assert_allclose(found, cells, atol=20)


@pytest.mark.parametrize("method", ["lmmse", "least-squares", "tv", "fista"])
def test_plain_patterns_of_equally_many_lit_cells_tell_no_level(method: str) -> None:
    """What rounding leaves of a flat image had been taken for its level: images of 1e15."""
    rng = np.random.default_rng(0)
    stack = np.zeros((100, 64), dtype=int)
    for row in stack:
        row[rng.choice(64, 32, replace=False)] = 1
    cells = rng.uniform(0, 1e4, 64)
    patterns = own_patterns(stack.reshape(-1, 8, 8), mode="plain")
    found = reconstruct(record_of(patterns, cells, background=3000.0, noise=5.0), method)
    image = found.image[0].ravel()
    assert abs(image.mean()) < 1e-6 * cells.mean()
    assert np.std(image - cells) < 0.1 * cells.std()
    assert any("its mean is set to 0" in warning for warning in found.warnings)
    if found.standard_error is not None:
        assert found.standard_error.max() < 1e4


@pytest.mark.parametrize("in_turn", [True, False])
def test_plain_patterns_that_are_shown_again_tell_their_noise(in_turn: bool) -> None:
    """128 patterns twice, one after the other or all of them again: the noise found is that of the
    exposures, of 128 differences known to 6 %, and of 64 errors by it the root mean square is 1.
    The scatter of all measurements, detail and all, is 70 times as much.
    """
    stack = np.random.default_rng(4).integers(0, 2, (128, 8, 8))
    shown = np.repeat(stack, 2, axis=0) if in_turn else np.tile(stack, (2, 1, 1))
    cells = np.random.default_rng(5).uniform(0, 1e4, 64)
    found = reconstruct(
        record_of(own_patterns(shown, "plain"), cells, noise=300.0), "least-squares"
    )
    assert found.most_noise_electrons[0] == pytest.approx(600, rel=0.25)
    off = (found.image[0].ravel() - cells) / found.standard_error[0].ravel()
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1, abs=0.4)
    # Student's t of 128 differences; of the errors of all 256 measurements it were 1.969.
    assert found.errors_in_95 == pytest.approx(1.979, abs=0.003)


@pytest.mark.parametrize("again", ["all", "eight", "one 16 times"])
@pytest.mark.parametrize("signal_to_noise", [1.0, 1.5])
def test_errors_of_patterns_shown_again_hold_what_smoothing_took(
    signal_to_noise: float, again: str
) -> None:
    """A checkerboard of 3 % contrast that noise all but hides, by all Hadamard patterns as a user's
    own: 93 % of the cells lie within ``errors_in_95`` and errors are less than 2.5 times too wide,
    in the mean over draws. By the prior's own loss it had been 64 to 78 %. Eight repetitions tell
    the noise to 50 %, and a pattern that is shown 17 times has a weight of its own.
    """
    random = np.random.default_rng(6)
    rows = PatternSet(16, 16, 256, "sequency", "plain").masks()
    shown = {"all": rows, "eight": rows[random.choice(256, 8)], "one 16 times": rows[[1] * 16]}
    patterns = own_patterns(np.concatenate([rows, shown[again]]), "plain")
    cells = 1e4 * (0.97 + 0.03 * (np.indices((16, 16)).sum(axis=0) % 2))
    noise = 300 / signal_to_noise * np.sqrt(patterns.count) / 2
    within, off, stated = [], [], []
    for seed in range(16):
        found = reconstruct(record_of(patterns, cells, 1e5, noise, seed))
        error = (found.image[0] - cells).ravel()[1:]  # all patterns light the first cell
        of_cell = found.standard_error[0].ravel()[1:]
        within.append(np.mean(np.abs(error) < found.errors_in_95 * of_cell))
        off.append(np.mean(error**2))
        stated.append(np.mean(of_cell**2))
    assert np.mean(within) > 0.93
    assert np.mean(stated) < 2.5**2 * np.mean(off)


def test_errors_hold_where_an_own_plain_set_lacks_a_pattern() -> None:
    """A disc at an SNR of 2 by 255 Hadamard patterns as a user's own, whose noise is more than its
    photons': the image is not smoothed and has all of it. Errors had been 0.3 of the true ones,
    with 50 % of the cells within ``errors_in_95``.
    """
    rows = PatternSet(16, 16, 256, "sequency", "plain").masks()
    patterns = own_patterns(np.delete(rows, 100, axis=0), "plain")
    down, along = np.mgrid[:16, :16]
    cells = 1e5 * (np.hypot(down - 8, along - 8) < 4)
    within = []
    for seed in range(6):
        found = reconstruct(record_of(patterns, cells, 1e7, 4e5, seed))
        off = (found.image[0] - cells).ravel()[1:] / found.standard_error[0].ravel()[1:]
        within.append(np.mean(np.abs(off) < found.errors_in_95))
    assert np.mean(within) > 0.93


@pytest.mark.parametrize("n_lit", [2, 4, 8, 32])
def test_the_most_that_an_unknown_level_can_be(n_lit: int) -> None:
    """All patterns light as many cells. The level stated is at least the largest mean of all images
    without negative cells that would have given the exposures (by linear programming), and at most
    twice that; cell 0 is lit once. Twice the brightest exposure over the number of cells, which
    holds where half of them are lit, is 0.2 times that of two lit cells.
    """
    from scipy.optimize import linprog

    rng = np.random.default_rng(n_lit)
    stack = np.zeros((200, 64))
    for row in stack[1:]:
        row[1 + rng.choice(63, n_lit, replace=False)] = 1
    stack[0, :n_lit] = 1
    cells = rng.exponential(1e4, 64)
    patterns = own_patterns(stack.reshape(-1, 8, 8), mode="plain")
    found = reconstruct(record_of(patterns, cells, background=0.0), "least-squares")
    light = stack @ cells
    most = -linprog(-np.ones(64) / 64, A_ub=stack, b_ub=np.ceil(light)).fun
    assert 0.999 * most < found.level_error_electrons[0] < 2 * most
    assert (found.standard_error >= found.level_error_electrons[0]).all()


@pytest.mark.parametrize("method", ["lmmse", "least-squares"])
@pytest.mark.parametrize("mode", ["differential", "complementary", "reference"])
@pytest.mark.parametrize("lit", ["all", "none", "some"])
def test_a_single_sum_of_the_cells_tells_no_errors(method: str, mode: str, lit: str) -> None:
    """One pattern, shown 20 times: nothing tells how large the detail is that it does not see.
    1e16 had been stated of all cells lit, and noise alone of some, 2000 times too small.
    """
    rng = np.random.default_rng(3)
    cells = rng.uniform(0, 1e4, 64)
    one = np.full(64, float(lit == "all")) if lit != "some" else np.arange(64) % 3 == 0
    stack = np.tile(one.reshape(8, 8).astype(float), (20, 1, 1))
    record = record_of(own_patterns(stack, mode=mode), cells, noise=30.0)
    found = reconstruct(record, method)
    assert np.isnan(found.standard_error).all()
    assert any("a single sum of the cells" in warning for warning in found.warnings)
    assert np.abs(found.image).max() < 3 * cells.mean()
    if lit != "some":
        np.testing.assert_allclose(found.image, cells.mean(), rtol=0.01)


def test_the_command_says_that_errors_are_unknown(tmp_path: Path) -> None:
    """Without a share of cells within them."""
    record = record_of(own_patterns(np.ones((5, 8, 8))), np.full(64, 1e3), noise=30.0)
    write_record(record, tmp_path / "record.h5")
    done = ugv("reconstruct", tmp_path / "record.h5")
    assert "standard error of a cell: unknown\n" in done.stdout
    assert "a single sum of the cells" in done.stdout + done.stderr


@pytest.mark.parametrize("method", ["lmmse", "least-squares"])
def test_plain_patterns_that_are_all_alike_are_refused(method: str) -> None:
    patterns = own_patterns(np.ones((5, 8, 8), dtype=int), mode="plain")
    with pytest.raises(InputError, match="patterns: all alike"):
        reconstruct(record_of(patterns, np.full(64, 100.0)), method)


def test_lost_patterns_are_left_out_and_unlit_cells_named() -> None:
    from dataclasses import replace

    bits = BITS.copy()
    bits[:, 0, 0] = 1
    patterns, cells = own_patterns(bits, "plain"), 1e4 * RNG.random(60)
    record = record_of(patterns, cells)
    lost = record.flags.copy()
    lost[5] = 8
    found = reconstruct(replace(record, flags=lost), "least-squares")
    assert np.isnan(found.image[0, 0, 0])
    np.testing.assert_allclose(found.image[0].ravel()[1:], cells[1:], atol=20)
    assert any("all patterns light alike" in warning for warning in found.warnings)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("stack", [BITS, GREY], ids=["binary", "grey"])
def test_a_record_holds_them_whole(tmp_path: Path, mode: str, stack: np.ndarray) -> None:
    """In a file and in a log, bit for bit, with a digest that tells what was changed."""
    record = record_of(own_patterns(stack, mode), RNG.random(60))
    path = tmp_path / "record.h5"
    write_record(record, path)
    again = read_record(path)
    assert again.patterns == record.patterns
    assert isinstance(again.patterns, OwnPatterns)
    np.testing.assert_array_equal(again.patterns.levels, record.patterns.levels)
    with Log(tmp_path / "log.mcap") as log:
        log.record("/spi/record", record)
        log.record("/spi/record", record)
    for received in read_records(tmp_path / "log.mcap"):
        assert received.record.patterns == record.patterns
        np.testing.assert_array_equal(received.record.counts, record.counts)
    name = "packed" if stack is BITS else "grey_levels"
    with h5py.File(path, "r+") as file:
        file["patterns"][name][0, 0] ^= 1
    with pytest.raises(InputError, match=r"record\.h5: patterns: their SHA-256 is"):
        read_record(path)


def test_binary_ones_take_one_bit_a_cell(tmp_path: Path) -> None:
    record = record_of(own_patterns(RNG.integers(0, 2, (512, 64, 64))), np.ones(4096))
    write_record(record, tmp_path / "record.h5")
    assert (tmp_path / "record.h5").stat().st_size < 1.3 * 512 * 4096 / 8


def test_a_device_is_sent_bits(tmp_path: Path) -> None:
    """Tables say what they are, and grey levels that no device takes are told where they stand."""
    for mode in MODES:
        patterns = own_patterns(BITS, mode)
        assert patterns_in(table_bytes(patterns), 6, 10, mode) == patterns
    table = bytearray(table_bytes(own_patterns(BITS, "differential")))
    table[0] ^= 0x80
    with pytest.raises(InputError, match="not one of mode 'differential'"):
        patterns_in(bytes(table), 6, 10, "differential")
    with pytest.raises(InputError, match="one bit per cell, but pattern 0 has the grey level"):
        SpiSettings(own_patterns(GREY), 1e-4)
    np.save(tmp_path / "mine.npy", BITS)
    settings = tmp_path / "camera.toml"
    settings.write_text(
        'integration_time_s = "315 us"\n[patterns]\nfile = "mine.npy"\nmode = "plain"\n'
    )
    assert read_settings(settings).patterns == own_patterns(BITS, "plain")
    settings.write_text('integration_time_s = 1e-4\n[patterns]\nfile = "mine.npy"\nrows = 6\n')
    with pytest.raises(InputError, match=r"camera\.toml: patterns\.rows"):
        read_settings(settings)
