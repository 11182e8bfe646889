"""Light that paths may have missed: bounds of what is smaller than the space between them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from twin.optics.devices import CellGrid, Device

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

#: Number of paths that would meet what all of them miss in 5 of 100 cases.
_MISSED = 3.0
#: Parts of the facets by the lengths of the ways over them.
_LENGTHS = 64


def facet_light(
    grid: CellGrid, detector: Device, corners: tuple[Array, Array], columns: int = 1
) -> Array:
    """Light that each cell would have if a facet filled it that has a corner in it or in a cell
    around, (rows, columns): facing both devices, as near and as reflective as that corner. 0 where
    there are no corners, and so no facets that paths could pass between.

    ``corners``: positions (n, 3) and reflectances (n,) of the meshes' vertices. ``columns`` of the
    detector, if it is a line sensor: the cells that each sees, side by side.
    """
    shape = (grid.rows, columns * grid.columns)
    if grid.device.pitch_m is not None:
        return np.full(shape, _of_elements(grid, detector, corners))
    _, places, facing = _facing(grid, detector, corners, columns)
    return _brightest(shape, places, facing)


@dataclass(frozen=True, eq=False)
class FacetsByLength:
    """`facet_light` in parts, (n, rows, columns), of the corners over which the way from emitter to
    detector is from ``shortest_m`` to ``longest_m``, (n,).
    """

    light: Array
    shortest_m: Array
    longest_m: Array


def facets_by_length(
    grid: CellGrid, detector: Device, corners: tuple[Array, Array], length_m: Array
) -> FacetsByLength:
    """Parts of about as many corners; ``length_m`` of the way over each corner, (n,)."""
    if grid.device.pitch_m is not None:
        light = facet_light(grid, detector, corners)
        shortest_m = min(length_m.min(initial=np.inf), length_m.max(initial=0.0))
        return FacetsByLength(
            light[None], np.array([shortest_m]), np.array([length_m.max(initial=0.0)])
        )
    which, places, facing = _facing(grid, detector, corners)
    length_m = length_m[which]
    order = np.argsort(length_m, kind="stable")
    parts = np.array_split(order, min(_LENGTHS, len(order))) if len(order) else []
    number = np.empty_like(order)
    number[order] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    light = _brightest((len(parts), grid.rows, grid.columns), np.stack([number, *places]), facing)
    shortest_m, longest_m = (np.array([length_m[part[end]] for part in parts]) for end in (0, -1))
    return FacetsByLength(light, shortest_m, longest_m)


def _facing(
    grid: CellGrid, detector: Device, corners: tuple[Array, Array], columns: int = 1
) -> tuple[Ints, Ints, Array]:
    """Numbers of the corners in the field, (n,), row and column of each, (2, n), and the light of a
    facet there that fills a cell, (n,).
    """
    vertices_m, reflectance = corners
    across, down = _places(grid.device, vertices_m)
    column, row = np.floor(across * grid.columns), np.floor(down * grid.rows)
    if columns > 1:
        column += grid.columns * np.floor(_places(detector, vertices_m)[0] * columns)
    inside = np.flatnonzero(np.isfinite(column + row))
    distance2 = _squared_norms(vertices_m[inside] - detector.origin_m)
    solid_angle = (2 * grid.device.tan_half_field) ** 2 / grid.size / columns
    facing = solid_angle * reflectance[inside] / np.pi / np.maximum(distance2, 1e-12)
    # Rounding may bring what is just within the field to its end.
    last = np.array([[grid.rows - 1], [columns * grid.columns - 1]])
    return inside, np.minimum(np.stack([row, column])[:, inside].astype(int), last), facing


def _brightest(shape: tuple[int, ...], places: Ints, light: Array) -> Array:
    """Of light at places (k, n) the brightest in each cell and the cells around it, (.., rows,
    columns).
    """
    brightest = np.zeros(shape)
    np.maximum.at(brightest, tuple(places), light)
    return np.asarray(maximum_filter(brightest, 3, axes=(-2, -1), mode="constant"))


def _places(device: Device, points_m: Array) -> Array:
    """Of points across and down a device's field, each from 0 to 1, (2, n); NaN: not in it."""
    ahead, left, up = device.axes @ (points_m - device.origin_m).T
    reach = device.tan_half_field * ahead
    inside = (np.abs(left) < reach) & (np.abs(up) < reach)
    places = (1 - np.stack([left, up]) / np.where(inside, reach, 1.0)) / 2
    return np.where(inside, places, np.nan)


def _of_elements(grid: CellGrid, detector: Device, corners: tuple[Array, Array]) -> float:
    """The same where each element lights the whole field: the paths of all cells look for the same
    facets, and miss one that has three paths' share of all of them in 5 of 100 cases.
    """
    emitter, (vertices_m, reflectance) = grid.device, corners
    lit = (vertices_m - emitter.origin_m) @ emitter.axes[0] > 0
    to_detector = vertices_m - detector.origin_m
    seen = lit & (to_detector @ detector.axes[0] > 0)
    distance2 = np.maximum(_squared_norms(to_detector[seen]), 1e-12)
    brightest = float((reflectance[seen] / np.pi / distance2).max(initial=0.0))
    whole = 2 * np.pi / (emitter.lobe_exponent + 1) / grid.size * brightest
    # As a deviation that is sqrt(3) times that of a share that is as likely as any smaller one.
    return _MISSED * math.sqrt(3) * whole / grid.size


def _squared_norms(vectors: Array) -> Array:
    """Of vectors (n, 3): a tenth of the time of a sum over so short an axis."""
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))


def contrast(light: Array) -> Array:
    """Largest difference of light (rows, columns) among the cells around each, (n_cells,): what an
    edge that just enters a cell may bring or take. Outside the image it is dark: the edge of the
    detector's field may run through the cells there.
    """
    brightest, darkest = maximum_filter(light, 3), minimum_filter(light, 3, mode="constant")
    return np.asarray((brightest - darkest).ravel())


def missed_edge_variance(light: Array, paths: float) -> Array:
    """Variance of cells' light, (rows, columns), by edges that all ``paths`` of a cell miss: the
    scatter of those that meet one shows it.

    Paths miss the area of A strata with the probability of e^-A at most, and it has A / ``paths``
    of the contrast: 4 / e^2 in the mean square, wherever the edge is; of few paths, of which a
    square root's number are in strata with an edge, no more than what that brings to their mean.
    """
    missed = np.minimum((2 / math.e / paths) ** 2, 1 / (6 * paths**1.5))
    return np.square(contrast(light).reshape(light.shape)) * missed


def missed_facet_variance(facets: Array, light: Array, paths: float) -> Array:
    """Variance of cells' light by `facet_light` that would be brighter, and that all ``paths`` of a
    cell may have missed: up to one path's share, any of which is as likely as any other.
    """
    return np.square(np.maximum(facets - light, 0) / paths) / 3
