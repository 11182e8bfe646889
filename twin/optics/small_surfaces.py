"""Cells of a device that look at surfaces smaller than they are, which few paths would miss."""

import itertools

import numpy as np
from numpy.typing import NDArray

from twin.optics.devices import CellGrid

Array = NDArray[np.float64]

#: Paths across a surface's narrower side.
_ACROSS = 2.0
#: Paths across a cell at most, and of all cells together.
MOST_ACROSS, _MOST_PATHS = 64, 2**20


def least_samples(grid: CellGrid, boxes_m: Array) -> NDArray[np.int64]:
    """Paths, a square number, that each cell needs at least so that two of them pass side by side
    over every surface in front of the device, (n_cells,); 1 where none is small.

    ``boxes_m`` (n, 2, 3): least and largest coordinates of the surfaces. Of the smallest surfaces
    the share that `_MOST_PATHS` allow, the largest first.
    """
    least = np.ones((grid.rows, grid.columns), dtype=np.int64)
    spent = 0
    low, high = _in_cells(grid, boxes_m)
    side = (high - low).min(axis=1)
    for index in np.argsort(-side):
        across = int(np.ceil(_ACROSS / max(side[index], 1e-9)))
        if across == 1 or across > MOST_ACROSS:
            continue
        (left, top), (right, bottom) = np.floor(low[index]), np.floor(high[index])
        cells = least[max(int(top), 0) : int(bottom) + 1, max(int(left), 0) : int(right) + 1]
        spent += cells.size * across**2
        if spent > _MOST_PATHS:
            break
        np.maximum(cells, across**2, out=cells)
    return least.ravel()


def _in_cells(grid: CellGrid, boxes_m: Array) -> tuple[Array, Array]:
    """Least and largest column and row of the boxes that lie wholly before the device and partly in
    its field, (n, 2) each.
    """
    device = grid.device
    corners = np.array(
        [
            [boxes_m[:, side, axis] for axis, side in enumerate(sides)]
            for sides in itertools.product((0, 1), repeat=3)
        ]
    ).reshape(8, 3, -1)
    seen = np.einsum("ij,kjn->nki", device.axes, corners - device.origin_m[None, :, None])
    seen = seen[(seen[..., 0] > 0).all(axis=1)]
    field = (1 - seen[..., 1:] / seen[..., :1] / device.tan_half_field) / 2
    where = field * (grid.columns, grid.rows)
    low, high = where.min(axis=1), where.max(axis=1)
    inside = (high > 0).all(axis=1) & (low < (grid.columns, grid.rows)).all(axis=1)
    return low[inside], high[inside]
