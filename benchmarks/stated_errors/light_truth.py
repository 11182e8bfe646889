"""Light of every cell by stock Mitsuba alone: its camera in the emitter's place, its projector in
the detector's, its path tracer.

Light goes the other way round as well as this one (surfaces are Lambertian): a camera where the
emitter is sees, in each pixel, what the emitter's cell brings to the detector, if the detector
shines with the intensity of its own cosine. Only triangles are shared with the twin's transport.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.devices import Device
from twin.optics.problem import LightProblem
from twin.optics.radiometry import cell_centres

Array = NDArray[np.float64]

_FILM, _TEXELS = 256, 1024
_ROULETTE = 4  # bounces, from which on paths end by chance


class Renderer:
    """Renders all cells at once. Devices have a lens, an even field and no blur."""

    def __init__(self, problem: LightProblem) -> None:
        emitter, detector = problem.emitter, problem.detector
        for device in (emitter, detector):
            even = Device(device.origin_m, device.axes, device.tan_half_field, device.outline)
            assert even.__dict__ | {"focus_m": device.focus_m} == device.__dict__, (
                "not an even field"
            )
        mi = mitsuba()
        x = cell_centres(_FILM) * emitter.tan_half_field
        cos3 = (1 + x[:, None] ** 2 + x**2) ** -1.5
        #: Solid angle of each pixel.
        self._weight = cos3 * (2 * emitter.tan_half_field / _FILM) ** 2
        film = {"type": "hdrfilm", "width": _FILM, "height": _FILM, "pixel_format": "luminance"}
        irradiance = {"type": "bitmap", "bitmap": mi.Bitmap(_texture(detector)), "raw": True}
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "embree_use_robust_intersections": True,
                "integrator": {"type": "path", "max_depth": -1, "rr_depth": _ROULETTE},
                "sensor": {
                    "type": "perspective",
                    **_pose(emitter),
                    "near_clip": 1e-4,
                    "film": {**film, "rfilter": {"type": "box"}, "component_format": "float32"},
                    # A stratified one's few samples are correlated along paths of many bounces: a
                    # closed white room was 2.6 % too dark.
                    "sampler": {"type": "independent"},
                },
                "projector": {
                    "type": "projector",
                    **_pose(detector),
                    "irradiance": {**irradiance, "filter_type": "nearest"},
                },
                **{f"s{i}": shape for i, shape in enumerate(problem.scene.shapes())},
            }
        )

    def render(self, shape: tuple[int, int], samples: int, seed: int) -> Array:
        """Irradiance on the pupil per radiant intensity of each cell, 1/m^2, (rows, columns), which
        are powers of two; with so many paths per pixel of the film.
        """
        image = mitsuba().render(self._scene, spp=samples, seed=seed)
        pixels = np.array(image, dtype=np.float64)[..., 0] * self._weight
        rows, columns = shape
        parts = pixels.reshape(rows, _FILM // rows, columns, _FILM // columns)
        return np.asarray(parts.sum(axis=(1, 3)))


def _texture(detector: Device) -> NDArray[np.float32]:
    """The plugin gives pi x texture on the plane at distance 1, where cos of intensity is cos^4."""
    x = cell_centres(_TEXELS)
    square = x[:, None] ** 2 + x**2
    cos4 = (1 + square * detector.tan_half_field**2) ** -2
    inside = square <= 1 if detector.outline == "disc" else np.ones_like(cos4)
    return (cos4 * inside / np.pi).astype(np.float32)[:, :, None]


def _pose(device: Device) -> dict[str, Any]:
    forward, _, up = device.axes
    look_at = mitsuba().ScalarTransform4f().look_at
    place = look_at(
        origin=device.origin_m.tolist(),
        target=(device.origin_m + forward).tolist(),
        up=up.tolist(),
    )
    return {"to_world": place, "fov": float(np.degrees(2 * np.arctan(device.tan_half_field)))}
