"""Declared points whose ways over two mirrors meet the edge that these share, as at round
coordinates: each of the two sequences of mirrors is there to one side of it, and counts half.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import CARRIER_HZ, OPTICS, RADAR, quad, world
from twin.fidelity import Fidelity
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject, Target

TALL_M, ASIDE_M, FAR_M = 1.0, 3.0, 10.0
BY_TWO = replace(OPTICS, radar_images=2)


def corner(material: str, below_m: float = 0.0, beyond_m: float = 0.0) -> list[SceneObject]:
    """A ground and a wall at a right angle, which may go on beyond each other."""
    low, side = -TALL_M, ASIDE_M
    edge, foot = side + beyond_m, low - below_m
    ground = quad(
        "ground", [[-5, -6, low], [40, -6, low], [40, edge, low], [-5, edge, low]], material
    )
    wall = quad(
        "wall", [[-5, side, foot], [40, side, foot], [40, side, 6], [-5, side, 6]], material
    )
    return [ground, wall]


def point(place) -> Target:
    return Target(f"point{place}", tuple(place), (0.0, 0.0, 0.0), 1.0, "declared")


def by_both(objects: list[SceneObject], place, fidelity: Fidelity | None = None) -> complex:
    """Of a point's echo what goes over both mirrors one way and straight the other, times both
    lengths.
    """
    found = trace(world(*objects, targets=(point(place),)), RADAR, fidelity=fidelity)
    paths = found.contributions.take(np.arange(len(found.names)))
    image = 2 * np.array([0, ASIDE_M, -TALL_M])
    both_m, straight_m = np.linalg.norm(place - image), np.linalg.norm(place)
    length_m = both_m + straight_m
    some = np.abs(paths.delay_s * speed_of_light - length_m) < 1e-4
    waves = paths.amplitude[some] * both_m * straight_m
    phase = CARRIER_HZ * (paths.delay_s[some] - length_m / speed_of_light)
    return complex(np.sum(waves * np.exp(-2j * np.pi * phase)))


@pytest.mark.quick(3)
@pytest.mark.parametrize("beyond", [(0.0, 0.0), (1.0, 0.0), (0.0, 2.0), (1.0, 2.0)])
@pytest.mark.parametrize("material", ["metal", "concrete"])
@pytest.mark.parametrize("fidelity", [None, BY_TWO], ids=["tolerance", "optics"])
def test_a_way_by_the_very_edge_is_as_those_beside_it(fidelity, material: str, beyond) -> None:
    """Straight ahead of the radar, at its height: there was no echo over both mirrors at all.

    Beside it, farther than a twentieth of a Fresnel zone, one sequence alone is there.
    """
    objects = corner(material, *beyond)
    at_edge, *around = (by_both(objects, [FAR_M, y, 0.0], fidelity) for y in (0.0, 0.04, -0.04))
    assert 0 not in around
    assert at_edge == pytest.approx(np.mean(around), rel=0.01)


@pytest.mark.quick(4)
@pytest.mark.parametrize("aside_m", [1e-6, -1e-6, 1e-5, -1e-5, 1e-4, -1e-3, 5e-3])
def test_there_is_no_gap_beside_the_edge(aside_m: float) -> None:
    objects = corner("metal")
    at_edge, beside = (by_both(objects, [FAR_M, y, 0.0]) for y in (0.0, aside_m))
    assert beside == pytest.approx(at_edge, rel=0.01)


@pytest.mark.parametrize("n_points", [0, 1, 2])
def test_points_of_whom_some_are_at_the_edge(n_points: int) -> None:
    """The ways of others are what they are alone."""
    places = [(FAR_M, 0.0, 0.0), (FAR_M, -1.0, 0.5)][:n_points]
    targets = tuple(point(place) for place in places)
    found = trace(world(*corner("metal"), targets=targets), RADAR)
    alone = [trace(world(*corner("metal"), targets=(one,)), RADAR) for one in targets]
    count = [len(one.names) for one in alone]
    assert count == [25, 16][:n_points]
    assert len(found.names) == sum(count)
    amplitude = [np.abs(one.contributions.amplitude[: len(one.names)]) for one in alone]
    together = np.abs(found.contributions.amplitude[: len(found.names)])
    assert np.sort(together) == pytest.approx(np.sort(np.concatenate([*amplitude, []])), rel=1e-6)
