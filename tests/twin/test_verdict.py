"""What a record is worth: the same words in Python, on the terminal and in the report."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from designs import changed
from scipy import integrate
from scipy.signal import lfilter

from hardware import reconstruct
from hardware.reconstruction import range_image
from hardware.records import Flag
from tests.still import still_yard
from twin.camera.acquisition import Capture, capture
from twin.camera.chain import Chain
from twin.camera.design_warnings import lag_shares
from twin.camera.evaluation import evaluate
from twin.camera.illumination import amplifier_residue, residual_share, switched_residue
from twin.camera.mounting import field_points
from twin.camera.score import score
from twin.camera.verdict import lit_cells, warnings_of_record
from twin.fidelity import Fidelity
from twin.scene import Scene, load_scene, parse_pose
from twin.system import System, load_system
from twin.warned import KINDS, CaptureWarning

FAST = Fidelity(samples=4, max_depth=1)


def taken(scene: Scene | str, system: System) -> Capture:
    return capture(
        load_scene(scene) if isinstance(scene, str) else scene, system, seed=1, fidelity=FAST
    )


@pytest.fixture(scope="module")
def saturated() -> Capture:
    return taken("table1", changed(readout__transimpedance_ohm=1e11))


def test_a_saturated_record_is_void_and_has_no_snr(saturated: Capture) -> None:
    """All exposures at the rail: the response has no slope, whatever the noise budget predicts.

    On ee37b06 the median of `snr` of such a record stood above that of the same system with a gain
    that fits.
    """
    top = 2**saturated.record.adc_bits - 1
    assert (saturated.record.counts == top).all()
    assert saturated.void
    assert saturated.verdict.void
    assert np.isnan(saturated.verdict.snr_median)
    assert not saturated.snr.any()
    assert [w.kind for w in saturated.verdict.void_because] == ["saturated"]


def test_the_same_words_in_python_terminal_and_report(tmp_path, capsys, monkeypatch) -> None:
    from html import unescape

    from twin import cli

    (tmp_path / "blind.toml").write_text(
        'base = "workable"\n[readout]\ntransimpedance_ohm = 1e11\n'
        "[emitter]\nrows = 16\ncolumns = 16\n[acquisition]\nn_patterns = 256\n"
    )
    out, system = tmp_path / "out", str(tmp_path / "blind.toml")
    monkeypatch.setattr(
        "sys.argv",
        f"twin run table1 --system {system} --compare none --radar none --out {out}".split(),
    )
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert not stopped.value.code
    printed = capsys.readouterr().out
    page = unescape((out / "report.html").read_text())
    python = evaluate(
        load_system(system), capture(load_scene("table1"), load_system(system), seed=0)
    )
    words = "void: 512 of 512 exposures saturate the ADC"
    for place in (printed, page, str(python)):
        assert words in place
        assert "SNR per pixel" not in place
        assert "PSNR" not in place


def test_an_empty_background_is_not_counted() -> None:
    """Two cylinders in front of nothing: the image is right to 60 dB, and so is the verdict.

    On ee37b06 the median over all cells was 0.
    """
    found = taken("fig3b", load_system("workable"))
    verdict = found.verdict
    lit = np.isfinite(found.truth.depth_m) & (found.cells_e > 0)
    assert not verdict.void
    assert verdict.lit_share == pytest.approx(lit.mean(), abs=0.02)
    assert verdict.lit_share < 0.2
    assert verdict.snr_median == pytest.approx(np.median(found.snr[lit]), rel=0.05)
    assert verdict.snr_median > 100
    assert score(found.cells_e, reconstruct(found.record, "zero-fill").picture).psnr_db > 55


def test_cells_without_a_surface_are_not_lit() -> None:
    """An emitter whose cells are blurred puts faint light into cells beside an object, and the more
    paths there are the more of these have any: the median does not count them.
    """
    light, albedo = np.array([1.0, 0.5, 1e-3, 0.0]), np.array([0.5, 0.3, 0.0, 0.2])
    assert lit_cells(light, albedo).tolist() == [True, True, False, False]
    # Of an object that no sample of the truth has met, all light counts.
    assert lit_cells(light, np.zeros(4)).tolist() == [True, True, True, False]
    assert not lit_cells(np.zeros(4), albedo).any()


def test_nothing_in_sight_is_void() -> None:
    sky = load_scene("yard", parse_pose("0,0,1.2,0,-80"))
    found = taken(sky, changed(emitter__rows=16, emitter__columns=16, acquisition__n_patterns=256))
    assert found.void
    assert "no-light" in {w.kind for w in found.verdict.void_because}
    assert "void: no light of the emitter comes back" in str(found.verdict)


def test_a_black_record_is_void() -> None:
    """No sun, no dark current, an offset of zero, and a gain at which nothing moves a count."""
    dark = changed(
        readout__transimpedance_ohm=1.0,
        readout__adc_offset_v=0.0,
        sky__illuminance_lx=0.0,
        emitter__rows=16,
        emitter__columns=16,
        acquisition__n_patterns=256,
    )
    found = taken("table1", dark)
    assert not found.record.counts.any()
    assert {w.kind for w in found.verdict.void_because} == {"black"}
    lifted = taken("table1", changed(readout__transimpedance_ohm=1.0))
    assert "underexposed" in {w.kind for w in lifted.verdict.void_because}
    assert "black" not in {w.kind for w in lifted.warnings}


def test_a_coarse_converter_is_told_but_not_void() -> None:
    """Eight bits over the same range: a step of 2^10 of the 18-bit one's, above all noise."""
    found = taken("table1", changed(readout__adc_bits=8))
    kinds = {w.kind for w in found.warnings}
    assert "quantisation" in kinds
    assert "quantisation" not in {w.kind for w in taken("table1", load_system("workable")).warnings}


