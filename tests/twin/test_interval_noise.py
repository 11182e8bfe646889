"""Intervals against other draws of the sensor's noise: what a user sees with another seed.

Each case draws one figure many times from the same light or the same echoes; its coverage is the
share of pairs of draws in which the interval of one holds the value of the other. `python -m
benchmarks noise_intervals` prints it for 200 draws.
"""

from itertools import permutations

import numpy as np
import pytest
from scipy import stats

import hardware
from benchmarks.noise_intervals import camera_draws, coverage, radar_draws
from twin.accuracy import Interval
from twin.camera import capture, noise_scatter
from twin.camera.acquisition import measure
from twin.camera.evaluation import evaluate
from twin.camera.intervals import psnr_interval, signal_interval, ssim_interval
from twin.camera.light import render
from twin.fidelity import Fidelity
from twin.radar import load_radar, radar_capture
from twin.radar.evaluation import evaluate_radar
from twin.report.measured import noise_found
from twin.report.summary import summary
from twin.scene import load_scene
from twin.system import System, load_system


def small(**changes: object) -> System:
    usual = {"emitter.rows": 16, "emitter.columns": 16, "acquisition.n_patterns": 256}
    return load_system("workable").with_({**usual, **changes})


@pytest.mark.thorough
@pytest.mark.parametrize("n_patterns", [256, 64])
@pytest.mark.parametrize("snr", [0.01, 1.0, 1000.0])
def test_scores_with_another_seed_are_within_their_intervals(snr: float, n_patterns: int) -> None:
    """PSNR and SSIM of three methods over 30 draws, at any signal, which tell a coverage of 95 % to
    some 4 %. Half the scatter would cover 67 %.
    """
    system = small(**{"acquisition.n_patterns": n_patterns})
    drawn = camera_draws(load_scene("table1"), system, snr, 30)
    covered = [coverage(of_seeds) for name, of_seeds in drawn.items() if name != "median SNR"]
    assert np.mean(covered) >= 0.9
    assert min(covered) >= 0.78
    for name, of_seeds in drawn.items():
        scatter = np.std([interval.value for interval in of_seeds], ddof=1)
        stated = np.mean([interval.noise for interval in of_seeds])
        assert stated <= 3 * scatter, name  # nor any width


@pytest.mark.thorough
def test_scores_of_many_captures_scatter_as_stated() -> None:
    """Each capture states its scatter from draws of its own, so that over 60 captures the root mean
    square is right to 2 %, and the true scatter known to 9 %. The same 16 draws of all captures
    alike had stated 0.75 of SSIM's here.
    """
    scene, system = load_scene("table1").with_({"rig.yaw_deg": 3}), small()
    system = system.with_({"readout.read_noise_e": 30000})
    light = render(scene, system, fidelity=Fidelity(samples=64), seed=np.random.SeedSequence(1))
    drawn = []
    for seed in range(60):
        taken = measure(scene, system, light, rng=np.random.default_rng(seed))
        drawn.append(ssim_interval(taken, hardware.reconstruct(taken.record, "zero-fill")))
    scatter = np.std([interval.value for interval in drawn], ddof=1)
    stated = np.sqrt(np.mean([interval.noise**2 for interval in drawn]))
    assert 0.86 <= stated / scatter <= 1.18
    assert coverage(drawn) >= 0.92


def test_draws_are_those_of_the_captures_seed() -> None:
    """Points of a sweep have one seed, and differ in their scatter by what is varied alone; to draw
    them changes nothing of the record.
    """
    scene, system = load_scene("table1"), small()
    fidelity = Fidelity(samples=16, max_depth=1)
    one, again, other = (capture(scene, system, fidelity=fidelity, seed=k) for k in (1, 1, 2))
    light = {"emitter.radiant_intensity_w_per_sr": 0.1}
    dim = capture(scene, system.with_(light), fidelity=fidelity, seed=1)
    assert one.noise_draws.seed == again.noise_draws.seed == dim.noise_draws.seed
    assert one.noise_draws.seed != other.noise_draws.seed
    drawn = [np.stack([r.counts for r in taken.noise_draws.records]) for taken in (one, again)]
    assert (drawn[0] == drawn[1]).all()
    assert (drawn[0] != one.record.counts).any(axis=(1, 2)).all()


