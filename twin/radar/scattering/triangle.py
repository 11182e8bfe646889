"""Exact integrals of a wave over flat triangles across which phase and logarithm are linear.

With barycentric coordinates the integral of exp(x) over a triangle of area A is 2 A times the
second divided difference of exp at the values of x at its corners (Hermite and Genocchi; Gordon,
IEEE Trans. AP 23, 1975, gives the same as a sum over edges). Here x is the logarithm of the
amplitude plus j times the phase. The curvature of x across the triangle is neglected; its effect
shrinks with the triangle and is extrapolated from two sizes of triangles (`currents.echoes_of`).

The echo of a body is put together in `twin.radar.propagation.facets`: of one triangle in `currents`
(with the gain and the distances), of all of a body's in `body_scattering`, over the band in
`wideband`.

Arrays on the device, one element per triangle; a complex number is a pair (Re, Im) of float64.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from twin.radar.scattering.arrays import Complex, Real

_CLOSE = 0.2  # of x, below which a series is exact to 1e-8 and a quotient may not be


@dataclass(frozen=True)
class Node:
    """A wave at a point: phase, logarithm of the amplitude, and its value."""

    phase: Real
    log: Real
    value: Complex


def node(phase: Real, log: Real) -> Node:
    """A wave at a point by its phase and the logarithm of its amplitude."""
    im, re = dr.sincos(phase)
    level = dr.exp(log)
    return Node(phase, log, (level * re, level * im))


def mean_along(p: Node, q: Node) -> Complex:
    """Mean of a wave along an edge, by its ends: a first divided difference of exp."""
    gap = q.log - p.log, q.phase - p.phase
    square = dr.square(gap[0]) + dr.square(gap[1])
    near = square < _CLOSE**2
    series = _times(p.value, _series(gap, (1 / 720, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0)))
    safe = dr.select(near, 1.0, square)
    away = q.value[0] - p.value[0], q.value[1] - p.value[1]
    return (
        dr.select(near, series[0], (away[0] * gap[0] + away[1] * gap[1]) / safe),
        dr.select(near, series[1], (away[1] * gap[0] - away[0] * gap[1]) / safe),
    )


def mean_over(corners: Sequence[Node]) -> Complex:
    """Mean of a wave over a triangle."""
    a, b, c = _apart(*corners)
    low, high = mean_along(a, b), mean_along(b, c)
    gap = c.log - a.log, c.phase - a.phase
    square = dr.square(gap[0]) + dr.square(gap[1])
    near = square < _CLOSE**2
    # Moments of a linear function on a triangle: E[x^n] = 2 n! / (n + 2)! h_n(x1, x2, x3).
    middle = (a.log + b.log + c.log) / 3, (a.phase + b.phase + c.phase) / 3
    x, y, z = ((v.log - middle[0], v.phase - middle[1]) for v in (a, b, c))
    squares = [_times(v, v) for v in (x, y, z)]
    second = tuple((u + v + w) / 12 for u, v, w in zip(*squares, strict=True))
    third, fourth = _times(_times(x, y), z), _times(second, second)
    mean = tuple(
        s / 2 + t / 60 + f * (36 / 15 / 24) for s, t, f in zip(second, third, fourth, strict=True)
    )
    # exp(middle) from that of b, which is within the gap of it.
    away = -y[0], -y[1]
    turn = _series(away, (1 / 720, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0))
    series = _times(_times(b.value, turn), (1 + mean[0], mean[1]))
    safe = dr.select(near, 1.0, square)
    more = 2 * (high[0] - low[0]), 2 * (high[1] - low[1])
    return (
        dr.select(near, series[0], (more[0] * gap[0] + more[1] * gap[1]) / safe),
        dr.select(near, series[1], (more[1] * gap[0] - more[0] * gap[1]) / safe),
    )


def curvature(values: list[Any]) -> Any:
    """Largest difference, over a triangle's edges, between the value in the middle of the edge and
    the mean of its ends; of values at the corners (0 to 2) and in the middles of the edges (3 to
    5).
    """
    largest = 0
    for first, second, middle in ((0, 1, 3), (1, 2, 4), (2, 0, 5)):
        off = values[middle] - (values[first] + values[second]) / 2
        largest = dr.maximum(largest, dr.abs(off))
    return largest


def mean_bound(phases: list[Any], phase_curvature: Any) -> Any:
    """Upper bound of the magnitude of `mean_over`, for the triangle and for any part of it.

    The bound is 2 over the phase difference of the corners. From that difference 8 times the
    curvature is taken off, since a curved phase may be stationary somewhere.
    """
    return dr.minimum(1.0, 2 / dr.maximum(span(phases) - 8 * phase_curvature, 1e-9))


def span(phases: Sequence[Any]) -> Any:
    """Largest less smallest of three phases."""
    low, high = dr.minimum(*phases[:2]), dr.maximum(*phases[:2])
    return dr.maximum(high, phases[2]) - dr.minimum(low, phases[2])


def _apart(a: Node, b: Node, c: Node) -> tuple[Node, Node, Node]:
    """The three nodes in an order in which the first and the last differ most."""
    ab, bc, ca = (
        dr.square(q.phase - p.phase) + dr.square(q.log - p.log) for p, q in ((a, b), (b, c), (c, a))
    )
    first, second = (ab >= bc) & (ab >= ca), bc >= ca
    return (
        _chosen(first | ~second, a, b),
        _chosen(first, c, _chosen(second, a, b)),
        _chosen(first, b, c),
    )


def _chosen(which: Any, one: Node, other: Node) -> Node:
    return Node(
        dr.select(which, one.phase, other.phase),
        dr.select(which, one.log, other.log),
        (
            dr.select(which, one.value[0], other.value[0]),
            dr.select(which, one.value[1], other.value[1]),
        ),
    )


def _times(a: Complex, b: Complex) -> Complex:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _series(x: Complex, coefficients: Sequence[float]) -> Complex:
    """A polynomial, the highest power first."""
    re, im = coefficients[0] + 0 * x[0], 0 * x[1]
    for coefficient in coefficients[1:]:
        re, im = _times((re, im), x)
        re += coefficient
    return re, im
