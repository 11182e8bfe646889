"""Fresnel-Kirchhoff diffraction by straight edges of any length, in closed form.

Kirchhoff's integral over an opaque screen is the wave of geometrical optics and an integral along
the screen's rim (Maggi and Rubinowicz: Born and Wolf, Principles of Optics, section 8.9). Along a
straight piece of the rim it is, to Fresnel's order, Owen's T function of an imaginary argument:
half the complementary error function for an infinite edge (the knife edge of ITU-R P.526), less the
part of that edge that is missing beyond each end. Path lengths enter exactly, as phase differences
from the direct path: ``q`` of the shortest path over the edge's line, and q + ``p`` of the path
over an end of the edge.

Factors are relative to the direct wave, for waves exp(-j k r), and without the phase exp(-j q) or
exp(-j (q + p)) of the longer path: they change slowly over the band.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

from hardware.compiled import kernel
from twin.radar.rows import dots, phasors

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)
_FAR = 8.0  # rad: beyond, the integral is taken down the steepest descent
_DEEP = 10.0  # of the scaled way down: exp(-10 sqrt 2) is left


def knife_edge_factor(q: Array) -> Complex:
    """Knife-edge diffraction factor of an infinite edge: erfc(sqrt(j q)) / 2, which is 1/2 at the
    shadow's border.
    """
    value: Complex = 0.5 * wofz(np.exp(0.75j * np.pi) * np.sqrt(q))
    return value


def on_one_side(one: Array, other: Array, along: Array) -> NDArray[np.bool_]:
    """Whether two ways (n, 3) from places on edges, to a source and to a place, lead to one side of
    the edges, whose unit vectors are ``along`` (n, 3): the border of a shadow is on the other side.
    """
    return np.asarray(dots(one, other) > dots(one, along) * dots(other, along))


def as_one(waves: Complex, q: Array) -> tuple[Complex, Array]:
    """Several waves (m, n), whose paths are longer by phases ``q``, as one: amplitude, and the
    phase of the strongest, (n,).
    """
    strongest = np.abs(waves).argmax(axis=0)
    longer = np.take_along_axis(q, strongest[None], axis=0)[0]
    return np.sum(waves * phasors(longer - q), axis=0), longer


def missing_edge_factor(q: Array, p: Array) -> Complex:
    """Part of the knife-edge factor that comes from an infinite edge beyond one end of the real
    one: the integral of exp(-j q (1 + x^2)) / (1 + x^2) / (2 pi) from sqrt(p / q) on.

    ``q`` and ``p`` (n,) are not negative.
    """
    factor = _owen_t(np.maximum(q, p), np.minimum(q, p))
    # Owen's reflection of T: the two orders add up to a product of knife edges.
    some = p > q
    factor[some] = knife_edge_factor(q[some]) * knife_edge_factor(p[some]) - factor[some]
    return factor


def _owen_t(q: Array, p: Array) -> Complex:
    """The integral for p up to q."""
    amplitude = np.empty(len(q), dtype=np.complex128)
    near = q <= _FAR
    amplitude[near] = _by_difference(q[near], p[near])
    amplitude[~near] = _by_steepest_descent(q[~near], p[~near])
    return amplitude


def _by_difference(q: Array, p: Array) -> Complex:
    """Half the infinite edge's factor less the integral up to the end."""
    ratio = np.sqrt(p / np.maximum(q, 1e-300))
    x = 0.5 * ratio[:, None] * (1 + _NODES)
    side = phasors(-q[:, None] * x**2) / (1 + x**2) @ _WEIGHTS * (0.25 * ratio / np.pi)
    factor: Complex = (0.5 * knife_edge_factor(q) - side) * phasors(p)
    return factor


def _by_steepest_descent(q: Array, p: Array) -> Complex:
    """Along x = sqrt(p / q) + exp(-j pi / 4) u, where the integrand decays without oscillation."""
    value: Complex = kernel(_descended)(q, p, 0.5 * _DEEP * (1 + _NODES), _DEEP * _WEIGHTS)
    return value


def _descended(q: Array, p: Array, nodes: Array, weights: Array) -> Complex:
    value = np.empty(len(q), dtype=np.complex128)
    for i in range(len(q)):
        root = np.sqrt(2 * p[i])
        scale = 1 / (1 + root)
        real, imag = 0.0, 0.0
        for node, weight in zip(nodes, weights):  # noqa: B905 - compiled
            w = node * scale
            turn = root * w
            fall = w * w + turn
            # 1 + x^2 is one + j other, conjugated.
            one, other = 1 + (p[i] + turn) / q[i], fall / q[i]
            level = weight * np.exp(-fall) / (one * one + other * other)
            cosine, sine = np.cos(turn), np.sin(turn)
            real += level * (cosine * one + sine * other)
            imag += level * (cosine * other - sine * one)
        value[i] = (1 - 1j) * (real + 1j * imag) * scale / np.sqrt(q[i])
    return value * (np.sqrt(0.5) / (4 * np.pi))


def missing_edge_bound(q: Array, p: Array) -> Array:
    """Bound of the magnitude of `missing_edge_factor`, at most 1.6 times that where p > 10.

    Down the steepest descent the integrand's exponential is exp(-w^2 - sqrt(2 p) w) in magnitude,
    and 1 + x^2 is nowhere below 1 + p / q.
    """
    width = 1 / np.maximum(np.sqrt(2 * p), 2 / np.sqrt(np.pi))
    bound: Array = width / (2 * np.pi * np.sqrt(q) * (1 + p / q))
    return bound


def double_knife_edge(
    q: Array, is_lit: NDArray[np.bool_], correlation: Array, faintest: float = 0.0
) -> tuple[Complex, NDArray[np.bool_]]:
    """Diffraction factor of two parallel edges one behind the other (double knife edge).

    The field behind both is a sum of up to four waves: the direct one where neither edge shadows
    it, the wave over each edge alone (`knife_edge_factor`), and the wave over both. Where both
    edges just touch the direct path, at thirds of its length, the sum is 1/2 - 1/6.

    Kirchhoff's integral over the planes of both edges (Vogler, Radio Science 17, 1982, 1541) is a
    bivariate normal distribution of imaginary argument, and that is two of Owen's functions.

    Parameters
    ----------
    q : (n, 2)
        Phase by which the path over each edge alone is longer than the direct one.
    is_lit : (n, 2)
        Whether the direct path passes each edge on its lit side.
    correlation : (n,)
        sqrt(a c / ((a + b) (b + c))) of the distances a, b, c before, between and behind the edges.
    faintest
        Waves over both edges that are weaker for sure may be 0.

    Returns
    -------
    factor : (n,)
        Of the wave over both edges, without the phase of its longer path.
    alone : (n, 2)
        Whether the wave over each edge alone is there too.
    """
    rest = np.maximum(1 - correlation**2, 1e-12)
    side = np.where(is_lit, -1.0, 1.0)
    height = side * np.sqrt(np.maximum(q, 1e-12))
    slope = height[:, ::-1] / height - correlation[:, None]
    beyond = height**2, (slope * height) ** 2 / rest[:, None]
    some = np.flatnonzero(missing_edge_bound(*beyond).sum(axis=1) >= faintest)
    parts = [missing_edge_factor(*(x[some, i] for x in beyond)) for i in (0, 1)]
    amplitude = np.zeros(len(q), dtype=np.complex128)
    amplitude[some] = np.sign(slope[some, 0]) * parts[0] + np.sign(slope[some, 1]) * parts[1]
    return amplitude, side * slope < 0