def image_of(found: Capture) -> np.ndarray:
    return reconstruct(found.record, "zero-fill").picture


def small(**values: float) -> System:
    return changed(emitter__rows=16, emitter__columns=16, acquisition__n_patterns=256, **values)


@pytest.fixture(scope="module")
def full_scale_ohm() -> float:
    """Gain at which the all-lit exposure of `small` before table1 stands at the upper rail."""
    found = taken("table1", small())
    record = found.record
    room = 2**record.adc_bits - 1 - record.offset_counts
    resistance = small().readout.transimpedance_ohm
    assert resistance is not None
    return resistance.value * room / (float(record.counts.max()) - record.offset_counts)


def held_to_its_image(found: Capture) -> None:
    """The verdict's SNR against the record's own image: the median of kept signal over the root
    mean square of what no factor explains. The image's error has 256 cells, so that its root mean
    square scatters by 1 / sqrt(512), 4.4 %; 20 % is 4.5 times that.
    """
    true, image = found.cells_e.ravel(), image_of(found).ravel()
    kept = float(true @ image / (true @ true))
    off = float(np.sqrt(np.mean((image - kept * true) ** 2)))
    assert found.verdict.snr_median == pytest.approx(kept * np.median(true) / off, rel=0.2)


@pytest.mark.parametrize("excess", [1.01, 1.1, 1.15])
def test_what_is_cut_off_is_counted_and_few_patterns_are_not_void(
    full_scale_ohm: float, excess: float
) -> None:
    """The all-lit exposure, then one or more of 512 at the rail: an offset of all pixels, which
    costs the image more than its noise but leaves the picture: void before, or SNR as of a whole
    record.
    """
    found = taken("table1", small(readout__transimpedance_ohm=excess * full_scale_ohm))
    true, image = found.cells_e.ravel(), image_of(found).ravel()
    assert np.corrcoef(true, image)[0, 1] > 0.97
    assert not found.void
    (told,) = [w for w in found.warnings if w.kind == "saturated"]
    assert "of its signal, and false signal is" in told
    held_to_its_image(found)


def test_an_image_of_half_its_light_has_no_snr_above_1() -> None:
    """The rail at half of all light, no sun: of each pair the brighter exposure is cut to the same
    count, and differences keep half of what they had. No cell is right to better than half of
    itself, as its SNR says: 330 of the brightest before, where the image's own error is 1.01.
    """
    strong = {"sky__illuminance_lx": 0.0, "emitter__radiant_intensity_w_per_sr": 300.0}
    whole = taken("table1", small(readout__transimpedance_ohm=1e5, **strong)).record
    room = 2**whole.adc_bits - 1 - whole.offset_counts
    gain = 1.97 * 1e5 * room / (float(whole.counts.max()) - whole.offset_counts)
    found = taken("table1", small(readout__transimpedance_ohm=gain, **strong))
    true, image = found.cells_e.ravel(), image_of(found).ravel()
    kept = float(true @ image / (true @ true))
    assert kept == pytest.approx(0.5, abs=0.01)
    assert not found.void
    assert found.verdict.snr_best < 1.02 * kept / (1 - kept)


