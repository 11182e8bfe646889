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
from twin.optics.devices import Grid, Role
from twin.optics.paths import Light, Quality
from twin.optics.scattering import Medium
from twin.optics.transport import Gathered, Kind, Task, blocks, path_values
from twin.optics.weather import Air

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ByObject:
    """Mean and mean square of what each cell gathers from each object, (n_passes, n_objects, rows,
    columns): straight, and where there is air scattered on its way to the surface.

    Of a scene whose reflectances are 1; ``samples`` paths per cell and pass.
    """

    mean: Array
    square: Array
    samples: int

    def gathered(self, reflectance: Array) -> Gathered:
        """What the cells gather with these reflectances, (n_objects,)."""
        total = np.tensordot(self.mean, reflectance, axes=([1], [0]))
        # A path meets one object: squares add up as well.
        square = np.tensordot(self.square, reflectance**2, axes=([1], [0]))
        variance = np.maximum(square - total**2, 0) / self.samples
        value = total.sum(axis=0)
        return Gathered(value, np.zeros_like(value), np.sqrt(variance.sum(axis=0)))


def gather_by_object(
    scene: Any,
    camera: Grid,
    light: Light,
    *,
    role: Role,
    quality: Quality,
    seed: int,
    air: Air | None = None,
) -> ByObject:
    """Direct light of a scene's shapes, in their order; draws the paths that `gather` draws."""
    medium = Medium(air, quality.air_orders) if air else None
    task = Task(scene, camera, light, role, medium)
    passes: list[tuple[Kind, tuple[int, ...]]] = [("direct", (seed,))]
    if medium and medium.scatters:
        passes.append(("scattered", (seed, 2)))
    moments = [_of_shapes(task, quality.samples, kind, seeds) for kind, seeds in passes]
    mean, square = np.moveaxis(np.array(moments), 2, 0)
    return ByObject(mean, square, quality.samples)


def _of_shapes(task: Task, samples: int, kind: Kind, seed: tuple[int, ...]) -> Array:
    """Mean and mean square by shape, (n_objects, 2, rows, columns)."""
    camera = task.camera
    sums = []
    for block in blocks(camera, samples):
        value, hit = path_values(task, samples, kind, seed, block)
        value, which = mitsuba().Float64(value), hit.shape
        dr.eval(value, which)
        sums.append(
            [_moments(dr.select(which == s, value, 0), samples) for s in task.scene.shapes()]
        )
    moments = np.concatenate([np.array(part) for part in sums], axis=-1)
    return moments.reshape(-1, 2, camera.rows, camera.columns)


def _moments(value: Any, samples: int) -> tuple[Array, Array]:
    sums = [dr.block_reduce(dr.ReduceOp.Add, x, samples) for x in (value, value * value)]
    return np.array(sums[0]) / samples, np.array(sums[1]) / samples