def test_few_draws_are_widened_as_their_number_asks() -> None:
    """By Student's distribution; at most by the interval of a standard deviation of so many."""
    n = noise_scatter.N_DRAWS  # and the record itself: as many degrees of freedom
    few = stats.t.ppf(0.975, n) / stats.norm.ppf(0.975)
    assert pytest.approx(few, abs=5e-4) == noise_scatter._FEW
    most = np.sqrt(n / stats.chi2.ppf(0.025, n)) / few
    assert pytest.approx(most, abs=5e-4) == noise_scatter._MOST


def test_noise_that_is_not_gaussian_is_not_stated_by_its_spectrum_alone() -> None:
    """Images whose error is always as large: none of their levels scatters, whatever a Gaussian
    noise of this spectrum would. Errors of white Gaussian noise are stated to a few per cent.
    """
    rng, truth = np.random.default_rng(1), np.ones((16, 16))
    white = rng.normal(0, 0.1, (noise_scatter.N_DRAWS + 1, 16, 16))
    alike = white / np.linalg.norm(white, axis=(1, 2), keepdims=True)
    assert noise_scatter.ScatterOfScores(truth, truth + alike).psnr_db < 1e-9
    gaussian = noise_scatter.ScatterOfScores(truth, truth + white).psnr_db
    expected = 10 / np.log(10) * np.sqrt(2 / 256)
    assert 0.95 * expected <= gaussian <= 1.3 * expected


def test_predicted_figures_do_not_depend_on_the_noise() -> None:
    drawn = camera_draws(load_scene("table1"), small(), 1.0, 5)["median SNR"]
    assert np.ptp([interval.value for interval in drawn]) < 1e-9
    assert all(interval.noise == 0 for interval in drawn)


def test_a_method_of_ones_own_scatters_as_its_error_were_noise() -> None:
    """The plain inverse of a full set, whose error is nothing but noise, under a name that nobody
    knows: PSNR of 60 seeds is within the intervals that the image's own error tells.
    """

    def own(values, noise_variance, sensing):  # type: ignore[no-untyped-def]
        return sensing.adjoint(values) / sensing.n_cells

    scene, system = load_scene("table1"), small()
    light = render(scene, system, fidelity=Fidelity(samples=16), seed=np.random.SeedSequence(1))
    drawn = []
    for seed in range(60):
        taken = measure(scene, system, light, rng=np.random.default_rng(seed))
        drawn.append(psnr_interval(taken, hardware.reconstruct(taken.record, own)))
    assert coverage(drawn) >= 0.9
    scatter = np.std([interval.value for interval in drawn], ddof=1)
    assert np.mean([interval.noise for interval in drawn]) <= 2.5 * scatter


def test_without_noise_there_is_none() -> None:
    taken = capture(
        load_scene("table1"), small(), fidelity=Fidelity(samples=16, noise="none"), seed=1
    )
    image = hardware.reconstruct(taken.record, "zero-fill")
    assert psnr_interval(taken, image).noise == ssim_interval(taken, image).noise == 0


def test_the_signal_of_an_emitter_that_fluctuates_scatters_as_stated() -> None:
    """Mean of 512 exposures whose light scatters by 20 %: of 60 seeds, to 20 % (two deviations of
    the scatter of as many).
    """
    scene, system = load_scene("table1"), small(**{"emitter.intensity_noise": 0.2})
    light = render(scene, system, fidelity=Fidelity(samples=16), seed=np.random.SeedSequence(1))
    drawn = [
        signal_interval(measure(scene, system, light, rng=np.random.default_rng(seed)))
        for seed in range(60)
    ]
    scatter = np.std([interval.value for interval in drawn], ddof=1)
    assert drawn[0].noise == pytest.approx(scatter, rel=0.2)


