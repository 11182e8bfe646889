"""What the emitter shows and what the filter passes, through to the counts.

Statistical bounds hold at 5 sigma, a false-alarm rate of 6e-7 per test.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from designs import QUIET
from scipy import integrate
from scipy.signal import lfilter

from hardware import reconstruct
from hardware.patterns import PatternSet
from tests.still import still_yard
from twin.camera import capture
from twin.camera import chain as chain_module
from twin.camera.chain import Chain
from twin.camera.filtered import share_of_cells, sun_of_parts
from twin.camera.illumination import (
    dark_share,
    frame_signal,
    ideal_signal,
    mean_signal,
    residual_share,
)
from twin.camera.rendered import DetectorLight, RenderedLight
from twin.camera.truth import Truth
from twin.detector import FrontEnd, expose, noise_budget
from twin.detector.flicker import FLICKER, by_cell, in_image
from twin.detector.inverse import inverse_image
from twin.fidelity import Fidelity
from twin.optics.devices import Device
from twin.optics.passband import passband
from twin.optics.solar_irradiance import sun_in_band
from twin.optics.spectra import in_band_fraction
from twin.scene import load_scene
from twin.system import Sky, System, load_system
from twin.toml import Sourced

SKY = Sky(illuminance_lx=Sourced(value=1e5, source="test"))
RNG = np.random.default_rng


def lit_cells(system: System, seed: int = 0) -> np.ndarray:
    return RNG(seed).uniform(0, 1e-9, (1, 1, system.patterns.n_cells))


def test_dark_cells_leak_the_same_light_into_every_pattern(system) -> None:
    """Contrast 100: pattern = lit + (1/100) dark; the difference of a pair loses 1 %."""
    leaky = system("[emitter]\ncontrast_ratio = 100.0\n")
    cells = lit_cells(leaky)
    ideal = frame_signal(system(""), cells, rng=RNG(0))[:, 0, 0]
    real = frame_signal(leaky, cells, rng=RNG(0))[:, 0, 0]
    total = cells.sum()
    np.testing.assert_allclose(real, ideal + (total - ideal) / 100, rtol=1e-12)
    assert real[1] == pytest.approx(total / 100)  # the complement of all lit is never dark
    assert dark_share(leaky) == pytest.approx(0.01)


def test_images_of_a_leaky_emitter_are_what_the_capture_promises(system) -> None:
    leaky = system("[emitter]\ncontrast_ratio = 10.0\nradiant_intensity_w_per_sr = 100.0\n")
    taken = capture(load_scene("table1"), leaky, fidelity=Fidelity(4, 1))
    picture = reconstruct(taken.record, "zero-fill").picture
    lit = taken.cells_e > 0.5 * taken.cells_e.max()
    assert picture[lit].sum() / taken.cells_e[lit].sum() == pytest.approx(1, rel=0.01)


def test_the_pattern_before_glows_into_the_next_exposure(system) -> None:
    """Share left over: the integral of exp(-t / tau) over the exposure, by quadrature; of all
    patterns before, each by exp(-P / tau) less than the one after it, P = 100 us.
    """
    slow = system("[emitter]\nswitching_time_s = 30e-6\n")
    tau = 30e-6 / math.log(9)
    dead, time = 20e-6, 80e-6
    expected, _ = integrate.quad(lambda t: math.exp(-t / tau) / time, dead, dead + time)
    assert residual_share(slow) == pytest.approx(expected, rel=1e-9)
    assert math.exp(-30e-6 / tau) == pytest.approx(1 / 9)  # from 90 to 10 %
    cells = lit_cells(slow)
    ideal = frame_signal(system(""), cells, rng=RNG(0))[:, 0, 0]
    real = frame_signal(slow, cells, rng=RNG(0))[:, 0, 0]
    kept = math.exp(-100e-6 / tau)
    before = np.zeros_like(ideal)
    for i in range(1, len(ideal)):
        before[i] = (1 - kept) * ideal[i - 1] + kept * before[i - 1]
    np.testing.assert_allclose(real, ideal + expected * (before - ideal), rtol=1e-12)
    assert residual_share(system("[emitter]\nswitching_time_s = 0.0\n")) == 0


@pytest.mark.parametrize("tof", [False, True])
@pytest.mark.parametrize("slow", ["emitter", "amplifier"])
def test_lag_is_that_of_one_decay_through_all_exposures(system, slow: str, tof: bool) -> None:
    """Light that decays with tau = 0.6 periods in steps of 0.25 us, and its means over exposures;
    each phase sees its own share of the same decay. Such steps are right to 0.01 of the light's
    spread; with the exposure before alone it is off by 0.03 (amplifier, no phases) to 0.7.
    """
    tau = 60e-6
    text = f"[emitter]\nswitching_time_s = {tau * math.log(9)}\n"
    if slow == "amplifier":
        text = f"[readout]\nbandwidth_hz = {1 / (2 * math.pi * tau)}\n"
    phases = "[time_of_flight]\nmodulation_hz = [10e6]\ncontrast = 0.8\nphase_steps = 3\n"
    made = system(text + phases * tof)
    chain = Chain.of(made, load_scene("table1").sun)
    n_shutters = len(chain.shutters)
    cells = RNG(1).uniform(0, 1e-9, (n_shutters, 1, made.patterns.n_cells))
    n = 40 * n_shutters
    signal_w = mean_signal(made, cells)
    found = chain.amplifier_output(signal_w, np.zeros(1), np.zeros(1))[:n]
    ideal = ideal_signal(made, cells)[:40, :, 0]
    step, period, time = 0.25e-6, 100e-6, made.acquisition.integration_time_s.value
    # What the emitter sends is seen through one phase after the other.
    seen = ideal.T if slow == "emitter" else ideal.reshape(1, -1)
    levels = np.repeat(seen, round(period / step) * n // seen.shape[1], axis=1)
    share = math.exp(-step / tau)
    decayed = lfilter([1 - share], [1, -share], levels, axis=1).reshape(len(seen), n, -1)
    due = decayed[:, :, -round(time / step) :].mean(axis=2)
    places = np.arange(n)
    due = due[places % n_shutters if slow == "emitter" else 0, places]
    np.testing.assert_allclose(found[:, 0], due, atol=0.015 * ideal.std())


@pytest.mark.parametrize("phases", [0, 3])
@pytest.mark.parametrize("taus", [(23e-6, 20e-6), (60e-6, 60e-6), (20e-6, 60e-6)])
def test_light_that_fades_within_exposures_goes_through_a_slow_amplifier(
    system, taus: tuple[float, float], phases: int
) -> None:
    """Both decays in a row in steps of 0.1 us, which are right to 0.003 of the largest lag, with
    the phases of each pattern in turn. Of means over exposures alone it had been 0.02 to 0.08 off.
    """
    emitter_s, amplifier_s = taus
    text = f"[emitter]\nswitching_time_s = {emitter_s * math.log(9)}\n"
    text += f"[readout]\nbandwidth_hz = {1 / (2 * math.pi * amplifier_s)}\n"
    if phases:
        text += "[time_of_flight]\nmodulation_hz = [10e6]\ncontrast = 0.8\n"
        text += f"phase_steps = {phases}\n"
    made = system(text)
    chain, n, step, period = Chain.of(made, load_scene("table1").sun), 40, 1e-7, 100e-6
    cells = RNG(1).uniform(0, 1e-9, (len(chain.shutters), 1, made.patterns.n_cells))
    dark = np.zeros(1)
    found = chain.amplifier_output(mean_signal(made, cells), dark, dark)[:, 0]
    ideal = ideal_signal(made, cells)[:n, :, 0]
    each, n_shutters = round(period / step), ideal.shape[1]
    fade, follow = (math.exp(-step / tau) for tau in taus)
    light = lfilter([1 - fade], [1, -fade], ideal.repeat(n_shutters * each, axis=0), axis=0)
    light = light.reshape(n, n_shutters, each, n_shutters)
    seen = np.stack([light[:, k, :, k] for k in range(n_shutters)], axis=1).ravel()
    output = lfilter([1 - follow], [1, -follow], seen).reshape(-1, each)
    due = output[:, -round(made.acquisition.integration_time_s.value / step) :].mean(axis=1)
    lag = np.abs(due - ideal.ravel()).max()
    np.testing.assert_allclose(found[: len(due)], due, atol=0.005 * lag)


def test_slow_switching_alone_explains_the_ghost_in_the_image(system) -> None:
    """Without noise: natural order shows each pattern after its neighbour's complement; an image
    taken with slow LEDs differs from a fast one's by the residual share, no more.
    """
    slow = system("[emitter]\nswitching_time_s = 60e-6\n")
    cells = lit_cells(slow)
    ideal = frame_signal(system(""), cells, rng=RNG(0))[:, 0, 0]
    real = frame_signal(slow, cells, rng=RNG(0))[:, 0, 0]
    share = residual_share(slow)
    assert 0.1 < share < 0.5
    assert np.abs(real - ideal).max() <= share * np.ptp(np.append(ideal, 0)) * (1 + 1e-12)


def test_the_emitter_fluctuates_as_a_whole(system) -> None:
    noisy = system("[emitter]\nintensity_noise = 0.01\n")
    cells = lit_cells(noisy)
    ideal = frame_signal(system(""), cells, rng=RNG(0))[:, 0, 0]
    real = frame_signal(noisy, cells, rng=RNG(1))[:, 0, 0]
    lit = ideal > 0.1 * ideal.max()
    relative = real[lit] / ideal[lit] - 1
    n = lit.sum()
    assert relative.std() == pytest.approx(0.01, rel=5 / math.sqrt(2 * n))
    assert abs(relative.mean()) < 5 * 0.01 / math.sqrt(n)


def test_fluctuation_is_in_the_budget(system) -> None:
    """Noise found in the record against the budget's total, which the fluctuation dominates."""
    noisy = system("[emitter]\nintensity_noise = 0.02\n")
    taken = capture(still_yard(), noisy, fidelity=Fidelity(4, 1))
    worst = max(taken.noise.noise_e, key=taken.noise.noise_e.__getitem__)
    assert worst == "fluctuation of the emitter"
    found = float(reconstruct(taken.record).noise_electrons[0]) / math.sqrt(2)
    assert found == pytest.approx(taken.noise.total_noise_e, rel=0.1)


