"""Facets answer waves over edges by the direction from which these come."""

from types import SimpleNamespace

import numpy as np

from tests.physics.radar_worlds import RADAR, quad, thing, world
from twin.radar.propagation.diffraction.two_way_echoes import _askew
from twin.radar.propagation.solvers import trace


def test_currents_grow_with_the_cosines_of_the_waves() -> None:
    """Of a facet edge-on to the straight waves, which has no current of them, the factor is none:
    nothing over nothing made the whole echo no number.
    """
    bends = SimpleNamespace(source=np.zeros((2, 3)), known=np.full((2, 3), [5.0, 0.0, 0.0]))
    back = np.array([[-1.0, 0.0, 0.0], [-0.8, 0.6, 0.0]])
    ways = SimpleNamespace(bends=bends, paths=SimpleNamespace(back=back))
    normals = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    factor = _askew(ways, np.arange(2), np.array([[0, 0], [1, 1]]), normals, np.arange(2))
    np.testing.assert_allclose(factor, [1.0, 0.9])


def test_a_body_in_the_plane_of_symmetry_has_an_echo() -> None:
    """Its sides are edge-on, and the screen's edge is level with it."""
    corners = [[x, y, z] for x in (8.0, 8.1) for y in (-0.05, 0.05) for z in (-0.05, 0.05)]
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    edge = [[4, -2, 0.0], [4, 2, 0.0], [4, 2, -2], [4, -2, -2]]
    found = trace(
        world(quad("screen", edge, radar="obstacle"), thing("box", corners, faces)), RADAR
    )
    (body,) = found.bodies
    assert np.isfinite(found.contributions.amplitude).all()
    assert 0 < body.estimated_error < 1
