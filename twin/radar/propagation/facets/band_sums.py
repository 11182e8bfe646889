"""Sums of many echoes over a band, of each owner by itself."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_AT_ONCE = 8192  # echoes that are summed together, which the processor's cache holds


def band_sums(
    owner: NDArray[np.integer], count: int, echo: Complex, length_m: Array, wave_numbers: Array
) -> Complex:
    """Sums of echo exp(-j k length) by owner, (count, n_frequencies), at wave numbers k equally
    spaced: to 1e-5 of the strongest, since levels and estimates of errors need no more.
    """
    n = len(wave_numbers)
    sums_of_owners = np.zeros((count, n), dtype=np.complex128)
    lowest = wave_numbers[0]
    step = wave_numbers[min(1, n - 1)] - lowest
    # Frequency a + p b by a product of matrices: turned by a steps, times turned by p b steps.
    p = int(np.ceil(np.sqrt(n)))
    q = -(-n // p)
    order = np.argsort(owner.astype(np.uint16) if count < 2**16 else owner, kind="stable")
    for begin in range(0, len(order), _AT_ONCE):
        some = order[begin : begin + _AT_ONCE]
        length, whose = length_m[some], owner[some]
        turn = _waves(step * length)
        fine = np.empty((p, len(some)), dtype=np.complex64)
        fine[0] = echo[some]
        fine[0] *= _waves(lowest * length)
        far = turn.copy()
        for i in range(1, p):
            np.multiply(fine[i - 1], turn, out=fine[i])
            far *= turn
        wide = np.ones((q, len(some)), dtype=np.complex64)
        for i in range(1, q):
            np.multiply(wide[i - 1], far, out=wide[i])
        ends = [0, *(np.flatnonzero(np.diff(whose)) + 1).tolist(), len(some)]
        for first, last in pairwise(ends):
            sums = wide[:, first:last] @ fine[:, first:last].T
            sums_of_owners[whose[first]] += sums.ravel()[:n]
    return sums_of_owners


def _waves(phase_rad: Array) -> NDArray[np.complex64]:
    """exp(-j phase), the phase reduced in float64."""
    cycles = phase_rad / (2 * np.pi)
    cycles -= np.floor(cycles)
    rest = cycles.astype(np.float32) * np.float32(-2 * np.pi)
    wave = np.empty(len(rest), dtype=np.complex64)
    np.cos(rest, out=wave.real)
    np.sin(rest, out=wave.imag)
    return wave
