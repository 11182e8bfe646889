"""Light that the air of a system's weather adds: backscatter of the emitter, and airlight."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.camera.mounting import field_points
from twin.camera.truth import Truth, depths
from twin.optics.backscatter import airlight, backscatter
from twin.optics.emission import emission_matrix, field_lobe
from twin.optics.lost_airlight import lost_airlight
from twin.optics.lost_orders import lost_orders_share
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.time_of_flight import Paths
from twin.optics.weather import Air
from twin.system import System

Array = NDArray[np.float64]


#: Optical depth of scattering below which scattering is not traced: at most this share of the light
#: then stays in the wrong cell.
THIN = 0.005
#: Along each side of a cell, for its backscatter: of a cell that the border of an object cuts, what
#: is in front of either surface counts to a sixth of the cell.
_RAYS = 3


def where_air_scatters(air: Air | None, depth_m: Array, quality: TracingQuality) -> TracingQuality:
    """``quality``, without scattering where the air in front of all surfaces is too thin to matter;
    ``depth_m`` of the image, infinite where there is no surface.
    """
    if air is None or scattering_depth(air, depth_m) >= THIN:
        return quality
    return replace(quality, air_orders=0)


def scattering_depth(air: Air, depth_m: Array) -> float:
    """Optical depth of scattering to the farthest surface: more than the share of light that is
    scattered on the way there.
    """
    return air.scattering_per_m * float(depth_m[np.isfinite(depth_m)].max(initial=0.0))


def lost_orders(problem: LightProblem, truth: Truth, cells: Array, orders: int) -> float:
    """Light that the air scatters more than ``orders`` times, as a share of ``cells``
    (n_detectors, n_cells), the light of surfaces: as before a wall at the mean distance of that
    light, of the mean reflectance that is seen.
    """
    depth_m, albedo = truth.depth_m, truth.albedo
    image = np.hstack(list(cells.reshape(len(cells), len(depth_m), -1)))
    lit = np.isfinite(depth_m) & (albedo > 0) & (image > 0)
    if problem.air is None or not lit.any():
        return 0.0
    return lost_orders_share(
        problem.air,
        float(np.average(depth_m[lit], weights=image[lit])),
        problem.emitter.tan_half_field,
        float(albedo[lit].mean()),
        orders,
        rng=np.random.default_rng(0),  # the same air always loses as much
    )


@dataclass(frozen=True, eq=False)
class CellBackscatter:
    """The emitter's light that the air scatters back, by detector and cell as in `DetectorLight`.

    ``paths``: the same with its path lengths; for one detector with time of flight only.
    """

    light: Array
    paths: Paths | None = None


def backscatter_of(system: System, problem: LightProblem) -> CellBackscatter:
    """Backscatter of every cell, in front of the surface that each of its rays meets first."""
    shape, n = (system.emitter.rows.value, system.emitter.columns.value), system.n_detectors
    distance = _distances_of_rays(problem, system.image_shape)
    edges = np.linspace(-1, 1, n + 1)
    strips = zip(edges[:-1], edges[1:], np.split(distance, n, axis=1), strict=True)
    parts = [backscatter(problem, shape, seen, strip=(a, b), rays=_RAYS) for a, b, seen in strips]
    light = _shared(system, np.stack([part.light.ravel() for part in parts]))
    if n > 1 or not system.time_of_flight:
        return CellBackscatter(light)
    value, length = (
        x.reshape(light.size, -1).astype(np.float32) for x in (parts[0].value, parts[0].length_m)
    )
    return CellBackscatter(light, Paths(value, length, shape))


def _distances_of_rays(problem: LightProblem, shape: tuple[int, int]) -> Array:
    """Along the rays of each cell to the first surface, (rows, columns, _RAYS, _RAYS)."""
    emitter, (rows, columns) = problem.emitter, shape
    fine, at = (rows * _RAYS, columns * _RAYS), None
    if problem.instants:  # of a cell that moves while it is lit, the one in the middle
        of_cells = np.arange(rows * columns).reshape(shape) * problem.instants
        at = (of_cells + problem.instants // 2).repeat(_RAYS, 0).repeat(_RAYS, 1).ravel()
    left, up = field_points(fine, emitter.tan_half_field)
    depth = depths(problem.scene, replace(emitter, outline="square"), fine, at)
    by_cell = (depth * np.sqrt(1 + left**2 + up**2)).reshape(rows, _RAYS, columns, _RAYS)
    return np.asarray(by_cell.swapaxes(1, 2))


def _shared(system: System, cells: Array) -> Array:
    """Light of the emitter's real cells, from that of ideal ones: with lobes, and without a lens
    over the whole field.
    """
    emitter = system.emitter
    if emitter.has_lens:
        return cells * field_lobe(emitter)
    equal = emission_matrix(emitter.model_copy(update={"intensity_spread": None}), np.inf)
    return cells @ equal.T


def airlight_of(problem: LightProblem, shape: tuple[int, int]) -> Array:
    """Sunlight scattered by the air in front of the surfaces, in the unit of `sun_light`."""
    return airlight(problem, shape, _distances(problem, shape))


def lost_airlight_of(problem: LightProblem, shape: tuple[int, int]) -> Array:
    """The same of light that is scattered more than once, which `airlight_of` leaves out: an
    estimate in a layer of air that is assumed.
    """
    if problem.air is None or problem.sun_direction is None:
        return np.zeros(shape)
    rng = np.random.default_rng(0)  # the same air always loses as much
    return lost_airlight(problem, shape, _distances(problem, shape), rng=rng)


def _distances(problem: LightProblem, shape: tuple[int, int]) -> Array:
    """Along the rays of the parts of the detector's field to the first surface."""
    detector = problem.detector
    left, up = field_points(shape, detector.tan_half_field)
    depth = depths(problem.scene, replace(detector, outline="square"), shape)
    return np.asarray(depth * np.sqrt(1 + left**2 + up**2))
