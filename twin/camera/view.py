"""Image of the scene at 1550 nm from the position of the emitter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.optics.devices import CellGrid
from twin.optics.paths import DeviceLight, Light, TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.tracer import Tracer
from twin.optics.transport import gather

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class View:
    """Radiance in the detector's band, W/(m^2 sr), (rows, columns), by source of the light."""

    sun: Array
    emitter: Array

    @property
    def total(self) -> Array:
        """Sun and emitter together."""
        return self.sun + self.emitter


def render_view(
    problem: LightProblem,
    *,
    sun_irradiance_w_per_m2: float,
    radiant_intensity_w_per_sr: float,
    pixels: int = 256,
    seed: int = 0,
) -> View:
    """Image of the lit field from the emitter's position, without air; sun and emitter (all cells
    on) are rendered separately, to some 2 % of white as a report shows them.
    """
    quality = TracingQuality(samples=9, indirect_samples=4, max_depth=3)
    camera = CellGrid(problem.emitter, pixels, pixels)

    def radiance(light: Light) -> Array:
        return gather(Tracer(problem.scene, camera, "image", light, None, quality, seed)).total

    return View(
        sun=sun_irradiance_w_per_m2 * radiance(problem.sun),
        emitter=radiant_intensity_w_per_sr * radiance(DeviceLight(problem.emitter, "emitter")),
    )
