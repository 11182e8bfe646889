"""Transport matrix between every emitter cell and every detector pixel, from one set of paths.

Paths start in the cells of one device and connect to the other device at every bounce. The point
of the connection in the other device's field determines its cell. *Dual*: paths start at the
emitter. *Scatter*: paths start at the detector's pixels. Both give the same matrix, in
scattering air too; the noise is lower when paths start at the device with more cells.
"""

from typing import Any, Literal, get_args

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.errors import InputError
from twin.optics.devices import CellGrid
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.ray_sets import pairs_of_strata, strata, strata_beside
from twin.optics.tracer import Block, Tracer

Array = NDArray[np.float64]
Start = Literal["dual", "scatter"]


def transport_matrix(
    problem: LightProblem,
    cells: tuple[int, int],
    pixels: tuple[int, int],
    *,
    quality: TracingQuality,
    seed: int,
    start: Start = "dual",
) -> tuple[Array, Array]:
    """T[pixel, cell] between ``cells`` of the emitter and ``pixels`` of the detector, (rows,
    columns) each, in 1/m^2: shape (n_pixels, n_cells); and the scatter of its paths, as
    `twin.optics.transport.path_moments` has it: over their number, `TracingQuality.samples`, it is
    the variance of T.

    The power that cell i puts on pixel j is I tau A_pupil T[j, i]; summed over the pixels it is
    `transport`. Contributions are added in float64 in a fixed order: same seed, same bits.

    Raises InputError for an unknown ``start``, and for *scatter* towards elements without a lens.
    """
    if start not in get_args(Start):
        raise InputError(f"start: {start!r} is none of dual, scatter")
    if start == "dual":
        tracer = problem.from_emitter(cells, quality, seed)
        mean, scatter = _matrix(tracer, CellGrid(problem.detector, *pixels))
        return mean.T, scatter.T
    if problem.emitter.pitch_m is not None:
        raise InputError("start: scatter needs an emitter behind a lens; use dual")
    tracer = problem.from_detector(pixels, quality, seed)
    return _matrix(tracer, CellGrid(problem.emitter, *cells))


def _matrix(tracer: Tracer, other: CellGrid) -> tuple[Array, Array]:
    """From every cell that paths start in (rows) to every cell of the device they connect to."""
    blocks = [_rows(tracer, other, block) for block in tracer.blocks(tracer.quality.samples)]
    mean, scatter = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return mean, scatter


def _rows(tracer: Tracer, other: CellGrid, block: Block) -> tuple[Array, Array]:
    """Rows of the matrix for the cells of one block, and the scatter of their paths."""
    mi, samples = mitsuba(), tracer.quality.samples
    n_cells = (block[1] - block[0]) * tracer.start.columns
    first = dr.arange(mi.UInt32, n_cells * samples) // dr.opaque(mi.UInt32, samples) * other.size
    wide, _ = strata(samples, tracer.start.rows / tracer.start.columns)
    sums, squares = np.zeros((2, n_cells * other.size))
    for bounce in tracer.bounces(block):
        cells = [_cell(other, left, up) for _, left, up in bounce.places]
        parts = [
            (bounce.value * fill if share is None else bounce.value * share * fill, first + cell)
            for (share, _, _), (cell, fill) in zip(bounce.places, cells, strict=True)
        ]
        dr.eval(parts)
        for value, where in parts:
            sums += _summed_by_cell(value, where, sums.size)
            # Parts of one path may all err alike.
            squares += len(parts) * _squared_differences(value, where, squares.size, samples, wide)
    mean = sums.reshape(n_cells, other.size) / samples
    return mean, squares.reshape(mean.shape) / (2 * pairs_of_strata(samples, wide))


def _squared_differences(value: Any, where: Any, size: int, samples: int, wide: int) -> Array:
    """Of paths of strata side by side, by where their light arrives: one that arrives elsewhere
    brings none there.
    """
    mi, total = mitsuba(), np.zeros(size)
    value = mi.Float64(value)  # squares of weak light are too small for 24 bits
    for there, is_beside in strata_beside(dr.width(value), samples, wide):
        light = dr.gather(mi.Float64, value, there, is_beside)
        place = dr.gather(mi.UInt32, where, there, is_beside)
        is_same = place == where
        own = dr.select(is_same, value - light, value)
        total += _summed_by_cell(dr.select(is_beside, own * own, 0), where, size)
        total += _summed_by_cell(dr.select(is_beside & ~is_same, light * light, 0), place, size)
    return total


def _summed_by_cell(value: Any, where: Any, size: int) -> Array:
    """Values added up by index. In fixed point the sum does not depend on the order of the threads;
    one step is 2^-40 of the largest value, and 2^22 of such values fit.
    """
    mi = mitsuba()
    largest = dr.max(value)
    if largest[0] == 0:
        return np.zeros(size)
    scale = mi.Float64(2.0**40) / mi.Float64(largest)
    total = dr.zeros(mi.UInt64, size)
    dr.scatter_reduce(dr.ReduceOp.Add, total, mi.UInt64(mi.Float64(value) * scale), where)
    return np.asarray(np.array(total, dtype=np.float64) / scale[0])


def _cell(grid: CellGrid, left: Any, up: Any) -> tuple[Any, Any]:
    """Cell of a point in the field, and the light there over the cell's mean (its fill factor)."""
    mi = mitsuba()
    x, y = (1 - left) / 2 * grid.columns, (1 - up) / 2 * grid.rows
    column = dr.clip(mi.Int32(dr.floor(x)), 0, grid.columns - 1)
    row = dr.clip(mi.Int32(dr.floor(y)), 0, grid.rows - 1)
    share = mi.Float(1)
    if grid.device.fill_factor < 1:
        half = dr.opaque(mi.Float, grid.device.fill_factor**0.5 / 2)
        lit = (dr.abs(x - column - 0.5) < half) & (dr.abs(y - row - 0.5) < half)
        share = dr.select(lit, dr.opaque(mi.Float, 1 / grid.device.fill_factor), 0)
    return mi.UInt32(row * grid.columns + column), share