def flickering(corner_cycles: float) -> FrontEnd:
    return replace(
        QUIET,
        read_e=100.0,
        electrons_per_count=0.01,
        offset_counts=2**30,
        flicker_cycles=corner_cycles,
    )


def test_flicker_has_the_spectrum_it_says() -> None:
    """White density below the corner times corner over frequency: periodogram in octaves, each
    within 5 sigma of its mean (a bin is exponential).
    """
    n, corner = 2**18, 0.02
    front_end = flickering(corner)
    counts, _ = expose(np.zeros((n, 1)), front_end, rng=RNG(3))
    x = (counts[:, 0] - front_end.offset_counts) * front_end.electrons_per_count
    density = np.abs(np.fft.rfft(x)) ** 2 / n
    frequency = np.fft.rfftfreq(n)
    for octave in range(2, 14):
        band = (frequency >= 2.0**-octave / 2) & (frequency < 2.0**-octave)
        expected = np.mean(1e4 * (1 + corner / frequency[band]))
        assert density[band].mean() == pytest.approx(expected, rel=5 / math.sqrt(band.sum()))


def test_what_a_pair_keeps_of_flicker_is_in_the_budget() -> None:
    """Variance of the difference of two exposures in turn, less its white part."""
    n, corner = 2**20, 0.5
    front_end = flickering(corner)
    counts, _ = expose(np.zeros((n, 1)), front_end, rng=RNG(4))
    pairs = np.diff(counts[:, 0].reshape(-1, 2)).ravel() * front_end.electrons_per_count
    budget = noise_budget(np.zeros(1), 0.0, front_end)
    assert np.std(pairs) / math.sqrt(2) == pytest.approx(
        budget.total_noise_e, rel=5 / math.sqrt(2 * n / 2) + 0.001
    )
    white = noise_budget(np.zeros(1), 0.0, replace(front_end, flicker_cycles=0.0))
    assert budget.total_noise_e > 1.2 * white.total_noise_e


