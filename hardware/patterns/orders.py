"""Orders of the Hadamard patterns: which come first, so that few of them carry most of an image.

Each order is a permutation of the rows of the Sylvester matrix H_rows (x) H_columns. All of them
follow from the sign changes of a pattern down its rows and along its columns (its sequency), since
a pattern is the outer product of two Walsh functions. Ties keep Sylvester's own order.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.patterns.transform import hadamard_rows

Integers = NDArray[np.intp]


def natural(rows: int, columns: int) -> Integers:
    """Sylvester's own order."""
    return np.arange(rows * columns)


def sequency(rows: int, columns: int) -> Integers:
    """Ascending sum of the sign changes along rows and along columns."""
    down, along = _changes(rows, columns)
    return _ascending(down + along)


def sequency_max(rows: int, columns: int) -> Integers:
    """Ascending larger of the two sequencies: squares of the sequency plane; then their sum."""
    down, along = _changes(rows, columns)
    return _ascending(np.maximum(down, along), down + along)


def walsh(rows: int, columns: int) -> Integers:
    """Walsh's order of the flattened pattern: ascending sign changes from cell to cell."""
    return _ascending(sign_changes(rows * columns))


def zigzag(rows: int, columns: int) -> Integers:
    """JPEG's path through the sequency plane (ITU-T T.81, figure 5): right, down-left, up-right."""
    down, along = _changes(rows, columns)
    diagonal = down + along
    return _ascending(diagonal, np.where(diagonal % 2, down, along))


def cake_cutting(rows: int, columns: int) -> Integers:
    """Ascending number of connected pieces (Yu, Sensors 19, 4122, 2019).

    Neighbouring blocks of an outer product differ in sign, so its pieces are its blocks.
    """
    down, along = _changes(rows, columns)
    return _ascending((down + 1) * (along + 1))


def russian_dolls(rows: int, columns: int) -> Integers:
    """Complete sets of smaller images one inside the other (Sun et al., Sci. Rep. 7, 3464, 2017).

    Each doll doubles both sides: after the smaller doll come patterns that are finer down the
    rows only, then along the columns only (for a square, their transposes), then in both; within
    each of these quarters by the number of pieces.
    """
    down, along = _changes(rows, columns)
    down_level, along_level = _halvings(down, rows), _halvings(along, columns)
    doll = np.minimum(down_level, along_level)
    quarter = 2 * (along_level == doll) + (down_level == doll)
    return _ascending(-doll, quarter, (down + 1) * (along + 1))


def total_variation(rows: int, columns: int) -> Integers:
    """Ascending isotropic total variation (Rudin, Osher and Fatemi, Physica D 60, 1992).

    Steps down the rows and along the columns are of height 2; where both meet they add in squares.
    The anisotropic kind would be the total sequency on a square grid.
    """
    down, along = _changes(rows, columns)
    return _ascending(np.round(down * columns + along * rows - (2 - np.sqrt(2)) * down * along, 9))


def prior_variance(rows: int, columns: int) -> Integers:
    """Descending variance of the measurement under the 1/f^2 prior; the mean comes first.

    var(h x) = sum over frequencies of the prior's power times that of the pattern.
    """
    power = 1 / squared_frequency(rows, columns)
    variance = (spectra(rows) @ power @ spectra(columns).T).ravel()
    variance[0] = np.inf
    return _ascending(-np.round(variance / variance[1:].max(initial=1e-300), 12))


def interleaved(rows: int, columns: int) -> Integers:
    """The sequency order, of which `interleaved_places` then says when each row is shown."""
    return sequency(rows, columns)


ORDERS: dict[str, Callable[[int, int], Integers]] = {
    "natural": natural,
    "sequency": sequency,
    "sequency-max": sequency_max,
    "walsh": walsh,
    "zigzag": zigzag,
    "cake-cutting": cake_cutting,
    "russian-dolls": russian_dolls,
    "total-variation": total_variation,
    "prior-variance": prior_variance,
    "interleaved": interleaved,
}


@lru_cache(maxsize=32)
def ordered_indices(rows: int, columns: int, order: str) -> Integers:
    """Rows of the natural-order matrix in an order, ``(rows * columns,)``, read only."""
    index = ORDERS[order](rows, columns)
    index.flags.writeable = False
    return index


def shown_indices(rows: int, columns: int, order: str, count: int) -> Integers:
    """The rows that the first ``count`` of an order are, in the order shown, ``(count,)``."""
    index = ordered_indices(rows, columns, order)[:count]
    if order != "interleaved":
        return index
    index = index[interleaved_places(count)]
    index.flags.writeable = False
    return index


@lru_cache(maxsize=32)
def interleaved_places(count: int) -> Integers:
    """Which of ``count`` rows by rising sequency is shown at each time: low and high in turn.

    Row k m mod count, with m the smallest number from 0.618 count (rounded) on that has no divisor
    in common with count. In any stretch of the frame the rows shown then lie nearly evenly in the
    order of sequency, as multiples of the golden ratio do modulo 1 (three-gap theorem: Sos, Ann.
    Univ. Sci. Budapest. Eotvos Sect. Math. 1, 1958), so that each holds a coarse image.
    """
    step = max((618 * count + 500) // 1000, 1)
    while math.gcd(step, count) > 1:
        step += 1
    return np.arange(count) * step % count


def sign_changes(n: int) -> NDArray[np.int64]:
    """Sign changes along each row of the natural-order n x n Hadamard matrix.

    The index with its bits reversed is the Gray code of the sequency.
    """
    bits = n.bit_length() - 1
    index = np.arange(n)
    gray = np.zeros(n, np.int64)
    for bit in range(bits):
        gray |= ((index >> bit) & 1) << (bits - 1 - bit)
    for shift in (1, 2, 4, 8, 16, 32):
        gray ^= gray >> shift
    return gray


def spectra(n: int) -> NDArray[np.float64]:
    """Power of each Hadamard row at each of the n frequencies, ``(n, n)``, rows sum to n."""
    walsh_functions = hadamard_rows(np.arange(n), n).astype(np.float64)
    power: NDArray[np.float64] = np.abs(np.fft.fft(walsh_functions, axis=1)) ** 2 / n
    return power


def squared_frequency(rows: int, columns: int) -> NDArray[np.float64]:
    """f^2 in cycles per image at each Fourier coefficient; infinite for the mean."""
    f2 = np.fft.fftfreq(rows, 1 / rows)[:, None] ** 2 + np.fft.fftfreq(columns, 1 / columns) ** 2
    f2[0, 0] = np.inf
    return np.asarray(f2, dtype=np.float64)


def _changes(rows: int, columns: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sign changes down the rows and along the columns, of every pattern in natural order."""
    index = np.arange(rows * columns)
    return sign_changes(rows)[index // columns], sign_changes(columns)[index % columns]


def _halvings(changes: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """How often the axis can be halved without losing the pattern; many times for a constant."""
    bits = np.ceil(np.log2(changes + 1)).astype(np.int64)
    return np.where(changes == 0, 64, size.bit_length() - 1 - bits)


def _ascending(*keys: NDArray[np.generic]) -> Integers:
    return np.lexsort(keys[::-1])
