"""Means over triangles of phasors whose phases are linear across them.

They are divided differences of the exponential between the phases at the corners (Gordon, IEEE
Trans. Antennas Propag. 23, 1975, 590), in any order of these; of phasors whose amplitudes are
linear as well, derivatives of the same. Where phases are alike their limits are taken.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Differences of phases, below which their squares are enough: along an edge, and across all of a
#: triangle.
_SHORT_RAD, _FLAT_RAD = 1e-2, 2e-2
#: Corners in the order of their values x, y, z, by the number x > y, plus 2 where x > z, plus 4
#: where y > z; 2 and 5 do not occur.
_ORDER = np.array(
    [[0, 1, 2], [1, 0, 2], [0, 1, 2], [1, 2, 0], [0, 2, 1], [2, 1, 0], [2, 0, 1], [2, 1, 0]]
)


def mean_phasors(phase: Array) -> Complex:
    """Means (n,) of phasors, of phases (3, n) at the corners, in ascending order."""
    apart, wave = _apart(phase), np.exp(1j * phase)
    lower, upper = _along(apart[0], wave[0], wave[1]), _along(apart[1], wave[1], wave[2])
    is_flat = apart[2] <= _FLAT_RAD
    mean: Complex = 2 * (upper - lower) / (1j * np.where(is_flat, 1.0, apart[2]))
    flat = np.flatnonzero(is_flat)
    squares = np.sum(apart[:, flat] ** 2, axis=0)
    mean[flat] = wave[:, flat].mean(axis=0) * (1 + squares / 24)
    return mean


def mean_waves(
    longer_m: Array, factor: Complex, phasor: Complex, step: Complex, wavenumber: float, by: float
) -> Complex:
    """Means of waves at three wavenumbers, one less and one more ``by`` some rad/m, (3, n).

    ``longer_m``, ``factor``, ``phasor`` and ``step`` (3, n) at the corners: path length, amplitude,
    and phasors of the length, at the middle wavenumber and for ``by``.
    """
    x, y, z = longer_m
    order = _ORDER.T[:, (x > y) + 2 * (x > z) + 4 * (y > z)] * len(x) + np.arange(len(x))
    factor, phasor, step = (v.ravel()[order] for v in (factor, phasor, step))
    apart_m = _apart(longer_m.ravel()[order])
    waves = (
        (wavenumber - by, phasor * step.conj()),
        (wavenumber, phasor),
        (wavenumber + by, phasor * step),
    )
    return np.array([_mean_wave(-k * apart_m, factor, wave) for k, wave in waves])


def _mean_wave(apart: Array, factor: Complex, wave: Complex) -> Complex:
    """Of phasors and their amplitudes at the corners, (3, n), and the phases between corners."""
    lower, upper = _along(apart[0], wave[0], wave[1]), _along(apart[1], wave[1], wave[2])
    is_flat = np.abs(apart[2]) <= _FLAT_RAD
    turn = 1j * np.where(is_flat, 1.0, apart[2])
    whole = (upper - lower) / turn
    first = (whole - _change(apart[0], wave[0], lower)) / turn
    last = (whole - _change(-apart[1], wave[2], upper)) / -turn
    mean: Complex = 2 * (factor[0] * first + factor[1] * (whole - first - last) + factor[2] * last)
    flat = np.flatnonzero(is_flat)
    some, at = factor[:, flat], wave[:, flat]
    squares = np.sum(apart[:, flat] ** 2, axis=0)
    mean[flat] = np.mean(some * (at + at.sum(axis=0)), axis=0) / 4 * (1 + squares / 24)
    return mean


def _apart(at: Array) -> Array:
    """Between the first two corners, the last two, and the first and the last, (3, n)."""
    return np.array([at[1] - at[0], at[2] - at[1], at[2] - at[0]])


def _along(apart: Array, begin: Complex, end: Complex) -> Complex:
    """Means along edges of phasors whose phases are ``apart`` at their ends."""
    is_short = np.abs(apart) < _SHORT_RAD
    mean: Complex = (end - begin) / (1j * np.where(is_short, 1.0, apart))
    short = np.flatnonzero(is_short)
    mean[short] = (begin[short] + end[short]) / 2 * (1 + apart[short] ** 2 / 12)
    return mean


def _change(apart: Array, begin: Complex, mean: Complex) -> Complex:
    """By how much means along edges change with the phase at the beginning, over j."""
    is_short = np.abs(apart) < _SHORT_RAD
    change: Complex = (mean - begin) / (1j * np.where(is_short, 1.0, apart))
    short = np.flatnonzero(is_short)
    turn = 1j * apart[short]
    change[short] = begin[short] * (1 / 2 + turn / 6 + turn**2 / 24)
    return change