@pytest.mark.quick(1)
@pytest.mark.parametrize("order", ["sequency", "natural"])
@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix", "differential"])
def test_noise_of_cells_holds_what_drifts_over_the_frame(mode: str, order: str) -> None:
    """8000 frames in the dark: the rms of each cell's noise is as told to 0.8 % (one deviation),
    that of all cells to 0.1 %. As it survives pairs it had been 0.6 of it in sets that show nothing
    twice, and 0.15 in their worst cells.
    """
    patterns, front_end = PatternSet(8, 8, 64, order, mode), flickering(0.5)
    budget = in_image(noise_budget(np.zeros(1), 0.0, front_end), patterns, front_end.times)
    counts, _ = expose(np.zeros((patterns.n_exposures, 8000)), front_end, rng=RNG(5))
    # Each frame has a process of its own, and all exposures the same mean.
    image = inverse_image((counts - counts.mean()) * front_end.electrons_per_count, patterns)
    measured = ~patterns.unmeasured_cells
    found, told = image[measured].std(axis=1), by_cell(budget, patterns, front_end.times)[measured]
    np.testing.assert_allclose(found / told, 1, atol=0.04)
    assert np.sqrt(np.mean(found**2) / np.mean(told**2)) == pytest.approx(1, abs=0.02)
    assert np.sqrt(np.mean(told**2)) == pytest.approx(budget.pixel_noise_e(patterns), rel=0.04)


