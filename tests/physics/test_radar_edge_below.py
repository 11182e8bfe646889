"""Edges that run along below the line of sight cast no shadow there: source and body are on one
side of them, and the border of their shadow is on the other.
"""

import numpy as np
import pytest

from tests.physics.radar_worlds import RADAR, quad, world
from tests.physics.shadow_worlds import Array
from twin.fidelity import DEFAULT
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject

WITH_WAVES = DEFAULT.with_(radar_edges=0)
WITHOUT = WITH_WAVES.with_(radar_shadowed=0)


def sheet(turn_deg: float) -> SceneObject:
    """It ends 0.35 m below the line of sight, along x or nearly so."""
    turn = np.deg2rad(turn_deg)
    along, aside = np.array([[np.cos(turn), np.sin(turn), 0], [np.sin(turn), -np.cos(turn), 0]])
    ends = [np.array([4.0, 0.0, -0.35]) + i * 3.9 * along for i in (-1, 1)]
    corners = np.array([*ends, ends[1] + 4 * aside, ends[0] + 4 * aside])
    return quad("sheet", corners, radar="obstacle")


def plate(aside_m: float, tilt: float) -> SceneObject:
    """6 cm, turned up or down from the radar."""
    towards = np.array([-1.0, 0.0, -tilt]) / np.hypot(1.0, tilt)
    one, up = np.array([0.0, 0.03, 0.0]), 0.03 * np.cross(towards, [0.0, 1.0, 0.0])
    middle = np.array([8.0, aside_m, 0.0])
    corners = [middle + i * one + j * up for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return quad("plate", corners)


def echo(found: Propagation) -> Array:
    """Over the band, (5,)."""
    c = found.contributions
    own = c.take(np.flatnonzero(c.object == found.objects.index("plate")))
    frequencies = np.linspace(77e9, 81e9, 5)[:, None]
    return (own.amplitude * np.exp(-2j * np.pi * (frequencies * own.delay_s % 1))).sum(axis=1)


@pytest.mark.parametrize(("tilt", "most"), [(0.0, 0.02), (0.02, 0.06)])
@pytest.mark.parametrize("turn_deg", [0.0, 0.2])
@pytest.mark.parametrize("aside_m", [0.0, 0.01, -0.01])
def test_an_edge_below_the_line_of_sight_takes_nothing(
    aside_m: float, turn_deg: float, tilt: float, most: float
) -> None:
    """Its waves are 0.01 of the straight one. While the plate crossed the plane of source and edge
    they had been what a shadow's border takes, 0.2 to 0.4 of the echo, at lengths of no path.
    """
    free = echo(trace(world(plate(aside_m, tilt)), RADAR, fidelity=WITHOUT))
    found = trace(world(sheet(turn_deg), plate(aside_m, tilt)), RADAR, fidelity=WITH_WAVES)
    change = np.linalg.norm(echo(found) - free) / np.linalg.norm(free)
    assert 0.01 < change < most
    (body,) = found.bodies
    assert found.contributions.delay_s.min() > 2 * 7.99 / 299792458
    assert body.estimated_error < 0.1
