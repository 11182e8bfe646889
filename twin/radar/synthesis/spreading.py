"""One-dimensional non-uniform FFT of contributions at one time, compiled.

Every contribution is spread over a few cells of a grid twice as fine as delays are resolved, by a
Kaiser-Bessel kernel; the grid's FFT over the kernel's own transform is the channel (Barnett,
Magland and af Klinteberg, SIAM J. Sci. Comput. 41, 2019). The kernel is a polynomial of each cell.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np

from twin.radar.synthesis.contributions import Array, Complex

_FINER = 2  # cells of the grid over subcarriers
_WIDTHS = 8, 16  # of kernels in cells: whole vectors of a processor
_REACHED = 5e-7  # error of the narrower one relative to the root mean square, at most
_COEFFICIENTS = 12, 20  # of the polynomials of their cells

#: Taylor coefficients of sin(2 pi x) / x and cos(2 pi x) in x^2: 2e-15 off at half a turn.
_SINE = np.array([(-1) ** k * (2 * np.pi) ** (2 * k + 1) / factorial(2 * k + 1) for k in range(13)])
_COSINE = np.array([(-1) ** k * (2 * np.pi) ** (2 * k) / factorial(2 * k) for k in range(14)])


@dataclass(frozen=True, eq=False)
class Kernel:
    """``cells`` (n_coefficients, width): polynomials of every cell's share in twice the distance of
    the first one from the contribution, plus one; ``inverse`` (n_subcarriers,) of its transform;
    ``grid``: its cells in all.
    """

    cells: Array
    inverse: Complex
    grid: int


@lru_cache(maxsize=32)
def kernel_of(n_subcarriers: int, tolerance: float) -> Kernel:
    """The narrowest kernel whose error is within a tolerance, or the widest there is."""
    from numpy.polynomial import chebyshev

    choice = 0 if tolerance >= _REACHED else 1
    width, coefficients = _WIDTHS[choice], _COEFFICIENTS[choice]
    shape = np.pi * width * (1 - 1 / (2 * _FINER))
    grid = max(_FINER * n_subcarriers, 2 * width)
    z = np.cos(np.pi * (np.arange(2 * coefficients) + 0.5) / (2 * coefficients))
    cells = np.empty((coefficients, width))
    for cell in range(width):
        share = _kaiser_bessel(((z - 1) / 2 + cell - width / 2 + 1) / (width / 2), shape)
        fitted = chebyshev.chebfit(z, share, coefficients - 1)
        cells[:, cell] = chebyshev.cheb2poly(fitted)
    offsets = np.arange(n_subcarriers) - n_subcarriers // 2
    place, weight = np.polynomial.legendre.leggauss(64)
    waves = np.cos(np.pi * width / grid * np.outer(place, offsets))
    transform = (width / 2 * weight * _kaiser_bessel(place, shape)) @ waves
    # On the grid as it is stored all lie half a kernel later.
    transform = transform * np.exp(-2j * np.pi * offsets * (width // 2 - 1) / grid)
    return Kernel(cells, 1 / transform, grid)


def _kaiser_bessel(x: Array, shape: float) -> Array:
    """From 1 in the middle to next to nothing at -1 and 1."""
    found: Array = np.i0(shape * np.sqrt(np.maximum(1 - x**2, 0.0))) / np.i0(shape)
    return found


def spectra(
    amplitude: Complex,
    delay: Array,
    rate: Array,
    acceleration: Array,
    times: Array,
    turns: float,
    kernel: Kernel,
) -> Complex:
    """Sums over contributions of amplitude exp(-j 2 pi (turns + k) d), with
    d = delay + (rate + acceleration t / 2) t, at every time and subcarrier k, (n_times,
    n_subcarriers).

    Parameters
    ----------
    amplitude, delay, rate, acceleration
        Each (n,); delays in periods of the subcarriers' spacing, and so the others per unit of
        time.
    times
        (n_times,).
    turns
        The carrier over the subcarriers' spacing.
    kernel
        `kernel_of` these subcarriers.
    """
    from scipy.fft import fft

    width, half = kernel.cells.shape[1], acceleration / 2
    real, imaginary = np.ascontiguousarray(amplitude.real), np.ascontiguousarray(amplitude.imag)
    strength, place = np.empty((2, len(delay))), np.empty(len(delay))
    grids = np.zeros((len(times), 2, kernel.grid + width))
    share = np.empty(width)
    at_time, spread = _compiled(_at_time), _compiled(_spreading(len(kernel.cells)))
    for grid, time in zip(grids, times, strict=True):
        at_time(delay, rate, half, real, imaginary, time, turns, _SINE, _COSINE, *strength, place)
        spread(place, *strength, kernel.grid, kernel.cells, share, *grid)
    grids[..., :width] += grids[..., kernel.grid :]
    waves = np.empty((len(times), kernel.grid), dtype=np.complex128)
    waves.real, waves.imag = grids[:, 0, : kernel.grid], grids[:, 1, : kernel.grid]
    found, lower = fft(waves, axis=1, overwrite_x=True), len(kernel.inverse) // 2
    sums = np.empty((len(times), len(kernel.inverse)), dtype=np.complex128)
    np.multiply(found[:, kernel.grid - lower :], kernel.inverse[:lower], out=sums[:, :lower])
    upper = len(kernel.inverse) - lower
    np.multiply(found[:, :upper], kernel.inverse[lower:], out=sums[:, lower:])
    return sums


@lru_cache(maxsize=8)
def _compiled(function: Callable[..., None]) -> Callable[..., None]:
    """By numba, kept on disk; runs beside other threads."""
    import numba

    fast: Callable[..., None] = numba.njit(
        function, cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"}
    )
    return fast


def _at_time(
    delay: Array,
    rate: Array,
    half: Array,
    real: Array,
    imaginary: Array,
    time: float,
    turns: float,
    sine: Array,
    cosine: Array,
    strength_re: Array,
    strength_im: Array,
    place: Array,
) -> None:
    """Strengths with the carrier's phase, and delays, at a time."""
    for i in range(len(delay)):
        there = delay[i] + (half[i] * time + rate[i]) * time
        cycles = -turns * there
        cycles -= np.floor(cycles + 0.5)
        square = cycles * cycles
        s, c = sine[12], cosine[13]
        for k in range(11, -1, -1):
            s = s * square + sine[k]
        for k in range(12, -1, -1):
            c = c * square + cosine[k]
        s *= cycles
        strength_re[i] = real[i] * c - imaginary[i] * s
        strength_im[i] = real[i] * s + imaginary[i] * c
        place[i] = there


@lru_cache(maxsize=2)
def _spreading(coefficients: int) -> Callable[..., None]:
    """What puts each contribution onto the cells around it, places in grids; the number of
    coefficients is known to the compiler.
    """
    last = coefficients - 1

    def spread(
        place: Array,
        strength_re: Array,
        strength_im: Array,
        grid: int,
        cells: Array,
        share: Array,
        grid_re: Array,
        grid_im: Array,
    ) -> None:
        width = len(share)
        for i in range(len(place)):
            x = (place[i] - np.floor(place[i])) * grid
            first = np.floor(x)
            z = 2.0 * (first - x) + 1.0
            for cell in range(width):
                value = cells[last, cell]
                for k in range(last - 1, -1, -1):
                    value = value * z + cells[k, cell]
                share[cell] = value
            begin = int(first)
            into_re, into_im = grid_re[begin : begin + width], grid_im[begin : begin + width]
            u, v = strength_re[i], strength_im[i]
            for cell in range(width):
                into_re[cell] += u * share[cell]
            for cell in range(width):
                into_im[cell] += v * share[cell]

    return spread
