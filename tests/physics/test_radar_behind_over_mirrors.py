"""Bodies behind obstacles over a ground: waves round edges on ways over mirrors.

Truth is Kirchhoff's field from the radar and from its image below a metal ground, by brute force.
"""

import numpy as np
import pytest
from scipy.special import erfc

from benchmarks.kirchhoff_over_ground import OverGround
from benchmarks.round_obstacles import against_images, sensitive_radar
from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, ball, plate, quad, world
from tests.physics.shadow_worlds import Array, K
from twin.fidelity import DEFAULT
from twin.radar import load_radar
from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.screens import Screens, screens
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject

BELOW_M = 0.4


def ground(below_m: float = BELOW_M, **more) -> SceneObject:
    corners = [[-2, -9, -below_m], [20, -9, -below_m], [20, 9, -below_m], [-2, 9, -below_m]]
    return quad("ground", corners, **more)


def upright(edge_m: float, top_m: float = 1.0, x: float = 4.0) -> SceneObject:
    """A screen on the ground, from an edge to the left."""
    corners = [[x, edge_m, -BELOW_M], [x, 6, -BELOW_M], [x, 6, top_m], [x, edge_m, top_m]]
    return quad("screen", corners, radar="obstacle")


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 12, 4])
def test_echoes_over_the_ground_go_round_a_screen_as_kirchhoffs_do(seed: int) -> None:
    """One that hangs before the direct way, or stands before both; what it changes had been missing
    over the ground: 0.5 to 1 of the level that errors are relative to.
    """
    (found,) = against_images("", OverGround.random(seed), load_radar("hybrid-79"))
    assert found.true < found.stated
    assert found.true < 0.25 * found.change


@pytest.mark.parametrize("seed", [30, pytest.param(37, marks=pytest.mark.thorough)])
def test_bodies_hidden_on_all_ways_answer_by_each_of_them(seed: int) -> None:
    """Where waves over edges are fainter than those that are followed everywhere, on the direct way
    or over the ground, most of the echo is by both: 1.3 of its level had been missing, 0.6 stated.
    """
    (found,) = against_images("", OverGround.hidden(seed), sensitive_radar())
    assert found.true < 0.5 * found.stated
    assert found.true < 0.25 * found.change


def _obstacles(*objects: SceneObject) -> Screens:
    scene = world(*objects, plate("body", (9.5, 0.0, 0.0), 0.05, radar="optics"))
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    prepared = prepare_scene(scene, RADAR, roles, 1)
    owner = np.full(len(prepared.items), -1, dtype=np.int32)
    owner[[item.name for item in prepared.items].index("body")] = 0
    found = screens(prepared, 40.0, owner)
    assert found is not None
    return found


def _field(obstacles: Screens, places: Array) -> np.ndarray:
    """Of the radar's image in the ground, over the straight wave."""
    context, none, own = obstacles.prepared.context, np.zeros_like(places), np.zeros(len(places))
    found = all_paths_to_points(context, obstacles, 1, places, none, own.astype(np.int64))
    return found.field(View(obstacles, 1).straight(places, none), K)


def test_an_edge_goes_on_in_the_mirror_on_which_it_stands() -> None:
    """Places whose ways over the ground are reflected at the foot of the screen, some mm before and
    behind it, or right there: next to an edge's end rays pass round the end, which led into the
    ground, and the wave over the edge was missing.
    """
    edge_m, foot, far = 0.03, 4.0, 8.0
    before_m = np.geomspace(1e-4, 0.05, 20)
    reflected_m = foot + np.concatenate([-before_m, [0.0], before_m])
    heights = BELOW_M * (far / reflected_m - 2)
    places = np.stack([np.full(41, far), np.full(41, 0.0), heights], axis=1)
    found = _field(_obstacles(ground(), upright(edge_m)), places)
    bend = K / 2 * (1 / np.hypot(foot, BELOW_M) + 1 / np.hypot(far - foot, BELOW_M))
    due = erfc(-np.sqrt(1j * bend) * edge_m) / 2
    # The screen's top, 1.4 m above the foot, is 46 dB down.
    assert np.abs(found - due).max() < 0.01


def test_a_body_hidden_from_the_image_alone_is_heard_over_the_ground() -> None:
    """A low screen before the ground's way leaves the direct one free: nothing of the way over the
    ground is in the light, and what comes over the screen is a fifth of the echo.
    """
    low = quad(
        "screen",
        [[4, -3, -BELOW_M], [4, 3, -BELOW_M], [4, 3, -0.12], [4, -3, -0.12]],
        radar="obstacle",
    )
    body = ball("ball", (8.0, 0.0, 0.1), 0.1, 5, radar="optics")
    free, found = (
        trace(world(*objects, body), RADAR, fidelity=DEFAULT.with_(radar_edges=0))
        for objects in ((ground(),), (ground(), low))
    )

    def over_ground(echoes) -> complex:
        own = (echoes.source != echoes.receiver) & (echoes.bounces <= 1)
        some = echoes.take(np.flatnonzero(own))
        return complex(np.sum(some.amplitude * np.exp(-2j * np.pi * (79e9 * some.delay_s % 1))))

    share = over_ground(found.contributions) / over_ground(free.contributions)
    assert 0.05 < abs(share) < 0.4
    (told,) = (d for d in found.decisions if d.effect.startswith("waves diffracted"))
    assert told.taken
