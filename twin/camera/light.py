"""Light that reaches each detector: from every emitter cell, and from the sun."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.optics.matrix import Grid, transport_matrix
from twin.optics.transport import Pinhole, Quality, sunlight, transport

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Light:
    """Per detector and cell, (n_detectors, n_cells): irradiance on the pupil per radiant intensity,
    1/m^2, with its Monte-Carlo standard error.
    """

    cells: Array
    error: Array


def emitter_light(
    world: Any,
    emitter: Pinhole,
    detector: Pinhole,
    shape: tuple[int, int],
    n_detectors: int,
    *,
    quality: Quality,
    seed: int,
) -> Light:
    """Transport from ``shape`` cells to one bucket, or to the columns of a line sensor."""
    if n_detectors == 1:
        found = transport(world, emitter, detector, shape, quality=quality, seed=seed)
        return Light(found.total.reshape(1, -1), found.standard_error.reshape(1, -1))
    cells, columns = Grid(emitter, *shape), Grid(detector, 1, n_detectors)
    finer, coarser = max(cells.size, n_detectors), min(cells.size, n_detectors)
    # As many paths per pair of cell and column as a bucket's cell would have, in two halves that
    # tell the error.
    side = math.ceil(math.sqrt(quality.samples * coarser / 2))
    halves = [
        transport_matrix(
            world,
            cells,
            columns,
            quality=Quality(side * side, quality.max_depth),
            seed=seed + half,
            role="scatter" if finer == n_detectors else "dual",
        )
        for half in range(2)
    ]
    return Light((halves[0] + halves[1]) / 2, np.abs(halves[0] - halves[1]) / 2)


def sun_light(
    world: Any,
    detector: Pinhole,
    direction: Array,
    n_detectors: int,
    *,
    quality: Quality,
    seed: int,
) -> Array:
    """Irradiance on the pupil per irradiance of the sun, by detector, (n_detectors,)."""
    columns = 32 if n_detectors == 1 else n_detectors
    parts = sunlight(
        world, detector, direction, shape=(32, columns), quality=quality, seed=seed
    ).total
    return parts.sum(axis=0) if n_detectors > 1 else parts.sum(keepdims=True).reshape(1)
