"""Sliding-window reconstruction: static scenes lose nothing, moving ones gain."""

import numpy as np
import pytest
from moving_scenes import AnalyticScene, psnr

from hardware import PatternSet, Shift
from hardware.patterns import fwht
from hardware.reconstruction import METHODS
from hardware.reconstruction.stream import SlidingWindow

SIDE, COUNT, CHUNK = 32, 256, 32
PATTERNS = PatternSet(SIDE, SIDE, COUNT)


def texture(seed: int) -> np.ndarray:
    """A periodic picture with a 1/f^2 power spectrum, and a mean."""
    rng = np.random.default_rng(seed)
    f2 = np.fft.fftfreq(SIDE, 1 / SIDE)[:, None] ** 2 + np.fft.fftfreq(SIDE, 1 / SIDE) ** 2
    f2[0, 0] = np.inf
    return np.fft.ifft2(np.fft.fft2(rng.normal(size=(SIDE, SIDE))) / np.sqrt(f2)).real * 1e3 + 500


def shifted(picture: np.ndarray, cells: float) -> np.ndarray:
    """Moved along the columns by a fraction of a cell, in Fourier space."""
    phase = np.exp(-2j * np.pi * np.fft.fftfreq(SIDE) * cells)
    return np.fft.ifft(np.fft.fft(picture, axis=1) * phase, axis=1).real


def run(speed: float, noise: float, rounds: int = 6) -> tuple[np.ndarray, np.ndarray, float]:
    """Squared errors of the window and of the newest whole set, at every chunk after the first
    two rounds; and the motion found. ``speed`` in cells per round.
    """
    rng = np.random.default_rng(5)
    picture = texture(4)
    window = SlidingWindow(PATTERNS, noise**2)
    per_round = COUNT // CHUNK
    whole, values = np.zeros(SIDE**2), np.zeros(COUNT)
    errors = []
    for step in range(rounds * per_round):
        now = shifted(picture, speed * step / per_round).ravel()
        places = np.arange(CHUNK) * per_round + step % per_round
        new = fwht(now)[PATTERNS.indices[places]] + rng.normal(size=CHUNK) * noise
        values[places] = new
        image = window.push(places, new, step / per_round)
        if step % per_round == per_round - 1:
            whole = METHODS["lmmse"](values, noise**2, PATTERNS)[0]
        if step >= 2 * per_round:
            errors.append([np.mean((image - now) ** 2), np.mean((whole - now) ** 2)])
    by_window, by_set = np.array(errors).T
    return by_window, by_set, window.motion_per_s


def test_a_static_scene_is_the_whole_set() -> None:
    """Without motion the window after a round is the LMMSE of the set, to roundoff."""
    picture = texture(1).ravel()
    values = fwht(picture)[PATTERNS.indices]
    window = SlidingWindow(PATTERNS, 25.0)
    for start in range(0, 2 * COUNT, CHUNK):
        places = np.arange(start, start + CHUNK) % COUNT
        image = window.push(places, values[places], float(start))
    expected = METHODS["lmmse"](values, 25.0, PATTERNS)[0]
    assert window.motion_per_s == 0
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-7 * np.ptp(expected))


def test_noise_is_not_taken_for_motion() -> None:
    """Static scene, noise as large as the fine patterns' signal: no worse than whole sets.

    Motion stays 0 until noise exceeds two of its standard deviations, 2 % of all seeds.
    """
    by_window, by_set, motion = run(speed=0.0, noise=2000.0)
    assert motion == 0
    assert by_window.mean() < 1.05 * by_set.mean()


@pytest.mark.parametrize(("speed", "share"), [(1.0, 0.8), (3.0, 0.6)])
def test_a_moving_scene_is_followed(speed: float, share: float) -> None:
    """Against the newest complete set, which is up to a round old: a share of its error."""
    by_window, by_set, motion = run(speed, noise=300.0)
    assert motion > 0
    assert by_window.mean() < share * by_set.mean()


def test_a_known_motion_is_the_prediction() -> None:
    """The window told how the scene moves, against the one that lets values age: 10 cells a round,
    after two rounds.
    """
    scene = AnalyticScene.of(3, SIDE, 40.0)
    patterns = PatternSet(SIDE, SIDE, COUNT, "interleaved")
    windows = [SlidingWindow(patterns, 1e-6, motion) for motion in (Shift(0.0, 10.0), None)]
    per_round = COUNT // CHUNK
    for step in range(2 * per_round):
        now = scene.cells(SIDE, 0.0, 10 * step / per_round)
        places = np.arange(CHUNK) + CHUNK * (step % per_round)
        new = fwht(now.ravel())[patterns.indices[places]]
        images = [window.push(places, new, step / per_round) for window in windows]
    predicted, aged = (psnr(image.reshape(SIDE, SIDE), now) for image in images)
    assert predicted > aged + 4


def test_a_motion_of_zero_is_none() -> None:
    picture = texture(1).ravel()
    values = fwht(picture)[PATTERNS.indices]
    windows = [SlidingWindow(PATTERNS, 25.0, motion) for motion in (Shift(0.0, 0.0), None)]
    images = [window.push(np.arange(COUNT), values, 0.0) for window in windows]
    np.testing.assert_array_equal(images[0], images[1])


def test_first_values_already_make_an_image() -> None:
    picture = texture(2).ravel()
    values = fwht(picture)[PATTERNS.indices]
    places = np.arange(64)  # the coarsest
    image = SlidingWindow(PATTERNS, 1.0).push(places, values[places], 0.0)
    few = PatternSet(SIDE, SIDE, 64)
    expected = METHODS["lmmse"](values[:64], 1.0, few)[0]
    np.testing.assert_allclose(image, expected, atol=1e-3 * np.ptp(expected))


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("values", (np.arange(3), np.zeros(2), 0.0)),
        ("values", (np.arange(2), np.array([1.0, np.nan]), 0.0)),
        ("places", (np.array([0, COUNT]), np.zeros(2), 0.0)),
        ("time_s", (np.arange(2), np.zeros(2), -1.0)),
    ],
)
def test_bad_input_is_named(field: str, arguments: tuple) -> None:
    window = SlidingWindow(PATTERNS, 1.0)
    window.push(np.arange(2), np.ones(2), 0.0)
    with pytest.raises(ValueError, match=f"^{field}: "):
        window.push(*arguments)
