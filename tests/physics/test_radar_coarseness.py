"""A mesh too coarse for the wavelength is warned of, with the size of the error."""

import re

import numpy as np
import pytest
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    GAIN,
    OPTICS,
    RADAR,
    ball,
    thing,
    trihedral,
    world,
)
from twin.radar import radar_capture
from twin.radar.propagation.solvers import trace


def coarse(*objects) -> list[str]:
    found = radar_capture(world(*objects), RADAR, fidelity=OPTICS)
    return [line for line in found.warnings if "facets are too coarse" in line]


def test_a_coarse_sphere_is_warned_of_and_a_fine_one_is_not() -> None:
    """A sphere of 0.15 m at 79 GHz: 5 120 facets leave +/- 0.8 dB, 81 920 less than 0.1 dB."""
    (line,) = coarse(ball("sphere", (8.0, 0.0, 0.0), level=4))
    assert re.search(r"worst sphere, whose echo has an error of 0\.8 dB", line)
    assert coarse(ball("sphere", (8.0, 0.0, 0.0), level=6)) == []
    spheres = [ball(f"level {n}", (8.0, n - 4.0, 0.0), level=n) for n in (3, 4, 6)]
    (line,) = coarse(*spheres)
    assert "worst level 3," in line
    assert "(and 1 more, by less)" in line


@pytest.mark.quick(1)
@pytest.mark.parametrize("level", [4, 5])
def test_the_error_is_as_large_as_said(level: int) -> None:
    """A sphere's echo in the optical limit against that of its facets at 9 frequencies and in 4
    positions: the complex rms, of which the level shows half the power, within a factor of 2 of
    what is said.
    """
    radius, off = 0.15, []
    said = (
        4
        * np.pi
        * CARRIER_HZ
        / speed_of_light
        * ball("b", (8, 0, 0), level=level).geometry.shape.depth_m
    )
    frequencies = CARRIER_HZ + np.linspace(-2e9, 2e9, 9)
    for y, z in ((0.0, 0.0), (0.3, 0.1), (-0.2, 0.3), (0.5, -0.4)):
        found = trace(world(ball("b", (8.0, y, z), level=level)), RADAR, fidelity=OPTICS, seed=0)
        echo = np.array(
            [
                np.sum(
                    found.surfaces.amplitude
                    * (CARRIER_HZ / f) ** found.surfaces.falloff
                    * np.exp(-2j * np.pi * (f * found.surfaces.delay_s % 1.0))
                )
                for f in frequencies
            ]
        )
        distance = np.linalg.norm([8.0, y, z])
        nearest = distance - radius
        pattern = RADAR.antenna.gain(np.array([8.0, y, z]) / distance) / 100.0
        # By stationary phase from a finite distance: r / (2 R (R - r)).
        expected = GAIN * pattern * speed_of_light / frequencies / (4 * np.pi)
        expected *= radius / (2 * nearest * distance)
        off.append(np.abs(echo) / expected - 1)
    assert said / 2 < np.sqrt(np.mean(np.square(off))) * 2**0.5 < said * 2


def test_what_is_meant_flat_is_not_coarse() -> None:
    """A trihedral, a box, and a thin wedge folded back upon itself have no smooth surface; a
    cylinder of 64 strips has, and its quadrangles' triangles are one facet.
    """
    box = np.array([[x, y, z] for x in (8, 8.5) for y in (0, 0.4) for z in (0, 0.3)])
    sides = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    sides += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    wedge = [[8, 0, 0], [8, 0, 0.3], *([x, 0.5, z] for x in (8, 8.004) for z in (0.3, 0))]
    around = [[0, 1, 2], [0, 2, 3], [0, 5, 4], [0, 4, 1], [3, 2, 4], [3, 4, 5]]
    folded = thing("wedge", wedge, around)
    for item in (trihedral("t", (8.0, 0.0, 0.0)), thing("box", box, sides), folded):
        assert item.geometry.shape.depth_m == 0
    angle, radius = np.arange(64) * 2 * np.pi / 64, 0.08
    ring = np.stack([8 + radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    points = np.vstack([np.column_stack([ring, np.full(64, z)]) for z in (0.0, 0.5)])
    i = np.arange(64)
    j = (i + 1) % 64
    faces = np.vstack([np.column_stack([i, j, j + 64]), np.column_stack([i, j + 64, i + 64])])
    width = 2 * radius * np.sin(np.pi / 64)
    depth = width**2 / (2 * radius) * np.sqrt(1 / 80 - 1 / 144)
    assert depth < thing("post", points, faces).geometry.shape.depth_m < 1.5 * depth
