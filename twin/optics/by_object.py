"""Direct light split by the object that reflects it, per unit of reflectance.

While light bounces once, transport is linear in each object's reflectance: one render serves every
combination of them.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.devices import Grid, Role, started_rays
from twin.optics.paths import Light, connector, next_event, random_numbers
from twin.optics.transport import RAYS_AT_ONCE, Gathered

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ByObject:
    """Mean and mean square of what each cell gathers from each object, (n_objects, rows, columns).

    Of a scene whose reflectances are 1; ``samples`` paths per cell.
    """

    mean: Array
    square: Array
    samples: int

    def gathered(self, reflectance: Array) -> Gathered:
        """What the cells gather with these reflectances, (n_objects,)."""
        total = np.tensordot(reflectance, self.mean, axes=1)
        # A path meets one object: squares add up as well.
        square = np.tensordot(reflectance**2, self.square, axes=1)
        error = np.sqrt(np.maximum(square - total**2, 0) / self.samples)
        return Gathered(total, np.zeros_like(total), error)


def gather_by_object(
    scene: Any,
    camera: Grid,
    light: Light,
    *,
    role: Role,
    samples: int,
    seed: int,
    extinction_per_m: float = 0.0,
) -> ByObject:
    """Direct light of a scene's shapes, in their order; draws the paths that `gather` draws."""
    per_block = max(1, RAYS_AT_ONCE // (camera.columns * samples))
    shapes, sums = scene.shapes(), []
    for top in range(0, camera.rows, per_block):
        block = (top, min(top + per_block, camera.rows))
        value, which = _block(scene, camera, light, role, samples, seed, extinction_per_m, block)
        sums.append([_moments(dr.select(which == s, value, 0), samples) for s in shapes])
    moments = np.concatenate([np.array(part) for part in sums], axis=-1)
    mean, square = np.moveaxis(moments, 1, 0)
    full = (len(shapes), camera.rows, camera.columns)
    return ByObject(mean.reshape(full), square.reshape(full), samples)


def _moments(value: Any, samples: int) -> tuple[Array, Array]:
    sums = [dr.block_reduce(dr.ReduceOp.Add, x, samples) for x in (value, value * value)]
    return np.array(sums[0]) / samples, np.array(sums[1]) / samples


def _block(
    scene: Any,
    camera: Grid,
    light: Light,
    role: Role,
    samples: int,
    seed: int,
    extinction_per_m: float,
    block: tuple[int, int],
) -> tuple[Any, Any]:
    """Direct light of every path, and the shape that it met."""
    mi = mitsuba()
    n_rays = (block[1] - block[0]) * camera.columns * samples
    rng = random_numbers(n_rays, seed, block[0])
    ray, weight, active = started_rays(camera, block, samples, rng, role)
    hit = scene.ray_intersect(ray, mi.RayFlags.All, mi.Bool(True), active)
    active &= hit.is_valid()
    value, link = next_event(scene, hit, ray, connector(light), rng, active, True)
    way = dr.select(active, hit.t, 0) + link.length
    value *= weight * dr.exp(-dr.opaque(mi.Float, extinction_per_m) * way)
    value, which = mi.Float64(value), hit.shape
    dr.eval(value, which)
    return value, which