@pytest.mark.parametrize(
    "slow",
    [
        {"emitter__switching_time_s": 0.0},
        {"emitter__switching_time_s": 3e-5},
        {"emitter__switching_time_s": 5e-5},
        {"emitter__switching_time_s": 1e-4},
        {"readout__bandwidth_hz": 1e4},
        {"readout__bandwidth_hz": 5e3},
    ],
)
def test_left_over_light_is_counted(slow: dict[str, float]) -> None:
    """One rule for a slow emitter and a slow amplifier: what they leave of the exposure before is
    in the record, in the SNR and, where noise does not hide it, in a warning.
    """
    found = taken("table1", small(**slow))
    told = [w for w in found.warnings if w.kind == "lag"]
    held_to_its_image(found)
    assert not found.void
    assert bool(told) is any(slow.values())
    for warning, field in zip(told, slow, strict=False):
        assert field.replace("__", ".") in warning


@pytest.mark.parametrize(
    "slow", [{"emitter__switching_time_s": 0.01}, {"readout__bandwidth_hz": 50.0}]
)
def test_a_picture_of_the_exposures_before_is_void(slow: dict[str, float]) -> None:
    """Nearly all light is that of exposures before: the image is nothing of the scene's."""
    found = taken("table1", small(**slow))
    assert np.corrcoef(found.cells_e.ravel(), image_of(found).ravel())[0, 1] < 0.5
    assert [w.kind for w in found.verdict.void_because] == ["lag"]
    assert not found.snr.any()


def test_light_that_never_changes_leaves_noise_alone() -> None:
    """Patterns that are over before the emitter has switched: nothing false either."""
    found = taken("table1", small(emitter__switching_time_s=1.0))
    assert found.verdict.snr_median < 1e-3
    assert [w.kind for w in found.warnings] == ["lag"]


@pytest.mark.parametrize(("excess", "switching_s"), [(1.22, 5e-4), (1.23, 4e-4)])
def test_lag_and_rails_that_hide_the_image_together_are_void(
    full_scale_ohm: float, excess: float, switching_s: float
) -> None:
    """A switching time that alone leaves an SNR of 0.01 and a gain that alone leaves a image:
    with both nothing is above what is false, and SNR 0 is no finding but a void record.
    """
    gain = {"readout__transimpedance_ohm": excess * full_scale_ohm}
    slow = {"emitter__switching_time_s": switching_s}
    assert not taken("table1", small(**gain)).void
    assert not taken("table1", small(**slow)).void
    found = taken("table1", small(**gain, **slow))
    assert not found.snr.any()
    assert str(found.verdict).startswith("void: lag and rails together hide the image")


def test_an_amplifiers_pole_is_the_integral_of_its_step() -> None:
    """Share of the exposure before by quadrature of exp(-2 pi B t) over the exposure."""
    slow = small(readout__bandwidth_hz=5e3)
    time = slow.acquisition.integration_time_s.value
    dead = slow.acquisition.pattern_period_s.value - time
    area, _ = integrate.quad(lambda t: np.exp(-2 * np.pi * 5e3 * t), dead, dead + time)
    assert amplifier_residue(slow) == pytest.approx(area / time, rel=1e-9)
    assert amplifier_residue(small()) == 0


