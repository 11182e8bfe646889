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
    next_event,
    random_numbers,
)
from twin.optics.scattering import Medium
from twin.optics.transport import blocks
from twin.optics.travel import travel
from twin.optics.weather import Air

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
    air: Air | None = None,
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
        there = _Pass(scene, emitter, detector, light, "emitter", quality, seed, air)
        return there.matrix().T
    if emitter.device.pitch_m is not None:
        raise ValueError("role: scatter needs an emitter behind a lens; take dual")
    light = DeviceLight(emitter.device, "emitter")
    back = _Pass(scene, detector, emitter, light, "pupil", quality, seed, air)
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
    air: Air | None

    def matrix(self) -> Array:
        """From every cell to every cell, (start.size, other.size)."""
        start = self.start
        matrix = np.zeros((start.size, self.other.size))
        for block in blocks(start, self.quality.samples):
            matrix[block[0] * start.columns : block[1] * start.columns] = self._rows(block)
        return matrix

    def _rows(self, block: tuple[int, int]) -> Array:
        """Of the start's cells in some rows."""
        mi, start, quality = mitsuba(), self.start, self.quality
        n_cells = (block[1] - block[0]) * start.columns
        rng = random_numbers(n_cells * quality.samples, self.seed, block[0])
        ray, throughput, active = started_rays(start, block, quality.samples, rng, self.role)
        medium = Medium(self.air, quality.air_orders) if self.air else None
        connect = connector(self.light, medium)
        length = mi.Float(0)
        samples = dr.opaque(mi.UInt32, quality.samples)
        from_cell = dr.arange(mi.UInt32, n_cells * quality.samples) // samples
        sums = np.zeros(n_cells * self.other.size)
        for depth in range(quality.max_depth):
            first = depth == 0
            hit, ray, active, further = travel(self.scene, ray, medium, rng, active, first=first)
            length = length + further
            value, link = next_event(self.scene, hit, ray, connect, rng, active, first)
            value *= throughput
            if medium:
                value *= medium.unabsorbed(length + link.length)
            arrived = [_cell(self.other, left, up) for _, left, up in link.places]
            parts = [
                (value * fill if share is None else value * share * fill, cell)
                for (share, _, _), (cell, fill) in zip(link.places, arrived, strict=True)
            ]
            if depth + 1 < quality.max_depth:
                throughput = throughput * albedo(hit, active)
                ray = bounce(hit, ray, rng)
            dr.eval(parts, throughput, ray, active, length, rng)
            for part, cell in parts:
                sums += _sums(part, from_cell * self.other.size + cell, sums.size)
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
