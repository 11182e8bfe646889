"""Photons to counts: means, variances and rails within their statistical bounds.

Every statistical bound holds at a false-alarm rate of 1e-6 per test.
"""

from dataclasses import replace

import numpy as np
import pytest
from designs import QUIET
from scipy import constants, stats

from hardware import PatternSet, SpiRecord, reconstruct
from hardware.records import Flag, QuaternionPose
from twin.detector import FrontEnd, expose, noise_budget
from twin.detector.gamma import gamma_quantile
from twin.detector.noise import settled_share
from twin.detector.poisson import poisson_quantile
from twin.schemas import file_schema
from twin.system import System, load_part, load_system

ALARM = 1e-6


def draws(front_end: FrontEnd, power_w: float, n: int = 20_000, seed: int = 0) -> np.ndarray:
    counts, _ = expose(np.full((n, 1), power_w), front_end, rng=np.random.default_rng(seed))
    return counts[:, 0].astype(np.float64)


def record_from(counts: np.ndarray, patterns: PatternSet, front_end: FrontEnd) -> SpiRecord:
    """A record around counts that a front end gave."""
    n = len(counts)
    return SpiRecord(
        counts=counts,
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=front_end.electrons_per_count,
        offset_counts=front_end.offset_counts,
        adc_bits=front_end.adc_bits,
        device="test",
        pose=QuaternionPose(),
    )


def assert_mean_and_variance(values: np.ndarray, mean: float, variance: float) -> None:
    n = len(values)
    z = (values.mean() - mean) / np.sqrt(variance / n)
    assert abs(z) < stats.norm.isf(ALARM / 2)
    # The variance of a sample variance needs the fourth moment: for Poisson 3 v^2 + v.
    spread = np.sqrt((2 * variance**2 + variance) / n)
    assert abs(values.var(ddof=1) - variance) / spread < stats.norm.isf(ALARM / 2)


@pytest.mark.parametrize("mean", [0.3, 50.0, 1e6])
def test_shot_noise_is_poisson(mean: float) -> None:
    assert_mean_and_variance(draws(QUIET, mean), mean, mean)


@pytest.mark.quick(1)
@pytest.mark.parametrize("mean", [0.0, 1e-9, 0.1, 0.7, 3.0, 99.5, 999.0, 1001.0, 1e5, 1e8])
def test_poisson_numbers_are_the_quantiles_of_their_draws(mean: float) -> None:
    """Against SciPy's, of the expansion but for one in 1e4; a little more light gives no less."""
    normal = np.random.default_rng(0).standard_normal(20_000)
    found = poisson_quantile(normal, np.full(normal.shape, mean))
    off = np.abs(found - stats.poisson.ppf(stats.norm.cdf(normal), mean))
    assert off.max() <= (1 if mean > 1000 else 0)
    assert np.count_nonzero(off) <= 3
    assert (poisson_quantile(normal, 1.001 * np.full(normal.shape, mean)) >= found).all()


@pytest.mark.parametrize("shape", [0.0, 1e-3, 0.3, 1.0, 7.7, 999.0, 9999.0, 1e4, 1e5])
def test_gamma_numbers_are_the_quantiles_of_their_draws(shape: float) -> None:
    """Against SciPy's, up to 6 standard deviations either way; a larger shape gives no less."""
    normal = np.linspace(-6, 6, 241)
    found = gamma_quantile(normal, np.full(normal.shape, shape))
    if shape == 0:
        assert (found == 0).all()
        return
    below, above = (stats.norm.cdf(sign * normal) for sign in (1, -1))
    due = np.where(normal < 0, stats.gamma.ppf(below, shape), stats.gamma.isf(above, shape))
    assert np.abs(found - due).max() < 1e-7 * np.sqrt(shape)
    assert (gamma_quantile(normal, 1.001 * np.full(normal.shape, shape)) >= found).all()


