"""Depth from phasors: closed forms, error bounds and unwrapping, against simulated light."""

import numpy as np
import pytest
from scipy import stats

from hardware.reconstruction.depth import common_range_m, depth
from hardware.waveform import C_M_PER_S


def phasors(distance_m: np.ndarray, amplitude: float, frequencies: list[float]) -> np.ndarray:
    """Straight from the definition: a exp(-j 2 pi f tau), tau = 2 d / c."""
    tau = 2 * np.asarray(distance_m) / C_M_PER_S
    return amplitude * np.exp(-2j * np.pi * np.asarray(frequencies)[:, None] * tau)


@pytest.mark.parametrize("frequencies", [[10e6], [10e6, 11e6], [20e6, 25e6, 30e6]])
def test_noiseless_distances_come_back(frequencies: list[float]) -> None:
    """Up to where everything repeats; one frequency 14.99 m, 10 and 11 MHz 149.9 m."""
    longest = common_range_m(frequencies)
    distance = np.linspace(0.001, 0.999, 500) * longest
    found = depth(phasors(distance, 3.0, frequencies), frequencies, 1e-6)
    np.testing.assert_allclose(found.distance_m, distance, rtol=1e-9)
    np.testing.assert_allclose(found.amplitude, 3.0)
    assert (found.confidence > 0.999).all()


def test_common_ranges() -> None:
    assert common_range_m([10e6]) == pytest.approx(C_M_PER_S / 20e6)
    assert common_range_m([10e6, 11e6]) == pytest.approx(C_M_PER_S / 2e6)
    assert common_range_m([20e6, 30e6]) == pytest.approx(C_M_PER_S / 20e6)


def test_standard_error_is_the_error_made() -> None:
    """One frequency at 20 dB: sigma_d = c/(4 pi f) sigma/a; chi-square bounds at 1e-6."""
    rng = np.random.default_rng(1)
    n, f, a, sigma = 20_000, 10e6, 10.0, 0.1
    distance = np.full(n, 7.0)
    noise = rng.normal(size=(2, 1, n)) * sigma
    found = depth(phasors(distance, a, [f]) + noise[0] + 1j * noise[1], [f], sigma)
    expected = C_M_PER_S / (4 * np.pi * f) * sigma / a
    np.testing.assert_allclose(found.standard_error_m, expected, rtol=0.06)
    low, high = stats.chi2.ppf([5e-7, 1 - 5e-7], n) / n
    # The bound holds to first order in sigma / a; the next is (sigma / a)^2 = 1e-4.
    assert low < np.mean((found.distance_m - 7.0) ** 2) / expected**2 < high * 1.001


@pytest.mark.parametrize("ratio", [0.1, 0.2, 0.3])
def test_confidence_is_the_share_of_right_unwrappings(ratio: float) -> None:
    """Noise near the amplitude's tenth makes some cells unwrap wrongly: as many as it says.

    Binomial bounds at 1e-6, and 0.03 for the noise not being Gaussian in phase.
    """
    rng = np.random.default_rng(2)
    n, frequencies = 20_000, [10e6, 13e6]
    distance = rng.uniform(20, 130, n)
    noise = rng.normal(size=(2, 2, n)) * ratio
    z = phasors(distance, 1.0, frequencies) + noise[0] + 1j * noise[1]
    found = depth(z, frequencies, ratio)
    right = np.abs(found.distance_m - distance) < 5 * found.standard_error_m
    share, said = right.mean(), found.confidence.mean()
    assert abs(share - said) < 5 * np.sqrt(0.25 / n) + 0.03
    if ratio > 0.1:
        assert share < 0.99  # the case is a hard one, or the test would say nothing


