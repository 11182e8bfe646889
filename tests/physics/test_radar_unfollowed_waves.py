"""What is stated of waves round obstacles that are too faint to be followed."""

import numpy as np
import pytest
from scipy.special import erf

from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, plate, quad, world
from tests.physics.shadow_worlds import BEND
from twin.radar.propagation.diffraction import unfollowed_waves
from twin.radar.propagation.diffraction.screens import screens
from twin.radar.propagation.diffraction.shadowed_facets import front_facets
from twin.radar.propagation.diffraction.unfollowed_waves import faint_waves
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.rows import lengths
from twin.scene import SceneObject


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
    monkeypatch, y_m: tuple[float, float], z_m: tuple[float, float]
) -> None:
    """At one frequency a sheet above or below and beside the line of sight takes from the field the
    product of two of Fresnel's integrals: by waves over its four corners, 0.4 to 0.8 times as much
    if all had one sign.
    """
    monkeypatch.setattr(unfollowed_waves, "_BIN_M", 10.0)
    root = np.sqrt(1j * BEND)
    parts = [(erf(root * far) - erf(root * near)) / 2 for near, far in (y_m, z_m)]
    assert stated(y_m, z_m) == pytest.approx(2 * abs(parts[0] * parts[1]), rel=0.25)


@pytest.mark.parametrize("turn_deg", [5.0, 15.0, 40.0])
@pytest.mark.parametrize("size_m", [0.05, 0.01, 0.003])
def test_parts_of_a_plate_far_from_square_nearly_cancel(turn_deg: float, size_m: float) -> None:
    """A plate of 8 cm, 10 m away and turned about the vertical, beside a strip 6 m away: what the
    strip takes from its echo, over the band, as Fresnel's integral says at every spot of it. Parts
    of it nearly cancel, large ones or small: were they cut where lengths are told apart, they would
    tell up to 1.7 times as much.
    """
    near, far, side = 0.55, 0.65, 0.08
    turn = np.radians(turn_deg)
    across, k = np.array([-np.sin(turn), np.cos(turn), 0]), 2 * np.pi / WAVELENGTH_M
    spots = (np.arange(400) + 0.5) / 400 - 0.5
    place = [10, 0, 0] + side * spots[:, None] * across
    straight = np.linalg.norm(place, axis=1)
    due = []
    for wavenumber in k + np.linspace(-42, 42, 41):  # a band of 4 GHz
        bend = np.sqrt(1j * wavenumber / 2 * (1 / 6 + 1 / (place[:, 0] - 6)))
        off = 6 / place[:, 0] * place[:, 1]
        missing = (erf(bend * (far - off)) - erf(bend * (near - off))) / 2
        due.append(np.mean(2 * missing * np.exp(-2j * wavenumber * straight)))
    up = np.array([0, 0, 1])
    sides = [sign * across + z * up for sign, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    body = quad("body", np.array([10, 0, 0]) + side / 2 * np.array(sides), radar="optics")
    found = stated((near, far), (-50, 50), body, size_m)
    assert found == pytest.approx(np.sqrt(np.mean(np.abs(due) ** 2)), rel=0.35)


def stated(
    y_m: tuple[float, float],
    z_m: tuple[float, float],
    body: SceneObject | None = None,
    size_m: float = 1.0,
) -> float:
    """Of a body 10 m away, a small plate, over its own echo were it in phase, by a sheet 6 m away;
    in facets of at most a size.
    """
    sides = ((y_m[0], z_m[0]), (y_m[1], z_m[0]), (y_m[1], z_m[1]), (y_m[0], z_m[1]))
    sheet = quad("sheet", [[6, y, z] for y, z in sides], radar="obstacle")
    scene = world(sheet, body or plate("body", (10, 0, 0), side=1e-3, radar="optics"))
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    owner = np.array([-1, 0], dtype=np.int32)
    obstacles = screens(prepare_scene(scene, RADAR, roles, 0), 30.0, owner)
    assert obstacles is not None
    view = View(obstacles, 0)
    facets = front_facets(obstacles, 0, view.place)
    facets = facets.divided(np.full(len(facets), size_m))
    area = lengths(facets.across)
    found = faint_waves(view, view, facets, 0, area / area.sum(), np.full(1, 2.0), 1e-4)
    return found.of_body(np.ones(1))
