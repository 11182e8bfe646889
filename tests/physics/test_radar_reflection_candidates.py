"""Facets from which something is hit by reflection, told by one ray each."""

import numpy as np
import pytest

from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, ball, reshaped, thing, world
from twin.radar.propagation.facets.front_facets import illuminated_facets
from twin.radar.propagation.facets.ray_hits import reflected_ray_hits
from twin.radar.propagation.facets.reflection_candidates import reflection_candidates
from twin.radar.propagation.facets.scatterers import scatterers
from twin.radar.propagation.physical_optics import _bodies
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.scene import SceneObject


def loose(item: SceneObject) -> SceneObject:
    """Every face with corners of its own."""
    points = item.vertices_m[item.geometry.faces].reshape(-1, 3)
    return reshaped(item, points, np.arange(len(points)).reshape(-1, 3))


def mirror(count: int = 20, side_m: float = 0.4) -> SceneObject:
    """A square of many facets, turned by 45 deg."""
    row, column = np.divmod(np.arange((count + 1) ** 2), count + 1)
    along, up = ((value / count - 0.5) * side_m for value in (row, column))
    points = np.stack([10 + along * np.sqrt(0.5), along * np.sqrt(0.5), up], axis=1)
    at = np.flatnonzero((row < count) & (column < count))
    across = at + count + 1
    first, second = np.stack([at, across, across + 1], 1), np.stack([at, across + 1, at + 1], 1)
    return thing("mirror", points, np.concatenate([first, second]), radar="optics")


@pytest.mark.parametrize("is_loose", [False, True])
def test_neighbours_of_what_sees_something_are_looked_at(is_loose: bool) -> None:
    """A mirror of 800 facets shows a ball: all by a corner of which the ball is seen are found,
    though not by their own centroids; most see nothing. With corners of their own they do as well.
    Fails where neighbours do not count.
    """
    item = loose(mirror()) if is_loose else mirror()
    scene = world(item, ball("ball", (10.0, 1.5, 0.0), 0.1, level=3))
    prepared = prepare_scene(
        scene, RADAR, assign_scattering_models(scene, WAVELENGTH_M, with_optics=True), 0
    )
    s, b = prepared.context, scatterers(prepared, RADAR.antenna, _bodies(prepared))
    facets = illuminated_facets(s, b, prepared.images)
    lit = facets.take(facets.all)
    by_any = reflected_ray_hits(s, b, lit, 4).is_valid.any(axis=0)
    by_own = reflected_ray_hits(s, b, lit, 1).is_valid[0]
    found = np.isin(facets.all, reflection_candidates(s, b, facets, 1.0))
    of_mirror = lit.body == lit.body[0]
    assert np.count_nonzero(of_mirror & by_any & ~by_own) > 20
    assert not (of_mirror & by_any & ~found).any()
    assert np.count_nonzero(found) < 0.6 * len(facets)