def test_noise_found_in_the_record_scatters_as_stated() -> None:
    scene, system = load_scene("table1"), small()
    light = render(scene, system, fidelity=Fidelity(samples=16), seed=np.random.SeedSequence(1))
    drawn = [
        noise_found(
            evaluate(system, measure(scene, system, light, rng=np.random.default_rng(seed)))
        )
        for seed in range(40)
    ]
    assert coverage(drawn) >= 0.85
    assert drawn[0].noise <= 2 * np.std([interval.value for interval in drawn], ddof=1)


def test_detections_with_another_seed_are_within_their_intervals() -> None:
    """Level, range and rate of declared targets at 35 dB less power, over 12 seeds."""
    radar = load_radar("hybrid-79")
    power_w = radar.front_end.transmit_power_w.value * 10**-3.5
    radar = radar.with_({"front_end.transmit_power_w": power_w})
    drawn = radar_draws(load_scene("yard"), radar, 12, Fidelity(radar="targets"))
    covered = {name: coverage(of_seeds) for name, of_seeds in drawn.items()}
    assert len(covered) >= 15
    assert np.mean(list(covered.values())) >= 0.93
    assert min(covered.values()) >= 0.75


@pytest.mark.thorough
def test_snr_scatters_with_the_level_and_with_the_noise_of_the_map() -> None:
    """Of the strongest echo the level is sure to 0.005 dB, the noise of a map of 512 x 32 cells to
    0.1: over 20 seeds.
    """
    slots = {"waveform.n_slots": 32, "waveform.n_subcarriers": 512, "waveform.repeats": 20}
    spacing = {"waveform.subcarrier_spacing_hz": 2e6, "waveform.prefix_s": 5e-7}
    radar, scene = load_radar("hybrid-79").with_({**slots, **spacing}), load_scene("yard")
    drawn = []
    for seed in range(20):
        taken = radar_capture(scene, radar, seed=seed, fidelity=Fidelity(radar="targets"))
        figures = summary(scene, None, [], evaluate_radar(radar, taken))["figures"]
        [snr] = [f for f in figures if f["name"] == "SNR" and f["of"][-1] == "trihedral"]
        drawn.append(Interval(snr["value"], noise=snr["noise"]))
    assert coverage(drawn) >= 0.85
    assert drawn[0].noise <= 2 * np.std([interval.value for interval in drawn], ddof=1)


@pytest.mark.thorough
def test_targets_near_the_threshold_are_counted_with_their_scatter() -> None:
    """At a power where about half of the targets are detected, over 12 seeds; and with all of the
    power, where none is missed, the number is sure.
    """
    radar, scene = load_radar("hybrid-79"), load_scene("yard")
    full = radar.front_end.transmit_power_w.value
    weak = radar.with_({"front_end.transmit_power_w": full * 1e-5})
    fidelity = Fidelity(radar="targets")
    drawn = radar_draws(scene, weak, 12, fidelity)["targets detected"]
    assert 1 < np.mean([interval.value for interval in drawn]) < 4
    assert coverage(drawn) >= 0.9
    assert max(interval.noise for interval in drawn) < 1.5
    sure = radar_draws(scene, radar, 1, fidelity)["targets detected"]
    assert (sure[0].value, sure[0].noise) == (5, 0)


@pytest.mark.thorough
def test_sunlight_that_scatters_within_a_moving_frame_is_in_the_scores_interval() -> None:
    """A plain set does not subtract the sun, whose light errs from instant to instant: of all pairs
    of seeds at least two thirds agree (30 % where the interval held the sensor's noise alone).
    """
    system, scene = small(**{"acquisition.mode": "plain"}), load_scene("yard")
    found = [evaluate(system, capture(scene, system, seed=k)) for k in range(6)]
    levels = [one.score_intervals[0].psnr_db for one in found]
    agree = [a.holds(b.value) for a, b in permutations(levels, 2)]
    assert np.mean(agree) >= 2 / 3
    assert all(level.half_width < 6 for level in levels)
