"""Integrals of a wave over flat triangles, exact where phase and logarithm are linear across them.

With barycentric coordinates the integral of exp(x) over a triangle of area A is 2 A times the
second divided difference of exp at the values of x at its corners (Hermite and Genocchi; Gordon,
IEEE Trans. AP 23, 1975, gives the same as a sum over edges). Here x is the logarithm of the
amplitude plus j times the phase.

Where x is curved, by q in the middle of an edge beyond the mean of its ends, x is the linear one
plus the sum of 4 q u v over the edges, with u and v the coordinates of their ends. Of that sum the
first power is integrated: the mean of u v exp(x) is the second derivative of the mean of exp(x) by
the values at both corners, a divided difference that has either of them twice.

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

_EXP = (1 / 720, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0)  # its series
_EDGES = (0, 1, 3), (1, 2, 4), (2, 0, 5)  # corners, and the node in the middle


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
    turn = _series(away, _EXP)
    series = _times(_times(b.value, turn), (1 + mean[0], mean[1]))
    safe = dr.select(near, 1.0, square)
    more = 2 * (high[0] - low[0]), 2 * (high[1] - low[1])
    return (
        dr.select(near, series[0], (more[0] * gap[0] + more[1] * gap[1]) / safe),
        dr.select(near, series[1], (more[1] * gap[0] - more[0] * gap[1]) / safe),
    )


def change_by_curvature(nodes: Sequence[Node]) -> Complex:
    """What curvature adds to `mean_over`, to its first power, by nodes at the corners (0 to 2) and
    in the middles of the edges (3 to 5).
    """
    off = [_beyond(nodes[i], nodes[j], nodes[m]) for i, j, m in _EDGES]
    a, b, c = _apart(*nodes[:3])
    ab, bc, ca = _in_that_order(nodes, off)
    gap = c.log - a.log, c.phase - a.phase
    near = dr.square(gap[0]) + dr.square(gap[1]) < _CLOSE**2
    low, high = _Differences.of(a, b), _Differences.of(b, c)
    inverse = _inverse(gap, near)

    def over_gap(more: Complex, less: Complex) -> Complex:
        return _times((more[0] - less[0], more[1] - less[1]), inverse)

    abc = over_gap(high.once, low.once)
    aabc, abbc = over_gap(abc, low.first), over_gap(high.first, low.last)
    abcc = over_gap(high.last, abc)
    exact = over_gap(abbc, low.both), over_gap(high.both, abbc), over_gap(abcc, aabc)
    middle = (a.log + b.log + c.log) / 3, (a.phase + b.phase + c.phase) / 3
    turn = _series((middle[0] - b.log, middle[1] - b.phase), _EXP)
    value = _times(b.value, turn)
    total: Complex = (0 * gap[0], 0 * gap[1])
    for moment, opposite, beyond in zip(exact, (c, a, b), (ab, bc, ca), strict=True):
        # Of u v the mean is 1 / 12, that of u v times the value at the third corner less the mean
        # of all three -1 / 60 of that difference.
        series = 1 / 12 - (opposite.log - middle[0]) / 60, (middle[1] - opposite.phase) / 60
        few = _times(value, series)
        mean = tuple(dr.select(near, x, 2 * y) for x, y in zip(few, moment, strict=True))
        part = _times(beyond, (mean[0], mean[1]))
        total = total[0] + 4 * part[0], total[1] + 4 * part[1]
    return total


@dataclass(frozen=True)
class _Differences:
    """Divided differences of exp between two corners p and q, of these ``once``; with the ``first``
    or the ``last`` twice; with ``both`` twice.
    """

    once: Complex
    first: Complex
    last: Complex
    both: Complex

    @staticmethod
    def of(p: Node, q: Node) -> "_Differences":
        """By the values at both."""
        gap = q.log - p.log, q.phase - p.phase
        near = dr.square(gap[0]) + dr.square(gap[1]) < _CLOSE**2
        inverse = _inverse(gap, near)

        def chosen(series: Sequence[float], more: Complex, less: Complex) -> Complex:
            close = _times(p.value, _series(gap, series))
            away = _times((more[0] - less[0], more[1] - less[1]), inverse)
            return dr.select(near, close[0], away[0]), dr.select(near, close[1], away[1])

        once = chosen((1 / 720, 1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0), q.value, p.value)
        first = chosen((1 / 720, 1 / 120, 1 / 24, 1 / 6, 1 / 2), once, p.value)
        last = chosen((1 / 144, 1 / 30, 1 / 8, 1 / 3, 1 / 2), q.value, once)
        both = chosen((1 / 1008, 1 / 180, 1 / 40, 1 / 12, 1 / 6), last, first)
        return _Differences(once, first, last, both)


def _inverse(gap: Complex, near: Any) -> Complex:
    """One over a gap, where it is not near 0."""
    square = dr.select(near, 1.0, dr.square(gap[0]) + dr.square(gap[1]))
    return gap[0] / square, -gap[1] / square


def _beyond(p: Node, q: Node, middle: Node) -> Complex:
    """The wave's logarithm in the middle of an edge less the mean of its ends."""
    return middle.log - (p.log + q.log) / 2, middle.phase - (p.phase + q.phase) / 2


def relative_curvature(nodes: Sequence[Node]) -> Real:
    """Curvature of a wave over its linear change along an edge, a quarter of it, or by itself where
    that is less: the square of it is what `change_by_curvature` leaves out, over what the triangle
    may return.
    """
    alone, over_change = 0.0 * nodes[0].phase, 0.0 * nodes[0].phase
    for i, j, m in _EDGES:
        log, phase = _beyond(nodes[i], nodes[j], nodes[m])
        off = dr.sqrt(dr.square(log) + dr.square(phase))
        change = dr.abs(nodes[j].phase - nodes[i].phase)
        alone = dr.maximum(alone, off)
        over_change = dr.maximum(over_change, 4 * off / dr.maximum(change, 1e-9))
    least: Real = dr.minimum(alone, over_change)
    return least


def curvature(values: list[Any]) -> Any:
    """Largest difference, over a triangle's edges, between the value in the middle of the edge and
    the mean of its ends; of values at the corners (0 to 2) and in the middles of the edges (3 to
    5).
    """
    largest = 0
    for first, second, middle in _EDGES:
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
    first, second = _widest(a, b, c)
    return (
        _chosen(first | ~second, a, b),
        _chosen(first, c, _chosen(second, a, b)),
        _chosen(first, b, c),
    )


def _in_that_order(corners: Sequence[Node], edges: Sequence[Complex]) -> list[Complex]:
    """Values of the edges between the first and the second node of that order, the second and the
    last, the last and the first.
    """
    first, second = _widest(*corners[:3])

    def chosen(one: Complex, other: Complex, last: Complex) -> Complex:
        re, im = (
            dr.select(first, x, dr.select(second, y, z))
            for x, y, z in zip(one, other, last, strict=True)
        )
        return re, im

    ab, bc, ca = edges
    return [chosen(ca, ab, ab), chosen(bc, ca, bc), chosen(ab, bc, ca)]


def _widest(a: Node, b: Node, c: Node) -> tuple[Any, Any]:
    """Whether the first and the second node differ most, and if not, whether the others do."""
    ab, bc, ca = (
        dr.square(q.phase - p.phase) + dr.square(q.log - p.log) for p, q in ((a, b), (b, c), (c, a))
    )
    return (ab >= bc) & (ab >= ca), bc >= ca


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
