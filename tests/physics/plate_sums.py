"""Echoes of flat plates by quadrature in float64: what the radar's solvers are compared with.

The radar stands at the origin and looks along x. The echo of a perfect conductor by physical optics
is -j / (4 pi) times the integral of gain, cosine and exp(-2 j k R) / R^2 over what it sees; its
polarisation is that of the antenna.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import GAIN, RADAR, WAVELENGTH_M

Array = NDArray[np.float64]

BAND_HZ = np.linspace(77e9, 81e9, 5)
_PANEL = 3.0  # wavelengths of panels of 16 nodes, each with 12 cycles of the echo at most


def turned_plate(
    center: tuple[float, float, float], side: float, yaw: float, pitch: float, roll: float
) -> Array:
    """Corners (4, 3) of a square across the x axis, turned by angles in degrees."""
    y, p, r = np.radians([yaw, pitch, roll])
    about_x = [[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]]
    about_y = [[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]]
    about_z = [[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]]
    square = side / 2 * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
    return square @ (np.array(about_z) @ about_y @ about_x).T + np.asarray(center)


def summed(polygons: list[Array], frequencies_hz: Array = BAND_HZ) -> NDArray[np.complex128]:
    """Echo of convex polygons (n, 3) at every frequency, in Duffy's coordinates of triangles."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    found = np.zeros(len(frequencies_hz), dtype=complex)
    for a, b, c in (p[[0, i, i + 1]] for p in polygons for i in range(1, len(p) - 1)):
        size = max(np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(a - c))
        panels = int(np.ceil(size / (_PANEL * WAVELENGTH_M)))
        u = ((np.arange(panels)[:, None] + (nodes + 1) / 2) / panels).ravel()
        share = np.tile(weights / (2 * panels), panels)
        normal = np.cross(b - a, c - a)
        points = a + u[:, None, None] * (b - a)
        points = points + ((1 - u)[:, None] * u)[..., None] * (c - a)
        distance = np.linalg.norm(points, axis=2)
        direction = points / distance[..., None]
        terms = share[:, None] * share * (1 - u)[:, None] / distance**2
        terms = terms * RADAR.antenna.gain(direction) * np.abs(direction @ normal)
        for row, frequency in enumerate(frequencies_hz):
            found[row] += np.sum(
                terms * np.exp(-4j * np.pi * frequency / speed_of_light * distance)
            )
    loss: float = GAIN / 100
    return -1j * loss / (4 * np.pi) * found


def seen_beside(plate: Array, other: Array) -> list[Array]:
    """Convex polygons of a convex plate that another one leaves in sight, which may cut it."""
    normal = np.cross(plate[1] - plate[0], plate[-1] - plate[0])
    normal *= -np.sign(normal @ plate[0])
    in_front = _clipped(other - plate[0], normal) + plate[0]
    if len(in_front) < 3:
        return [plate]
    left, found = plate, []
    for begin, end in zip(in_front, np.roll(in_front, -1, axis=0), strict=True):
        side = np.cross(begin, end)
        side *= np.sign(side @ in_front.mean(axis=0))
        found.append(_clipped(left, -side))
        left = _clipped(left, side)
    return [part for part in found if len(part) > 2]


def _clipped(polygon: Array, normal: Array) -> Array:
    """The part on the normal's side of a plane through the origin."""
    found, off = [], polygon @ normal
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        if off[i] >= 0:
            found.append(polygon[i])
        if off[i] * off[j] < 0:
            found.append(polygon[i] + (polygon[j] - polygon[i]) * off[i] / (off[i] - off[j]))
    return np.array(found).reshape(-1, 3)
