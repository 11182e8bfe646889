"""Edges of tall metal prisms against a method of moments in two dimensions (Harrington, Field
Computation by Moment Methods, chapter 3): level and stated error of a body hold its edges.

The oracle: currents on the outline of a prism in a plane wave, piecewise constant on pieces that
are shorter towards edges, matched at their middles; with the field along the prism its tangential
part vanishes (EFIE), with the field across it half the magnetic current is that of the rest (MFIE,
of closed outlines, which fails at the few frequencies at which the inside resonates: medians do not
hold these). What scatters back over what physical optics says is independent of the prism's height.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.special import hankel2

from tests.physics.radar_worlds import RADAR, thing, world
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions
from twin.scene import SceneObject

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PER_WAVELENGTH = 24
HEIGHT_M, PLACE_M = 0.3, 40.0
#: So strong that no echo here is faint.
STRONG = RADAR.with_({"front_end.transmit_power_w": 1e4})
BAND_HZ = 79e9 + np.linspace(-0.5, 0.5, 21) * RADAR.ofdm.bandwidth_hz
ALONG, ACROSS = "along", "across"


@dataclass(frozen=True)
class Prism:
    """A plate (depth 0) or a box, turned by an angle from square to the radar, the field ``along``
    its edges or ``across`` them.
    """

    depth_m: float
    width_m: float
    angle_deg: float
    field: str

    @property
    def outline(self) -> Array:
        """Corners, relative to its middle, anticlockwise."""
        u, v = self.depth_m / 2, self.width_m / 2
        corners = [[0, -v], [0, v]] if not u else [[-u, -v], [u, -v], [u, v], [-u, v]]
        angle = np.radians(self.angle_deg)
        c, s = np.cos(angle), np.sin(angle)
        return np.array(corners) @ np.array([[c, s], [-s, c]])

    @property
    def body(self) -> SceneObject:
        """Upright, or lying where the field is across it."""
        x, y = self.outline.T
        low, high = (np.column_stack([x, y, 0 * x + z]) for z in (-HEIGHT_M / 2, HEIGHT_M / 2))
        n = len(x)
        sides = [[k, (k + 1) % n, k + n] for k in range(n)]
        sides += [[(k + 1) % n, (k + 1) % n + n, k + n] for k in range(n)]
        ends = [] if n == 2 else [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
        faces = [[0, 1, 3], [0, 3, 2]] if n == 2 else sides + ends
        vertices = np.vstack([low, high])
        if self.field == ACROSS:
            vertices = vertices[:, [0, 2, 1]] * [1, -1, 1]
        return thing("prism", vertices + [PLACE_M, 0, 0], faces)


def pieces(prism: Prism, wavelength_m: float) -> tuple[Array, Array, Array]:
    """Middles (n, 2), outer normals (n, 2) and lengths (n,) of pieces of the outline."""
    corners, parts = prism.outline, []
    count = len(corners) if len(corners) > 2 else 1
    for k in range(count):
        begin, end = corners[k], corners[(k + 1) % len(corners)]
        length = float(np.linalg.norm(end - begin))
        n = int(np.ceil(PER_WAVELENGTH * length / wavelength_m))
        share = (1 - np.cos(np.pi * np.arange(n + 1) / n)) / 2
        middle = begin + np.outer((share[1:] + share[:-1]) / 2, end - begin)
        along = (end - begin) / length
        parts.append((middle, np.tile([along[1], -along[0]], (n, 1)), np.diff(share) * length))
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))  # type: ignore[return-value]


def over_physical_optics(prism: Prism, frequency_hz: float) -> complex:
    """What scatters back over what physical optics says."""
    k = 2 * np.pi * frequency_hz / speed_of_light
    place, normal, length = pieces(prism, 2 * np.pi / k)
    apart = place[:, None] - place
    distance = np.linalg.norm(apart, axis=2)
    np.fill_diagonal(distance, 1.0)
    incident = np.exp(-1j * k * place[:, 0])
    is_lit = normal[:, 0] < 0 if prism.depth_m else np.ones(len(place), dtype=bool)
    back = length * incident
    if prism.field == ALONG:
        matrix = k / 4 * hankel2(0, k * distance) * length
        euler = 1.781072418
        own = k / 4 * length * (1 - 2j / np.pi * (np.log(euler * k * length / 4) - 1))
        np.fill_diagonal(matrix, own)
        current = np.linalg.solve(matrix, incident)
        return complex(current @ back / (2 * np.abs(normal[:, 0]) * is_lit * incident @ back))
    slope = 1j / 4 * hankel2(1, k * distance) * k
    slope = slope * np.einsum("ijk,jk->ij", -apart, normal) / distance
    np.fill_diagonal(slope, 0)
    field = np.linalg.solve(np.eye(len(place)) / 2 - slope * length, incident)
    weight = -normal[:, 0] * back
    return complex(field @ weight / (2 * incident * is_lit @ weight))


def channel(echoes: Contributions) -> Complex:
    turns = np.outer(BAND_HZ, echoes.delay_s) % 1
    return np.asarray(np.exp(-2j * np.pi * turns) @ echoes.amplitude)


def rms(values: Complex) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def usual(values: Complex) -> float:
    return float(np.median(np.abs(values)))


PRISMS = [
    *(Prism(0.0, 0.03, angle, ALONG) for angle in (25, 45, 65, 80)),
    *(Prism(0.03, 0.03, angle, ALONG) for angle in (20, 45)),
    *(Prism(0.02, 0.03, angle, ACROSS) for angle in (30, 45)),
    Prism(0.04, 0.06, 30, ACROSS),
]


@pytest.mark.quick(1)
@pytest.mark.parametrize("prism", PRISMS, ids=str)
def test_level_and_error_of_a_prism_hold_its_edges(prism: Prism) -> None:
    """The level had been that of the facets alone, 17 dB too low of a plate seen at 80 degrees, and
    of what edges are off by nothing was stated: up to 0.23 of that level.
    """
    found = trace(world(prism.body), STRONG)
    of_edges = found.echoes.bounces == 0
    of_facets = found.echoes.take(np.flatnonzero(~of_edges))
    truth = channel(of_facets) * [over_physical_optics(prism, f) for f in BAND_HZ]
    error = usual(channel(found.echoes) - truth)
    (body,) = found.bodies
    assert usual(channel(found.echoes)) == pytest.approx(usual(truth), rel=0.15)
    assert body.amplitude == pytest.approx(rms(channel(found.echoes)), rel=0.02)
    stated = body.estimated_error * body.level_amplitude
    assert error < stated
    edges = rms(channel(found.echoes.take(np.flatnonzero(of_edges))))
    assert stated < 0.5 * edges + 0.03 * body.level_amplitude