def test_a_set_that_measures_no_cell_has_no_noise_that_drifts() -> None:
    """One pattern, all cells lit."""
    patterns = PatternSet(8, 8, 1, "sequency", "plain")
    assert patterns.unmeasured_cells.all()
    front_end = flickering(0.5)
    budget = noise_budget(np.zeros(1), 0.0, front_end)
    assert in_image(budget, patterns, front_end.times).noise_e[FLICKER] == 0


def test_a_filter_before_the_lens_passes_less_at_the_edge_of_the_field(system) -> None:
    """A laser line of 2 nm at 1550, a 12 nm filter of index 1.8: the band moves down by
    1550 (1 - sqrt(1 - sin^2 / n^2)) and has left the line behind at 10 degrees.
    """
    narrow = system(
        "[filter]\nwidth_m = 12e-9\neffective_index = 1.8\n[optics]\nfield_of_view_deg = 30.0\n"
    )
    found = passband(narrow, SKY)
    assert found.emitter_at(np.array(0.0)) == pytest.approx(1, abs=1e-6)
    edge = float(found.emitter_at(np.array(12.0)))
    assert edge == pytest.approx(in_band_fraction(narrow.emitter, narrow.filter, 12.0), abs=0.02)
    assert edge < 0.05
    taken = capture(still_yard(), narrow, fidelity=Fidelity(4, 1))
    wide = capture(
        still_yard(), system("[optics]\nfield_of_view_deg = 30.0\n"), fidelity=Fidelity(4, 1)
    )
    lit = wide.cells_e > 0
    kept = np.divide(taken.cells_e, wide.cells_e, out=np.full((64, 64), np.nan), where=lit)
    assert kept[31:33, 31:33] == pytest.approx(1, abs=1e-3)
    assert np.nanmin(kept[-1]) < 0.2


