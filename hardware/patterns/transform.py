"""The fast Walsh-Hadamard transform, and rows of the Hadamard matrix where a few are needed."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware import compiled
from hardware.errors import InputError

Array = NDArray[np.float64]


#: Values up to which matrix products, 0.2 ms at most, do: compiled steps take a sixth of that, but
#: 0.7 s to load.
_SMALL = 2**14


def fwht(values: NDArray[np.floating] | NDArray[np.integer]) -> Array:
    """Walsh-Hadamard transform H x along the first axis, natural order, unnormalised.

    Additions only, in float64: exact for integers as long as sums stay below 2**53. Applied twice
    it returns n x. Raises InputError unless the first axis is a power of two.
    """
    x = np.array(values, dtype=np.float64, order="C")
    return fwht_in_place(x)


def fwht_in_place(x: Array, *, repeated: bool = False) -> Array:
    """The same, overwriting a C-contiguous float64 array ``(n, ...)``, which is also returned.

    ``repeated``: it is one of many, for which compiled code is worth loading at any size.
    """
    n = x.shape[0]
    if n < 1 or n & (n - 1):
        raise InputError(f"length {n} is not a power of two")
    if x.dtype != np.float64 or not x.flags.c_contiguous:
        raise InputError(f"array: {x.dtype}, expected C-contiguous float64")
    if x.size == 0:
        return x
    if (repeated or x.size > _SMALL) and compiled.available():
        _compiled_steps(x.reshape(-1), x.size // n)
    else:
        _array_steps(x)
    return x


def hadamard_rows(indices: NDArray[np.integer], n_cells: int) -> NDArray[np.int8]:
    """Rows of the natural-order Hadamard matrix, +1 and -1, shape ``(len(indices), n_cells)``.

    H[i, j] = (-1)^popcount(i & j).
    """
    i = np.asarray(indices, dtype=np.uint64)[:, None]
    parity = np.bitwise_count(i & np.arange(n_cells, dtype=np.uint64)) & 1
    return (1 - 2 * parity.astype(np.int8)).astype(np.int8)


def _array_steps(x: Array) -> None:
    """Factors of up to 64 of the Kronecker product, each as one matrix product."""
    n, inner = x.shape[0], x.size // x.shape[0]
    while n > 1:
        factor = min(n, 64)
        matrix = small_matrix(factor)
        if inner == 1:  # the last axis, where the matrix goes to the right
            x[...] = (x.reshape(-1, factor) @ matrix).reshape(x.shape)
        else:
            blocks = x.reshape(-1, factor, inner)
            blocks[...] = matrix @ blocks
        n, inner = n // factor, inner * factor


_matrices: dict[int, Array] = {}


def small_matrix(n: int) -> Array:
    """The n x n Hadamard matrix, kept; for small n."""
    if n not in _matrices:
        _matrices[n] = hadamard_rows(np.arange(n), n).astype(np.float64)
    return _matrices[n]


#: 2 to this power values stay in the second-level cache while all their short strides are done.
_BLOCK_BITS = 14


def _compiled_steps(x: Array, inner: int) -> None:
    bits = (x.size // inner).bit_length() - 1
    long_steps = -(-max(bits - _BLOCK_BITS, 0) // 2)  # of radix 4, each one pass over memory
    compiled.kernel(butterflies)(x, inner, x.size >> 2 * long_steps)


def butterflies(x: Any, inner: int, block: int) -> None:
    """All steps on a flat array: short strides block by block, then the long ones.

    Strides 1, 2 and 4 in registers, then radix 4 on slices, which the compiler turns into vector
    instructions.
    """
    first, size = inner, block
    for _ in range(2):
        for start in range(0, x.size, size):
            stride = first
            if stride == 1 and size >= 8:
                for i in range(start, start + size, 8):
                    a, b, c, d = x[i] + x[i + 1], x[i] - x[i + 1], x[i + 2], x[i + 3]
                    e, f, g, h = x[i + 4] + x[i + 5], x[i + 4] - x[i + 5], x[i + 6], x[i + 7]
                    c, d, g, h = c + d, c - d, g + h, g - h
                    a, b, c, d = a + c, b + d, a - c, b - d
                    e, f, g, h = e + g, f + h, e - g, f - h
                    x[i], x[i + 1], x[i + 2], x[i + 3] = a + e, b + f, c + g, d + h
                    x[i + 4], x[i + 5], x[i + 6], x[i + 7] = a - e, b - f, c - g, d - h
                stride = 8
            while stride < size:
                radix = 4 if 4 * stride <= size else 2
                for base in range(start, start + size, radix * stride):
                    p, q = x[base : base + stride], x[base + stride : base + 2 * stride]
                    if radix == 4:
                        r = x[base + 2 * stride : base + 3 * stride]
                        s = x[base + 3 * stride : base + 4 * stride]
                        for i in range(stride):
                            a, b, c, d = p[i] + q[i], p[i] - q[i], r[i] + s[i], r[i] - s[i]
                            p[i], q[i], r[i], s[i] = a + c, b + d, a - c, b - d
                    else:
                        for i in range(stride):
                            a, b = p[i], q[i]
                            p[i], q[i] = a + b, a - b
                stride *= radix
        first, size = block, x.size
