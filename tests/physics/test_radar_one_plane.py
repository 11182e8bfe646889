"""Surfaces in one plane echo once, whichever objects they are of."""

import numpy as np
import pytest
import trimesh

from tests.physics.radar_worlds import (
    GAIN,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    plate,
    thing,
    wave,
    world,
)
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject

K = 2 * np.pi / WAVELENGTH_M


def box(name: str, low, high) -> SceneObject:
    mesh = trimesh.creation.box(bounds=[low, high])
    return thing(name, mesh.vertices, mesh.faces)


def front(y_m: tuple[float, float], z_m: tuple[float, float], x_m: float) -> complex:
    """Physical optics of a conducting rectangle across x, by quadrature of its surface."""
    y, z = (low + (high - low) * (np.arange(400) + 0.5) / 400 for low, high in (y_m, z_m))
    y, z = np.meshgrid(y, z)
    r = np.sqrt(x_m**2 + y**2 + z**2)
    area = (y_m[1] - y_m[0]) * (z_m[1] - z_m[0]) / y.size
    gain = GAIN * (x_m / r) ** 49
    return 1j * np.sum(gain * x_m / r * np.exp(-2j * K * r) / (4 * np.pi * r**2)) * area


def level_db(objects: list[SceneObject], expected: complex) -> float:
    echo = wave(trace(world(*objects), RADAR, fidelity=OPTICS).contributions)
    return float(20 * np.log10(abs(echo) / abs(expected)))


SIDE = -0.05, 0.05
TURNED = [[0, 1, 3], [1, 2, 3]]  # a square's other diagonal


@pytest.mark.parametrize("gap_m", [0.0, 1e-6, 1e-5])
def test_a_plate_before_its_like_hides_it_however_near(gap_m: float) -> None:
    """Shadow rays start 10 um off a plate at 10 m: it was 6 dB too much."""
    one = plate("one", (10, 0, 0), 0.1)
    other = thing("other", one.vertices_m - [gap_m, 0, 0], TURNED)
    expected = front(SIDE, SIDE, 10.0)
    for objects in ([one, other], [other, one]):
        assert level_db(objects, expected) == pytest.approx(0, abs=0.1)


def test_labels_and_flush_fronts() -> None:
    """A label on a plate and on a box, half as large and as large, and boxes that overlap with
    their fronts in one plane: it was 1.9, 6 and 2.7 dB too much.
    """
    label = plate("label", (10, 0, 0), 0.05)
    body = box("body", (10, -0.05, -0.05), (10.1, 0.05, 0.05))
    whole = front(SIDE, SIDE, 10.0)
    for under in (plate("sheet", (10, 0, 0), 0.1), body):
        for objects in ([under, label], [label, under], [under, plate("on", (10, 0, 0), 0.1)]):
            assert level_db(objects, whole) == pytest.approx(0, abs=0.1)
    beside = box("beside", (10, 0, -0.05), (10.1, 0.1, 0.05))
    both = front((-0.05, 0.1), SIDE, 10.0)
    assert level_db([body, beside], both) == pytest.approx(0, abs=0.1)


def test_of_two_surfaces_in_one_plane_the_later_echoes_and_else_the_nearer() -> None:
    """Wood on metal, as told by its weaker echo."""
    metal = plate("metal", (10, 0, 0), 0.1)
    whole = front(SIDE, SIDE, 10.0)

    def board(x_m: float) -> SceneObject:
        return plate("board", (x_m, 0, 0), 0.1, "wood")

    assert level_db([metal, board(10.0)], whole) < -3
    assert level_db([board(10.0), metal], whole) == pytest.approx(0, abs=0.1)
    assert level_db([board(10.0 - 5e-6), metal], whole) < -3
    assert level_db([metal, board(10.0 + 5e-6)], whole) == pytest.approx(0, abs=0.1)
