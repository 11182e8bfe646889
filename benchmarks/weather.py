"""Where Beer-Lambert and single backscatter stop being enough: a wall in fog against `volpath`."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.optical import wall_at
from benchmarks.timing import Figure, timed
from twin.optics.backscatter import backscatter, cell_rays
from twin.optics.devices import Device
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.reference import PatternRenderer
from twin.optics.transport import transport
from twin.optics.weather import Air, air_of
from twin.scene.mitsuba import mitsuba_scene
from twin.system import load_part

_DISTANCE_M = 10.0
_SIZE = 16
_TAN = math.tan(math.radians(10))
_DEPTH = {0.02: 6, 0.05: 6, 0.1: 8, 0.2: 8, 0.5: 12, 1.0: 20, 2.0: 32, 3.0: 48}
_EMITTER = Device(np.zeros(3), np.eye(3), _TAN)
_DETECTOR = Device(np.array([0, 0.3, 0]), np.eye(3), _TAN)


def figures() -> Iterator[Figure]:
    """Name, value and unit: extinction of the bundled weathers, error over optical depth, time."""
    for name in ("clear-air", "haze", "fog-200m", "rain-10", "snow-2-wet", "snow-2-dry", "smoke"):
        air = air_of(load_part(name).weather, 1550e-9)
        yield f"{name}: extinction at 1550 nm", air.extinction_per_m * 1e4 / math.log(10), "dB/km"
    light = _wall_light()
    fog = air_of(load_part("fog-200m").weather, 1550e-9)
    for kind, asymmetry, share in (
        ("fog", fog.asymmetry, fog.backward_share),
        ("isotropic", 0.0, 0.0),
    ):
        lacking = []
        for tau, depth in _DEPTH.items():
            air = Air(tau / _DISTANCE_M, 0.99 * tau / _DISTANCE_M, asymmetry, share)
            for figure in _errors(f"{kind}, optical depth {tau:g}", air, depth, light):
                yield figure
                if figure[0].endswith("model less full scattering"):
                    lacking.append(abs(figure[1]))
        yield f"{kind}: optical depth where 5 % is missing", np.interp(5.0, lacking, [*_DEPTH]), ""
    grid = (64, 64)
    problem = _before_wall(fog)
    work = timed(lambda: backscatter(problem, grid, _DISTANCE_M))
    yield "backscatter of 64 x 64 cells", work, ""


def _before_wall(air: Air | None = None) -> LightProblem:
    return LightProblem(mitsuba_scene(wall_at(_DISTANCE_M)), _EMITTER, _DETECTOR, air=air)


def _errors(
    name: str, air: Air, depth: int, light: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> Iterator[Figure]:
    """All cells lit: backscatter over wall, the model's error at single and at full scattering."""
    cells, path = light
    wall = float((cells * air.transmission(path)).sum())
    problem = _before_wall(air)
    added = float(backscatter(problem, (_SIZE, _SIZE), path / 2).value.sum())
    yield f"{name}: backscatter over wall", 100 * added / wall, "%"
    everything = np.ones((_SIZE, _SIZE))
    for what, bounces, samples in (("single", 1, 64), ("full", depth, 256)):
        reference = PatternRenderer(problem, max_depth=bounces)
        got = [reference.render(everything, samples=samples, seed=i) for i in range(8)]
        mean, error = np.mean(got), np.std(got, ddof=1) / math.sqrt(len(got))
        yield f"{name}: model less {what} scattering", 100 * float((wall + added) / mean - 1), "%"
        yield f"{name}: standard error of {what} scattering", 100 * float(error / mean), "%"
    # Light scattered a little forward still lands in the field: it is not lost (delta-Eddington).
    kept = air.scattering_per_m * max(air.asymmetry, 0) ** 2
    scaled = float((cells * air.transmission(path) * np.exp(kept * path)).sum())
    error = 100 * float((scaled + added) / mean - 1)
    yield f"{name}: model without the forward peak's loss, less full scattering", error, "%"


def _wall_light() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Direct light of the wall without air, and the mean path there and back, by cell."""
    grid = (_SIZE, _SIZE)
    cells = transport(_before_wall(), grid, quality=TracingQuality(1024, 1), seed=1)
    _, cosine = cell_rays(_EMITTER, grid, 8)
    return cells.total, 2 * (_DISTANCE_M / cosine).mean(axis=(2, 3))
