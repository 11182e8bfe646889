"""Light transport from emitter to detector, rendered once for all patterns.

*Dual* form (Helmholtz reciprocity): paths start at the emitter, one stratum of one cell each, and
every vertex connects to the detector's pupil. One pixel is the irradiance of the pupil per radiant
intensity of one cell; a pattern's signal is the sum of its lit pixels, exact in float64.

The same paths, started at the detector and connected to the sun, give the background; and started
at a camera, the image. Contributions are added up per cell in float64, in a fixed order: the same
seed gives the same bits.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from twin.engine import mitsuba
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.ray_sets import Rays, RowRays, pairs_of_strata, strata, strata_beside
from twin.optics.tracer import Tracer
from twin.optics.unseen import missed_edge_variance

Array = NDArray[np.float64]

#: Of `variance_of_mean`: weight of the cells around, and standard deviation of their window.
_NEIGHBOURS, _WINDOW_CELLS = 12, 1.5


@dataclass(frozen=True, eq=False)
class CellLight:
    """Light of each cell of a grid, (rows, columns), with its standard error.

    For the standard error see `variance_of_mean`; that of direct light is no less than edges
    between paths may do (`missed_edge_variance`).
    """

    direct: Array
    indirect: Array
    standard_error: Array

    @property
    def total(self) -> Array:
        """Direct and indirect light together."""
        return self.direct + self.indirect


def transport(
    problem: LightProblem, shape: tuple[int, int], *, quality: TracingQuality, seed: int
) -> CellLight:
    """Irradiance on the detector's pupil per radiant intensity of each cell, in 1/m^2.

    The power that cell i puts on the detector is I tau A_pupil times the value of its pixel, with
    the radiant intensity I that the cell has inside its solid angle. Cosines of surface and pupil,
    shadowing and the outline of the detector's field are in it. Row 0 is the top, column 0 left.
    Extinction and scattering by the air are included (`twin.optics.scattering`); the air's own
    backscatter is not (`twin.optics.backscatter`).
    """
    return gather(problem.from_emitter(shape, quality, seed))


def sunlight(
    problem: LightProblem, shape: tuple[int, int] = (32, 32), *, quality: TracingQuality, seed: int
) -> CellLight:
    """Irradiance on the detector's pupil per irradiance of the sun, by part of its field.

    The sum of the parts is the background; times E_sun tau A_pupil it is a power.
    """
    return gather(problem.from_sun(shape, quality, seed))


def gather(tracer: Tracer) -> CellLight:
    """Light that each cell receives, with the weights of the tracer's rays.

    Direct light, indirect light, and direct light that the air scatters on its way to the surface
    are rendered separately, each with its own number of paths.
    """
    quality = tracer.quality
    direct, scatter = _moments(tracer, quality.samples, lambda rays: tracer.direct(rays).value)
    variance = variance_of_direct(direct, scatter, quality.samples)
    if tracer.scatters:
        airlight, scatter = _moments(
            tracer, quality.samples, lambda rays: tracer.scattered(rays).value
        )
        direct, variance = direct + airlight, variance + variance_of_mean(scatter, quality.samples)
    if quality.max_depth == 1:
        return CellLight(direct, np.zeros_like(direct), np.sqrt(variance))
    indirect, scatter = _moments(tracer, quality.further_samples, tracer.indirect)
    variance = variance + variance_of_mean(scatter, quality.further_samples)
    return CellLight(direct, indirect, np.sqrt(variance))


def _moments(tracer: Tracer, samples: int, trace: Callable[[Rays], Any]) -> tuple[Array, Array]:
    """Mean and scatter of each cell's paths, in blocks of rows that fit into memory."""
    shape = (tracer.start.rows, tracer.start.columns)
    wide, _ = strata(samples, shape[0] / shape[1])
    moments = [
        path_moments(trace(RowRays(*block, samples)), samples, wide)
        for block in tracer.blocks(samples)
    ]
    mean, scatter = (np.concatenate(parts).reshape(shape) for parts in zip(*moments, strict=True))
    return mean, scatter if samples > 1 else _scatter_of_cells(mean)


def _scatter_of_cells(light: Array) -> Array:
    """Scatter of paths of which each cell, (rows, columns), has one: half the mean squared
    difference from those of the cells beside it; of a single cell its square.
    """
    if light.size == 1:
        return light**2
    squares, count = np.zeros((2, *light.shape))
    for axis in (0, 1):
        difference = np.square(np.diff(light, axis=axis))
        for end in ((1, 0), (0, 1)):
            pad = [(0, 0), (0, 0)]
            pad[axis] = end
            squares += np.pad(difference, pad)
            count += np.pad(np.ones_like(difference), pad)
    return squares / count / 2


def variance_of_direct(mean: Array, scatter: Array, samples: float) -> Array:
    """Variance of each cell's mean of direct light, (rows, columns): no less than edges may do."""
    return np.maximum(variance_of_mean(scatter, samples), missed_edge_variance(mean, samples))


def variance_of_mean(scatter: Array, samples: float) -> Array:
    """Variance of each cell's mean, (rows, columns), from the scatter of its paths.

    A cell whose paths all miss an edge or a rare bright bounce has too small a variance of its own,
    but paths of cells around hit them: their mean variance, of a Gaussian window, stands for that
    of 12 / n further paths of each cell, so that it matters where paths are few, and nowhere from
    some hundred on. The sum over an image is kept. A single path keeps all of its own scatter,
    which is by cells around: an image's brightest cells are those with a path that is too bright.
    """
    around = gaussian_filter(scatter, _WINDOW_CELLS, mode="nearest")
    further = _NEIGHBOURS / samples
    pooled = (samples * scatter + further * around) / (samples + further) / samples
    return np.asarray(pooled if samples > 1 else np.maximum(pooled, scatter))


def path_moments(value: Any, samples: int, wide: int) -> tuple[Array, Array]:
    """Mean of the paths of each cell, and their scatter: half the mean squared difference of paths
    of strata side by side, ``wide`` of which are in a row, (n_cells,). It is the variance of a path
    within its stratum, and part of what light changes by from one to the next. Errors by the
    scatter of all paths, as if they were independent, would be 30 times too large on a plane with
    1024 paths. In float64, since the kernel's own numbers have 24 bits.
    """
    mi = mitsuba()
    value = mi.Float64(value)
    dr.eval(value)
    squares = mi.Float64(0)
    for there, is_beside in strata_beside(dr.width(value), samples, wide):
        difference = dr.gather(mi.Float64, value, there, is_beside) - value
        squares += dr.select(is_beside, difference * difference, 0)
    sums = [np.array(dr.block_reduce(dr.ReduceOp.Add, x, samples)) for x in (value, squares)]
    return sums[0] / samples, sums[1] / (2 * pairs_of_strata(samples, wide))
