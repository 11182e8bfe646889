"""Fresnel-Kirchhoff diffraction by straight edges of any length, in closed form.

Kirchhoff's integral over an opaque screen is the wave of geometrical optics and an integral along
the screen's rim (Maggi and Rubinowicz: Born and Wolf, Principles of Optics, section 8.9). Along a
straight piece of the rim it is, to Fresnel's order, Owen's T function of an imaginary argument:
half the complementary error function where the whole edge is there (the knife edge of ITU-R P.526),
less what lies beyond each of its ends. Lengths of the ways enter exactly, as differences of path in
radians: ``q`` over the edge, where the way is shortest, and q + ``p`` over one of its ends.

Values are relative to the straight way's, for waves exp(-j k r), and without the factor exp(-j q)
or exp(-j (q + p)) that the difference itself makes: they change slowly over the band.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_FAR = 8.0  # rad: beyond, the integral is taken down the steepest descent
_DEEP = 10.0  # of the scaled way down: exp(-10 sqrt 2) is left


def over_edge(q: Array) -> Complex:
    """What comes over a straight edge without ends into its shadow: erfc(sqrt(j q)) / 2; 1/2 at
    the border.
    """
    value: Complex = 0.5 * wofz(np.exp(0.75j * np.pi) * np.sqrt(q))
    return value


def beyond_end(q: Array, p: Array) -> Complex:
    """What a straight edge would add that went on to infinity beyond an end p behind it:
    the integral of exp(-j q (1 + x^2)) / (1 + x^2) / (2 pi) from sqrt(p / q) on.

    ``q`` and ``p`` (n,) are not negative.
    """
    swap = p > q
    beyond = _beyond(np.where(swap, p, q), np.where(swap, q, p))
    # Owen's reflection of T: the two orders add up to a product of knife edges.
    whole: Complex = np.where(swap, over_edge(q) * over_edge(p) - beyond, beyond)
    return whole


def _beyond(q: Array, p: Array) -> Complex:
    """For p up to q."""
    amplitude = np.empty(len(q), dtype=np.complex128)
    near = q <= _FAR
    amplitude[near] = _to_end(q[near], p[near])
    amplitude[~near] = _down(q[~near], p[~near])
    return amplitude


def _to_end(q: Array, p: Array) -> Complex:
    """The whole half less what lies this side of the end."""
    ratio = np.sqrt(p / np.maximum(q, 1e-300))
    x = 0.5 * ratio[:, None] * (1 + _NODES)
    side = np.exp(-1j * q[:, None] * x**2) / (1 + x**2) @ _WEIGHTS * (0.25 * ratio / np.pi)
    turned: Complex = (0.5 * over_edge(q) - side) * np.exp(1j * p)
    return turned


def _down(q: Array, p: Array) -> Complex:
    """Along x = sqrt(p / q) + exp(-j pi / 4) u, where the integrand falls and does not turn."""
    scale = 1 / (1 + np.sqrt(2 * p))
    w = 0.5 * _DEEP * (1 + _NODES) * scale[:, None]
    root = np.sqrt(q)[:, None]
    x = np.sqrt(p / q)[:, None] + np.exp(-0.25j * np.pi) * w / root
    falling = np.exp(-(w**2) - 2 * np.exp(0.25j * np.pi) * np.sqrt(p)[:, None] * w)
    sums = falling / (1 + x**2) @ _WEIGHTS
    value: Complex = np.exp(-0.25j * np.pi) * _DEEP * scale / (4 * np.pi) / np.sqrt(q) * sums
    return value


def over_two_edges(
    q: Array, is_lit: NDArray[np.bool_], correlation: Array
) -> tuple[Complex, NDArray[np.bool_]]:
    """Two parallel edges on one way, each q (n, 2) radians out of the straight way and on either
    side of it: what comes over both (n,), beside the straight way where both leave it lit and the
    ways over one alone where the answer (n, 2) says so, 1/2 less 1/6 where both just touch it in
    thirds of its length.

    Kirchhoff's integral over both of their planes (Vogler, Radio Science 17, 1982, 1541) is the
    normal distribution of two variables beyond two bounds, of imaginary argument, and that is two
    of Owen's functions. ``correlation``, sqrt(a c / ((a + b) (b + c))), is that of stretches a, b
    and c before, between and behind the edges. The factor left out is that of the way over both.
    """
    rest = np.maximum(1 - correlation**2, 1e-12)
    side = np.where(is_lit, -1.0, 1.0)
    height = side * np.sqrt(np.maximum(q, 1e-12))
    amplitude = np.zeros(len(q), dtype=np.complex128)
    alone = np.zeros(q.shape, dtype=np.bool_)
    for i in (0, 1):
        one = height[:, i]
        slope = height[:, 1 - i] / one - correlation
        amplitude += np.sign(slope) * beyond_end(one**2, (slope * one) ** 2 / rest)
        alone[:, i] = side[:, i] * slope < 0
    return amplitude, alone
