"""Detectors with gain, and what physics forbids of the others.

Statistical bounds hold at a false-alarm rate of 1e-6 per test.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from designs import QUIET
from scipy import constants, stats

from hardware import reconstruct
from twin.budget import link_of
from twin.budget.link import maximum_distance_m, minimum_time_s, noise_e
from twin.camera import capture
from twin.detector import FrontEnd, expose, noise_budget
from twin.detector.front_end import _collect
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.optics.radiometry import collection
from twin.scene import load_scene
from twin.scene.materials import load_materials
from twin.system import load_part, load_system
from twin.system.detector import quantum_limit_a_per_w

Z = stats.norm.isf(0.5e-6)


def collected(front_end: FrontEnd, mean_e: float, n: int, seed: int = 0) -> np.ndarray:
    exposures = np.full((n, 1), mean_e)
    return expose(exposures, front_end, rng=np.random.default_rng(seed))[0][:, 0].astype(float)


# Noise of the multiplication.


@pytest.mark.parametrize("primaries", [0.5, 3.0, 10.0, 1e5])
def test_multiplied_charge_follows_the_light(primaries: float) -> None:
    """With the same draws 1 % more light gives no exposure less charge: where the gamma numbers
    were drawn by rejection, up to 34 % of them lost some.
    """
    front_end = replace(QUIET, gain=10.0, excess_noise=3.0)
    light = 10 * primaries * np.linspace(0.5, 1.5, 5000)
    less, more = (
        _collect(share * light, front_end, np.random.default_rng(1), "full")
        for share in (1.0, 1.01)
    )
    assert (more >= less).all()
    assert less.sum() == pytest.approx(light.sum(), rel=6 * np.sqrt(3 / (5000 * primaries)))


@pytest.mark.parametrize(
    ("k", "gain", "expected"),
    [
        (0.0, 1.0, 1.0),  # nothing is multiplied
        (0.0, 50.0, 1.98),  # one carrier alone: 2 - 1 / M
        (1.0, 50.0, 50.0),  # both alike: M
        (0.02, 100.0, 3.95),  # silicon, the value usually quoted as 4
    ],
)
def test_excess_noise_is_mcintyres(system, k: float, gain: float, expected: float) -> None:
    made = system(
        f"[detector]\nresponsivity_a_per_w = 0.9\ngain = {gain}\nionisation_ratio = {k}\n"
    )
    assert made.detector.excess_noise == pytest.approx(expected, abs=5e-3)


@pytest.mark.parametrize("mean_e", [3e3, 1e6])
@pytest.mark.parametrize(("gain", "excess"), [(10.0, 5.14), (4.0, 1.0), (1.0, 1.0)])
def test_shot_noise_is_gain_times_excess_noise_times_the_mean(
    mean_e: float, gain: float, excess: float
) -> None:
    """Var = M F mean at the terminals, the variance's own spread from the sample's kurtosis."""
    n = 40_000
    drawn = collected(replace(QUIET, gain=gain, excess_noise=excess), mean_e, n)
    variance = gain * excess * mean_e
    assert abs(drawn.mean() - mean_e) < Z * np.sqrt(variance / n)
    spread = np.sqrt((stats.kurtosis(drawn) + 2) / n)
    assert abs(drawn.var() / variance - 1) < Z * spread + 1e-3  # counts are rounded


def test_few_photons_have_the_distribution_of_an_avalanche() -> None:
    """One carrier ionises: each electron becomes a geometric number of mean M (a Yule process), so
    n of them a negative binomial one. 2 photons, M = 300: Kolmogorov-Smirnov against it.
    """
    n, photons, gain = 20_000, 2.0, 300.0
    found = collected(replace(QUIET, gain=gain, excess_noise=2 - 1 / gain), photons * gain, n)
    rng = np.random.default_rng(1)
    freed = rng.poisson(photons, n)
    truth = np.where(freed > 0, freed + rng.negative_binomial(np.maximum(freed, 1), 1 / gain), 0)
    assert stats.ks_2samp(found, truth).pvalue > 1e-6
    # What would be found out: Poisson numbers, or normal ones of the right variance.
    normal = rng.normal(photons * gain, np.sqrt(2 * gain * photons * gain), n)
    assert stats.ks_2samp(normal, truth).pvalue < 1e-12


@pytest.mark.parametrize("mean_e", [1e12, 1e16, 1e30])
def test_the_largest_means(mean_e: float) -> None:
    from twin.detector.front_end import _collect

    front_end = replace(QUIET, gain=10.0, excess_noise=5.0)
    drawn = _collect(np.full(20_000, mean_e), front_end, np.random.default_rng(2), "full")
    scaled = (drawn - mean_e) / np.sqrt(50 * mean_e)
    assert abs(scaled.mean()) < Z / np.sqrt(len(scaled))
    assert abs(scaled.std() - 1) < Z / np.sqrt(2 * len(scaled))


def test_the_record_of_an_avalanche_diode_holds_the_noise_of_its_budget(system) -> None:
    """Photons to counts to the scatter that the vehicle finds, against `noise_budget`."""
    made = system(
        '[detector]\npart = "ingaas-apd-200"\n[readout]\nread_noise_e = 1.0\n'
        "transimpedance_ohm = 1e7\n[sky]\nilluminance_lx = 2e3\n"
    )
    taken = capture(load_scene("table1"), made, seed=2, fidelity=Fidelity(4, 1))
    noise = taken.noise.noise_e
    shot = [value for name, value in noise.items() if name.startswith("shot")]
    total = taken.noise.signal_e + taken.noise.background_e + taken.noise.dark_e
    assert sum(np.square(shot)) == pytest.approx(10 * (0.4 * 10 + 0.6 * 1.9) * total, rel=1e-9)
    found = reconstruct(taken.record, "zero-fill").noise_electrons[0] / np.sqrt(2)
    assert not taken.void
    # 4095 pairs; the first pattern's exposures carry more light than the mean: 1 %.
    assert abs(found / taken.noise.total_noise_e - 1) < Z * np.sqrt(3 / (4 * 4095)) + 0.01


def test_gain_helps_until_its_own_noise_takes_over(system) -> None:
    """SNR of one exposure against the closed form s / sqrt(F s + (r / M)^2), s photo-electrons
    before multiplication: read noise is divided by the gain, shot noise grows with F.
    """
    power = 2e-13
    for gain in (1.0, 5.0, 20.0, 100.0):
        made = system(
            f"[detector]\nresponsivity_a_per_w = {0.95 * gain}\ngain = {gain}\n"
            "ionisation_ratio = 0.4\ndark_current_a = 0.0\n"
        )
        front_end = replace(FrontEnd.of(made), electrons_per_count=1e-3)
        budget = noise_budget(np.array([power]), 0.0, front_end)
        s = power * 0.95 * made.acquisition.integration_time_s.value / constants.e
        excess = 0.4 * gain + 0.6 * (2 - 1 / gain)
        expected = s / np.sqrt(excess * s + (front_end.amplifier_e / gain) ** 2)
        assert budget.signal_e / budget.total_noise_e == pytest.approx(expected, rel=1e-6)


def test_the_closed_form_knows_the_excess_noise() -> None:
    """`OpticalLink` of a diode and of an avalanche: time and distance give the SNR asked for."""
    part = load_part("ingaas-apd-200")
    link = link_of(load_system("paper"), part)
    assert link.shot_variance == pytest.approx(10 * (0.4 * 10 + 0.6 * 1.9))
    signal, background, read = link.signal_e_per_s(0.5, 5.0), link.background_e_per_s(0.5), 300.0
    time = minimum_time_s(signal, background, read, 3.0, link.shot_variance)
    noise = noise_e(signal, background, time, read, link.shot_variance)
    assert signal * time / noise == pytest.approx(3.0)
    far = maximum_distance_m(
        link.signal_e_per_s(0.5, 1.0), background, time, read, 3.0, link.shot_variance
    )
    assert far == pytest.approx(5.0)


# What physics forbids.


def test_one_electron_a_photon() -> None:
    """Q lambda / (h c) at 1550 nm: 1.25 A/W, quantum efficiency 1."""
    assert quantum_limit_a_per_w(1550e-9) == pytest.approx(1.2501, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "[detector]\nresponsivity_a_per_w = 9.4",
            r"one electron a photon is 1\.25 A/W; more needs",
        ),
        (
            "[detector]\nresponsivity_a_per_w = 9.4\ngain = 7.0\nexcess_noise_factor = 3.0",
            r"8\.751 A/W with a gain of 7",
        ),
        ("[detector]\ngain = 10.0", "gain needs either excess_noise_factor or ionisation_ratio"),
        ("[detector]\nexcess_noise_factor = 3.0", "belong to a gain"),
        ("[detector]\ngain = 0.5\nexcess_noise_factor = 3.0", r"gain\.value = 0.5"),
        ("[detector]\ngain = 2.0\nexcess_noise_factor = 0.9", r"excess_noise_factor\.value = 0.9"),
        ("[detector]\ngain = 2.0\nionisation_ratio = 1.1", r"ionisation_ratio\.value = 1.1"),
        ("[detector]\nline_rate_hz = 5e3", "line_rate_hz allows 5000 readouts per second"),
        ("[readout]\nadc_offset_v = 5.0", "leaves nothing of adc_full_scale_v"),
        ("[optics]\nf_number = 0.4", "expected at least 0.5"),
        ("[optics]\ntransmission = 1.01", "expected at most 1"),
        ("[filter]\ntransmission = 1.01", "expected at most 1"),
        ("[emitter]\ncontrast_ratio = 0.5", "expected above 1"),
        (
            '[weather]\npart = "clear-air"\ntemperature_k = 273.15\nwater_vapour_kg_per_m3 = 0.01',
            "air of 273.15 K holds 0.0048",
        ),
        ("[emitter]\nline_fwhm_m = 2e-6", "wider than peak_wavelength_m"),
        ("[time_of_flight]\nmodulation_hz = [1e3]\ncontrast = 0.5", "less than one period"),
        ("[time_of_flight]\nmodulation_hz = [1e6]\ncontrast = 1.5", "expected at most 1"),
        (
            "[time_of_flight]\npulse_width_s = 2e-8\npulse_rate_hz = 1e6\ngate_width_s = 2e-8\n"
            "gate_delays_s = [0.0, 9.9e-7]",
            "when the next pulse is under way",
        ),
        ("[detector]\ngain = 1.0\nexcess_noise_factor = 2.0", "gain of 1 multiplies nothing"),
        (
            "[time_of_flight]\npulse_width_s = 2e-8\npulse_rate_hz = 1.0\ngate_width_s = 2e-8\n"
            "gate_delays_s = [0.0]",
            r"pulse_rate_hz = 1: less than one pulse in acquisition\.integration_time_s",
        ),
        ("[acquisition]\ncolumns = 4", r"acquisition\.columns = 4: belongs to a line sensor"),
        ("[optics.f_number]\nvalue = 1.0\nsource = ''", r"optics\.f_number\.source = ''"),
        ("[optics.f_number]\nvalue = 1.0\nassumed = ' '", r"optics\.f_number\.assumed = ' '"),
        (
            "[readout]\ntransimpedance_ohm = 1e6\nfeedback_capacitance_f = 1e-12",
            "either transimpedance_ohm or feedback_capacitance_f",
        ),
        (
            "[readout]\nfull_well_e = 1e6",
            r"readout: full_well_e = 1e\+06: a transimpedance amplifier has no well, expected feed",
        ),
        ("[detector]\nresponsivity_csv = 'no.csv'", r"detector\.responsivity_csv = .*no\.csv'"),
        ("[emitter]\nspectrum_csv = 'no.csv'", "spectrum_csv = .* expected a file, there is none"),
    ],
)
def test_what_physics_forbids_is_refused(system, text: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected) as caught:
        system(text + "\n")
    assert "\n" not in str(caught.value)


def test_a_lens_is_focused_beyond_its_focal_length(system) -> None:
    """An object nearer than that has no image: refused where it is set, in files and objects."""
    focal_m = collection(system("")).focal_length_m
    assert collection(system(f"[optics]\nfocus_m = {1.01 * focal_m}\n")).focal_length_m == focal_m
    for use in (
        lambda: system(f"[optics]\nfocus_m = {0.99 * focal_m}\n"),
        lambda: system("").with_({"optics.focus_m": 0.99 * focal_m}),
    ):
        with pytest.raises(InputError, match=r"optics\.focus_m = .* more than the focal length"):
            use()


def test_a_gain_of_one_is_no_avalanche(system) -> None:
    assert system("[detector]\ngain = 1.0\nexcess_noise_factor = 1.0\n").detector.excess_noise == 1
    assert system("[detector]\ngain = 1.0\nionisation_ratio = 0.4\n").detector.excess_noise == 1


def test_a_stated_gain_is_accepted(system) -> None:
    made = system(
        "[detector]\nresponsivity_a_per_w = 9.4\ngain = 10.0\nexcess_noise_factor = 5.0\n"
    )
    assert FrontEnd.of(made).shot_variance == 50.0


def test_a_vendors_curve_above_the_limit_is_refused(system, tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("nm,A/W\n1000,0.7\n1540,1.3\n1560,1.1\n")
    with pytest.raises(InputError, match=r"r\.csv: .*= 1\.3: at 1540 nm one electron"):
        system('[detector]\nresponsivity_csv = { value = "r.csv", source = "vendor" }\n')
    (tmp_path / "odd.toml").write_text('base = "fga015"\n[detector]\nresponsivity_a_per_w = 2\n')
    odd = load_part(tmp_path / "odd.toml")
    with pytest.raises(InputError, match=r"part odd: detector\.responsivity_a_per_w = 2"):
        link_of(load_system("paper"), odd)


def test_a_filter_narrower_than_the_line_is_told() -> None:
    """Of the paper's 100 nm line 11 % pass 12 nm: no fault of physics, but a warning."""
    scene = load_scene("table1")
    told = capture(scene, load_system("paper"), fidelity=Fidelity(1, 1)).warnings
    assert any("11.2% of its light passes" in w for w in told)
    assert not any(
        "narrower" in w
        for w in capture(scene, load_system("workable"), fidelity=Fidelity(1, 1)).warnings
    )


