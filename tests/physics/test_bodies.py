"""The scenes' car and person answer a 79 GHz radar about as strongly and unevenly as real ones.

docs/bodies.md says where the published cross-sections were read, and what was not to be had.
"""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.constants import speed_of_light

from benchmarks.bodies import body, over_aspect

BODIES = Path(__file__).parents[2] / "scenes" / "bodies"
WAVELENGTH = speed_of_light / 79e9

#: 3GPP TR 38.901, table 7.9.2.1-4, passenger car, level with it, over all azimuths, with its
#: log-normal spread: mean of m^2, mean of dB, standard deviation in dB.
CAR = (13.4, 9.4, 5.6)
#: JRC78619: two adults in four kinds of clothes, means over azimuth and 76 to 81 GHz at 3.4 m.
PERSON_DBSM = (-6.07, -6.86, -3.51, -4.82, -5.22, -6.59, -5.43, -6.43)
#: 3GPP TR 38.901, table 7.9.2.1-1: standard deviation in dB.
PERSON_SPREAD = 3.94


def _decibel(sigma):
    return 10 * np.log10(sigma)


@pytest.mark.parametrize(
    "part", ["car", "car_windows", "car_wheels", "car_rims", "person", "person_head"]
)
def test_facets_follow_their_surface(part):
    """Nine in ten edges between facets of a smooth surface lie within 1 / 11 wavelength of it.

    Bend and width of two neighbours are trimesh's own (radius and span); what turns by more than
    15 deg is an edge of the body. The meshes before these had up to three quarters of a wavelength.
    """
    mesh = trimesh.load(BODIES / f"{part}.ply")
    turn = mesh.face_adjacency_angles
    smooth = (turn > 1e-4) & (turn < np.radians(15))
    sagitta = (mesh.face_adjacency_span**2 / (32 * mesh.face_adjacency_radius))[smooth]
    assert np.percentile(sagitta, 90) < WAVELENGTH / 11


@pytest.mark.parametrize(
    ("parts", "most"),
    [
        (("car", "car_windows", "car_wheels", "car_rims", "car_plate"), 30_000),
        (("person", "person_head"), 13_000),
    ],
)
def test_meshes_stay_light(parts, most):
    """What every ray and every triangle of the radar's solvers pays for."""
    meshes = [trimesh.load(BODIES / f"{part}.ply") for part in parts]
    assert sum(len(mesh.faces) for mesh in meshes) < most


@pytest.mark.parametrize("part", ["car_windows", "car_wheels", "car_rims", "person", "person_head"])
def test_solid_parts_are_closed(part):
    """Glass, rubber and cloth let waves in: what they fill must have an inside."""
    assert trimesh.load(BODIES / f"{part}.ply").is_watertight


@pytest.mark.thorough
def test_a_car_is_bright_from_most_sides():
    """Between its flashes the car lies near what was measured, not 10 dB below it.

    Mean of dB over 10 aspects at one frequency: of a spread of 6 dB within 1.9 dB, and 3 of these
    are allowed. The car without recesses, rims and wheel houses has -0.9 dBsm.
    """
    sigma = over_aspect(body("car"), np.arange(9.3, 360, 36.0), 10.0, (79e9,), 0.1)
    assert abs(_decibel(sigma).mean() - CAR[1]) < 5.7


@pytest.mark.slow
def test_car_over_aspect():
    """Means within 3 dB, spread within a factor of 2 of the published ones.

    36 aspects at three frequencies, 108 figures of 6 dB of spread: within 0.6 dB of their mean.
    """
    sigma = over_aspect(body("car"), np.arange(0.7, 360, 10.0), 10.0, (76.5e9, 78e9, 79.5e9), 0.1)
    assert abs(_decibel(sigma.mean()) - CAR[0]) < 3
    assert abs(_decibel(sigma).mean() - CAR[1]) < 3
    assert CAR[2] / 2 < _decibel(sigma).std() < CAR[2] * 2


@pytest.mark.slow
def test_person_over_aspect():
    """Mean within 3 dB of that of two adults in four dresses, spread within a factor of 2.

    At the distance and the height of the antenna of the measurement.
    """
    sigma = over_aspect(body("person"), np.arange(0.7, 360, 10.0), 3.4, (76.5e9, 78e9, 79.5e9), 0.1)
    band = sigma.mean(axis=0)
    measured = np.mean(10 ** (np.array(PERSON_DBSM) / 10))
    assert abs(_decibel(band.mean() / measured)) < 3
    assert PERSON_SPREAD / 2 < _decibel(band).std() < PERSON_SPREAD * 2
