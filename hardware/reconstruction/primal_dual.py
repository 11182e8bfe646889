"""The two halves of a primal-dual step for total variation, on a picture with free edges.

Differences count with ``weights`` (down the rows, along the columns), and steps are over-relaxed
(Condat, J. Optim. Theory Appl. 158, 2013, algorithm 3.2): each goes ``RELAXATION`` times as far.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware import compiled

Array = NDArray[np.float64]

#: Below 2, where convergence ends.
RELAXATION = 1.9


def ascend(ahead: Array, duals: Array, step: float, weights: tuple[float, float]) -> None:
    """Dual step, in place: p + step grad x, each cell's vector cut to length 1, over-relaxed.

    ``ahead`` (rows, columns), ``duals`` (2, rows, columns): down the rows, along the columns.
    """
    down, along = step * weights[0], step * weights[1]
    if compiled.available():
        compiled.kernel(_ascend_loops)(ahead, duals, down, along, RELAXATION)
    else:
        _ascend_arrays(ahead, duals, down, along)


def descend(picture: Array, duals: Array, step: float, weights: tuple[float, float]) -> Array:
    """Primal step: x + step div p, with div = -grad^T."""
    out = np.empty_like(picture)
    down, along = step * weights[0], step * weights[1]
    if compiled.available():
        compiled.kernel(_descend_loops)(picture, duals, down, along, out)
    else:
        _descend_arrays(picture, duals, down, along, out)
    return out


def _ascend_arrays(x: Array, p: Array, down: float, along: float) -> None:
    raised = np.empty_like(p)
    raised[0, -1], raised[1, :, -1] = 0.0, 0.0
    np.subtract(x[1:], x[:-1], out=raised[0, :-1])
    np.subtract(x[:, 1:], x[:, :-1], out=raised[1, :, :-1])
    raised[0] *= down
    raised[1] *= along
    raised += p
    length = np.square(raised[0])
    length += raised[1] ** 2
    np.maximum(length, 1.0, out=length)
    np.sqrt(length, out=length)
    np.divide(RELAXATION, length, out=length)
    raised *= length
    p *= 1 - RELAXATION
    p += raised


def _descend_arrays(x: Array, p: Array, down: float, along: float, out: Array) -> None:
    flow = down * p[0]
    np.add(x, flow, out=out)
    out[1:] -= flow[:-1]
    np.multiply(p[1], along, out=flow)
    out += flow
    out[:, 1:] -= flow[:, :-1]


def _ascend_loops(x: Any, p: Any, down: float, along: float, relaxation: float) -> None:
    rows, columns = x.shape
    previous_weight = 1 - relaxation
    for i in range(rows):
        below = min(i + 1, rows - 1)
        for j in range(columns - 1):
            a = p[0, i, j] + down * (x[below, j] - x[i, j])
            b = p[1, i, j] + along * (x[i, j + 1] - x[i, j])
            scale = relaxation / np.sqrt(max(a * a + b * b, 1.0))
            p[0, i, j] = previous_weight * p[0, i, j] + a * scale
            p[1, i, j] = previous_weight * p[1, i, j] + b * scale
        j = columns - 1
        a = p[0, i, j] + down * (x[below, j] - x[i, j])
        p[0, i, j] = previous_weight * p[0, i, j] + relaxation * min(max(a, -1.0), 1.0)


def _descend_loops(x: Any, p: Any, down: float, along: float, out: Any) -> None:
    rows, columns = x.shape
    for i in range(rows):
        for j in range(columns):
            out[i, j] = x[i, j] + down * p[0, i, j] + along * p[1, i, j]
        for j in range(1, columns):
            out[i, j] -= along * p[1, i, j - 1]
        if i > 0:
            for j in range(columns):
                out[i, j] -= down * p[0, i - 1, j]