@pytest.mark.parametrize("mean", [0.3, 50.0, 1e6, 1e13])
def test_shot_noise_follows_the_light(mean: float) -> None:
    """With the same draws 0.3 % more light gives no exposure less, and all together 0.3 % more, to
    five standard deviations of so many electrons.
    """
    from twin.detector.front_end import _shot

    light = mean * np.linspace(0.5, 1.5, 5000)
    less, more = (_shot(share * light, np.random.default_rng(1)) for share in (1.0, 1.003))
    assert (more >= less).all()
    scatter = 5 * np.sqrt(0.003 / less.sum())
    assert more.sum() / less.sum() == pytest.approx(1.003, abs=scatter)


@pytest.mark.parametrize("mean", [0.9e12, 1.1e12, 1e15, 1e19, 1e30])
def test_shot_noise_at_the_largest_means(mean: float) -> None:
    """Where `Generator.poisson` spreads wrongly (1e14) or raises (1e19)."""
    from twin.detector.front_end import _shot

    drawn = _shot(np.full(20_000, mean), np.random.default_rng(1))
    scaled = (drawn - mean) / np.sqrt(mean)
    assert abs(scaled.mean()) * np.sqrt(len(scaled)) < stats.norm.isf(ALARM / 2)
    assert abs(scaled.std() - 1) * np.sqrt(2 * len(scaled)) < stats.norm.isf(ALARM / 2)


def test_photo_current_is_responsivity_times_power() -> None:
    """1 nW x 0.95 A/W x 315 us / e, and 0.5 nA of dark current, in electrons."""
    front_end = FrontEnd.of(load_system("paper"))
    assert front_end.electrons_per_watt * 1e-9 == pytest.approx(
        0.95e-9 * 315e-6 / constants.e, rel=1e-12
    )
    assert front_end.dark_e == pytest.approx(9.83e5, rel=1e-3)


def test_johnson_noise_is_that_of_the_resistor() -> None:
    """Current noise density sqrt(4 k T / R) times the square root of the noise bandwidth 1 / 2T."""
    system = load_system("paper")
    t = system.acquisition.integration_time_s.value
    density = np.sqrt(4 * constants.k * 300.0 / 100e6)
    expected = density * np.sqrt(1 / (2 * t)) * t / constants.e
    assert FrontEnd.of(system).johnson_e == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", ["paper", "workable"])
def test_counts_have_the_mean_and_variance_of_the_budget(name: str) -> None:
    """The whole chain at once: electrons back from counts, against `noise_budget`."""
    front_end = FrontEnd.of(load_system(name))
    power = 2e-9
    counts = draws(front_end, power, n=40_000)
    electrons = (counts - front_end.offset_counts) * front_end.electrons_per_count
    budget = noise_budget(np.array([power]), 0.0, front_end)
    assert_mean_and_variance(electrons, budget.signal_e + budget.dark_e, budget.total_noise_e**2)


def test_background_and_signal_add() -> None:
    front_end = FrontEnd.of(load_system("paper"))
    both = noise_budget(np.array([1e-9]), 3e-9, front_end)
    one = noise_budget(np.array([4e-9]), 0.0, front_end)
    assert both.total_noise_e == pytest.approx(one.total_noise_e, rel=1e-12)


def test_quantisation_noise_is_a_twelfth_of_a_step() -> None:
    """Read noise of many steps dithers the converter; what it adds is step^2 / 12."""
    front_end = replace(QUIET, electrons_per_count=100.0, offset_counts=5e4, read_e=200.0)
    electrons = (draws(front_end, 0.0, n=200_000) - 5e4) * 100.0
    expected = 200.0**2 + 100.0**2 / 12
    spread = expected * np.sqrt(2 / 200_000)
    assert abs(electrons.var() - expected) < stats.norm.isf(ALARM / 2) * spread


def test_the_full_scale_is_one_step_above_the_highest_code() -> None:
    """A step is the full scale over 2^bits, as the schema says: 2^bits - 1 steps give the top."""
    system = load_system("workable")
    readout, front_end = system.readout, FrontEnd.of(system)
    step_v = readout.adc_full_scale_v.value / 2**readout.adc_bits.value
    volts_per_e = constants.e * readout.transimpedance_ohm.value
    volts_per_e /= system.acquisition.integration_time_s.value
    assert front_end.electrons_per_count * volts_per_e == pytest.approx(step_v, rel=1e-12)
    described = file_schema("system")["$defs"]["Readout"]["properties"]["adc_full_scale_v"]
    assert "steps of adc_full_scale_v / 2^adc_bits" in described["description"]


