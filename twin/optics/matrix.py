"""Transport between every emitter cell and every detector pixel, from one pass of paths.

Paths start in the cells of one device and connect, at every bounce, to the other; the place in the
other's field tells which of its cells the connection belongs to. *Dual*: paths start at the
emitter. *Scatter*: paths start at the detector's pixels. Both give the same matrix; which one is
less noisy depends on whose cells are finer: start from the side with more cells.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.devices import Grid, Role, started_rays
from twin.optics.paths import (
    DeviceLight,
    Quality,
    albedo,
    bounce,
    connector,
    meet,
    next_event,
    random_numbers,
)
from twin.optics.transport import RAYS_AT_ONCE

Array = NDArray[np.float64]
Start = Literal["dual", "scatter"]


def transport_matrix(
    scene: Any,
    emitter: Grid,
    detector: Grid,
    *,
    quality: Quality,
    seed: int,
    role: Start = "dual",
    extinction_per_m: float = 0.0,
) -> Array:
    """T[pixel, cell], shape ``(detector.size, emitter.size)``, in 1/m^2.

    The power that cell i puts on pixel j is I tau A_pupil T[j, i]; summed over the pixels it is
    `transport`. Contributions are added in float64 in a fixed order: same seed, same bits.

    Raises ValueError for a role that is none, and for *scatter* towards elements without a lens.
    """
    if role not in get_args(Start):
        raise ValueError(f"role: {role!r} is none of dual, scatter")
    if role == "dual":
        light = DeviceLight(detector.device, "pupil")
        there = _Pass(scene, emitter, detector, light, "emitter", quality, seed, extinction_per_m)
        return there.matrix().T
    if emitter.device.pitch_m is not None:
        raise ValueError("role: scatter needs an emitter behind a lens; take dual")
    light = DeviceLight(emitter.device, "emitter")
    back = _Pass(scene, detector, emitter, light, "pupil", quality, seed, extinction_per_m)
    return back.matrix()


@dataclass(frozen=True, eq=False)
class _Pass:
    """Paths from the cells of one device to those of the other."""

    scene: Any
    start: Grid
    other: Grid
    light: DeviceLight
    role: Role
    quality: Quality
    seed: int
    extinction_per_m: float

    def matrix(self) -> Array:
        """From every cell to every cell, (start.size, other.size)."""
        start, samples = self.start, self.quality.samples
        per_block = max(1, RAYS_AT_ONCE // (start.columns * samples))
        matrix = np.zeros((start.size, self.other.size))
        for top in range(0, start.rows, per_block):
            block = (top, min(top + per_block, start.rows))
            matrix[block[0] * start.columns : block[1] * start.columns] = self._rows(block)
        return matrix

    def _rows(self, block: tuple[int, int]) -> Array:
        """Of the start's cells in some rows."""
        mi, start, quality = mitsuba(), self.start, self.quality
        n_cells = (block[1] - block[0]) * start.columns
        rng = random_numbers(n_cells * quality.samples, self.seed, block[0])
        ray, throughput, active = started_rays(start, block, quality.samples, rng, self.role)
        connect = connector(self.light)
        extinction = dr.opaque(mi.Float, self.extinction_per_m)
        length = mi.Float(0)
        samples = dr.opaque(mi.UInt32, quality.samples)
        from_cell = dr.arange(mi.UInt32, n_cells * quality.samples) // samples
        sums = np.zeros(n_cells * self.other.size)
        for depth in range(quality.max_depth):
            first = depth == 0
            hit = meet(self.scene, ray, first, active)
            active &= hit.is_valid()
            length = length + dr.select(active, hit.t, 0)
            value, link = next_event(self.scene, hit, ray, connect, rng, active, first)
            value *= throughput * dr.exp(-extinction * (length + link.length))
            cell, share = _cell(self.other, link.left, link.up)
            value *= share
            if depth + 1 < quality.max_depth:
                throughput = throughput * albedo(hit, active)
                ray = bounce(hit, ray, rng)
            dr.eval(value, cell, throughput, ray, active, length, rng)
            sums += _sums(value, from_cell * self.other.size + cell, sums.size)
        return sums.reshape(n_cells, self.other.size) / quality.samples


def _sums(value: Any, where: Any, size: int) -> Array:
    """Values added up by place. In fixed point the order in which threads add does not matter;
    one step is 2^-40 of the largest value, and 2^22 of them fit.
    """
    mi = mitsuba()
    largest = dr.max(value)
    if largest[0] == 0:
        return np.zeros(size)
    scale = mi.Float64(2.0**40) / mi.Float64(largest)
    target = dr.zeros(mi.UInt64, size)
    dr.scatter_reduce(dr.ReduceOp.Add, target, mi.UInt64(mi.Float64(value) * scale), where)
    return np.asarray(np.array(target, dtype=np.float64) / scale[0])


def _cell(grid: Grid, left: Any, up: Any) -> tuple[Any, Any]:
    """Cell of a place in the field, and the light there over the cell's mean (its fill factor)."""
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
