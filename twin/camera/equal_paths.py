"""Light of a system with as many paths in every cell."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from twin.camera.rendered import DetectorLight, RenderedLight
from twin.fidelity import Start
from twin.optics.matrix import transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.time_of_flight import trace_paths
from twin.optics.transport import CellLight, sunlight, transport
from twin.system import System

Array = NDArray[np.float64]
#: Of the field's height, and of its width for a bucket.
SUN_PARTS = 32
#: Radiance per irradiance of the sun that a surface has at most, with light of ten bounces.
SUNLIT = 10 / math.pi
#: Number of paths that would meet what all of them miss in 5 of 100 cases.
MISSED = 3.0
#: Standard deviation of the window over which variances of a line sensor are taken together.
_WINDOW_CELLS = 1.5


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
    light = emitter_light(
        problem, shape, system.n_detectors, quality=quality, seed=seed, start=start
    )
    paths = None
    if system.time_of_flight:
        paths = trace_paths(problem, shape, quality=quality, seed=seed)
    return replace(rendered, light=light, paths=paths)


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
    if n_detectors == 1:
        return of_bucket(transport(problem, shape, quality=quality, seed=seed))
    n_cells = shape[0] * shape[1]
    if start == "auto":
        start = "scatter" if n_detectors > n_cells else "dual"
    ends = n_cells if start == "scatter" else n_detectors
    # As many paths per pair of cell and column as per cell of a bucket detector, in two halves
    # whose difference gives the error.
    side = math.ceil(math.sqrt(quality.samples * ends / 2))
    quality = replace(quality, samples=side * side)
    halves = [
        transport_matrix(
            problem, shape, (1, n_detectors), quality=quality, seed=seed + half, start=start
        )
        for half in range(2)
    ]
    mean, own = (halves[0] + halves[1]) / 2, (halves[0] - halves[1]) ** 2 / 4
    return DetectorLight(mean, np.sqrt((own + _around(own, shape)) / 2))


def _around(variance: Array, shape: tuple[int, int]) -> Array:
    """Mean variance of the cells around, (n_detectors, n_cells): that of two halves alone has one
    degree of freedom.
    """
    side_by_side = np.hstack(list(variance.reshape(len(variance), *shape)))
    around = gaussian_filter(side_by_side, _WINDOW_CELLS, mode="nearest")
    return np.stack(np.hsplit(around, len(variance))).reshape(variance.shape)


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
