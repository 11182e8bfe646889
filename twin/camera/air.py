"""What the air of a system's weather adds: the emitter's veil, and the glow of the sunlit air."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.mounting import field_points
from twin.camera.truth import depths
from twin.optics.devices import Device
from twin.optics.emission import emission_matrix, field_lobe
from twin.optics.paths import Quality
from twin.optics.time_of_flight import Paths
from twin.optics.veil import airlight, backscatter, backscatter_paths
from twin.optics.weather import Air
from twin.system import System

Array = NDArray[np.float64]


#: Optical depth of scattering below which none is followed: no more light than that is then left
#: in the wrong cell.
_THIN = 0.005


def where_air_scatters(air: Air | None, depth_m: Array, quality: Quality) -> Quality:
    """The same knobs, without scatterings where the air before all surfaces is too thin to matter;
    ``depth_m`` of the picture, infinite where nothing is.
    """
    farthest_m = float(depth_m[np.isfinite(depth_m)].max(initial=0.0))
    if air is None or air.scattering_per_m * farthest_m >= _THIN:
        return quality
    return replace(quality, air_orders=0)


@dataclass(frozen=True, eq=False)
class Veil:
    """The emitter's light that the air sends straight back, by detector and cell as in `Light`.

    ``value``, ``length_m``: its parts with the length of their ways, (n_cells, n), for time of
    flight.
    """

    light: Array
    value: Array
    length_m: Array

    @property
    def paths(self) -> Paths:
        """Its ways; of one detector, and only with time of flight."""
        value, length = self.value.astype(np.float32), self.length_m.astype(np.float32)
        return Paths(value, length, (len(value), 1))

    def added_to(self, paths: Paths) -> Paths:
        """Paths to surfaces, and those to the air."""
        own = self.paths
        value = np.hstack([paths.value, own.value])
        return Paths(value, np.hstack([paths.length_m, own.length_m]), paths.shape)


def veil_of(system: System, air: Air, emitter: Device, detector: Device, depth_m: Array) -> Veil:
    """Veil of every cell; ``depth_m`` (rows, columns x n_detectors) along the boresight."""
    rows, columns, n = system.emitter.rows.value, system.emitter.columns.value, system.n_detectors
    left, up = field_points(depth_m.shape, emitter.tan_half_field)
    distance = depth_m * np.sqrt(1 + left**2 + up**2)
    spread = _spread(system)
    none = np.zeros((rows * columns, 0))
    if n == 1 and system.time_of_flight:
        value, length = backscatter_paths(emitter, detector, (rows, columns), distance, air)
        value, length = (x.reshape(rows * columns, -1) for x in (value, length))
        return Veil(spread(value.sum(axis=1)[None]), value, length)
    edges = np.linspace(-1, 1, n + 1)
    strips = zip(edges[:-1], edges[1:], np.hsplit(distance, n), strict=True)
    light = [
        backscatter(emitter, detector, (rows, columns), seen, air, strip=(a, b)).ravel()
        for a, b, seen in strips
    ]
    return Veil(spread(np.stack(light)), none, none)


def _spread(system: System) -> Any:
    """From ideal cells to the emitter's own: bare LEDs light the whole field, lobes fall."""
    emitter = system.emitter
    if emitter.has_lens:
        return lambda cells: cells * field_lobe(emitter)
    equal = emission_matrix(emitter.model_copy(update={"intensity_spread": None}), np.inf)
    return lambda cells: cells @ equal.T


def glow(
    air: Air, world: Any, detector: Device, shape: tuple[int, int], sun_direction: Array
) -> Array:
    """Sunlight scattered by the air before the surfaces, as `sun_light` gives that of surfaces."""
    sharp = replace(detector, outline="square")
    left, up = field_points(shape, detector.tan_half_field)
    distance = depths(world, sharp, shape) * np.sqrt(1 + left**2 + up**2)
    return airlight(detector, shape, distance, sun_direction, air)