@pytest.mark.parametrize(
    "frequencies", [[20e6], [20e6, 25e6], [10e6, 80e6], [20e6, 24e6, 29e6]], ids=len
)
@pytest.mark.parametrize("ratio", [0.5, 1.0])
def test_errors_hold_where_phases_are_not_normal(frequencies: list[float], ratio: float) -> None:
    """Noise as large as the amplitude, and half of it: of those on the right period 91 to 98 %
    lie within 1.96 errors, and the mean confidence is 0.9 to 1.3 times their share. With errors of
    normal phases it is 81 to 91 %, and 1.7 times with three frequencies.
    """
    rng = np.random.default_rng(8)
    n, longest = 10_000, common_range_m(frequencies)
    distance = rng.uniform(0, longest, n)
    noise = rng.normal(size=(2, len(frequencies), n)) * ratio
    z = phasors(distance, 1.0, frequencies) + noise[0] + 1j * noise[1]
    found = depth(z, frequencies, ratio)
    off = np.abs(found.distance_m - distance)
    right = off < C_M_PER_S / 4 / max(frequencies)
    assert 0.91 < np.mean(off[right] < 1.96 * found.standard_error_m[right]) < 0.98
    assert 0.9 < found.confidence.mean() / right.mean() < 1.3


@pytest.mark.parametrize("frequencies", [[20e6], [20e6, 30e6]])
def test_near_the_ends_of_the_period_confidence_says_which_end(frequencies: list[float]) -> None:
    """A tenth of noise, distances all over the period (9 sigma are 10 % of it): all are told from 0
    to its end, farther than 5 sigma from either end rightly and surely; nearer as many are right
    as confidence says, three quarters of those within 1 sigma (binomial bounds at five deviations).
    """
    rng = np.random.default_rng(7)
    n, ratio, longest = 40_000, 0.1, common_range_m(frequencies)
    distance = rng.uniform(0, longest, n)
    noise = rng.normal(size=(2, len(frequencies), n)) * ratio
    z = phasors(distance, 1.0, frequencies) + noise[0] + 1j * noise[1]
    found = depth(z, frequencies, ratio)
    assert ((found.distance_m >= 0) & (found.distance_m < longest)).all()
    right = np.abs(found.distance_m - distance) < longest / 2
    to_end = np.minimum(found.distance_m, longest - found.distance_m) / found.standard_error_m
    assert right[to_end > 5].all()
    assert found.confidence[to_end > 5].mean() > 0.999
    for low, high in ((0, 1), (1, 2)):
        near = (low <= to_end) & (to_end < high)
        share, said = right[near].mean(), found.confidence[near].mean()
        assert abs(share - said) < 5 * np.sqrt(said * (1 - said) / near.sum())
        assert said < 0.97


def test_a_phase_that_no_distance_up_to_the_longest_gives_is_not_trusted() -> None:
    """20 MHz, asked up to 5 m of 7.5: 6 m lies 118 standard errors beyond, 3 m is sure."""
    found = depth(phasors(np.array([3.0, 6.0]), 1.0, [20e6]), [20e6], 0.007, longest_m=5.0)
    assert found.confidence[0] > 0.999
    assert found.confidence[1] < 1e-6


def test_frequencies_without_noise_that_contradict_each_other_are_not_trusted() -> None:
    """No distance fits 0.1 and 2.4 rad at 10 and 11 MHz: misfits of 1e24, and no confidence."""
    found = depth(np.exp(-1j * np.array([[0.1], [2.4]])), [10e6, 11e6], 0.0)
    assert np.isfinite(found.distance_m).all()
    assert found.confidence[0] < 1e-6


def test_a_shorter_range_rules_wrong_wraps_out() -> None:
    rng = np.random.default_rng(3)
    n, frequencies, ratio = 5000, [10e6, 11e6], 0.2
    distance = rng.uniform(1, 20, n)
    noise = rng.normal(size=(2, 2, n)) * ratio
    z = phasors(distance, 1.0, frequencies) + noise[0] + 1j * noise[1]
    wide, narrow = depth(z, frequencies, ratio), depth(z, frequencies, ratio, longest_m=25.0)
    wrong = [np.mean(np.abs(d.distance_m - distance) > 3) for d in (wide, narrow)]
    assert wrong[1] < 0.6 * wrong[0]


