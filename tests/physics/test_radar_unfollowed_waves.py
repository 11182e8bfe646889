"""What is stated of waves round obstacles that are too faint to be followed."""

import numpy as np
import pytest
from scipy.special import erf

from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, plate, quad, world
from twin.radar.propagation.diffraction.screens import screens
from twin.radar.propagation.diffraction.shadowed_facets import front_facets
from twin.radar.propagation.diffraction.unfollowed_waves import faint_waves
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models

K = 2 * np.pi / WAVELENGTH_M


@pytest.mark.parametrize("half_cycles", [0.3, 1.0, 1.5, 2.0])
def test_waves_past_both_sides_of_a_post_differ_in_sign(half_cycles: float) -> None:
    """A strip half a metre beside the line of sight takes from the field what Fresnel's integral
    over it says: most where the ways past both of its sides are half a cycle apart, next to nothing
    where they are a whole one apart. The other way round without the sign of either wave.
    """
    bend = K / 2 * (1 / 6 + 1 / 4)
    near, far = 0.5, np.sqrt(0.25 + half_cycles * np.pi / bend)
    sides = ((near, -50), (far, -50), (far, 50), (near, 50))
    strip = quad("strip", [[6, y, z] for y, z in sides], radar="obstacle")
    body = plate("body", (10, 0, 0), side=1e-3, radar="optics")
    scene = world(strip, body)
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    owner = np.array([-1, 0], dtype=np.int32)
    obstacles = screens(prepare_scene(scene, RADAR, roles, 0), 30.0, owner)
    assert obstacles is not None
    view = View(obstacles, 0)
    facets = front_facets(obstacles, 0, view.place)
    strength = np.full(len(facets), 1 / len(facets))
    found = faint_waves(view, view, facets, 0, strength, np.full(1, 2.0)).of_body(np.ones(1))
    root = np.sqrt(1j * bend)
    due = 2 * abs(erf(root * far) - erf(root * near)) / 2
    assert found == pytest.approx(due, abs=0.004)
    assert due < 0.005 if half_cycles == 2.0 else due > 0.02
