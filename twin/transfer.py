"""NumPy arrays to the engine and back, so that no kernel is compiled for one array alone.

Dr.Jit writes two things about an array into the code of a kernel: how the memory of one taken from
NumPy is aligned, and how long a vector is that is turned into a matrix. Either makes a new frame
compile for tens of milliseconds what an older one already had.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

_ALIGNMENT = 64  # bytes: what Dr.Jit's own arrays have


def aligned(values: NDArray[Any]) -> NDArray[Any]:
    """A flat copy where the engine's arrays begin, to be handed over element by element."""
    room = np.empty(values.nbytes + _ALIGNMENT, dtype=np.uint8)
    start = -room.ctypes.data % _ALIGNMENT
    copy = room[start : start + values.nbytes].view(values.dtype)
    copy[:] = values.ravel()
    return copy


def vector(mi: Any, values: NDArray[np.float64], kind: str) -> Any:
    """Rows (n, 3) as a vector of the engine: ``kind`` Vector3d, Point3f, Vector3f."""
    number = mi.Float64 if kind.endswith("d") else mi.Float
    narrow = np.float64 if kind.endswith("d") else np.float32
    return getattr(mi, kind)(*(number(aligned(values[:, i].astype(narrow))) for i in range(3)))


def rows(value: Any) -> NDArray[Any]:
    """A vector of the engine as rows (n, 3)."""
    return np.stack([np.array(part) for part in value], axis=1)
