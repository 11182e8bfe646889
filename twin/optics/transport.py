"""Light transport from emitter to detector, rendered once for all patterns.

*Dual* form (Helmholtz reciprocity): paths start at the emitter, one stratum of one cell each, and
every vertex connects to the detector's pupil. What a cell sends to the pupil per radiant intensity
is one pixel; a pattern's signal is then the sum of its lit pixels, exact in float64.

The same path tracer, started at the detector and connected to the sun, gives the background; and
started at a camera, the picture. Contributions are added up per cell in float64, in a fixed order:
the same seed gives the same bits.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

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
    next_event,
    random_numbers,
)
from twin.optics.scattering import Medium
from twin.optics.travel import scattered_once_or_more, travel
from twin.optics.weather import Air

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
    air: Air | None = None,
) -> Gathered:
    """Irradiance on the detector's pupil per radiant intensity of each cell, in 1/m^2.

    The power that cell i puts on the detector is I tau A_pupil times the value of its pixel, with
    the radiant intensity I that the cell has inside its solid angle. Cosines of surface and pupil,
    shadowing and the outline of the detector's field are in it. Row 0 is the top, column 0 left.
    Air dims and spreads it (`twin.optics.scattering`); what the air itself sends back is not in it
    (`twin.optics.veil`).
    """
    return gather(
        scene,
        Grid(emitter, *shape),
        DeviceLight(detector, "pupil"),
        role="emitter",
        quality=quality,
        seed=seed,
        air=air,
    )


def sunlight(
    scene: Any,
    detector: Device,
    direction: Array,
    *,
    shape: tuple[int, int] = (32, 32),
    quality: Quality,
    seed: int,
    air: Air | None = None,
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
        air=air,
    )


def gather(
    scene: Any,
    camera: Grid,
    light: Light,
    *,
    role: Role,
    quality: Quality,
    seed: int,
    air: Air | None = None,
) -> Gathered:
    """Light that each cell of a camera's field receives, weighted by the camera's ``role``.

    Direct and indirect light are rendered apart, each with its own number of paths; so is direct
    light that the air scatters on its way from the camera to the surface.
    """
    medium = Medium(air, quality.air_orders) if air else None
    task = Task(scene, camera, light, role, medium)
    direct, error = _passes(task, quality.samples, "direct", (seed,))
    if medium and medium.scatters:
        scattered, further = _passes(task, quality.samples, "scattered", (seed, 2))
        direct, error = direct + scattered, np.hypot(error, further)
    if quality.max_depth == 1:
        return Gathered(direct, np.zeros_like(direct), error)
    bounces = quality.max_depth
    indirect, further = _passes(task, quality.further_samples, bounces, (seed, 1))
    return Gathered(direct, indirect, np.hypot(error, further))


class Task(NamedTuple):
    """What is gathered, whatever the number of paths."""

    scene: Any
    camera: Grid
    light: Light
    role: Role
    medium: Medium | None


#: Light that comes straight to the first surface it meets, or is scattered before; or, by their
#: greatest number, light of further bounces.
Kind = Literal["direct", "scattered"] | int


def _passes(task: Task, samples: int, kind: Kind, seed: tuple[int, ...]) -> tuple[Array, Array]:
    """Mean of each cell and its standard error, in blocks of rows that fit into memory."""
    camera = task.camera
    means, errors = [], []
    for block in blocks(camera, samples):
        # Sums per cell, in float64: the kernel's own numbers have 24 bits.
        value = mitsuba().Float64(path_values(task, samples, kind, seed, block)[0])
        sums = [dr.block_reduce(dr.ReduceOp.Add, x, samples) for x in (value, value * value)]
        mean, square = (np.array(s) / samples for s in sums)
        means.append(mean)
        errors.append(np.sqrt(np.maximum(square - mean**2, 0) / samples))
    shape = (camera.rows, camera.columns)
    return np.concatenate(means).reshape(shape), np.concatenate(errors).reshape(shape)


def blocks(camera: Grid, samples: int) -> Iterator[tuple[int, int]]:
    """Rows whose paths fit into memory together."""
    per_block = max(1, RAYS_AT_ONCE // (camera.columns * samples))
    for top in range(0, camera.rows, per_block):
        yield top, min(top + per_block, camera.rows)


def path_values(
    task: Task, samples: int, kind: Kind, seed: tuple[int, ...], block: tuple[int, int]
) -> tuple[Any, Any]:
    """Light of one kind that every path of some rows finds, and the surface that it met."""
    mi = mitsuba()
    scene, camera, light, role, medium = task
    n_rays = (block[1] - block[0]) * camera.columns * samples
    rng = random_numbers(n_rays, *seed, block[0])
    ray, weight, active = started_rays(camera, block, samples, rng, role)
    connect, hit = connector(light, medium), None
    if kind == "direct":
        value, hit = _direct(scene, ray, rng, connect, medium, active)
    elif kind == "scattered":
        value, hit = _scattered(scene, ray, rng, connect, medium, active)
    else:
        depth = dr.opaque(mi.UInt32, kind)
        value = _indirect(mi, scene, ray, rng, connect, medium, active, depth)
    return weight * value + dr.zeros(mi.Float, n_rays), hit


def _direct(
    scene: Any, ray: Any, rng: Any, connect: Any, medium: Medium | None, active: Any
) -> tuple[Any, Any]:
    """Light that comes straight from the camera to a surface and on to the light; and the hit."""
    hit, ray, active, length = travel(scene, ray, None, rng, active, first=True)
    value, link = next_event(scene, hit, ray, connect, rng, active, True)
    if medium:
        value *= medium.unabsorbed(length + link.length)
        if medium.scatters:
            value *= medium.unscattered(length)
    return value, hit


def _scattered(
    scene: Any, ray: Any, rng: Any, connect: Any, medium: Any, active: Any
) -> tuple[Any, Any]:
    """Light that the air scatters before it meets a surface; and the hit."""
    hit, ray, active, length, share = scattered_once_or_more(scene, ray, medium, rng, active)
    value, link = next_event(scene, hit, ray, connect, rng, active, False)
    return value * share * medium.unabsorbed(length + link.length), hit


@dr.syntax
def _indirect(
    mi: Any,
    scene: Any,
    ray: Any,
    rng: Any,
    connect: Any,
    medium: Any,
    active: Any,
    max_depth: Any,
) -> Any:
    """Path tracing with next-event estimation from the second vertex on."""
    hit, ray, active, length = travel(scene, ray, medium, rng, active, first=True)
    throughput, total = albedo(hit, active), mi.Float(0)
    ray = bounce(hit, ray, rng)
    depth = mi.UInt32(1)
    active &= throughput > 0
    while active & (depth < max_depth):
        hit, ray, active, further = travel(scene, ray, medium, rng, active, first=False)
        length += further
        value, link = next_event(scene, hit, ray, connect, rng, active, False)
        if dr.hint(medium is not None, mode="scalar"):
            value *= medium.unabsorbed(length + link.length)
        total += throughput * value
        throughput *= albedo(hit, active)
        active &= throughput > 0
        ray = bounce(hit, ray, rng)
        depth += 1
    return total