def test_an_excess_noise_of_ones_own_replaces_the_parts(system) -> None:
    made = system('[detector]\npart = "ingaas-apd-200"\nexcess_noise_factor = 4.0\n')
    assert made.detector.excess_noise == 4.0


def test_a_radio_band_ascends(tmp_path: Path) -> None:
    (tmp_path / "materials.toml").write_text(
        "[stuff.optical]\nreflectance = 0.5\n[[stuff.radio.cited]]\nfrom_hz = 9e9\nto_hz = 8e9\n"
        "relative_permittivity = 2.0\nconductivity_s_per_m = 0.0\n"
    )
    with pytest.raises(InputError, match=r"from_hz = 9e\+09 is not below to_hz, 8e\+09"):
        load_materials(tmp_path / "materials.toml")


def test_arrays_of_the_closed_form_are_refused_as_fields_are(tmp_path: Path) -> None:
    """A pupil faster than f/0.5 and 9.4 A/W without a gain fail; the points beside them do not."""
    from twin.sweep import load_study
    from twin.sweep.evaluate import evaluate_chunk

    (tmp_path / "study.toml").write_text(
        'scene = "yard"\nmodel = "closed-form"\nmetrics = ["snr"]\n[grid]\n'
        '"system.optics.f_number" = [0.4, 0.5]\n'
        '"system.detector.responsivity_a_per_w" = [1.2, 9.4]\n'
    )
    chunk = evaluate_chunk(load_study(tmp_path / "study.toml"), 0, 4)
    assert set(chunk.errors) == {0, 1, 3}
    assert "optics.f_number.value = 0.4" in chunk.errors[0]
    assert "one electron a photon is 1.25 A/W" in chunk.errors[3]
    assert np.isfinite(chunk.values["snr"]).tolist() == [False, False, True, False]
