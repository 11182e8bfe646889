"""The two halves of a primal-dual step for total variation, on a picture with free edges."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware import compiled

Array = NDArray[np.float64]


def ascend(picture: Array, duals: Array, step: float) -> None:
    """Dual step, in place: p <- p + step grad x, each cell's vector cut to length 1.

    ``picture`` (rows, columns), ``duals`` (2, rows, columns): down the rows, along the columns.
    """
    if compiled.available():
        compiled.kernel(_ascend_loops)(picture, duals, step)
    else:
        _ascend_arrays(picture, duals, step)


def descend(picture: Array, duals: Array, step: float) -> Array:
    """Primal step: x + step div p, with div = -grad^T."""
    out = np.empty_like(picture)
    if compiled.available():
        compiled.kernel(_descend_loops)(picture, duals, step, out)
    else:
        _descend_arrays(picture, duals, step, out)
    return out


def _ascend_arrays(x: Array, p: Array, step: float) -> None:
    p[0, :-1] += step * (x[1:] - x[:-1])
    p[1, :, :-1] += step * (x[:, 1:] - x[:, :-1])
    length = np.sqrt(p[0] ** 2 + p[1] ** 2)
    p /= np.maximum(length, 1.0, out=length)


def _descend_arrays(x: Array, p: Array, step: float, out: Array) -> None:
    out[...] = x
    flow = step * p
    out += flow[0]
    out += flow[1]
    out[1:] -= flow[0, :-1]
    out[:, 1:] -= flow[1, :, :-1]


def _ascend_loops(x: Any, p: Any, step: float) -> None:
    rows, columns = x.shape
    for i in range(rows):
        below = min(i + 1, rows - 1)
        for j in range(columns - 1):
            down = p[0, i, j] + step * (x[below, j] - x[i, j])
            along = p[1, i, j] + step * (x[i, j + 1] - x[i, j])
            scale = 1 / np.sqrt(max(down * down + along * along, 1.0))
            p[0, i, j], p[1, i, j] = down * scale, along * scale
        down = p[0, i, columns - 1] + step * (x[below, columns - 1] - x[i, columns - 1])
        p[0, i, columns - 1] = min(max(down, -1.0), 1.0)


def _descend_loops(x: Any, p: Any, step: float, out: Any) -> None:
    rows, columns = x.shape
    for i in range(rows):
        for j in range(columns):
            out[i, j] = x[i, j] + step * (p[0, i, j] + p[1, i, j])
        for j in range(1, columns):
            out[i, j] -= step * p[1, i, j - 1]
        if i > 0:
            for j in range(columns):
                out[i, j] -= step * p[0, i - 1, j]