@pytest.mark.parametrize(("switching_s", "bandwidth_hz"), [(20e-6, 15e3), (1e-5, 5e4)])
def test_a_slow_emitter_before_a_slow_amplifier_is_slower_than_both(
    switching_s: float, bandwidth_hz: float
) -> None:
    """Both one-pole filters in a row, in steps of 20 ns: 1.26 and 2.01 % make 6.52 %, and 0.07 and
    0.007 % make 0.22 %.
    """
    slow = small(emitter__switching_time_s=switching_s, readout__bandwidth_hz=bandwidth_hz)
    chain = Chain.of(slow, load_scene("table1").sun)
    light = np.random.default_rng(1).uniform(0, 1, (40, 1, 1))
    period, time = (
        value.value
        for value in (slow.acquisition.pattern_period_s, slow.acquisition.integration_time_s)
    )
    step, taus = 2e-8, (switching_s / np.log(9), 1 / (2 * np.pi * bandwidth_hz))
    kept = [np.exp(-step / tau) for tau in taus]
    levels = np.repeat(light.ravel(), round(period / step))
    for share in kept:
        levels = lfilter([1 - share], [1, -share], levels)
    due = levels.reshape(len(light), -1)[:, -round(time / step) :].mean(axis=1)
    before = np.concatenate([np.zeros((1, 1, 1)), light[:-1]])
    lagged = light + residual_share(slow) * (before - light)
    got = chain.amplifier_output(lagged, np.zeros(1), np.zeros(1))[:, 0]
    share = switched_residue(slow)
    np.testing.assert_allclose(got[2:], due[2:], atol=0.03 * share * light.std())
    steps = (light[:-1] - light[1:]).ravel()[1:]
    assert steps @ (due - light.ravel())[2:] / (steps @ steps) == pytest.approx(share, rel=0.02)
    assert share > 1.9 * (residual_share(slow) + amplifier_residue(slow))
    assert any("and readout.bandwidth_hz" in field for field in lag_shares(slow))


def test_two_alike_decays_are_one_decay_twice() -> None:
    """The limit of equal times, by quadrature of (1 + t / tau) exp(-t / tau)."""
    acquisition = small().acquisition
    time = acquisition.integration_time_s.value
    dead = acquisition.pattern_period_s.value - time
    for tau in (1e-6, 2e-5, 1e-3):
        area, _ = integrate.quad(
            lambda t, tau=tau: (1 + t / tau) * np.exp(-t / tau), dead, dead + time
        )
        for other in (tau, tau * (1 + 1e-5), tau * (1 + 1e-3)):
            got = acquisition.residue_of_two(tau, other)
            assert got == pytest.approx(area / time, rel=0.02 * (other - tau) / tau * 1e3 + 1e-6)


def test_flags_of_a_device_are_told_by_kind() -> None:
    good = taken(
        "table1", changed(emitter__rows=16, emitter__columns=16, acquisition__n_patterns=256)
    )
    flags = good.record.flags.copy()
    flags[:3], flags[5], flags[7:9] = Flag.LOST, Flag.OVERRUN, Flag.RESET
    told = {w.kind: w for w in warnings_of_record(replace(good.record, flags=flags))}
    assert set(told) == {"lost", "overrun", "reset"}
    assert told["lost"] == "3 of 512 exposures are marked lost"
    assert not any(w.void for w in told.values())
    every = replace(good.record, flags=np.full_like(flags, Flag.LOST))
    assert next(iter(warnings_of_record(every))).void


def test_one_column_of_a_line_sensor_does_not_void_the_others() -> None:
    """Void is told by detector: one blind column leaves the image of the rest."""
    system = load_system("line-256x16")
    found = taken("table1", system)
    counts = found.record.counts.copy()
    counts[:, 3] = 2**found.record.adc_bits - 1
    record = replace(found.record, counts=counts)
    (told,) = [w for w in warnings_of_record(record) if w.kind == "saturated"]
    assert not told.void
    from twin.camera.verdict import saturated_detectors

    assert np.flatnonzero(saturated_detectors(record)).tolist() == [3]


def test_warnings_are_sentences_with_a_kind_of_a_closed_list() -> None:
    import pickle

    told = CaptureWarning("saturated", "all at the rail", void=True)
    again = pickle.loads(pickle.dumps(told))
    assert (again, again.kind, again.void) == ("all at the rail", "saturated", True)
    assert "saturated" in KINDS
    with pytest.raises(ValueError, match="'odd' is none of saturated, "):
        CaptureWarning("odd", "x")  # type: ignore[arg-type]


