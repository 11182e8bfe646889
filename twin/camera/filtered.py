"""What the filter passes of each cell and of each part of the field: means over their areas.

A filter before the lens passes less towards the edge of the field, within a cell too. The mean over
a cell is weighted by the light of a plane at the cell's depth that faces the device.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from twin.camera.rendered import RenderedLight
from twin.optics.devices import Device
from twin.optics.passband import Passband
from twin.optics.radiometry import cell_centres

Array = NDArray[np.float64]

#: Change over a cell, of the largest value, below which its middle stands for it.
_FLAT = 1e-6
#: Points of all cells together: several times what a line of 1 nm needs, whatever the grid.
_MOST_POINTS = 2**18


def share_of_cells(rendered: RenderedLight, band: Passband) -> Array:
    """Share of the emitter's line that passes from each cell of the virtual image, (rows, columns),
    at its true depth.
    """
    emitter, depth_m = rendered.emitter, rendered.truth.depth_m
    n = _per_side(band.angles_deg, band.emitter, depth_m.shape, emitter)
    left, up, weight = _points(depth_m.shape, n, emitter, math.sqrt(emitter.fill_factor))
    seen = rendered.towards(left, up, depth_m.repeat(n, axis=0).repeat(n, axis=1))
    weight = weight * (1 + left**2 + up**2) ** (-(3 + emitter.lobe_exponent) / 2)
    return _mean(band.emitter_at, seen, weight, rendered.detector, n)


def sun_of_parts(rendered: RenderedLight, band: Passband) -> Array:
    """Irradiance of the sun behind the filter, W/m^2, of each part of the detector's field, (rows,
    columns).
    """
    shape, detector = rendered.sun.shape, rendered.detector
    n = _per_side(band.angles_deg, band.sun_w_per_m2, shape, detector)
    left, up, weight = _points(shape, n, detector)
    seen = np.stack([np.ones_like(left), left, up], axis=-1) @ detector.axes
    return _mean(band.sun_at, seen, weight, detector, n)


def _per_side(angles_deg: Array, values: Array, shape: tuple[int, ...], device: Device) -> int:
    """Points to a side of a cell: eight for every width of the passband's steepest edge. Two are
    enough for the edge itself; where the field's border cuts a cell its mean is off by up to 2 %.
    """
    if len(angles_deg) == 1 or not (most := values.max()):
        return 1
    steepest = np.abs(np.diff(values) / np.diff(angles_deg)).max() / most
    widths = float(steepest) * math.degrees(2 * device.tan_half_field / min(shape))
    if widths < _FLAT:
        return 1
    return min(1 + math.ceil(8 * widths), max(2, math.isqrt(_MOST_POINTS // math.prod(shape))))


def _points(
    shape: tuple[int, ...], n: int, device: Device, lit: float = 1.0
) -> tuple[Array, Array, Array]:
    """Gauss's points of every cell, n to a side, on the plane at distance 1, left and up, and their
    weights; ``lit``: part of a cell's side.
    """
    node, weight = np.polynomial.legendre.leggauss(n)
    up, left = (
        -device.tan_half_field * (cell_centres(cells)[:, None] + lit * node / cells).ravel()
        for cells in shape
    )
    weights = np.multiply.outer(np.tile(weight, shape[0]), np.tile(weight, shape[1]))
    return *np.meshgrid(left, up), weights


def _mean(
    value_at: Callable[[Array], Array], seen: Array, weight: Array, detector: Device, n: int
) -> Array:
    """Mean of a value, by angle to the detector's axis, over the n x n points of every cell, seen
    in directions (rows, columns, 3), that lie in the detector's field; of a cell that has none
    there, or no light, over all. A surface that faces the detector sends cos^4 of its light.
    """
    ahead, left, up = np.moveaxis(seen @ detector.axes.T, -1, 0)
    cos = np.clip(ahead / np.linalg.norm(seen, axis=-1), -1, 1)
    value = value_at(np.degrees(np.arccos(cos)))
    if n == 1:
        return value
    beside = np.hypot(left, up) if detector.outline == "disc" else np.maximum(abs(left), abs(up))
    weight = weight * np.maximum(cos, 0) ** 4

    def of_cells(points: Array) -> Array:
        rows, columns = points.shape
        return points.reshape(rows // n, n, columns // n, n).sum(axis=(1, 3))

    def where_any(first: Array, other: Array) -> Array:
        has_some = of_cells(first) > 0
        return np.where(has_some.repeat(n, axis=0).repeat(n, axis=1), first, other)

    in_field = weight * (beside <= detector.tan_half_field * ahead)
    weight = where_any(in_field, where_any(weight, np.ones_like(weight)))
    return np.asarray(of_cells(weight * value) / of_cells(weight))
