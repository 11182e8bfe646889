"""Verdicts in words, and the factors on the SNR that they name, against the models themselves."""

from dataclasses import replace

import numpy as np
import pytest

from twin.camera.acquisition import capture
from twin.camera.evaluation import Evaluation, evaluate
from twin.detector import FrontEnd
from twin.fidelity import PRESETS, Fidelity
from twin.radar import load_radar, radar_capture
from twin.radar.evaluation import RadarEvaluation, evaluate_radar
from twin.radar.propagation.facets.convergence import BodyEcho
from twin.report import charts
from twin.report.findings import camera_finding
from twin.report.levers import camera_levers
from twin.report.places import half_width_rad, in_image, places_of
from twin.report.radar_findings import radar_finding, reach_of, threshold_db
from twin.report.scene_model import coarser, scene_model
from twin.report.summary import summary
from twin.scene import Pose, Rig, Scene, Sun, Target, load_scene
from twin.system import System, load_system

SMALL = {"emitter.rows": 16, "emitter.columns": 16, "acquisition.n_patterns": 256}


def evaluated(changes: dict[str, object] | None = None, scene: Scene | None = None) -> Evaluation:
    system = load_system("workable").with_(SMALL | (changes or {}))
    world = scene or load_scene("table1")
    return evaluate(system, capture(world, system, seed=1, fidelity=PRESETS["draft"]))


@pytest.fixture(scope="module")
def seen() -> Evaluation:
    return evaluated()


def snr(system: System, signal_w: np.ndarray, background_w: float) -> float:
    budget = FrontEnd.of(system).noise_budget(signal_w, background_w)
    return budget.signal_e / budget.total_noise_e


@pytest.mark.parametrize(
    ("field", "factor", "light", "sun"),
    [
        ("emitter.radiant_intensity_w_per_sr", 2.0, 2.0, 1.0),
        ("optics.f_number", 0.5**0.5, 2.0, 2.0),
        ("acquisition.integration_time_s, pattern_period_s", 2.0, 1.0, 1.0),
        ("readout.transimpedance_ohm", 2.0, 1.0, 1.0),
        ("detector.dark_current_a", 0.5, 1.0, 1.0),
        ("readout.read_noise_e", 0.5, 1.0, 1.0),
    ],
)
def test_a_factor_is_that_of_the_changed_front_end(
    seen: Evaluation, field: str, factor: float, light: float, sun: float
) -> None:
    """The design is changed, and its front end's own budget is taken at the light it then has."""
    system, taken = seen.system, seen.capture
    names = [field]
    if "," in field:
        names = ["acquisition.integration_time_s", "acquisition.pattern_period_s"]
    values = dict(system.values())
    changed = system.with_({name: factor * values[name].value for name in names})
    before = snr(system, taken.signal_w, taken.background_w)
    after = snr(changed, light * taken.signal_w, sun * taken.background_w)
    lever = next(lever for lever in camera_levers(seen) if lever.field == field)
    assert lever.snr_factor == pytest.approx(after / before, rel=1e-9)


def test_coarser_cells_have_the_factor_that_a_capture_has(seen: Evaluation) -> None:
    """Twice as wide and high: the SNR per pixel of a plain surface doubles."""
    factor = next(lever for lever in camera_levers(seen) if "cells" in lever.change).snr_factor
    half = {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 64}
    coarse = evaluated(half).verdict.snr_median
    assert coarse / seen.verdict.snr_median == pytest.approx(factor, rel=0.1)


def test_a_camera_says_what_it_sees(seen: Evaluation) -> None:
    finding = camera_finding(seen)
    answers = dict(finding.answers)
    assert finding.state == ("good" if seen.verdict.snr_median >= 1 else "limited")
    largest = max(seen.capture.noise.noise_e, key=lambda name: seen.capture.noise.noise_e[name])
    assert largest in answers["What limits it"]
    assert finding.levers[0].change in answers["What would help most"]
    assert all(np.isfinite(figure.interval.value) for figure in finding.figures)