def test_sweeps_measure_lit_cells_too(tmp_path: Path) -> None:
    """In front of nothing the median of all cells is dark: on ee37b06 SNR 0 and no time enough."""
    from twin.sweep import load_study
    from twin.sweep.evaluate import outcome_of
    from twin.sweep.inputs import inputs_of
    from twin.sweep.metrics import metric

    (tmp_path / "study.toml").write_text(
        'scene = "fig3b"\nmetrics = ["snr_median", "minimum_time_s", "maximum_distance_m"]\n'
        "[set]\n"
        '"fidelity.max_depth" = 1\n[grid]\n"system.optics.f_number" = [1.0, 2.0]\n'
    )
    study = load_study(tmp_path / "study.toml")
    outcome = outcome_of(study, 0)
    found = (metric(name, inputs_of(study))(outcome) for name in study.metrics)
    snr, time, distance = (interval.value for interval in found)
    assert snr == outcome.capture.verdict.snr_median > 100
    assert 0 < time < outcome.setup.system.acquisition.integration_time_s.value
    # Cylinders 0.9 m ahead, read at a hundred times the SNR that is needed.
    assert 2 < distance < 100


def test_backscatter_of_fog_is_no_signal(tmp_path: Path) -> None:
    """Signal over noise falls with the air's transmission there and back, and no faster than the
    light that fog scatters forward explains; an empty field in fog is not lit.
    """
    path = tmp_path / "fog.toml"
    path.write_text('base = "workable"\n[weather]\npart = "fog-200m"\n')
    clear = capture(still_yard(), load_system("workable"), seed=1)
    foggy = capture(still_yard(), load_system(path), seed=1)
    assert np.median(foggy.backscatter_e) > 0.2 * np.median(foggy.cells_e)
    np.testing.assert_allclose(foggy.scene_e + foggy.backscatter_e, foggy.cells_e)
    assert foggy.verdict.snr_median < clear.verdict.snr_median
    assert foggy.verdict.lit_share == pytest.approx(clear.verdict.lit_share, abs=0.1)
    assert not clear.backscatter_e.any()


def foggy_patch(tmp_path: Path, corners: str, visibility_m: float) -> tuple[Scene, System]:
    """One patch of reflectance 0.5 and 16 x 16 cells of `workable` in fog; 0: clear air."""
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0">'
        '<bsdf type="diffuse" id="generic"><spectrum name="reflectance" value="0.5"/></bsdf>'
        f'<shape type="rectangle" id="patch"><transform name="to_world">{corners}</transform>'
        '<ref id="generic"/></shape></scene>'
    )
    (tmp_path / "scene.toml").write_text(
        "[rig]\nposition_m = [0.0, 0.0, 0.0]\n[rig.emitter]\noffset_m = [0.0, 0.0, 0.0]\n"
        "[rig.detector]\noffset_m = [0.0, -0.05, 0.0]\n"
        "[sun]\nazimuth_deg = 40.0\nelevation_deg = 40.0\nilluminance_lx = 0.0\n"
    )
    weather = (
        f"[weather]\nvisibility_m = {visibility_m}\nsingle_scattering_albedo = 0.99\n"
        "asymmetry = 0.85\nlidar_ratio_sr = 18.8\n"
    )
    (tmp_path / "system.toml").write_text(
        'base = "workable"\n[emitter]\nrows = 16\ncolumns = 16\n'
        "[acquisition]\nn_patterns = 256\n" + (weather if visibility_m else "")
    )
    return load_scene(tmp_path), load_system(tmp_path / "system.toml")


