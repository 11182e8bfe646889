"""A textured plane that moves before the camera: its moving image is known in closed form.

The light of a cell is the integral of rho(y, z) cos^7 / (pi d^2) over the cell. The reflectance is
constant in each texel, and texels slide over cells: between any two neighbouring edges, of cells or
of texels, the integrand is smooth and 4 x 4 nodes of Gauss and Legendre integrate it to rounding.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from tests.physics.moving_worlds import exposed, going, passed, small, world
from twin.camera.chain import Chain
from twin.camera.exposures import Exposures
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.scene import SceneObject
from twin.scene.texture import Texture
from twin.system import System

Array = NDArray[np.float64]

DISTANCE_M, SIDE_M, SIDE = 5.0, 9.0, 8
#: Times within an exposure of which the mean is taken.
TIMES = 4
TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class Plane:
    """A plate of 9 m that faces the rig, u along y and v along z, as far as its texture goes."""

    reflectance: Array

    @classmethod
    def of(cls, texels: int, brightest: float) -> "Plane":
        rng = np.random.default_rng(4)
        return cls(rng.uniform(brightest / 10, brightest, (texels, texels)))

    @property
    def item(self) -> SceneObject:
        low, high = -SIDE_M / 2, SIDE_M / 2
        across = ((low, low), (high, low), (high, high), (low, high))
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
        corners, faces = np.array([(DISTANCE_M, *at) for at in across]), [[0, 2, 1], [0, 3, 2]]
        texture = Texture(self.reflectance.astype(np.float32), "nearest", "clamp")
        geometry = Geometry(corners, np.array(faces, np.int32), uv)
        return SceneObject("plane", geometry, "m", texture)

    def light(self, half_field: float, moved_m: Array) -> Array:
        """Of all cells (n_cells,), when it has moved by so many metres along y and z; the first
        cell is on top to the left, where y and z are greatest.
        """
        borders = half_field * np.linspace(-1, 1, SIDE + 1)
        edges = np.linspace(-SIDE_M / 2, SIDE_M / 2, len(self.reflectance) + 1)
        (y, wide, column, of_column), (z, high, row, of_row) = (
            pieces(borders, (edges + moved) / DISTANCE_M) for moved in moved_m
        )
        falls = (1 + z[:, :, None, None] ** 2 + y**2) ** -3.5 / (np.pi * DISTANCE_M**2)
        smooth = np.einsum("iajb,ia,jb->ij", falls, high, wide)
        cells = of_row @ (self.reflectance[np.ix_(row, column)] * smooth) @ of_column.T
        return cells[::-1, ::-1].ravel()


def pieces(borders: Array, edges: Array) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Nodes and weights (n, 4) of the pieces of an axis between borders of cells and edges of
    texels, ascending; the texel of each; and, of each cell, its pieces as ones, (n_cells, n).
    """
    inner = edges[(edges > borders[0]) & (edges < borders[-1])]
    ends = np.sort(np.concatenate([borders, inner]))
    points, weights = leggauss(4)
    middles, halves = (ends[1:] + ends[:-1])[:, None] / 2, np.diff(ends)[:, None] / 2
    texel = np.searchsorted(edges, middles[:, 0]) - 1
    cell = np.searchsorted(borders, middles[:, 0]) - 1
    of_cell = (cell == np.arange(len(borders) - 1)[:, None]).astype(float)
    return middles + halves * points, halves * weights, texel, of_cell


@pytest.fixture(scope="module")
def system() -> System:
    """8 x 8 cells of 0.22 m on the plane, 128 exposures in 12.8 ms."""
    side = {"value": SIDE, "assumed": "test"}
    patterns = {"value": SIDE**2, "assumed": "test"}
    return small(emitter__rows=side, emitter__columns=side, acquisition__n_patterns=patterns)


@pytest.mark.parametrize(
    ("plane", "velocity_m_per_s"),
    [
        # Texels of two cells; 2.7 cells in the frame.
        (Plane.of(20, 0.2), (40.0, -25.0)),
        # Texels of 0.7 cells, of 4 times the light.
        pytest.param(Plane.of(60, 0.95), (40.0, -25.0), marks=pytest.mark.thorough),
        # Half a cell in the frame.
        pytest.param(Plane.of(30, 0.95), (8.0, -5.0), marks=pytest.mark.thorough),
    ],
    ids=["coarse", "fine", "slow"],
)
def test_every_exposure_to_a_textured_plane_is_the_closed_form(
    plane: Plane, velocity_m_per_s: tuple[float, float], system: System
) -> None:
    """Paths and interpolation in time may each be off by 0.1 of a count's noise, their sum by 0.14.
    Of eight seeds rms errors are 0.034 to 0.049 of it with the coarse texture, 0.076 to 0.110 with
    the fine one. Where cells are no longer followed once a middle is right (`Effort.many_edges`),
    they are 0.19 and 0.17.
    """
    scene = world(going(plane.item, 0.0, *velocity_m_per_s))
    fidelity = Fidelity(light_tolerance=TOLERANCE, motion_tolerance=TOLERANCE)
    frame, noise = exposed(scene, system, fidelity)
    assert frame.signal_w is not None
    exposures, chain = Exposures.of(system), Chain.of(system, scene.sun)
    watt = system.emitter.radiant_intensity_w_per_sr.value * chain.lens.transmission
    watt *= chain.lens.pupil_area_m2
    half = float(np.tan(np.radians(system.emitter.field_of_view_deg.value / 2)))
    lit = system.patterns.masks().reshape(system.patterns.n_exposures, -1)
    share = (np.arange(TIMES) + 0.5) / TIMES
    times = exposures.starts_s[:, None] + share * exposures.integration_s
    moved = times[..., None] * np.array(velocity_m_per_s)
    cells = np.array([[plane.light(half, at) for at in some] for some in moved]).mean(axis=1)
    cells *= passed(system, chain)
    true = watt * np.einsum("nc,nc->n", lit, cells)
    still = watt * lit @ cells[len(cells) // 2]
    error = (frame.signal_w[:, 0, 0] - true) / noise
    assert np.std(true - still) > 10 * noise
    assert np.sqrt(np.mean(error**2)) < np.sqrt(2) * TOLERANCE
    assert np.abs(error).max() < 4 * TOLERANCE
