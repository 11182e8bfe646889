"""Targets whose cross-section is known, at 79 GHz, shared by the tests of `twin rcs`."""

import math
from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.constants import speed_of_light

from twin.geometry import Geometry
from twin.radar.scattering import PEC, LayeredSurface, MeshTarget

CARRIER = 79e9
WAVELENGTH = speed_of_light / CARRIER
K = 2 * math.pi / WAVELENGTH
FAR = math.inf


def dbsm(amplitude) -> np.ndarray:
    return 10 * np.log10(np.maximum(4 * np.pi * np.abs(amplitude) ** 2, 1e-300))


def as_target(mesh: trimesh.Trimesh, surface: LayeredSurface = PEC) -> MeshTarget:
    return MeshTarget(Geometry(np.array(mesh.vertices), np.array(mesh.faces)), (surface,))


def polygons(*corners: Sequence[Sequence[float]]) -> trimesh.Trimesh:
    """Triangles and quadrilaterals as one mesh, nothing merged."""
    vertices, faces = [], []
    for polygon in corners:
        n = len(vertices)
        vertices += list(polygon)
        faces += [[n, n + i, n + i + 1] for i in range(1, len(polygon) - 1)]
    return trimesh.Trimesh(vertices, faces, process=False)


def rectangle(width_m: float, height_m: float) -> list[list[float]]:
    """In the yz plane."""
    y, z = width_m / 2, height_m / 2
    return [[0, -y, -z], [0, y, -z], [0, y, z], [0, -y, z]]


def dihedral(side_m: float) -> list[list[list[float]]]:
    """Two squares at right angles, open towards +x, folded along z."""
    d, z = side_m * math.sqrt(0.5), side_m / 2
    return [[[0, 0, -z], [d, sign * d, -z], [d, sign * d, z], [0, 0, z]] for sign in (1, -1)]


def trihedral(leg_m: float) -> list[list[list[float]]]:
    """Three right triangles in the coordinate planes."""
    a, b, c = leg_m * np.eye(3)
    return [[[0, 0, 0], list(p), list(q)] for p, q in ((a, b), (b, c), (c, a))]