def test_the_reach_is_the_same_from_farther_away() -> None:
    """Captured again from 1.4 times as far, the SNR halves and the stated reach stays."""
    scene = load_scene("table1")
    near = evaluated(scene=scene)
    depth_m = float(np.median(near.capture.truth.depth_m))
    x, y, z = scene.rig.pose.position_m
    far = evaluated(scene=scene.at(replace(scene.rig.pose, position_m=(x - 0.4 * depth_m, y, z))))
    assert far.verdict.snr_median == pytest.approx(near.verdict.snr_median / 1.96, rel=0.1)
    name = "distance at which a cell such as the median one has an SNR of 1"
    reach_m = [
        {f.name: f.interval.value for f in camera_finding(e).figures}[name] for e in (near, far)
    ]
    assert reach_m[1] == pytest.approx(reach_m[0], rel=0.05)


def test_an_overexposed_camera_says_by_how_much_and_what_fits() -> None:
    """With the transimpedance that is advised no exposure saturates."""
    blind = evaluated({"readout.transimpedance_ohm": 1e11})
    finding = camera_finding(blind)
    answers = dict(finding.answers)
    assert finding.state == "void"
    assert "overexposed" in answers["What limits it"]
    assert answers["What is seen"].startswith("nothing")
    advice = answers["What would help most"]
    most, prefix = advice.split(" at most ")[1].split(" ohm")[0].split(",")[0].split()[0:2]
    scale = {"k": 1e3, "M": 1e6, "G": 1e9}[prefix[0]] if prefix[0] in "kMG" else 1.0
    fits = evaluated({"readout.transimpedance_ohm": 0.99 * float(most) * scale})
    assert not fits.verdict.void


def test_an_empty_field_says_so() -> None:
    """A rig that looks up has nothing in its field: no division by nothing, and no canned words."""
    away = load_scene("table1").at(Pose((0.0, 0.0, 1.0), 0.0, -80.0))
    finding = camera_finding(evaluated(scene=away))
    assert finding.state == "void"
    assert "nothing" in dict(finding.answers)["What is seen"]


def world(*targets: Target) -> Scene:
    rig = Rig(Pose((0.0, 0.0, 1.0)), radar=Pose((0.0, 0.0, 0.0)))
    return Scene("none", load_scene("table1").path, "", (), rig, Sun(0, 45, 0), targets)


def heard(*targets: Target, name: str = "hybrid-79", **changes: float) -> RadarEvaluation:
    radar = load_radar(name).with_({"waveform.n_subcarriers": 512} | changes)
    scene = world(*targets)
    return evaluate_radar(radar, radar_capture(scene, radar, fidelity=Fidelity(radar="targets")))


def target(name: str, x: float, y: float = 0.0, rcs_m2: float = 1.0) -> Target:
    return Target(name, (x, y, 1.0), (0.0, 0.0, 0.0), rcs_m2, "test")


def test_the_threshold_is_exceeded_as_often_as_asked() -> None:
    """Of exponential powers, a share of the false-alarm probability lies above it."""
    evaluation = heard(target("ball", 20.0))
    drawn = np.random.default_rng(1).exponential(size=1_000_000)
    many = replace(evaluation.how, cfar=replace(evaluation.how.cfar, false_alarm=1e-3))
    level = 10 ** (threshold_db(replace(evaluation, how=many)) / 10)
    assert np.mean(drawn > level) == pytest.approx(1e-3, rel=0.15)


def test_the_reach_is_where_the_echo_equals_the_threshold() -> None:
    evaluation = heard(target("ball", 20.0), **{"front_end.transmit_power_w": 1e-9})
    reach_m = reach_of(evaluation, 1.0)
    echo = evaluation.radar.received_power_w(reach_m, 1.0) / evaluation.image.noise_w
    assert 10 * np.log10(echo) == pytest.approx(threshold_db(evaluation), abs=1e-6)
    assert reach_m < evaluation.waveform.max_range_m


def test_a_missed_target_is_said_to_lack_what_it_lacks() -> None:
    faint = heard(target("ball", 20.0), target("fly", 60.0, 3.0, 1e-7))
    finding = radar_finding(faint)
    answers = dict(finding.answers)
    assert finding.state == "limited"
    assert "fly is missed: noise" in answers["What limits it"]
    lacking_db = float(answers["What limits it"].split("noise, ")[1].split(" dB")[0])
    louder = 10 ** ((lacking_db + 6) / 10)
    found = heard(target("ball", 20.0), target("fly", 60.0, 3.0, 1e-7 * louder))
    assert not found.missed