def test_no_light_gives_the_offset() -> None:
    front_end = replace(QUIET, offset_counts=320.0, adc_bits=16)
    assert set(draws(front_end, 0.0, n=10)) == {320.0}


@pytest.mark.parametrize("power", [1e6, 1e20, 1e300])
def test_too_much_light_gives_the_top_code_and_the_flag(power: float) -> None:
    counts, flags = expose(
        np.full((3, 1), power), replace(QUIET, adc_bits=16), rng=np.random.default_rng(0)
    )
    assert (counts == 65535).all()
    assert (flags == Flag.SATURATED).all()


def test_noise_below_the_lower_rail_is_flagged_too() -> None:
    front_end = replace(QUIET, read_e=50.0, adc_bits=16)
    counts, flags = expose(np.zeros((100, 1)), front_end, rng=np.random.default_rng(0))
    assert counts.min() == 0
    assert flags.any()


def test_a_capacitive_amplifier_gives_q_over_c_and_fills_its_well() -> None:
    """Gain from the photon-transfer curve: variance over mean of the counts, in the shot-noise
    limit, is one count's share of an electron. Beyond the well the count stays and is flagged.
    """
    part = load_part("ctia-low-gain")
    content = load_system("paper").model_dump()
    content["readout"] = part.readout.model_dump()
    content["readout"]["read_noise_e"] = 0.0
    front_end = FrontEnd.of(System.model_validate(content))
    per_count = 2.5 / 2**16 / (constants.e / 10e-12)
    assert front_end.electrons_per_count == pytest.approx(per_count, rel=1e-12)
    assert front_end.johnson_e == 0
    power = 5e7 / front_end.electrons_per_watt
    counts = draws(front_end, power, n=100_000) - front_end.offset_counts
    gain = (counts.var() - 1 / 12) / counts.mean()
    assert gain * per_count == pytest.approx(1.0, abs=5 * np.sqrt(2 / 100_000))
    full, flags = expose(np.full((10, 1), 100 * power), front_end, rng=np.random.default_rng(0))
    well = part.readout.full_well_e.value / per_count + front_end.offset_counts
    assert (full == round(well)).all()
    assert (flags == Flag.SATURATED).all()


def test_same_seed_same_counts() -> None:
    front_end = FrontEnd.of(load_system("paper"))
    a, b, other = (draws(front_end, 1e-9, n=100, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert (a != other).any()


def test_pixel_noise_is_what_reconstruction_shows() -> None:
    """Noise of zero-fill pixels of a dark scene against `NoiseBudget.pixel_noise_e`."""
    front_end = FrontEnd.of(load_system("paper"))
    patterns = PatternSet(64, 64, 4096)
    budget = noise_budget(np.zeros(1), 2e-9, front_end)
    counts, _ = expose(
        np.full((patterns.n_exposures, 1), 2e-9), front_end, rng=np.random.default_rng(2)
    )
    image = reconstruct(record_from(counts, patterns, front_end), "zero-fill").image
    expected = budget.pixel_noise_e(patterns)
    spread = np.sqrt(1 / (2 * 4095))
    assert abs(image.std() / expected - 1) < stats.norm.isf(ALARM / 2) * spread


@pytest.mark.parametrize("steps", [0.0, 0.1, 0.2, 0.35, 0.6])
def test_how_much_of_rounding_follows_from_the_place_between_two_steps(steps: float) -> None:
    """Brute force: the mean error of rounding at 1000 places, from the normal distribution's share
    of each step, over 1/12.
    """
    place = (np.arange(1000) + 0.5) / 1000 - 0.5
    level = np.arange(-8, 9)
    if steps:
        ends = stats.norm.cdf((level[:, None] + np.array([[-0.5], [0.5]])[:, None] - place) / steps)
        mean = level @ (ends[1] - ends[0])
    else:
        mean = np.round(place)
    assert settled_share(steps * np.sqrt(12)) == pytest.approx(
        12 * np.mean((mean - place) ** 2), rel=1e-3 if steps else 0.1, abs=1e-12
    )
