"""Spectrograms of a run: what turns, rolls or swings, beside the rates that it has."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.physics.radar_worlds import OPTICS, RADAR, ball, thing, world
from twin.motion import Product, Rolling, Straight, Turning
from twin.radar.acquisition import radar_capture
from twin.radar.evaluation import RadarEvaluation, evaluate_radar
from twin.report.radar_charts import micro_doppler_charts, micro_doppler_title
from twin.report.radar_figures import micro_doppler as drawn
from twin.report.summary import radar_figures
from twin.scene import Scene, SceneObject, Target

SPEED, RADIUS, AXLE = 4.0, 0.3, (10.0, 0.0, 0.3)


def seen_in(scene: Scene) -> RadarEvaluation:
    knobs = OPTICS.with_(radar="targets")
    return evaluate_radar(RADAR, radar_capture(scene, RADAR, seed=1, fidelity=knobs), scene=scene)


def wheel(speed: float) -> SceneObject:
    """Upright, rolling along x."""
    mesh = trimesh.creation.cylinder(RADIUS, 0.1, sections=48)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    ahead = Straight((speed, 0.0, 0.0))
    item = thing("wheel", mesh.vertices + np.array(AXLE), mesh.faces)
    return item.following(Product((ahead, Rolling(ahead, (0, 1, 0), AXLE, RADIUS))))


def on_rim(item: SceneObject, angle: float) -> Target:
    place = np.array(AXLE) + RADIUS * np.array([np.sin(angle), 0, np.cos(angle)])
    velocity = tuple(item.state.at_world(place[None])[0][0].tolist())
    return Target(f"rim {angle:.1f}", tuple(place.tolist()), velocity, 1.0, "declared", "wheel")


@pytest.fixture(scope="module")
def rolling() -> RadarEvaluation:
    item = wheel(-SPEED)
    return seen_in(world(item, targets=tuple(on_rim(item, a) for a in np.arange(8) * np.pi / 4)))


def test_the_rim_of_a_wheel_is_heard_from_standing_to_twice_its_speed(
    rolling: RadarEvaluation,
) -> None:
    """Points all round it: where it touches the road 0, on top -2 v; 8 m/s in 21 windows' cells."""
    body, *others = rolling.micro_doppler  # one picture for all points of the wheel
    assert not others
    cell = 2 * RADAR.channel_waveform.velocity_cell_m_per_s
    assert body.least_m_per_s == pytest.approx(-2 * SPEED, rel=0.01)
    assert body.greatest_m_per_s == pytest.approx(0.0, abs=0.02)
    low, high = body.heard_m_per_s
    assert -2 * SPEED - 3 * cell < low < -2 * SPEED + cell / 2
    assert -cell / 2 < high < 3 * cell
    mean = body.seen.power_w.mean(axis=1)
    for angle in np.arange(8) * np.pi / 4:
        rate = -SPEED * (1 + np.cos(angle))
        near = abs(body.seen.range_rate_m_per_s - rate) < cell
        assert mean[near].max() > 0.01 * mean.max(), rate


def test_page_picture_and_figures_say_it(rolling: RadarEvaluation) -> None:
    (chart,) = micro_doppler_charts(rolling)
    assert "micro-Doppler of" in chart["title"]
    assert chart["image"]["rows"] > 20
    assert chart["layers"][0]["labels"] == ["wheel"]
    assert chart["y"]["low"] < -2 * SPEED
    (axis, _) = drawn(rolling).axes
    assert "micro-Doppler" in axis.get_title()
    told = {f.name: f.interval.value for f in radar_figures(rolling) if "micro-Doppler" in f.of}
    assert told["least range rate of its parts"] == pytest.approx(-2 * SPEED, rel=0.01)
    assert len(told) == 4


def test_what_goes_straight_or_turns_too_slowly_has_none() -> None:
    target = Target("t", (8.0, 0.3, 0.0), (0, 0, 0), 1.0, "declared", "b")
    item = ball("b", (8.0, 0.3, 0.0), 0.2, 2)
    for course in (Straight((30.0, 0, 0)), Turning((0, 0, 1), (8.0, 0.3, 0), 0.5)):
        moving = item.following(course)
        velocity = tuple(moving.state.at_world(np.array([[8.0, 0.3, 0]]))[0][0].tolist())
        scene = world(moving, targets=(replace(target, velocity_m_per_s=velocity),))
        assert seen_in(scene).micro_doppler == ()
    assert seen_in(world(item, targets=(target,))).micro_doppler == ()
    assert seen_in(world()).micro_doppler == ()


@pytest.mark.parametrize("level", [0.0, 3e-3])
def test_the_noise_is_not_heard(rolling: RadarEvaluation, level: float) -> None:
    """The wheel's spectrogram within noise: all of it, and a tenth of the strongest's amplitude."""
    (body,) = rolling.micro_doppler
    rng, shape = np.random.default_rng(2), body.seen.power_w.shape
    top_w = float(body.seen.power_w.mean(axis=1).max())
    noise_w = rng.exponential(1e-3 * top_w, shape)
    power = body.seen.power_w * (level > 0) + noise_w
    noisy = replace(
        body, seen=replace(body.seen, power_w=power, noise_w=np.full(shape[1], 1e-3 * top_w))
    )
    low, high = noisy.heard_m_per_s
    if level:
        assert body.least_m_per_s - 1 < low < high < body.greatest_m_per_s + 1
        assert 10 < noisy.depth_db < 25
        assert "down to the noise" in micro_doppler_title(rolling, noisy)
    else:
        assert np.isnan([low, high]).all()
        assert noisy.depth_db == 0
        assert "no echo above the noise" in micro_doppler_title(rolling, noisy)
