"""Means over triangles of phasors whose phases are linear across them.

They are divided differences of the exponential between the phases at the corners (Gordon, IEEE
Trans. Antennas Propag. 23, 1975, 590), in any order of these; of phasors whose amplitudes are
linear as well, derivatives of the same. Where phases are alike their limits are taken.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

#: Differences of phases, below which their squares are enough: along an edge, and across all of a
#: triangle.
_SHORT_RAD, _FLAT_RAD = 1e-2, 2e-2
#: Corners in the order of their values x, y, z, by the number x > y, plus 2 where x > z, plus 4
#: where y > z; 2 and 5 do not occur.
_ORDER = np.array(
    [[0, 1, 2], [1, 0, 2], [0, 1, 2], [1, 2, 0], [0, 2, 1], [2, 1, 0], [2, 0, 1], [2, 1, 0]]
)


def mean_phasors(corners: Array, slope: Array) -> Complex:
    """Means (n,) of phasors over triangles (n, 3, 3), whose phases are 0 at the centroids and have
    gradients (n, 3) in rad/m.
    """
    mean: Complex = kernel(_mean_phasors, _along)(
        np.ascontiguousarray(corners), np.ascontiguousarray(slope)
    )
    return mean


def mean_waves(
    legs: tuple[Array, Complex, Complex, Complex],
    first: Indices,
    corners: Indices,
    triangle: Indices,
    wavenumber: float,
    by: float,
) -> tuple[Complex, Array]:
    """Means of waves by two legs each at three wavenumbers, one less and one more ``by`` some
    rad/m, (3, n), and the mean lengths of both legs, (n,).

    Of all legs to all corners, (m,): by how much each is longer, its amplitude, and phasors of
    that length, at the middle wavenumber and for ``by``. ``first`` (2, n): rows of both legs to
    the corner of number 0; ``corners`` (3, n_triangles): numbers of those of each triangle;
    ``triangle`` (n,).
    """
    rows = (first, np.ascontiguousarray(corners), triangle)
    means, longer_m = kernel(_mean_waves, _mean_wave, _along, _change)(*legs, *rows, wavenumber, by)
    return means, longer_m


def _along(apart: float, begin: complex, end: complex) -> complex:
    """Mean along an edge of phasors whose phases are ``apart`` at its ends."""
    if abs(apart) < _SHORT_RAD:
        return (begin + end) / 2 * (1 + apart * apart / 12)
    return (end - begin) * complex(0.0, -1 / apart)


def _change(apart: float, begin: complex, mean: complex) -> complex:
    """By how much a mean along an edge changes with the phase at the beginning, over j."""
    if abs(apart) < _SHORT_RAD:
        turn = 1j * apart
        return begin * (1 / 2 + turn / 6 + turn * turn / 24)
    return (mean - begin) * complex(0.0, -1 / apart)


def _mean_wave(lower: float, upper: float, wave: Complex, factor: Complex) -> complex:
    """Of phasors and their amplitudes at the corners, (3,), and the phases between corners."""
    whole = lower + upper
    if abs(whole) <= _FLAT_RAD:
        squares = lower * lower + upper * upper + whole * whole
        total = wave[0] + wave[1] + wave[2]
        mean = factor[0] * (total + wave[0]) + factor[1] * (total + wave[1])
        return (mean + factor[2] * (total + wave[2])) / 12 * (1 + squares / 24)
    turn = complex(0.0, -1 / whole)
    below, above = _along(lower, wave[0], wave[1]), _along(upper, wave[1], wave[2])
    mean = (above - below) * turn
    first = (mean - _change(lower, wave[0], below)) * turn
    last = (mean - _change(-upper, wave[2], above)) * -turn
    return 2 * (factor[0] * first + factor[1] * (mean - first - last) + factor[2] * last)


def _mean_phasors(corners: Array, slope: Array) -> Complex:
    mean = np.empty(len(slope), dtype=np.complex128)
    phase = np.empty(3)
    for i in range(len(slope)):
        phase[:] = 0
        for axis in range(3):
            a, b, c = corners[i, 0, axis], corners[i, 1, axis], corners[i, 2, axis]
            middle = (a + b + c) / 3
            phase[0] += slope[i, axis] * (a - middle)
            phase[1] += slope[i, axis] * (b - middle)
            phase[2] += slope[i, axis] * (c - middle)
        x, y, z = min(phase), phase.sum() - min(phase) - max(phase), max(phase)
        first = complex(math.cos(x), math.sin(x))
        second = complex(math.cos(y), math.sin(y))
        third = complex(math.cos(z), math.sin(z))
        if z - x <= _FLAT_RAD:
            squares = (y - x) ** 2 + (z - y) ** 2 + (z - x) ** 2
            mean[i] = (first + second + third) / 3 * (1 + squares / 24)
        else:
            change = _along(z - y, second, third) - _along(y - x, first, second)
            mean[i] = change * complex(0.0, -2 / (z - x))
    return mean


def _mean_waves(
    leg_m: Array,
    leg_factor: Complex,
    leg_phasor: Complex,
    leg_step: Complex,
    first: Indices,
    corners: Indices,
    triangle: Indices,
    wavenumber: float,
    by: float,
) -> tuple[Complex, Array]:
    count = len(triangle)
    means, longer_m = np.empty((3, count), dtype=np.complex128), np.empty(count)
    length, factor = np.empty(3), np.empty(3, dtype=np.complex128)
    wave, step = np.empty((2, 3), dtype=np.complex128)
    for i in range(count):
        one, other, corner = first[0, i], first[1, i], corners[:, triangle[i]]
        for c in range(3):
            length[c] = leg_m[one + corner[c]] + leg_m[other + corner[c]]
        x, y, z = length
        longer_m[i] = (x + y + z) / 3
        order = _ORDER[int(x > y) + 2 * int(x > z) + 4 * int(y > z)]
        for c in range(3):
            p, q = one + corner[order[c]], other + corner[order[c]]
            factor[c] = leg_factor[p] * leg_factor[q]
            step[c] = leg_step[p] * leg_step[q]
            wave[c] = leg_phasor[p] * leg_phasor[q] * step[c].conjugate()
        x, y, z = length[order[0]], length[order[1]], length[order[2]]
        for band in range(3):
            k = wavenumber + (band - 1) * by
            means[band, i] = _mean_wave(k * (x - y), k * (y - z), wave, factor)
            for c in range(3):
                wave[c] *= step[c]
    return means, longer_m