def test_behind_the_lens_the_whole_cone_is_averaged(system) -> None:
    """Mean over the cone's solid angle, by quadrature; the same everywhere in the field."""
    behind = system(
        '[filter]\nwidth_m = 12e-9\neffective_index = 1.8\nplace = "behind lens"\n'
        "[optics]\nf_number = 2.0\n"
    )
    found = passband(behind, SKY)
    expected, _ = integrate.quad(
        lambda s2: in_band_fraction(
            behind.emitter, behind.filter, math.degrees(math.asin(math.sqrt(s2)))
        ),
        0,
        1 / 17,  # sin^2 of the cone that collects the light, 1 / (4 N^2 + 1)
        limit=200,
    )
    assert float(found.emitter_at(np.array(5.0))) == pytest.approx(expected * 17, abs=2e-3)
    assert found.emitter_at(np.array(0.0)) == found.emitter_at(np.array(10.0))
    assert expected * 17 < 0.7


def seen_wall(n: int, baseline_m: float) -> RenderedLight:
    """Square cells over 20 degrees of a wall at 5 m, the detector beside the emitter."""
    axes, tangent = np.eye(3), math.tan(math.radians(10))
    aside = np.array([0.0, baseline_m, 0.0])
    return RenderedLight(
        DetectorLight(np.ones((1, n * n)), np.ones((1, n * n))),
        np.ones((n, n)),
        Truth(np.full((n, n), 0.5), np.full((n, n), 5.0)),
        Device(np.zeros(3), axes, tangent),
        Device(aside, axes, tangent),
    )


def mean_by_brute_force(value_at, n: int, baseline_m: float, emitter: bool) -> np.ndarray:
    """Mean over each cell on a grid of 800 x 800: cos^3 to the wall if the ``emitter`` lights it,
    cos^4 from there, where the detector's field holds it.
    """
    tangent, fine = math.tan(math.radians(10)), 800 // n
    across = -((2 * np.arange(800) + 1) / 800 - 1) * tangent
    left, up = np.meshgrid(across, across)
    beside = left - baseline_m / 5
    light = (1 + beside**2 + up**2) ** -2 * (abs(beside) <= tangent)
    if emitter:
        light *= (1 + left**2 + up**2) ** -1.5
    passed = light * value_at(np.degrees(np.arctan(np.hypot(beside, up))))
    sums = (x.reshape(n, fine, n, fine).sum(axis=(1, 3)) for x in (passed, light))
    return np.divide(*sums)


@pytest.mark.parametrize("line_m", [2e-9, 1e-10])
@pytest.mark.parametrize(("n", "baseline_m"), [(8, 0.0), (16, 0.0), (8, -0.05)])
def test_a_cell_has_the_mean_of_what_the_filter_passes_over_it(
    line_m: float, n: int, baseline_m: float
) -> None:
    """The edge of a 12 nm band crosses cells of 1 to 3 degrees. Taken at their middles, the shares
    had been off by 0.1 to 0.5; through a table of 65 angles, for a line of 0.1 nm, by 0.015.
    """
    made = load_system("workable").with_({"filter.part": "fb1550-12"})
    made = made.with_({"emitter.line_fwhm_m": line_m})
    band, wall = passband(made, SKY), seen_wall(n, baseline_m)
    expected = mean_by_brute_force(
        lambda deg: in_band_fraction(made.emitter, made.filter, deg), n, baseline_m, emitter=True
    )
    assert expected.min() < 0.01
    assert expected.max() > 0.99
    cut = 0.02 if baseline_m else 3e-4  # of the cells at the border of the detector's field
    found = share_of_cells(wall, band)
    np.testing.assert_allclose(found, expected, atol=cut)
    np.testing.assert_allclose(found[:, 1:-1], expected[:, 1:-1], atol=3e-4)


