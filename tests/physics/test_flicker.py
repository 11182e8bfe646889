"""1/f noise of the amplifier: of each exposure, between exposures, and in images of many shutters.

Statistical bounds hold at 5 sigma.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from hardware.patterns import OwnPatterns, Patterns, PatternSet, RasterScan, own_patterns
from twin.budget.design import wall_rows
from twin.camera.cell_noise import cells_noise_e
from twin.camera.chain import Chain, Powers
from twin.detector import FrontEnd, expose
from twin.detector.flicker import FLICKER, ExposureTimes, drawn, flicker_of_cells
from twin.detector.inverse import inverse_image
from twin.scene import load_scene

RNG = np.random.default_rng
PHASES = "[time_of_flight]\nmodulation_hz = [10e6]\ncontrast = 0.8\nphase_steps = 4\n"
GATES = """[time_of_flight]
pulse_width_s = 10e-9
pulse_rate_hz = 1e6
gate_width_s = 20e-9
gate_delays_s = [20e-9, 40e-9, 60e-9]
readout = "{}"
"""


def toeplitz(covariance: np.ndarray) -> np.ndarray:
    places = np.arange(len(covariance))
    return covariance[np.abs(places[:, None] - places)]


@pytest.mark.parametrize("period", [1.0, 1.25, 10.0, 100.0])
@pytest.mark.parametrize("apart", [1, 2, 7])
def test_exposures_differ_by_the_spectrum_through_their_windows(period: float, apart: int) -> None:
    """Half the variance of the difference of two exposures of length 1 is the integral of
    2 sinc(f)^2 (1 - cos(2 pi f t)) / f over all f from 0 up, for S0 fc = 1; beyond 300 the integral
    is less than 2 / (2 pi^2 300^2) = 1.2e-6.
    """
    begins = np.arange(0, 300, 0.5 / (period * apart))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    f = begins[:, None] + 0.25 / (period * apart) * (1 + nodes)
    density = 2 * np.sinc(f) ** 2 * (1 - np.cos(2 * np.pi * f * period * apart)) / f
    expected = 0.25 / (period * apart) * np.sum(density @ weights)
    covariance = ExposureTimes(period).covariance(apart + 1)
    assert covariance[0] - covariance[apart] == pytest.approx(expected, rel=1e-5)


def test_draws_have_that_covariance_about_the_mean_of_their_frame() -> None:
    """40 000 frames: a variance is known to 0.7 %, a covariance to 0.5 % of it (one deviation)."""
    n, times = 12, ExposureTimes(1.3)
    about_mean = np.eye(n) - 1 / n
    expected = about_mean @ toeplitz(times.covariance(n)) @ about_mean
    found = np.cov(drawn((n, 40_000), times, RNG(1)))
    np.testing.assert_allclose(found, expected, atol=5 * 0.007 * expected.max())


def test_gates_of_the_same_pulses_have_one_noise() -> None:
    noise = drawn((12, 1), ExposureTimes(1.0, 3, at_once=True), RNG(2)).reshape(4, 3)
    assert np.ptp(noise, axis=1).max() == 0
    assert np.ptp(noise[:, 0]) > 0.5


def test_its_size_follows_from_the_exposure_and_hardly_from_the_pause(system) -> None:
    """Of pairs 1 to 100 exposures apart: S0 fc T^2 (4 ln 2 to 3 + 2 ln 100) once T is kept, in
    place of a hundred times the variance; of exposures 10 times as long 10 times S0 T fc T.
    """
    text = "[acquisition]\nintegration_time_s = {}\npattern_period_s = {}\n"
    text += "[readout]\nflicker_corner_hz = 1e5\n"

    def front_end(time_s: float, period_s: float) -> FrontEnd:
        return FrontEnd.of(system(text.format(time_s, period_s)))

    def variance(end: FrontEnd) -> float:
        budget = end.noise_budget(np.zeros(1), 0.0)
        return (budget.noise_e[FLICKER] / end.amplifier_e) ** 2

    assert variance(front_end(1e-4, 1e-4)) == pytest.approx(10 * 4 * math.log(2), rel=1e-9)
    assert variance(front_end(1e-4, 1e-2)) == pytest.approx(10 * (3 + 2 * math.log(100)), rel=1e-4)
    assert variance(front_end(1e-3, 1e-3)) == pytest.approx(100 * 4 * math.log(2), rel=1e-9)


@pytest.mark.parametrize("times", [ExposureTimes(1.2), ExposureTimes(1.2, 3)])
@pytest.mark.parametrize(
    "patterns",
    [
        *(
            PatternSet(8, 8, count, "sequency", mode)
            for mode in ("differential", "plain", "reference", "s-matrix")
            for count in (64, 23)
        ),
        *(
            own_patterns(RNG(3).integers(0, 2, (20, 4, 4)).astype(np.uint8), mode)
            for mode in ("differential", "plain", "reference")
        ),
        RasterScan(4, 8, mode="plain"),
        RasterScan(4, 8, mode="differential"),
    ],
    ids=lambda p: f"{type(p).__name__} {p.mode} {p.count}" if isinstance(p, Patterns) else "",
)
def test_variance_of_cells_is_that_of_the_matrix(patterns: Patterns, times: ExposureTimes) -> None:
    """The covariance of exposures through the inverse transform, written out."""
    inverse = inverse_image(np.eye(patterns.n_exposures), patterns)
    if isinstance(patterns, RasterScan):  # the frame's mean is an offset
        inverse = inverse - inverse.mean(axis=1, keepdims=True)
    covariance = toeplitz(times.covariance_of_patterns(patterns.n_exposures))
    expected = np.einsum("ij,jk,ik->i", inverse, covariance, inverse)
    measured = ~patterns.unmeasured_cells
    found = flicker_of_cells(patterns, times)
    np.testing.assert_allclose(found[measured], expected[measured], rtol=1e-8, atol=1e-12)
    assert isinstance(patterns, OwnPatterns) or measured.sum() > patterns.n_cells // 2


@pytest.mark.parametrize("tof", ["", PHASES, GATES.format("in turn"), GATES.format("waveform")])
@pytest.mark.parametrize("mode", ["differential", "plain"])
def test_noise_of_the_sum_of_shutters_is_as_stated(system, mode: str, tof: str) -> None:
    """2000 frames in the dark: each cell's noise to 1.6 % (one deviation), all together to 0.2 %.
    Taken as independent from shutter to shutter it had been half of it behind four phases.
    """
    small = "[emitter]\nrows = 8\ncolumns = 8\n[acquisition]\nn_patterns = 64\nmode = "
    made = system(f'{small}"{mode}"\n[readout]\nflicker_corner_hz = 1e5\nadc_bits = 24\n{tof}')
    chain = Chain.of(made, load_scene("table1").sun)
    end, n_shutters = replace(chain.front_end, offset_counts=2**23), len(chain.shutters)
    counts, _ = expose(np.zeros((made.n_exposures, 2000)), end, rng=RNG(4))
    electrons = (counts - end.offset_counts) * end.electrons_per_count
    image = inverse_image(electrons.reshape(-1, n_shutters, 2000).sum(axis=1), made.patterns)
    nothing = np.zeros((n_shutters, 1, 64))
    # No light at all.
    power = Powers(nothing, nothing[0], np.zeros(1), nothing, nothing[0], *2 * [np.zeros(1)])
    stated = cells_noise_e(chain, power, chain.mean_signal(power))[0]
    measured = ~made.patterns.unmeasured_cells
    found = image[measured].std(axis=1)
    np.testing.assert_allclose(found / stated[measured], 1, atol=0.08)
    assert np.sqrt(np.mean(found**2) / np.mean(stated[measured] ** 2)) == pytest.approx(1, abs=0.01)


def test_the_budget_of_shutters_is_that_of_their_sum(system) -> None:
    """Differences of patterns four periods apart, of sums of four exposures: by the covariance."""
    made = system(f"[readout]\nflicker_corner_hz = 1e5\n{PHASES}")
    (row,) = wall_rows(made, [5.0], [0.5])
    end = FrontEnd.of(made)
    lags = end.times.covariance(8)
    sums = np.kron(np.array([1, -1]), np.ones(4))
    expected = end.flicker_e**2 * (sums @ toeplitz(lags) @ sums) / 8
    assert row.budget.noise_e[FLICKER] ** 2 == pytest.approx(expected, rel=1e-9)
