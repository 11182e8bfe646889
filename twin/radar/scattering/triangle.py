"""Exact integrals of a wave over flat triangles whose phase is linear across them.

With barycentric coordinates the integral of exp(j phase) over a triangle of area A is 2 A times the
second divided difference of exp(j p) at the phases p of its corners (Hermite and Genocchi; Gordon,
IEEE Trans. AP 23, 1975, gives the same as a sum over edges). What the phase is curved across the
triangle is left: half of it is halved edges, and two sizes of triangles extrapolate to none.

Arrays on the device, one element per triangle; a complex number is a pair (Re, Im) of float64.
"""

from typing import Any

import drjit as dr

_CLOSE = 0.2  # rad below which a series is exact to 1e-8 and a quotient may not be

Complex = tuple[Any, Any]


def phasor(phase: Any) -> Complex:
    """exp(j phase)."""
    im, re = dr.sincos(phase)
    return re, im


def mean_along(p: Any, q: Any, at_p: Complex, at_q: Complex) -> Complex:
    """Mean of exp(j phase) where the phase runs linearly from p to q: a first divided difference.

    ``at_p`` and ``at_q``: the phasors at the ends.
    """
    gap = q - p
    near = dr.abs(gap) < _CLOSE
    safe = dr.select(near, 1.0, gap)
    # exp(j p) times the mean of exp(j t) for t from 0 to the gap.
    square = dr.square(gap)
    re = 1 - square * (1 / 6 - square * (1 / 120))
    im = gap * (0.5 - square * (1 / 24 - square * (1 / 720)))
    series = at_p[0] * re - at_p[1] * im, at_p[0] * im + at_p[1] * re
    return (
        dr.select(near, series[0], (at_q[1] - at_p[1]) / safe),
        dr.select(near, series[1], (at_p[0] - at_q[0]) / safe),
    )


def mean_over(phases: list[Any], phasors: list[Complex]) -> Complex:
    """Mean of exp(j phase) over a triangle, by the phases at its corners and their phasors."""
    a, b, c = _sorted(phases, phasors)
    low, high = mean_along(a[0], b[0], a[1], b[1]), mean_along(b[0], c[0], b[1], c[1])
    span = c[0] - a[0]
    near = span < _CLOSE
    safe = dr.select(near, 1.0, span)
    # Moments of a linear function on a triangle: E[x^n] = 2 n! / (n + 2)! h_n(x1, x2, x3).
    middle = (a[0] + b[0] + c[0]) / 3
    x, y, z = a[0] - middle, b[0] - middle, c[0] - middle
    second = (dr.square(x) + dr.square(y) + dr.square(z)) / 12
    even = 1 - second / 2 + dr.square(second) * (36 / 15 / 24)
    odd = -x * y * z / 60
    # exp(j middle) from that of b, which is within the span of it.
    away = middle - b[0]
    turn_im, turn_re = dr.sincos(away)
    re, im = b[1][0] * turn_re - b[1][1] * turn_im, b[1][0] * turn_im + b[1][1] * turn_re
    return (
        dr.select(near, re * even - im * odd, 2 * (high[1] - low[1]) / safe),
        dr.select(near, re * odd + im * even, 2 * (low[0] - high[0]) / safe),
    )


def bend(phases: list[Any]) -> Any:
    """By how much the phase in the middle of an edge differs from the mean of its ends, at most, by
    the phases at corners 0 to 2 and in the middles of edges 3 to 5.
    """
    found = 0
    for first, second, middle in ((0, 1, 3), (1, 2, 4), (2, 0, 5)):
        off = phases[middle] - (phases[first] + phases[second]) / 2
        found = dr.maximum(found, dr.abs(off))
    return found


def largest(phases: list[Any], bent: Any) -> Any:
    """Bound of the magnitude of `mean_over` by the phases alone, which any part of the triangle
    keeps: a phase that is ``bent`` may be level somewhere.
    """
    low, high = dr.minimum(*phases[:2]), dr.maximum(*phases[:2])
    span = dr.maximum(high, phases[2]) - dr.minimum(low, phases[2])
    return dr.minimum(1.0, 2 / dr.maximum(span - 8 * bent, 1e-9))


def _sorted(phases: list[Any], phasors: list[Complex]) -> list[tuple[Any, Complex]]:
    rows = [(p, *z) for p, z in zip(phases, phasors, strict=True)]
    for i, j in ((0, 1), (1, 2), (0, 1)):
        swap = rows[i][0] > rows[j][0]
        first, second = rows[i], rows[j]
        rows[i] = tuple(dr.select(swap, v, u) for u, v in zip(first, second, strict=True))
        rows[j] = tuple(dr.select(swap, u, v) for u, v in zip(first, second, strict=True))
    return [(p, (re, im)) for p, re, im in rows]