def test_a_part_has_the_mean_of_the_sun_behind_the_filter_over_it() -> None:
    """A band of 6 nm that moves through the water vapour's lines at 1350 nm, 4 x 4 parts: at their
    middles the sun had been 14 to 46 % too weak.
    """
    made = load_system("workable").with_({"filter.center_wavelength_m": 1355e-9})
    made = made.with_({"filter.width_m": 6e-9, "emitter.peak_wavelength_m": 1355e-9})
    band = passband(made, SKY)

    def sun_at(angles_deg: np.ndarray) -> np.ndarray:
        some = np.linspace(0, 15, 600)
        suns = [sun_in_band(SKY, made.filter, deg).irradiance_w_per_m2 for deg in some]
        return np.interp(angles_deg, some, suns)

    expected = mean_by_brute_force(sun_at, 4, 0.0, emitter=False)
    np.testing.assert_allclose(sun_of_parts(seen_wall(4, 0.0), band), expected, rtol=1e-3)


def test_what_the_filter_passes_is_found_once_for_a_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other light from the same view needs no other means; another detector or depth does."""
    made = load_system("workable")
    n = math.isqrt(made.patterns.n_cells)
    walls = [seen_wall(n, 0.0), seen_wall(n, -0.05)]
    walls.append(replace(walls[0], truth=replace(walls[0].truth, depth_m=np.full((n, n), 3.0))))
    asked: list[str] = []

    def counted(name: str):
        known = getattr(chain_module, name)
        return lambda *given: asked.append(name) or known(*given)

    for name in ("share_of_cells", "sun_of_parts"):
        monkeypatch.setattr(chain_module, name, counted(name))
    chain = Chain.of(made, load_scene("yard").sun)
    for _ in range(2):
        for wall in (walls[0], replace(walls[0], sun=2 * walls[0].sun)):
            chain.powers(wall)
    assert sorted(asked) == ["share_of_cells", "sun_of_parts"]
    collected, band = chain.lens.transmission * chain.lens.pupil_area_m2, chain.sky
    for wall in walls:
        assert (chain.passed(wall) == share_of_cells(wall, band).reshape(1, -1)).all()
        assert (chain.sun_weight(wall) == collected * sun_of_parts(wall, band)).all()


def test_a_band_that_does_not_change_is_taken_at_the_middle_of_cells() -> None:
    """Not a bit of a capture without the shift is another one."""
    made = load_system("workable").with_({"filter.effective_index": None})
    wall = seen_wall(8, 0.0)
    band = passband(made, SKY)
    assert (share_of_cells(wall, band) == band.emitter[0]).all()
    assert (sun_of_parts(wall, band) == band.sun_w_per_m2[0]).all()


def test_a_broad_line_hardly_notices_the_shift(system) -> None:
    paper = load_system("paper")
    found = passband(paper, SKY)
    assert found.emitter[0] == pytest.approx(0.112, abs=1e-3)


@pytest.mark.parametrize(("rows", "columns"), [(16, 256), (16, 64), (16, 128), (64, 64)])
def test_every_grid_of_the_paper_works_with_mirrors(system, rows: int, columns: int) -> None:
    made = system(
        f"[emitter]\nrows = {rows}\ncolumns = {columns}\n[acquisition]\nn_patterns = 512\n"
    )
    taken = capture(still_yard(), made, fidelity=Fidelity(4, 1))
    assert taken.cells_e.shape == (rows, columns)
    truth, found = taken.cells_e, reconstruct(taken.record).picture
    assert np.corrcoef(truth.ravel(), found.ravel())[0, 1] > 0.5


def test_cells_without_any_light_have_a_share_that_passes() -> None:
    """Of bare LEDs with lobes of 0.3 degrees; it was not a number, and so was the signal."""
    narrow = load_system("led-16x16-bare").with_({"emitter.viewing_angle_deg": 0.3})
    taken = capture(still_yard(), narrow, seed=1)
    assert np.isfinite(taken.cells_e).all()
    assert taken.cells_e.max() > 0
