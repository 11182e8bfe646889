"""Light of a system with as many paths in every cell."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.camera.rendered import DetectorLight, RenderedLight
from twin.fidelity import Start
from twin.optics.matrix import transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.time_of_flight import Paths, trace_paths
from twin.optics.transport import CellLight, sunlight, transport, variance_of_direct
from twin.optics.unseen import missed_facet_variance
from twin.system import System

Array = NDArray[np.float64]
#: Of the field's height, and of its width for a bucket.
SUN_PARTS = 32
#: Radiance per irradiance of the sun that a surface has at most, with light of ten bounces.
SUNLIT = 10 / math.pi
#: Number of paths that would meet what all of them miss in 5 of 100 cases.
MISSED = 3.0


def with_light(
    rendered: RenderedLight,
    problem: LightProblem,
    system: System,
    quality: TracingQuality,
    seed: int,
    start: Start,
) -> RenderedLight:
    """The same with the emitter's light, and its paths for a system with time of flight."""
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    if system.optics.is_scanned:  # all else comes from beside the detector's field
        quality = replace(quality, max_depth=1)
    if system.time_of_flight:
        paths = trace_paths(problem, shape, quality=quality, seed=seed)
        return replace(rendered, light=_of_paths(paths), paths=paths)
    light = emitter_light(
        problem, shape, system.n_detectors, quality=quality, seed=seed, start=start
    )
    return replace(rendered, light=light)


def _of_paths(paths: Paths) -> DetectorLight:
    """All light of one detector's cells."""
    light, first = paths.light(), float(paths.value[:, : paths.samples].sum(dtype=np.float64))
    share = 1 - first / float(light.sum()) if light.any() else 0.0
    return DetectorLight(light.reshape(1, -1), paths.standard_error.reshape(1, -1), share)


def emitter_light(
    problem: LightProblem,
    shape: tuple[int, int],
    n_detectors: int,
    *,
    quality: TracingQuality,
    seed: int,
    start: Start = "auto",
) -> DetectorLight:
    """Transport from ``shape`` cells to one bucket, or to the columns of a line sensor."""
    facets = problem.facet_light(shape, n_detectors)
    if n_detectors == 1:
        light = of_bucket(transport(problem, shape, quality=quality, seed=seed))
        return with_missed(light, facets.reshape(light.cells.shape), quality.samples)
    n_cells = shape[0] * shape[1]
    if start == "auto":
        start = "scatter" if n_detectors > n_cells else "dual"
    ends = n_cells if start == "scatter" else n_detectors
    # As many paths per pair of cell and column as per cell of a bucket detector.
    side = math.ceil(math.sqrt(quality.samples * ends))
    quality = replace(quality, samples=side * side)
    mean, scatter = transport_matrix(
        problem, shape, (1, n_detectors), quality=quality, seed=seed, start=start
    )
    paths, image = side * side / ends, _side_by_side(mean, shape)
    # Each pixel has a share of all paths, so that it is as one of few that all arrive.
    variance = variance_of_direct(image, _side_by_side(scatter, shape) / ends, paths)
    variance += missed_facet_variance(facets, image, paths)
    error = np.stack(np.hsplit(np.sqrt(variance), n_detectors)).reshape(mean.shape)
    return DetectorLight(mean, error)


def _side_by_side(values: Array, shape: tuple[int, int]) -> Array:
    """The image of all columns, from (n_detectors, n_cells)."""
    return np.hstack(list(values.reshape(-1, *shape)))


def with_missed(light: DetectorLight, facets: Array, samples: int) -> DetectorLight:
    """The same with the error by facets that all of a cell's paths may have missed."""
    missed = missed_facet_variance(facets, light.cells, samples)
    return replace(light, error=np.sqrt(light.error**2 + missed))


def of_bucket(gathered: CellLight) -> DetectorLight:
    """Cells of one detector."""
    total = gathered.total
    share = float(gathered.indirect.sum() / total.sum()) if total.any() else 0.0
    return DetectorLight(total.reshape(1, -1), gathered.standard_error.reshape(1, -1), share)


def sun_light(
    problem: LightProblem, shape: tuple[int, int], *, quality: TracingQuality, seed: int
) -> CellLight:
    """Irradiance on the pupil per irradiance of the sun, by part of the field, (rows, columns); the
    columns are those of a line sensor.
    """
    return sunlight(problem, shape, quality=quality, seed=seed)


def unseen_sun(problem: LightProblem, shape: tuple[int, int], quality: TracingQuality) -> float:
    """Bound of each part of the sun's light where no path met any of it."""
    paths = shape[0] * shape[1] * quality.samples
    return MISSED * SUNLIT * problem.from_sun(shape, quality, 0).largest_weight / paths


def sun_shape(system: System) -> tuple[int, int]:
    """Parts of the detector's field, rows and columns: of one that follows the lit cell as large as
    cells, over twice the field's sides.
    """
    if system.optics.is_scanned:
        rows, columns = system.image_shape
        return 2 * rows, 2 * columns
    return SUN_PARTS, SUN_PARTS if system.n_detectors == 1 else system.n_detectors
