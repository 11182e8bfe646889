"""What a radar's run is said to have achieved: targets by the extent of their objects, further
echoes, misses.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.radar import Detection, OfdmWaveform
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.radar import load_radar, radar_capture
from twin.radar.device.design_warnings import rate_warnings
from twin.radar.evaluation import evaluate_radar, further_echoes, match_detections, write_detections
from twin.radar.truth import TrueTarget, _nearest
from twin.report.radar_summary import radar_summary
from twin.scene import Pose, Rig, Scene, Sun, Target
from twin.scene.objects import SceneObject

WAVE = OfdmWaveform(79e9, 4096, 976562.5, 256, 39.0625e-6, 37, 1.024e-6)  # cells of 37 mm, 0.19 m/s
BALL = TrueTarget("ball", 10.0, 0.0, 0.0, 0.3, 1e-12, True, 10.0, nearer_m=0.3, farther_m=0.3)


def found(range_m: float, rate: float = 0.0, power_w: float = 1e-12) -> Detection:
    return Detection(range_m, rate, power_w, 60.0, 1e-4, 1e-3)


def test_a_ball_is_found_by_its_front() -> None:
    """Its declared place is its centre, 8 cells behind the echo; two cells before it count."""
    for range_m, match in ((9.7, True), (9.63, True), (9.62, False), (10.38, False)):
        (hit,) = match_detections([found(range_m)], (BALL,), WAVE)
        assert (hit is BALL) == match
    assert match_detections([found(9.7, 0.5)], (BALL,), WAVE) == (None,)


def test_the_declared_place_comes_before_the_extent_and_the_rest_is_named() -> None:
    detections = [found(9.7), found(10.01), found(10.2), found(12.0), found(9.9, 3.0)]
    matches = match_detections(detections, (BALL,), WAVE)
    assert matches == (None, BALL, None, None, None)
    assert further_echoes(detections, matches, (BALL,), WAVE) == (BALL, None, BALL, None, None)


def test_the_nearest_point_of_triangles() -> None:
    """Against 2e5 points on each: the foot within, on an edge, on a corner, and edge on."""
    rng = np.random.default_rng(0)
    u, v = rng.random((2, 200_000))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    for _ in range(60):
        corners = rng.normal(size=(3, 3)) + rng.normal(size=3)
        points = (
            corners[0] + np.outer(u, corners[1] - corners[0]) + np.outer(v, corners[2] - corners[0])
        )
        least = np.linalg.norm(points, axis=1).min()
        assert _nearest(corners[None]) <= least + 1e-12
        assert _nearest(corners[None]) == pytest.approx(least, abs=0.02)


@pytest.fixture(scope="module")
def evaluation():
    """A plate of 1 m at 5 m, declared 2 cm behind its front, and a target of 1e-12 m^2."""
    corners = np.array([[5.0, y, z] for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    plate = SceneObject("plate", Geometry(corners, np.array([[0, 1, 2], [1, 3, 2]])), "metal", 0.5)
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    targets = (
        Target("plate", (5.02, 0.0, 0.0), (0.0, 0.0, 0.0), 10.0, "declared", "plate"),
        Target("fly", (40.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1e-12, "declared"),
    )
    scene = Scene("two", Path(), "", (plate,), rig, Sun(0.0, 0.0, 0.0), targets)
    radar = load_radar("hybrid-79")
    return evaluate_radar(
        radar, radar_capture(scene, radar, seed=1, fidelity=Fidelity(radar="targets"))
    )


def test_an_objects_extent_is_that_of_its_triangles(evaluation) -> None:
    plate, fly = evaluation.capture.truth
    assert plate.range_m - plate.nearer_m == pytest.approx(5.0, abs=1e-12)
    assert plate.range_m + plate.farther_m == pytest.approx(np.sqrt(25.5), abs=1e-12)
    assert (fly.nearer_m, fly.farther_m) == (0.0, 0.0)


def test_missed_targets_are_listed_with_what_was_to_be_expected(evaluation, tmp_path: Path) -> None:
    """The same words in Python, on the terminal and in the report."""
    assert [target.name for target in evaluation.missed] == ["fly"]
    first, second = str(evaluation).splitlines()
    assert first.startswith("hybrid-79: 1 of 2 targets among 1 detection")
    assert second.startswith("hybrid-79: missed: fly (-")
    assert "dB over the map's noise" in second
    assert radar_summary(evaluation)["headlines"] == [first, second]
    parts = replace(evaluation, matches=(None,))
    write_detections(parts, tmp_path / "detections.csv")
    header, row = (tmp_path / "detections.csv").read_text().splitlines()
    assert header.endswith("target,further_echo_of")
    assert row.endswith(",,plate")


def test_long_symbols_of_fast_targets_are_warned_of() -> None:
    """At 40 m/s subcarriers 400 kHz apart leak by pi eps / sqrt(3), eps = 0.0527: -20 dB."""
    wave = replace(WAVE, n_subcarriers=1024, subcarrier_spacing_hz=400e3, repeats=1)
    (told,) = [str(one) for one in rate_warnings(wave, wave, 40.0) if "subcarriers" in str(one)]
    assert "at 40.0 m/s -20 dB of an echo leak" in told
    assert not [one for one in rate_warnings(wave, wave, 20.0) if "subcarriers" in str(one)]