@pytest.mark.parametrize(
    ("error", "state", "result"),
    [
        (0.1, "good", "1 of 1 targets"),
        (0.8, "usable", "1 of 1 targets; echoes less exact than asked"),
    ],
)
def test_a_verdict_tells_errors_beyond_what_was_asked(
    error: float, state: str, result: str
) -> None:
    """Of a body whose echo is known to a factor of five the verdict is not the same as of one that
    is known to a tenth; on the command line and in the summary neither.
    """
    seen = heard(target("ball", 20.0))
    car = BodyEcho(("car",), 0.0, error, 0.1, amplitude=1e-6, level_amplitude=1e-6)
    first = replace(seen.capture.bursts[0], bodies=(car,))
    seen = replace(seen, capture=replace(seen.capture, bursts=(first,)))
    finding = radar_finding(seen)
    assert (finding.state, finding.result) == (state, result)
    told = "echoes stated with 95 % confidence: car to 80 %; 10 % asked"
    assert (told in dict(finding.answers)["What is seen"]) == (state == "usable")
    assert (told in str(seen)) == (state == "usable")
    (said,) = summary(world(), None, [], seen)["findings"]
    assert (said["state"], said["result"]) == (state, result)


def test_a_radar_without_any_echo_says_so() -> None:
    finding = radar_finding(heard())
    assert dict(finding.answers)["What is seen"].startswith("no detection at all")


def test_the_half_power_width_is_that_of_the_closed_form() -> None:
    """G0 cos^q with q = G0 / 2 - 1: half of it at acos(0.5^(1/q))."""
    radar = load_radar("hybrid-79")
    q = 10 ** (radar.antenna.ahead_dbi / 10) / 2 - 1
    assert half_width_rad(radar) == pytest.approx(np.arccos(0.5 ** (1 / q)), abs=1e-3)


def test_measured_directions_are_where_the_targets_are() -> None:
    """The array's detections, as places, lie at the true targets; so do they in the image."""
    balls = target("left", 15.0, 2.0), target("right", 20.0, -1.5)
    evaluation = heard(*balls, name="hybrid-79-mimo")
    scene = world(*balls)
    placed = {p.target: p for p in places_of(scene, evaluation) if p.measured}
    for ball in balls:
        off = np.asarray(placed[ball.name].position_m) - np.asarray(ball.position_m)
        assert np.linalg.norm(off[:2]) < 0.3


def test_the_image_has_the_field_from_edge_to_edge(seen: Evaluation) -> None:
    """A point on the boresight is in the middle; one at the field's left upper corner in it."""
    scene = world()
    half = np.tan(np.radians(seen.system.emitter.field_of_view_deg.value / 2))
    points = np.array([[10.0, 0.0, 1.0], [10.0, 10 * half, 1 + 10 * half], [-5.0, 0.0, 1.0]])
    found = in_image(scene, seen, points)
    np.testing.assert_allclose(found[:2], [[0, 0], [-1, 1]], atol=1e-12)
    assert np.isnan(found[2]).all()


def test_a_coarser_mesh_keeps_its_place_and_stays_within_its_number() -> None:
    car = next(o for o in load_scene("yard").objects if o.name == "car")
    vertices, faces = coarser(car.vertices_m, car.geometry.faces.astype(np.int64), 3000)
    assert 500 < len(faces) <= 3000
    assert faces.max() < len(vertices)
    cell = np.ptp(car.vertices_m, axis=0).max() / 32
    np.testing.assert_allclose(vertices.min(axis=0), car.box_m[0], atol=2 * cell)
    np.testing.assert_allclose(vertices.max(axis=0), car.box_m[1], atol=2 * cell)


def test_meshes_come_back_from_their_steps() -> None:
    """Sixteen bits: off by half a 65535th of the object's box at most."""
    import base64

    scene = load_scene("yard")
    model = scene_model(scene, (), None)
    for item, packed in zip(scene.objects, model["objects"], strict=True):
        steps = np.frombuffer(base64.b64decode(packed["vertices"]), "<u2").reshape(-1, 3)
        span = np.array(packed["span"])
        back = np.array(packed["low"]) + steps / 65535 * span
        assert (np.abs(back - item.vertices_m) <= 0.51 / 65535 * span + 2e-5).all()


def test_a_raster_has_its_levels() -> None:
    import base64

    made = charts.raster(np.array([[0.0, 1.0], [np.nan, 0.5]]), (0, 1), (0, 1), 0, 1, "dB")
    assert list(base64.b64decode(made["data"])) == [1, 255, 0, 128]
