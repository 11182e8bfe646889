"""NumPy arrays to the engine and back, so that no kernel is compiled for one array alone.

Dr.Jit writes three things about an array into the code of a kernel: how the memory of one taken
from NumPy is aligned, how long a vector is that is turned into a matrix, and how long are arrays
that others are put behind. Each makes a new frame compile for tens of milliseconds what an older
one already had.
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

_ALIGNMENT = 64  # bytes: what Dr.Jit's own arrays have
#: Bytes beyond the end that a kernel may read, where no memory need be: Dr.Jit takes the memory of
#: arrays of NumPy as it is, and reads vectors of up to 16 numbers of 8 bytes.
_BEYOND = 16 * 8


def aligned(values: NDArray[Any]) -> NDArray[Any]:
    """A flat copy where the engine's arrays begin, with memory behind it for the last vector of a
    kernel, to be handed over element by element.
    """
    room = np.empty(values.nbytes + _ALIGNMENT + _BEYOND, dtype=np.uint8)
    start = -room.ctypes.data % _ALIGNMENT
    copy = room[start : start + values.nbytes].view(values.dtype)
    copy[:] = values.ravel()
    return copy


def vector(mi: Any, values: NDArray[np.float64], kind: str) -> Any:
    """Rows (n, 3) as a vector of the engine: ``kind`` Vector3d, Point3f, Vector3f."""
    number = mi.Float64 if kind.endswith("d") else mi.Float
    narrow = np.float64 if kind.endswith("d") else np.float32
    return getattr(mi, kind)(*(number(aligned(values[:, i].astype(narrow))) for i in range(3)))


def concatenated(columns: Sequence[Sequence[Any]], sizes: Sequence[int]) -> list[Any]:
    """Columns of numbers on the device, the parts of each, of these sizes, one after the other."""
    index = dr.uint32_array_t(type(columns[0][0]))
    first = index(aligned(np.cumsum([0, *sizes[:-1]]).astype(np.uint32)))
    found = [dr.empty(type(parts[0]), sum(sizes)) for parts in columns]
    for i, size in enumerate(sizes):
        row = dr.arange(index, size) + dr.gather(index, first, i)
        for column, parts in zip(found, columns, strict=True):
            dr.scatter(column, parts[i], row, mode=dr.ReduceMode.Permute)
        dr.eval(*found)  # by themselves: parts of one size would share a kernel of their own
    return found


def host(values: Sequence[Any], count: int) -> list[NDArray[Any]]:
    """Numbers, each (count,), and vectors, each (count, 3), all computed at once."""
    dr.eval(*values)
    found = []
    for value in values:
        one = np.array(value) if dr.depth_v(value) == 1 else np.stack([*map(np.array, value)], 1)
        found.append(np.broadcast_to(one, (count, *one.shape[1:])))
    return found
