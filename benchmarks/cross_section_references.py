"""What cross-sections are judged by: Mie's series, and surface integrals over image sources.

Brute force in float64 NumPy; nothing of the ray tracer is in it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.radar.scattering.wave import Radar

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def mie_coefficients(
    size: float, index: complex | None = None
) -> tuple[NDArray[np.int64], Complex, Complex]:
    """Orders and coefficients a_n, b_n of a sphere of ``size`` k r; ``index`` None: a conductor.

    Bohren and Huffman, Absorption and scattering of light by small particles, eq. 4.88 (time
    dependence exp(-i omega t): a lossy index has a positive imaginary part).
    """
    from scipy.special import spherical_jn, spherical_yn

    n = np.arange(1, int(size + 4 * size ** (1 / 3) + 20))
    j, y = spherical_jn(n, size), spherical_yn(n, size)
    psi, xi = size * j, size * (j + 1j * y)
    if index is None:
        psi_slope = j + size * spherical_jn(n, size, True)
        xi_slope = psi_slope + 1j * (y + size * spherical_yn(n, size, True))
        return n, psi_slope / xi_slope, psi / xi
    z = index * size
    top = int(max(n[-1], abs(z))) + 20
    d = np.zeros(top + 1, dtype=np.complex128)  # logarithmic derivative, stable downwards
    for i in range(top, 0, -1):
        d[i - 1] = i / z - 1 / (d[i] + i / z)
    psi_less = np.concatenate([[np.sin(size)], psi[:-1]])
    xi_less = np.concatenate([[np.sin(size) - 1j * np.cos(size)], xi[:-1]])
    factors = (d[n] / index + n / size, index * d[n] + n / size)
    a, b = ((f * psi - psi_less) / (f * xi - xi_less) for f in factors)
    return n, a, b


def mie_cross_section(radius_m: float, wavelength_m: float, index: complex | None = None) -> float:
    """Of a sphere, back to the source, in m^2."""
    k = 2 * np.pi / wavelength_m
    n, a, b = mie_coefficients(k * radius_m, index)
    return float(np.pi / k**2 * np.abs(np.sum((2 * n + 1) * (-1.0) ** n * (a - b))) ** 2)


def image_integral(
    faces: Sequence[Any], radar: Radar, wavelength_m: float, port: int, n: int = 300
) -> complex:
    """Amplitude S (m) of a conducting corner reflector in physical optics.

    For every chain of up to three faces, the field of the radar's image drives J = 2 n x H on the
    last one, where the way back to the image goes through the faces before. Nothing may stand
    between faces and radar.

    Parameters
    ----------
    faces
        Triangles and parallelograms, corners in order.
    port
        0 for V, 1 for H, sent and received; the radar at a finite distance.
    n
        Points of Gauss's rule along the first side of a face; along the last side of a
        parallelogram a fifth of it.
    """
    here, k = radar.direction * radar.distance_m, 2 * np.pi / wavelength_m
    sent, boresight = radar.polarizations[port], -radar.direction
    polygons = [_Polygon(face) for face in faces]
    total = 0j
    for chain in _chains(len(faces)):
        last, before = polygons[chain[-1]], [polygons[i] for i in chain[:-1]]
        points, weights = last.quadrature(n)
        images, turn = [here], np.eye(3)
        for face in before:
            images.append(face.corners[0] + face.mirror @ (images[-1] - face.corners[0]))
            turn = face.mirror @ turn
        lit, at = np.ones(len(points), dtype=bool), points
        for image, face in zip(images[:0:-1], before[::-1], strict=True):
            at, through = face.crossing(at, image)
            lit &= through
        way = points - images[-1]
        length = np.linalg.norm(way, axis=1)
        direction = way / length[:, None]
        field = (-1) ** len(before) * _turned(sent, boresight, direction @ turn) @ turn.T
        facing = last.normal * -np.sign(direction @ last.normal)[:, None]
        current = 2 * np.cross(facing, np.cross(direction, field))
        back = here - points
        r = np.linalg.norm(back, axis=1)
        seen = np.sum(current * _turned(sent, boresight, -back / r[:, None]), axis=1)
        phase = np.exp(-1j * k * (length + r - 2 * radar.distance_m))
        total += np.sum((weights * seen * phase / (length * r))[lit])
    return complex(-1j * k / (4 * np.pi) * radar.distance_m**2 * total)


class _Polygon:
    """A convex face: where lines cross it, its mirror, its quadrature."""

    def __init__(self, corners: Any) -> None:
        self.corners = np.array(corners, dtype=np.float64)
        a, b, c = self.corners[:3]
        self.normal = np.cross(b - a, c - a)
        self.normal /= np.linalg.norm(self.normal)
        self.mirror = np.eye(3) - 2 * np.outer(self.normal, self.normal)

    def crossing(self, start: Array, end: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Where lines to one point cross the plane, and whether they do so within the face."""
        towards = end - start
        slope = towards @ self.normal
        t = ((self.corners[0] - start) @ self.normal) / np.where(slope == 0, np.inf, slope)
        at = start + t[:, None] * towards
        inside = (t > 0) & (t < 1)
        for corner, following in zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True):
            inside &= np.cross(following - corner, at - corner) @ self.normal > -1e-12
        return at, inside

    def quadrature(self, n: int) -> tuple[Array, Array]:
        """Points (m, 3) and weights (m,) of a Gauss rule, collapsed on a triangle."""
        is_triangle = len(self.corners) == 3
        t, w = np.polynomial.legendre.leggauss(n)
        s, v = np.polynomial.legendre.leggauss(n if is_triangle else n // 5)
        a, b = np.meshgrid((t + 1) / 2, (s + 1) / 2, indexing="ij")
        p, q = self.corners[1] - self.corners[0], self.corners[-1] - self.corners[0]
        weights = np.outer(w, v) / 4 * np.linalg.norm(np.cross(p, q))
        if is_triangle:
            weights, a, b = weights * a, a - a * b, a * b
        points = self.corners[0] + a[..., None] * p + b[..., None] * q
        return points.reshape(-1, 3), weights.ravel()


def _chains(count: int) -> list[tuple[int, ...]]:
    """Every order in which up to three different faces may be met."""
    chains: list[tuple[int, ...]] = [(i,) for i in range(count)]
    for _ in range(2):
        chains += [(*chain, i) for chain in chains for i in range(count) if i not in chain]
    return list(dict.fromkeys(chains))


def _turned(e: Array, boresight: Array, direction: Array) -> Array:
    """Polarisation turned with the ray from boresight, by Rodrigues' formula."""
    axis = np.cross(boresight, direction)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    cosine = (direction @ boresight)[:, None]
    axis /= np.maximum(sine, 1e-300)
    turned: Array = (
        e * cosine + np.cross(axis, e) * sine + axis * (axis @ e)[:, None] * (1 - cosine)
    )
    return turned
