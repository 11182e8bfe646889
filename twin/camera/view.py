"""The scene at 1550 nm as a camera beside the emitter would see it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.optics.devices import Device, Grid
from twin.optics.paths import DeviceLight, Light, Quality, SunLight
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
    world: Any,
    emitter: Device,
    sun_direction: Array,
    *,
    sun_irradiance_w_per_m2: float,
    radiant_intensity_w_per_sr: float,
    pixels: int = 384,
    samples: int = 16,
    seed: int = 0,
) -> View:
    """Picture of the lit field, sun and emitter (all cells on) rendered apart."""
    quality = Quality(samples=samples, max_depth=3)

    def seen(light: Light) -> Array:
        grid = Grid(emitter, pixels, pixels)
        return gather(world, grid, light, role="picture", quality=quality, seed=seed).total

    return View(
        sun=sun_irradiance_w_per_m2 * seen(SunLight(sun_direction)),
        emitter=radiant_intensity_w_per_sr * seen(DeviceLight(emitter, "emitter")),
    )
