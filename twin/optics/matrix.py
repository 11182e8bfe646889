"""Transport between every emitter cell and every detector pixel, from one pass of paths.

Paths start in the cells of one device and connect, at every bounce, to the other; the direction of
the connection tells which of the other's cells it belongs to. *Dual*: paths start at the emitter.
*Scatter*: paths start at the detector's pixels. Both give the same matrix; which one is less noisy
depends on whose cells are finer: start from the side with more cells.
"""

from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.transport import (
    DeviceLight,
    Pinhole,
    Quality,
    connector,
    field_coordinates,
    inside,
    primary_rays,
)

Array = NDArray[np.float64]
Role = Literal["dual", "scatter"]

_RAYS_AT_ONCE = 2**22


@dataclass(frozen=True, eq=False)
class Grid:
    """A device whose field is divided into rows x columns of equal cells on the plane at 1."""

    pinhole: Pinhole
    rows: int
    columns: int

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.rows * self.columns


def transport_matrix(
    scene: Any,
    emitter: Grid,
    detector: Grid,
    *,
    quality: Quality,
    seed: int,
    role: Role = "dual",
) -> Array:
    """T[pixel, cell], shape ``(detector.size, emitter.size)``, in 1/m^2.

    The power that cell i puts on pixel j is I tau A_pupil T[j, i]; summed over the pixels it is
    `transport`. Contributions are added in float64 in a fixed order: same seed, same bits.

    Raises ValueError for a role that is none.
    """
    if role == "dual":
        return _pass(scene, emitter, detector, 3, "pupil", quality, seed).T
    if role == "scatter":
        return _pass(scene, detector, emitter, 4, "emitter", quality, seed)
    raise ValueError(f"role: {role!r} is none of dual, scatter")


def _pass(
    scene: Any,
    start: Grid,
    other: Grid,
    cos_power: int,
    kind: Literal["emitter", "pupil"],
    quality: Quality,
    seed: int,
) -> Array:
    """Matrix (start.size, other.size) of paths that start at ``start``."""
    per_block = max(1, _RAYS_AT_ONCE // (start.columns * quality.samples))
    matrix = np.zeros((start.size, other.size))
    for top in range(0, start.rows, per_block):
        rows = (top, min(top + per_block, start.rows))
        first, last = rows[0] * start.columns, rows[1] * start.columns
        matrix[first:last] = _block(scene, start, other, rows, cos_power, kind, quality, seed)
    return matrix * (2 * start.pinhole.tan_half_field) ** 2 / start.size


def _block(
    scene: Any,
    start: Grid,
    other: Grid,
    rows: tuple[int, int],
    cos_power: int,
    kind: Literal["emitter", "pupil"],
    quality: Quality,
    seed: int,
) -> Array:
    mi = mitsuba()
    n_cells = (rows[1] - rows[0]) * start.columns
    n_rays = n_cells * quality.samples
    state = int(np.random.SeedSequence([seed, rows[0]]).generate_state(1)[0])
    rng = mi.PCG32(size=n_rays, initstate=dr.opaque(mi.UInt64, state))
    shape = (start.rows, start.columns)
    ray, cos = primary_rays(start.pinhole, shape, rows, quality.samples, rng)
    connect = connector(DeviceLight(other.pinhole, kind))
    context = mi.BSDFContext()
    active = inside(start.pinhole, ray.d)
    throughput = dr.power(cos, cos_power)
    from_cell = np.repeat(np.arange(n_cells), quality.samples)
    sums = np.zeros(n_cells * other.size)
    for depth in range(quality.max_depth):
        hit = scene.ray_intersect(ray, active)
        active &= hit.is_valid()
        surface = hit.bsdf(ray)
        direction, shadow_ray, weight = connect(mi, hit)
        value = throughput * surface.eval(context, hit, hit.to_local(direction), active)[0] * weight
        lit = active & (value > 0)
        lit &= ~scene.ray_test(shadow_ray, lit)
        value = dr.select(lit, value, 0)
        cell = _cell(other, -direction)
        if depth + 1 < quality.max_depth:
            point = mi.Point2f(rng.next_float32(), rng.next_float32())
            sampled, factor = surface.sample(context, hit, rng.next_float32(), point, active)
            throughput = throughput * factor[0]
            ray = hit.spawn_ray(hit.to_world(sampled.wo))
            dr.eval(value, cell, throughput, ray, active, rng)
        added = np.array(value, dtype=np.float64)
        where = from_cell * other.size + np.array(cell, dtype=np.int64)
        sums += np.bincount(where, weights=added, minlength=sums.size)
    return sums.reshape(n_cells, other.size) / quality.samples


def _cell(grid: Grid, direction: Any) -> Any:
    """Index of the cell that a direction away from the device goes through; 0 outside."""
    mi = mitsuba()
    left, up = field_coordinates(grid.pinhole, direction)
    column = mi.Int32(dr.floor((1 - left) / 2 * grid.columns))
    row = mi.Int32(dr.floor((1 - up) / 2 * grid.rows))
    column = dr.clip(column, 0, grid.columns - 1)
    return mi.UInt32(dr.clip(row, 0, grid.rows - 1) * grid.columns + column)
