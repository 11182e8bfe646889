"""The field behind black rectangles in two planes by brute force, to compare with: no rays, no
rims, no knife edges.

Kirchhoff's integral over both planes to Fresnel's order. A rectangle is a product of two intervals,
so that what rectangles one behind the other take is a product of two double integrals: in closed
form over the farther interval, by Gauss and Legendre over the nearer one, with points closer
together where an edge of the other passes.
"""

from collections.abc import Callable
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.special import erf

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Interval = tuple[float, float]
#: Distance along x, and extents in y and z.
Rectangle = tuple[float, Interval, Interval]

_WIDEST_M = 2.5e-4  # between panels of 8 points
_AROUND = np.linspace(-20, 20, 161)  # an edge, of the root of the gap over the wavenumber
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_PLACES = 17  # along a side, between which a field is interpolated


def field_behind(rectangles: list[Rectangle], target: Array, k: float) -> complex:
    """At a target, of a wave from the origin, over the straight wave; rectangles in two planes."""
    total = 0.0 + 0.0j
    for count in range(len(rectangles) + 1):
        for some in combinations(rectangles, count):
            total += (-1) ** count * _through(list(some), target, k)
    return total


def field_around(
    rectangles: list[Rectangle], center: Array, half_m: float, k: float
) -> Callable[[Array], Complex]:
    """The same at places (n, 3) to within a distance of a center, interpolated: over the straight
    wave it changes little along that.
    """
    at = np.linspace(-half_m, half_m, _PLACES)
    every = [[field_behind(rectangles, center + [0, y, z], k) for z in at] for y in at]
    real, imag = (RectBivariateSpline(at, at, part) for part in (np.real(every), np.imag(every)))

    def field_at(places: Array) -> Complex:
        _, y, z = (places * (center[0] / places[:, :1]) - center).T
        return np.asarray(real.ev(y, z) + 1j * imag.ev(y, z))

    return field_at


def _through(rectangles: list[Rectangle], target: Array, k: float) -> complex:
    """What passes through all of some rectangles, as openings."""
    planes: dict[float, Array] = {}
    for x, *extents in rectangles:
        off = np.array(extents) - target[1:, None] * x / target[0]
        before = planes.get(x, np.array([[-np.inf, np.inf]] * 2))
        planes[x] = np.stack([np.maximum(before, off)[:, 0], np.minimum(before, off)[:, 1]], axis=1)
    if any((extent[:, 0] >= extent[:, 1]).any() for extent in planes.values()):
        return 0.0
    axes = ([(x, planes[x][axis]) for x in sorted(planes)] for axis in (0, 1))
    return complex(np.prod([_along_one_axis(axis, target[0], k) for axis in axes]))


def _along_one_axis(planes: list[tuple[float, Array]], end: float, k: float) -> complex:
    if not planes:
        return 1.0
    (x, extent), *rest = planes
    root = np.sqrt(0.5j * k * (1 / x + 1 / (end - x)))
    if not rest:
        return complex(np.diff(erf(root * extent))[0] / 2)
    ((farther, behind),) = rest
    gap, left = farther - x, end - farther
    at, weight = _points(extent, behind * x / farther, np.sqrt(gap / k))
    middle = at * left / (gap + left)  # where the straight way from there passes the farther plane
    second = np.sqrt(0.5j * k * (1 / gap + 1 / left))
    passes = (erf(second * (behind[1] - middle)) - erf(second * (behind[0] - middle))) / 2
    wave = np.exp(-0.5j * k * at**2 * (1 / x + 1 / (gap + left))) * passes
    return complex(root / np.sqrt(np.pi) * np.sum(weight * wave))


def _points(extent: Array, edges: Array, width: float) -> tuple[Array, Array]:
    count = int(np.ceil(np.diff(extent)[0] / _WIDEST_M)) + 1
    fine = (edges[:, None] + width * _AROUND).ravel()
    bounds = np.unique([*np.linspace(*extent, count), *np.clip(fine, *extent)])
    size = np.diff(bounds)[:, None]
    return (bounds[:-1, None] + size * (_NODES + 1) / 2).ravel(), (size * _WEIGHTS / 2).ravel()
