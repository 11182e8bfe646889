"""Waves by the corners of thick obstacles, against Kirchhoff's integral over the planes of both."""

import numpy as np
import pytest
import trimesh
from scipy.special import erfc

from tests.physics.radar_worlds import RADAR, ball, thing, wave, world
from tests.physics.shadow_worlds import OPTICS, K, echo, point
from twin.fidelity import DEFAULT
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject

NODES, WEIGHTS = np.polynomial.legendre.leggauss(600)
TURN = np.exp(0.25j * np.pi)
LOW = OPTICS.with_(radar_shadow_db=40.0)


def beyond(height: np.ndarray | float, a: float, b: float) -> np.ndarray:
    """Share of a wave below a height over its way, a plane's distances from both ends apart."""
    return 0.5 * erfc(-height * np.sqrt(K / 2 * (1 / a + 1 / b)) / TURN)


def beyond_both(heights: tuple[float, float], a: float, b: float, c: float) -> complex:
    """Below a height in each of two planes: over the second along the path of steepest descent."""
    scale = np.sqrt(K / 2 * (1 / (a + b) + 1 / c))
    long = 7 / scale + 2 * abs(heights[1])
    u, w = (NODES + 1) / 2 * long, WEIGHTS / 2 * long
    place = heights[1] - u * TURN
    first = beyond(heights[0] - place * a / (a + b), a, b)
    return (
        TURN * scale / np.sqrt(1j * np.pi) * np.sum(w * first * np.exp(1j * (scale * place) ** 2))
    )


def field_behind(corner: np.ndarray, deep_m: float) -> complex:
    """Behind a corner 6 m off, at (y, z) of the way to a target 10 m off: a quarter of each plane
    is opaque, and the waves there are products.
    """
    a, b, c = 6.0, deep_m, 4.0 - deep_m
    both = np.prod([beyond_both((h, h), a, b, c) for h in corner])
    one, other = beyond(corner, a, b + c).prod(), beyond(corner, a + b, c).prod()
    return complex(1 - one - other + both).conjugate()  # of waves exp(-j k r)


def corner_of_a_box(corner: np.ndarray, deep_m: float, roll_deg: float = 0.0) -> SceneObject:
    """2 m wide and high, turned about the way to the target."""
    low, high = [6.0, *(corner - 2.0)], [6.0 + deep_m, *corner]
    mesh = trimesh.creation.box(bounds=[low, high])
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(roll_deg), [1, 0, 0]))
    return thing("box", mesh.vertices, mesh.faces, radar="obstacle")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("deep_m", [0.1, 0.3, 1.0])
def test_behind_a_corner_of_a_box_it_is_kirchhoffs_integral(deep_m: float, seed: int) -> None:
    """Within the shadow of the corner, past it, or beside one of its edges; as of thin sheets, by
    infinitely long edges, it is off by 0.02 to 0.15.
    """
    rng = np.random.default_rng([seed, 7])
    corner = rng.uniform(-0.02, 0.02, 2)
    due = field_behind(corner, deep_m) ** 2
    for roll_deg in (0.0, float(rng.uniform(10, 80))):
        got = echo(corner_of_a_box(corner, deep_m, roll_deg), fidelity=LOW)
        assert abs(got - due) < 0.01


@pytest.mark.parametrize("deep_m", [0.1, 1.0])
def test_the_corner_itself_may_be_in_the_way(deep_m: float) -> None:
    due = field_behind(np.zeros(2), deep_m) ** 2
    assert abs(echo(corner_of_a_box(np.zeros(2), deep_m), at=point(), fidelity=LOW) - due) < 0.005


@pytest.mark.parametrize("aside_m", [0.0, 1e-9, -1e-8, 1e-5])
@pytest.mark.parametrize("edge_m", [-0.05, -0.01, -0.001, 0.001, 0.01])
@pytest.mark.parametrize("axis", [0, 1])
def test_one_side_may_be_exactly_in_line(axis: int, edge_m: float, aside_m: float) -> None:
    """Radar and target in the plane of one of the corner's sides, past the other side or not: up to
    three times the true echo, or none.
    """
    corner = np.full(2, aside_m)
    corner[axis] = edge_m
    due = field_behind(corner, 0.5) ** 2
    got = echo(corner_of_a_box(corner, 0.5), at=point(), fidelity=LOW)
    assert abs(got - due) < 0.01


@pytest.mark.parametrize("high_m", [1.0, 3.0, 4.0, 8.0])
def test_a_large_box_near_the_radar_has_corners_too(high_m: float) -> None:
    """From 4 m on its front counted as a side along the way: its edge far aside is seen so."""
    mesh = trimesh.creation.box(bounds=[[0.8, -high_m, -high_m], [1.4, -0.03, 0.04]])
    box = thing("box", mesh.vertices, mesh.faces, radar="obstacle")
    a, b, c = 0.8, 0.6, 8.6
    heights = (-0.03, 0.04)
    both = np.prod([beyond_both((h, h), a, b, c) for h in heights])
    one, other = (np.prod([beyond(h, x, 10 - x) for h in heights]) for x in (a, a + b))
    due = complex(1 - one - other + both).conjugate() ** 2
    assert abs(echo(box, at=point(), fidelity=LOW) - due) < 0.02


@pytest.mark.quick(2)
@pytest.mark.parametrize("deep_m", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("edge_m", [-0.02, 0.002, 0.02])
def test_bodies_behind_corners_are_within_what_is_stated(edge_m: float, deep_m: float) -> None:
    """A ball, whose echo comes from a few mm, where the way is lit or not at all of it; as by
    infinitely long edges, up to 2.6 times as far off.
    """
    body, box = ball("ball", (10.03, 0, 0), 0.03, 5), corner_of_a_box(np.full(2, edge_m), deep_m)
    alone, behind = (trace(world(*o), RADAR, fidelity=DEFAULT) for o in ((body,), (box, body)))
    free = wave(alone.echoes)
    due = field_behind(np.full(2, edge_m), deep_m) ** 2
    stated = behind.bodies[0].estimated_error * behind.bodies[0].level_amplitude
    off = abs(wave(behind.echoes) - due * free)
    assert off < stated
    assert off < 0.04 * abs(free)
