"""Light of every cell by stock Mitsuba alone: its camera in the emitter's place, its projector in
the detector's, its path tracer; and the sun's light by its camera in the detector's place, under
its directional light.

Light goes the other way round as well as this one (surfaces are Lambertian): a camera where the
emitter is sees, in each pixel, what the emitter's cell brings to the detector, if the detector
shines with the intensity of its own cosine. Only triangles are shared with the twin's transport.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from twin.engine import mitsuba
from twin.optics.devices import Device
from twin.optics.problem import LightProblem
from twin.optics.radiometry import cell_centres

Array = NDArray[np.float64]

_FILM, _SUN_FILM, _TEXELS = 256, 128, 1024
_ROULETTE = 4  # bounces, from which on paths end by chance
_SIGMAS = 5  # of blur, within which light is
#: Pixels that a standard deviation of blur has at least: with 1.1 the finest bars of the chart in
#: the yard were 5 % too bright or dark.
_ACROSS_BLUR = 3


class Renderer:
    """Renders all cells at once. Devices have a lens and an even field; the emitter's may blur. A
    cell shows what of the image its square, blurred by a Gaussian, covers.
    """

    def __init__(self, problem: LightProblem, shape: tuple[int, int]) -> None:
        """``shape``: rows and columns of cells."""
        emitter, detector = problem.emitter, problem.detector
        for device, blur_tan in ((emitter, emitter.blur_tan), (detector, 0.0)):
            even = Device(
                device.origin_m, device.axes, device.tan_half_field, device.outline, blur_tan
            )
            assert even.__dict__ | {"focus_m": device.focus_m} == device.__dict__, (
                "not an even field"
            )
        blur = emitter.blur_tan / emitter.tan_half_field
        #: Half the film, in half fields of the emitter: with what is blurred beyond its edge.
        half = 1 + _SIGMAS * blur
        film = max(_FILM, math.ceil(_ACROSS_BLUR * 2 * half / blur)) if blur else _FILM
        across = half * cell_centres(film)
        self._rows, self._columns = (covers(n, across, blur) for n in shape)
        light = _projector(detector)
        self._view = _View(problem, emitter, half * emitter.tan_half_field, 3, light, film)

    def render(self, samples: int, seed: int) -> Array:
        """Irradiance on the pupil per radiant intensity of each cell, 1/m^2, (rows, columns), with
        so many paths per pixel of the film.
        """
        return self._rows @ self._view.render(samples, seed) @ self._columns.T


class SunRenderer:
    """Renders the sun's light in all parts of the detector's field, which has a lens."""

    def __init__(self, problem: LightProblem, shape: tuple[int, int]) -> None:
        """``shape``: rows and columns of parts. Raises ValueError with the sun in the field."""
        detector = problem.detector
        assert problem.sun_direction is not None, "no sun"
        if _is_in_field(detector, problem.sun_direction):
            raise ValueError("the sun is in the field, where a camera does not see it")
        x = cell_centres(_SUN_FILM)
        self._rows, self._columns = (covers(n, x, 0.0) for n in shape)
        square = x[:, None] ** 2 + x**2
        self._inside = square <= (1 if detector.outline == "disc" else 2)
        sun = {
            "type": "directional",
            "direction": (-problem.sun_direction).tolist(),
            "irradiance": 1.0,
        }
        self._view = _View(problem, detector, detector.tan_half_field, 4, sun, _SUN_FILM)

    def render(self, samples: int, seed: int) -> Array:
        """Irradiance on the pupil per irradiance of the sun, by part, (rows, columns)."""
        image = self._view.render(samples, seed) * self._inside
        return self._rows @ image @ self._columns.T


class _View:
    """A camera in a device's place, of a square field, and one light."""

    def __init__(
        self,
        problem: LightProblem,
        device: Device,
        tan: float,
        power: int,
        light: dict[str, Any],
        film: int,
    ) -> None:
        """``power`` of the cosine in a pixel's weight: 3 for solid angle, 4 for projected;
        ``film``: pixels of a side.
        """
        x = cell_centres(film) * tan
        self._weight = (1 + x[:, None] ** 2 + x**2) ** (-power / 2) * (2 * tan / film) ** 2
        grid = {"type": "hdrfilm", "width": film, "height": film, "pixel_format": "luminance"}
        self._scene = mitsuba().load_dict(
            {
                "type": "scene",
                "embree_use_robust_intersections": True,
                "integrator": {"type": "path", "max_depth": -1, "rr_depth": _ROULETTE},
                "sensor": {
                    "type": "perspective",
                    **_pose(device, tan),
                    "near_clip": 1e-4,
                    "film": {**grid, "rfilter": {"type": "box"}, "component_format": "float32"},
                    # A stratified one's few samples are correlated along paths of many bounces: a
                    # closed white room was 2.6 % too dark.
                    "sampler": {"type": "independent"},
                },
                "light": light,
                **{f"s{i}": shape for i, shape in enumerate(problem.scene.shapes())},
            }
        )

    def render(self, samples: int, seed: int) -> Array:
        """Radiance times weight of each pixel, top left first."""
        image = mitsuba().render(self._scene, spp=samples, seed=seed)
        return np.array(image, dtype=np.float64)[..., 0] * self._weight


def covers(n_cells: int, pixels: Array, blur: float) -> Array:
    """Share of each pixel's light that each cell has, (n_cells, n_pixels), across a field from -1
    to 1 with this standard deviation of blur.
    """
    edges = np.linspace(-1, 1, n_cells + 1)[:, None]
    if not blur:
        return ((pixels >= edges[:-1]) & (pixels < edges[1:])).astype(np.float64)
    below: Array = ndtr((edges - pixels) / blur)
    return below[1:] - below[:-1]


def _is_in_field(device: Device, towards: Array) -> bool:
    """Whether a direction is in a device's field, or near it."""
    corner = np.arctan(np.sqrt(2) * device.tan_half_field)
    return bool(device.axes[0] @ towards > np.cos(corner) - 0.01)


def _projector(detector: Device) -> dict[str, Any]:
    irradiance = {"type": "bitmap", "bitmap": mitsuba().Bitmap(_texture(detector)), "raw": True}
    return {
        "type": "projector",
        **_pose(detector, detector.tan_half_field),
        "irradiance": {**irradiance, "filter_type": "nearest"},
    }


def _texture(detector: Device) -> NDArray[np.float32]:
    """The plugin gives pi x texture on the plane at distance 1, where cos of intensity is cos^4."""
    x = cell_centres(_TEXELS)
    square = x[:, None] ** 2 + x**2
    cos4 = (1 + square * detector.tan_half_field**2) ** -2
    inside = square <= 1 if detector.outline == "disc" else np.ones_like(cos4)
    return (cos4 * inside / np.pi).astype(np.float32)[:, :, None]


def _pose(device: Device, tan: float) -> dict[str, Any]:
    forward, _, up = device.axes
    look_at = mitsuba().ScalarTransform4f().look_at
    place = look_at(
        origin=device.origin_m.tolist(),
        target=(device.origin_m + forward).tolist(),
        up=up.tolist(),
    )
    return {"to_world": place, "fov": float(np.degrees(2 * np.arctan(tan)))}