def test_dark_cells_are_no_distance() -> None:
    found = depth(np.zeros((2, 3), complex), [10e6, 11e6], 1.0)
    assert np.isnan(found.distance_m).all()
    assert not found.confidence.any()
    assert not found.amplitude.any()


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("phasors", (np.ones((2, 3), complex), [1e6], 0.1)),
        ("phasors", (np.full((1, 3), np.nan, complex), [1e6], 0.1)),
        ("modulation_hz", (np.ones((1, 3), complex), [-1e6], 0.1)),
        ("modulation_hz", (np.ones((1, 3), complex), [np.nan], 0.1)),
    ],
)
def test_bad_input_is_named(field: str, arguments: tuple) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        depth(*arguments)


def test_a_range_beyond_the_common_one_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^longest_m: 200\.0 is"):
        depth(np.ones((2, 3), complex), [10e6, 11e6], 0.1, longest_m=200.0)


def test_unequal_noise_is_weighed() -> None:
    """One frequency ten times noisier: the errors are still those said, chi-square at 1e-6."""
    rng = np.random.default_rng(4)
    n, frequencies, sigma = 20_000, [10e6, 12e6], np.array([0.003, 0.03])
    noise = rng.normal(size=(2, 2, n)) * sigma[:, None]
    z = phasors(np.full(n, 21.0), 1.0, frequencies) + noise[0] + 1j * noise[1]
    found = depth(z, frequencies, sigma)
    low, high = stats.chi2.ppf([5e-7, 1 - 5e-7], n) / n
    ratio = np.mean((found.distance_m - 21.0) ** 2 / found.standard_error_m**2)
    assert low < ratio < high * 1.005  # sigma squared, the next order, is 1e-3


@pytest.mark.parametrize("places", [(10.1, 3.0), (5.0, 12.0), (11.0, 14.0)])
def test_frequencies_that_contradict_each_other_are_not_trusted(
    places: tuple[float, float],
) -> None:
    """Two equal echoes in a cell, noise a thousandth of them: no distance fits both frequencies, so
    either an echo lies within three claimed errors or the claim is not confident.
    """
    rng = np.random.default_rng(5)
    frequencies = [10e6, 11e6]
    both = sum(phasors(np.full(200, d), 0.5, frequencies) for d in places)
    noise = rng.normal(size=(2, 2, 200)) * 1e-3
    found = depth(both + noise[0] + 1j * noise[1], frequencies, 1e-3)
    off = np.min([np.abs(found.distance_m - d) for d in places], axis=0)
    assert ((off < 3 * found.standard_error_m) | (found.confidence < 0.6)).all()


def test_chance_alone_is_no_contradiction() -> None:
    """Of 1e5 cells of one surface 0.1 % claim more than the Cramer-Rao bound (three frequencies,
    noise a fiftieth; binomial bounds at five standard deviations, wider by half as noise of a
    phasor is not quite normal in phase).
    """
    rng = np.random.default_rng(6)
    n, frequencies = 100_000, [10e6, 12e6, 15e6]
    noise = rng.normal(size=(2, 3, n)) * 0.02
    z = phasors(np.full(n, 7.0), 1.0, frequencies) + noise[0] + 1j * noise[1]
    claimed = depth(z, frequencies, 0.02, tolerance=0.0).standard_error_m
    share = np.mean(claimed > 1.5 * np.median(claimed))
    assert abs(share - 1e-3) < 5 * np.sqrt(1e-3 / n) + 5e-4


def test_what_a_device_may_differ_by_is_no_contradiction() -> None:
    """Contrasts 0.5 % apart and noise of 1e-5: still one surface."""
    frequencies = [10e6, 11e6]
    z = phasors(np.linspace(1, 100, 50), 1.0, frequencies) * [[1.0], [1.005]]
    assert (depth(z, frequencies, 1e-5).confidence > 0.999).all()
