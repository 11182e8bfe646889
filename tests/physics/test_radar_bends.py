"""Waves over edges and corners, from a place to which they are known to others beside it."""

import numpy as np
import pytest

from benchmarks.kirchhoff import field_behind
from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, plate, thing, world
from tests.physics.shadow_worlds import Array, K
from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.screens import screens
from twin.radar.propagation.one_way.points import paths_to_points
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.rows import phasors
from twin.scene import SceneObject

#: Corners before the middle of a place 10 m away: of a rectangle, and between those of an L.
RECTANGLE = [((0.0, 0.3), (0.0, 0.25))]
ELL = [((-0.3, 0.0), (-0.25, 0.0)), ((0.0, 0.3), (-0.25, 0.0)), ((-0.3, 0.0), (0.0, 0.25))]


@pytest.mark.parametrize(
    "known", [(0.006, 0.004), (-0.005, 0.006), (-0.004, -0.005), (0.007, -0.006)]
)
@pytest.mark.parametrize("sides", [RECTANGLE, ELL], ids=["rectangle", "ell"])
def test_waves_go_on_round_a_corner(sides, known: tuple[float, float]) -> None:
    """From one place in each quarter to places in all of them the sum of all waves is Kirchhoff's
    field: in the light, in the shadow, and past the ends of both edges. Where the wave over the
    corner keeps its amplitude, it is off by up to 0.1; where both edges are one wave, by 0.16.
    """
    off = np.random.default_rng(3).uniform(-0.012, 0.012, (60, 2))
    places = np.column_stack([np.full(60, 10.0), off])
    due = 1 - sum(1 - field_behind(corners, places, K) for corners in rectangles(sides))
    got = continued(sheet(sides), np.array([[10.0, *known]]), places)
    np.testing.assert_allclose(got, due, rtol=0, atol=1.5e-3)


@pytest.mark.parametrize("sides", [RECTANGLE, ELL], ids=["rectangle", "ell"])
@pytest.mark.parametrize("along", [-0.007, 0.0, 0.005])
def test_waves_are_steady_at_borders_and_at_the_corner(sides, along: float) -> None:
    """Facets are cut at borders, so that corners of theirs lie on these, and on two at once. There
    the wave over the corner was off by 0.5.
    """
    item, known = sheet(sides), np.array([[10.0, 0.006, -0.004]])
    for across in ([1.0, 0.0], [0.0, 1.0]):
        beside = np.outer([-1e-7, 0.0, 1e-7], across) + along * np.array(across)[::-1]
        field = continued(item, known, np.column_stack([np.full(3, 10.0), beside]))
        np.testing.assert_allclose(field, field[1], rtol=0, atol=1e-4)


def rectangles(sides) -> Array:
    """Corners (n, 4, 3) of rectangles 6 m away."""
    return np.array(
        [[[6.0, y[i], z[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))] for y, z in sides]
    )


def sheet(sides) -> SceneObject:
    corners = rectangles(sides).reshape(-1, 3)
    vertices, number = np.unique(corners, axis=0, return_inverse=True)
    quads = number.reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return thing("sheet", vertices, faces, radar="obstacle")


def continued(item: SceneObject, known: Array, places: Array) -> np.ndarray:
    """The field at places (n, 3) over the straight wave, by the paths to one that is ``known``."""
    scene = world(item, plate("body", (10, 0, 0), side=1e-3, radar="optics"))
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    prepared = prepare_scene(scene, RADAR, roles, 0)
    obstacles = screens(prepared, 60.0, np.array([-1, 0], dtype=np.int32))
    assert obstacles is not None
    off, own = np.zeros((1, 3)), np.zeros(1, dtype=np.int64)
    found = all_paths_to_points(prepared.context, obstacles, 0, known, off, own)
    straight = paths_to_points(prepared.context, 0, known, off, unshadowed=True)
    source = prepared.images[0].place
    bends = Bends.of(source, known[found.point], found.diffracted, K)
    longer_m = found.paths.extra - straight.extra[found.point]
    field = np.zeros(len(places), dtype=complex)
    for path, share in enumerate(found.over(straight)):
        change = bends.to(np.full(len(places), path), places)
        field += share * change.factor * phasors(-K * (longer_m[path] + change.longer_m))
    return field
