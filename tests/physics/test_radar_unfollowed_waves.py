"""What is stated of waves round obstacles that are too faint to be followed."""

import numpy as np
import pytest
from scipy.special import erf

from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, plate, quad, world
from tests.physics.shadow_worlds import BEND
from twin.radar.propagation.diffraction.screens import screens
from twin.radar.propagation.diffraction.shadowed_facets import front_facets
from twin.radar.propagation.diffraction.unfollowed_waves import faint_waves
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models


@pytest.mark.parametrize("half_cycles", [0.3, 1.0, 1.5, 2.0])
def test_waves_past_both_sides_of_a_post_differ_in_sign(half_cycles: float) -> None:
    """A strip half a metre beside the line of sight takes from the field what Fresnel's integral
    over it says: most where the ways past both of its sides are half a cycle apart, next to nothing
    where they are a whole one apart. The other way round without the sign of either wave.
    """
    near, far = 0.5, np.sqrt(0.25 + half_cycles * np.pi / BEND)
    root = np.sqrt(1j * BEND)
    due = 2 * abs(erf(root * far) - erf(root * near)) / 2
    assert stated((near, far), (-50, 50)) == pytest.approx(due, abs=0.004)
    assert due < 0.005 if half_cycles == 2.0 else due > 0.02


@pytest.mark.parametrize(
    ("y_m", "z_m"),
    [((0.5, 0.53), (0.2, 0.25)), ((0.3, 0.4), (-0.65, -0.6)), ((-0.43, -0.4), (0.02, 0.5))],
)
def test_waves_past_the_corners_of_a_sheet_differ_in_sign(
    y_m: tuple[float, float], z_m: tuple[float, float]
) -> None:
    """A sheet above or below and beside the line of sight takes from the field the product of two
    of Fresnel's integrals: by waves over its four corners, 0.4 to 0.8 times as much if all had one
    sign.
    """
    root = np.sqrt(1j * BEND)
    parts = [(erf(root * far) - erf(root * near)) / 2 for near, far in (y_m, z_m)]
    assert stated(y_m, z_m) == pytest.approx(2 * abs(parts[0] * parts[1]), rel=0.1)


def stated(y_m: tuple[float, float], z_m: tuple[float, float]) -> float:
    """Of a small plate 10 m away, over its own echo, by a sheet 6 m away."""
    sides = ((y_m[0], z_m[0]), (y_m[1], z_m[0]), (y_m[1], z_m[1]), (y_m[0], z_m[1]))
    sheet = quad("sheet", [[6, y, z] for y, z in sides], radar="obstacle")
    scene = world(sheet, plate("body", (10, 0, 0), side=1e-3, radar="optics"))
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    owner = np.array([-1, 0], dtype=np.int32)
    obstacles = screens(prepare_scene(scene, RADAR, roles, 0), 30.0, owner)
    assert obstacles is not None
    view = View(obstacles, 0)
    facets = front_facets(obstacles, 0, view.place)
    strength = np.full(len(facets), 1 / len(facets))
    found = faint_waves(view, view, facets, 0, strength, np.full(1, 2.0), 1e-4)
    return found.of_body(np.ones(1))
