"""Direct light split by the object that reflects it, per unit of reflectance.

While light bounces once, transport is linear in each object's reflectance: one render serves every
combination of them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.ray_sets import Rays, RowRays, strata
from twin.optics.tracer import Bounce, Tracer
from twin.optics.transport import CellLight, path_moments, variance_of_direct, variance_of_mean

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LightByObject:
    """Mean and scatter of each cell's direct light by object, (n_passes, n_objects, rows, columns);
    see `path_moments`. First pass: unscattered light; second pass, in air only: light scattered on
    its way to the surface.

    Of a scene whose reflectances are 1; ``samples`` paths per cell and pass.
    """

    mean: Array
    scatter: Array
    samples: int

    def with_reflectance(self, reflectance: Array) -> CellLight:
        """Light of the cells for these reflectances, (n_objects,)."""
        total = np.tensordot(self.mean, reflectance, axes=([1], [0]))
        # A path hits one object only. Two that hit different ones differ by no more than either's
        # light, so that the squares of their difference add up to no more than these.
        scatter = np.tensordot(self.scatter, reflectance**2, axes=([1], [0]))
        variance = [variance_of_direct(total[0], scatter[0], self.samples)]
        variance += [variance_of_mean(further, self.samples) for further in scatter[1:]]
        value = total.sum(axis=0)
        return CellLight(value, np.zeros_like(value), np.sqrt(np.sum(variance, axis=0)))


def gather_by_object(tracer: Tracer) -> LightByObject:
    """Direct light of a scene's shapes, in their order; draws the same paths as `gather`."""
    passes = [tracer.direct, tracer.scattered] if tracer.scatters else [tracer.direct]
    moments = [_of_shapes(tracer, trace) for trace in passes]
    mean, scatter = np.moveaxis(np.array(moments), 2, 0)
    return LightByObject(mean, scatter, tracer.quality.samples)


def _of_shapes(tracer: Tracer, trace: Callable[[Rays], Bounce]) -> Array:
    """Mean and scatter by shape, (n_objects, 2, rows, columns)."""
    samples, sums = tracer.quality.samples, []
    wide, _ = strata(samples, tracer.start.rows / tracer.start.columns)
    for block in tracer.blocks(samples):
        light = trace(RowRays(*block, samples))
        value = mitsuba().Float64(light.value)
        dr.eval(value, light.shape)
        sums.append(
            [
                path_moments(dr.select(light.shape == shape, value, 0), samples, wide)
                for shape in tracer.scene.shapes()
            ]
        )
    moments = np.concatenate([np.array(part) for part in sums], axis=-1)
    return moments.reshape(-1, 2, tracer.start.rows, tracer.start.columns)
