"""Light of a world in motion at some times of a frame: few paths, enough to say what changes."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.camera.motion import WorldInMotion
from twin.engine import mitsuba
from twin.optics.devices import Device
from twin.optics.paths import SunLight, TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.ray_sets import CellRays
from twin.optics.tracer import RAYS_AT_ONCE, Tracer

Array = NDArray[np.float64]

#: Paths of a cell at each time.
_PATHS = 8
#: Relative difference of light that is a rounding of single precision.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class Looks:
    """Direct light at equally spaced times, (n, rows, columns): of cells lit by the emitter, and of
    parts of the detector's field under the sun; ``step_s`` from one to the next. The same paths at
    all of them.
    """

    step_s: float
    light: Array
    sun: Array

    @staticmethod
    def of(
        world: WorldInMotion,
        emitter: Device,
        detector: Device,
        shape: tuple[int, int],
        sun_shape: tuple[int, int],
    ) -> "Looks":
        """In clear air, which takes no light."""
        times = world.looks_s
        scene, quality = world.scene_at(times), TracingQuality(1, 1)
        problem = LightProblem(scene, emitter, detector, world.scene.sun.direction)
        towards_sun = SunLight(world.sun_directions(times))
        return Looks(
            float(times[1]),
            _traced(problem.from_emitter(shape, quality, 0), len(times)),
            _traced(
                replace(problem.from_sun(sun_shape, quality, 0), light=towards_sun), len(times)
            ),
        )


def _traced(tracer: Tracer, n_times: int) -> Array:
    """Direct light of a tracer's cells at all times."""
    grid = tracer.start
    at_once = max(1, RAYS_AT_ONCE // (grid.size * _PATHS))
    blocks = [np.arange(n_times)[i : i + at_once] for i in range(0, n_times, at_once)]
    means = [_mean_light(tracer, instants) for instants in blocks]
    light = np.concatenate(means).reshape(n_times, grid.rows, grid.columns)
    still = np.abs(light - light[0]) <= _ROUNDING * light[0]
    return np.where(still, light[0], light)


def _mean_light(tracer: Tracer, instants: NDArray[np.int64]) -> Array:
    """Mean of the paths of each cell at these instants, cell by cell."""
    n_cells = tracer.start.size
    cells = np.tile(np.arange(n_cells), len(instants))
    nothing = np.zeros_like(cells)
    number = np.repeat(instants, n_cells)
    rays = CellRays(cells, nothing, nothing + _PATHS, 1, tracer.seed, (), number)
    value = np.array(mitsuba().Float64(tracer.direct(rays).value))
    return np.asarray(value.reshape(-1, _PATHS).mean(axis=1))
