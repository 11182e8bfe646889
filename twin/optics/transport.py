"""Light transport from emitter to detector, rendered once for all patterns.

*Dual* form (Helmholtz reciprocity): paths start at the emitter, one stratum of one cell each, and
every vertex connects to the detector's pupil. What a cell sends to the pupil per radiant intensity
is one pixel; a pattern's signal is then the sum of its lit pixels, exact in float64.

The same path tracer, started at the detector and connected to the sun, gives the background; and
started at a camera, the picture. Contributions are added up per cell in float64, in a fixed order:
the same seed gives the same bits.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.devices import Device, Grid, Role, started_rays
from twin.optics.paths import (
    DeviceLight,
    Light,
    Quality,
    SunLight,
    albedo,
    bounce,
    connector,
    meet,
    next_event,
    random_numbers,
)

Array = NDArray[np.float64]

#: Paths traced in one kernel, which bounds memory.
RAYS_AT_ONCE = 2**22


@dataclass(frozen=True, eq=False)
class Gathered:
    """What a grid of cells gathers, (rows, columns), with standard error."""

    direct: Array
    indirect: Array
    standard_error: Array

    @property
    def total(self) -> Array:
        """Direct and indirect light together."""
        return self.direct + self.indirect


def transport(
    scene: Any,
    emitter: Device,
    detector: Device,
    shape: tuple[int, int],
    *,
    quality: Quality,
    seed: int,
    extinction_per_m: float = 0.0,
) -> Gathered:
    """Irradiance on the detector's pupil per radiant intensity of each cell, in 1/m^2.

    The power that cell i puts on the detector is I tau A_pupil times the value of its pixel, with
    the radiant intensity I that the cell has inside its solid angle. Cosines of surface and pupil,
    shadowing and the outline of the detector's field are in it. Row 0 is the top, column 0 left.
    """
    return gather(
        scene,
        Grid(emitter, *shape),
        DeviceLight(detector, "pupil"),
        role="emitter",
        quality=quality,
        seed=seed,
        extinction_per_m=extinction_per_m,
    )


def sunlight(
    scene: Any,
    detector: Device,
    direction: Array,
    *,
    shape: tuple[int, int] = (32, 32),
    quality: Quality,
    seed: int,
    extinction_per_m: float = 0.0,
) -> Gathered:
    """Irradiance on the detector's pupil per irradiance of the sun, by part of its field.

    The sum of the parts is the background; times E_sun tau A_pupil it is a power.
    """
    return gather(
        scene,
        Grid(detector, *shape),
        SunLight(direction),
        role="pupil",
        quality=quality,
        seed=seed,
        extinction_per_m=extinction_per_m,
    )


def gather(
    scene: Any,
    camera: Grid,
    light: Light,
    *,
    role: Role,
    quality: Quality,
    seed: int,
    extinction_per_m: float = 0.0,
) -> Gathered:
    """Light that each cell of a camera's field receives, weighted by the camera's ``role``.

    Direct and indirect light are rendered apart, each with its own number of paths. Air takes
    exp(-extinction x length) from every path.
    """
    task = _Task(scene, camera, light, role, extinction_per_m)
    direct, error = _passes(task, quality.samples, 1, (seed,))
    if quality.max_depth == 1:
        return Gathered(direct, np.zeros_like(direct), error)
    indirect, further = _passes(task, quality.further_samples, quality.max_depth, (seed, 1))
    return Gathered(direct, indirect, np.hypot(error, further))


class _Task(NamedTuple):
    scene: Any
    camera: Grid
    light: Light
    role: Role
    extinction_per_m: float


def _passes(
    task: _Task, samples: int, max_depth: int, seed: tuple[int, ...]
) -> tuple[Array, Array]:
    """Mean of each cell and its standard error, in blocks of rows that fit into memory."""
    camera = task.camera
    per_block = max(1, RAYS_AT_ONCE // (camera.columns * samples))
    means, errors = [], []
    for top in range(0, camera.rows, per_block):
        block = (top, min(top + per_block, camera.rows))
        # Sums per cell, in float64: the kernel's own numbers have 24 bits.
        value = mitsuba().Float64(_block(task, samples, max_depth, seed, block))
        sums = [dr.block_reduce(dr.ReduceOp.Add, x, samples) for x in (value, value * value)]
        mean, square = (np.array(s) / samples for s in sums)
        means.append(mean)
        errors.append(np.sqrt(np.maximum(square - mean**2, 0) / samples))
    shape = (camera.rows, camera.columns)
    return np.concatenate(means).reshape(shape), np.concatenate(errors).reshape(shape)


def _block(
    task: _Task, samples: int, max_depth: int, seed: tuple[int, ...], block: tuple[int, int]
) -> Any:
    """Direct light of every path (``max_depth`` 1), or the light of further bounces."""
    mi = mitsuba()
    scene, camera, light, role, extinction_per_m = task
    n_rays = (block[1] - block[0]) * camera.columns * samples
    rng = random_numbers(n_rays, *seed, block[0])
    ray, weight, active = started_rays(camera, block, samples, rng, role)
    extinction = dr.opaque(mi.Float, extinction_per_m)
    connect = connector(light)
    if max_depth == 1:
        light_found = _direct(scene, ray, rng, connect, extinction, active)
    else:
        depth = dr.opaque(mi.UInt32, max_depth)
        light_found = _indirect(mi, scene, ray, rng, connect, extinction, active, depth)
    return weight * light_found + dr.zeros(mi.Float, n_rays)


def _direct(scene: Any, ray: Any, rng: Any, connect: Any, extinction: Any, active: Any) -> Any:
    hit, active, length = _first_hit(scene, ray, active)
    value, link = next_event(scene, hit, ray, connect, rng, active, True)
    return value * dr.exp(-extinction * (length + link.length))


def _first_hit(scene: Any, ray: Any, active: Any) -> tuple[Any, Any, Any]:
    hit = meet(scene, ray, True, active)
    active = active & hit.is_valid()
    return hit, active, dr.select(active, hit.t, 0)


@dr.syntax
def _indirect(
    mi: Any,
    scene: Any,
    ray: Any,
    rng: Any,
    connect: Any,
    extinction: Any,
    active: Any,
    max_depth: Any,
) -> Any:
    """Path tracing with next-event estimation from the second vertex on."""
    hit, active, length = _first_hit(scene, ray, active)
    throughput, total = albedo(hit, active), mi.Float(0)
    ray = bounce(hit, ray, rng)
    depth = mi.UInt32(1)
    active &= throughput > 0
    while active & (depth < max_depth):
        hit = meet(scene, ray, False, active)
        active &= hit.is_valid()
        length += dr.select(active, hit.t, 0)
        value, link = next_event(scene, hit, ray, connect, rng, active, False)
        total += throughput * value * dr.exp(-extinction * (length + link.length))
        throughput *= albedo(hit, active)
        active &= throughput > 0
        ray = bounce(hit, ray, rng)
        depth += 1
    return total