PHASES = "modulation_hz = [10e6]\nphase_steps = 4\ncontrast = 0.9\n"
GATES = (
    "pulse_width_s = 20e-9\npulse_rate_hz = 1e5\ngate_width_s = 20e-9\n"
    "gate_delays_s = [0.0, 20e-9, 40e-9, 60e-9, 80e-9, 100e-9]\n"
)


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("shutters", "intensity"), [(PHASES, 20.0), (GATES, 3e3)], ids=["phases", "gates"]
)
def test_what_fog_does_to_distances_is_told(
    tmp_path: Path, shutters: str, intensity: float
) -> None:
    """A wall at 10 m, its way half the baseline longer at most, in a visibility of 200 m: what the
    capture says of the median error is what the vehicle's own distances are off, to 20 % and the
    noise; in clear air nothing is said.
    """
    wall = FACING + '<scale value="10"/><translate x="10"/>'
    for visibility_m in (0.0, 200.0):
        scene, _ = foggy_patch(tmp_path, wall, visibility_m)
        path = tmp_path / "system.toml"
        strong = path.read_text().replace(
            "[emitter]", f"[emitter]\nradiant_intensity_w_per_sr = {intensity}"
        )
        path.write_text(strong + "[time_of_flight]\n" + shutters)
        found = capture(scene, load_system(path), seed=1, fidelity="standard")
        told = [w for w in found.warnings if "backscatter is" in w]
        if not visibility_m:
            assert found.range_error is None
            assert not told
            continue
        assert found.range_error is not None
        assert found.range_error.matters
        assert len(told) == 1
        assert str(found.verdict).endswith(
            f"distances {found.range_error.error_m:.2g} m off because of backscatter (median)"
        )
        seen = range_image(found.record, "zero-fill").distance_m[0]
        left, up = field_points((16, 16), np.tan(np.radians(10.0)))
        true = 10.0 * np.sqrt(1 + left**2 + up**2)
        off = np.median(np.abs(seen - true))
        assert found.range_error.error_m == pytest.approx(off, rel=0.2, abs=0.1)


FACING = '<rotate y="1" angle="-90"/>'


@pytest.mark.thorough
def test_fog_makes_no_image_better(tmp_path: Path) -> None:
    """A grey wall at 10 m in ever thicker fog. The plain inverse's error is the noise alone, so its
    score follows from the scene's light and that noise (closed form; 256 cells leave 0.4 dB of
    draw, held to 5 of them), and no method's score rises as the fog thickens.
    """
    wall = FACING + '<scale value="10"/><translate x="10"/>'
    scores = []
    for visibility_m in (0.0, 200.0, 10.0):
        scene, system = foggy_patch(tmp_path, wall, visibility_m)
        found = evaluate(system, capture(scene, system, seed=1))
        by_method = {i.method: s for i, s in zip(found.reconstructions, found.scores, strict=True)}
        best = found.capture.scene_e.max()
        noise = np.median(found.capture.scene_e) / found.verdict.snr_median
        expected = 20 * np.log10(best / noise)
        assert by_method["zero-fill"].psnr_db == pytest.approx(expected, abs=2)
        scores.append([(by_method[m].psnr_db, by_method[m].ssim) for m in ("zero-fill", "lmmse")])
    assert (np.diff(np.array(scores)[:, :, 0], axis=0) < 0).all()
    assert (np.array(scores)[-1, :, 1] < np.array(scores)[0, :, 1]).all()


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("place", "text"),
    [
        ('<translate x="10" y="-50"/>', "nothing in the field of view"),
        ('<scale value="100"/><translate x="150"/>', "the air transmits none"),
    ],
    ids=["nothing", "far"],
)
def test_fog_before_nothing_is_no_picture(tmp_path: Path, place: str, text: str) -> None:
    """Where no light of the scene comes back the record is void, however bright the fog is; 150 m
    of a visibility of 10 m leave exp(-117) of it.
    """
    scene, system = foggy_patch(tmp_path, FACING + place, 10.0)
    found = capture(scene, system, seed=1)
    assert found.cells_e.min() > 0
    assert not found.scene_e.any()
    assert found.verdict.void
    assert str(found.verdict) == f"void: no light of the emitter comes back: {text}"
    assert not evaluate(system, found).best.startswith("lmmse")


def test_the_verdict_scores_the_method_that_was_asked_for(tmp_path: Path) -> None:
    """And names the best one, where that is another: `--method zero-fill` was told of lmmse only.

    The adjoint without its factor 1 / n is thousands of times too bright, and never the best.
    """
    wall = FACING + '<scale value="2"/><translate x="10"/>'
    scene, system = foggy_patch(tmp_path, wall, 0.0)
    found = capture(scene, system, seed=1)

    def too_bright(values, noise_variance, sensing):
        return sensing.adjoint(values)

    for method in ("zero-fill", too_bright):
        scored = evaluate(system, found, method=method)
        place = [image.method for image in scored.reconstructions].index(str(scored.asked))
        assert f"{scored.asked}: {scored.score_intervals[place]}" in str(scored)
        assert scored.best in str(scored)
    assert str(scored.asked) in scored.images.split("; best of 3 methods, ")[0]
    assert evaluate(system, found).images == evaluate(system, found).best
