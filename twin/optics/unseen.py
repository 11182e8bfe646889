"""Light that paths may have missed: bounds of what is smaller than the space between them."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from twin.optics.devices import CellGrid, Device

Array = NDArray[np.float64]


def facet_light(grid: CellGrid, detector: Device, corners: tuple[Array, Array]) -> Array:
    """Light that each cell would have if a facet filled it that has a corner in it or in a cell
    around, (n_cells,): facing both devices, as near and as reflective as that corner. 0 where there
    are no corners, and so no facets that paths could pass between.

    ``corners``: positions (n, 3) and reflectances (n,) of the meshes' vertices.
    """
    emitter, light = grid.device, np.zeros((grid.rows, grid.columns))
    if emitter.pitch_m is not None:  # each element lights the whole field
        return light.ravel()
    vertices_m, reflectance = corners
    seen = (vertices_m - emitter.origin_m) @ emitter.axes.T
    before = seen[:, 0] > 0
    seen, vertices_m, reflectance = seen[before], vertices_m[before], reflectance[before]
    field = (1 - seen[:, 1:] / seen[:, :1] / emitter.tan_half_field) / 2
    column, row = np.floor(field * (grid.columns, grid.rows)).T
    inside = (column >= 0) & (column < grid.columns) & (row >= 0) & (row < grid.rows)
    distance2 = np.sum((vertices_m[inside] - detector.origin_m) ** 2, axis=1)
    solid_angle = (2 * emitter.tan_half_field) ** 2 / grid.size
    facing = solid_angle * reflectance[inside] / np.pi / np.maximum(distance2, 1e-12)
    np.maximum.at(light, (row[inside].astype(int), column[inside].astype(int)), facing)
    return np.asarray(maximum_filter(light, 3, mode="constant").ravel())


def contrast(light: Array) -> Array:
    """Largest difference of light (rows, columns) among the cells around each, (n_cells,): what an
    edge that just enters a cell may bring or take.
    """
    return np.asarray((maximum_filter(light, 3) - minimum_filter(light, 3)).ravel())
