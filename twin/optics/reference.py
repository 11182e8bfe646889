"""The slow way, as reference: Mitsuba's own projector, camera and path tracer, pattern by pattern.

It shares nothing with `transport` but the triangles: another emitter, another integrator, light
followed in the other direction.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.transport import Pinhole
from twin.scene import Scene
from twin.scene.mitsuba import mitsuba_scene

_FILM = 64  # pixels along the detector's field
_FINE = 4  # texels along a cell: cos^3 in steps that cost below 0.1 %


class PatternRenderer:
    """Renders one pattern at a time: irradiance on the pupil per radiant intensity, 1/m^2.

    Parameters
    ----------
    scene
        What is lit.
    emitter, detector
        Square fields.
    max_depth
        Bounces, as in `Quality`.
    """

    def __init__(
        self, scene: Scene, emitter: Pinhole, detector: Pinhole, *, max_depth: int
    ) -> None:
        mi = mitsuba()
        if "disc" in (emitter.outline, detector.outline):
            raise ValueError("outline: the reference renderer knows square fields only")
        self._emitter = emitter
        shapes = {f"s{i}": shape for i, shape in enumerate(mitsuba_scene(scene).shapes())}
        self._plugins: dict[str, Any] = {
            "type": "scene",
            # Mitsuba counts the emitter's own vertex; roulette would only add noise.
            "integrator": {"type": "path", "max_depth": max_depth + 1, "rr_depth": 1000},
            "sensor": {
                "type": "perspective",
                **_placed(detector),
                "film": {
                    "type": "hdrfilm",
                    "width": _FILM,
                    "height": _FILM,
                    "pixel_format": "luminance",
                    "rfilter": {"type": "box"},
                },
            },
            **shapes,
        }
        tan = detector.tan_half_field
        u = ((np.arange(_FILM) + 0.5) / _FILM * 2 - 1) * tan
        # Radiance to irradiance on a flat pupil: cosine times solid angle, cos^4 per pixel.
        self._weight = (1 + u[:, None] ** 2 + u**2) ** -2 * (2 * tan / _FILM) ** 2
        self._mi = mi

    def render(self, pattern: NDArray[Any], *, samples: int, seed: int) -> float:
        """Bucket signal of one pattern (rows, columns) with ``samples`` paths per film pixel."""
        mi = self._mi
        texture = mi.Bitmap(self._texture(pattern)[:, :, None])
        projector = {
            "type": "projector",
            **_placed(self._emitter),
            "irradiance": {"type": "bitmap", "bitmap": texture, "raw": True}
            | {"filter_type": "nearest"},
        }
        world = mi.load_dict({**self._plugins, "projector": projector})
        image = np.array(mi.render(world, spp=samples, seed=seed), dtype=np.float64)[..., 0]
        return float((image * self._weight).sum())

    def _texture(self, pattern: NDArray[Any]) -> NDArray[np.float32]:
        """The plugin gives pi x texture on the plane at distance 1; intensity 1 gives cos^3."""
        shape = (pattern.shape[0] * _FINE, pattern.shape[1] * _FINE)
        y, x = (((np.arange(n) + 0.5) / n * 2 - 1) * self._emitter.tan_half_field for n in shape)
        cos3 = (1 + y[:, None] ** 2 + x**2) ** -1.5
        return (np.kron(pattern, np.ones((_FINE, _FINE))) * cos3 / np.pi).astype(np.float32)


def _placed(device: Pinhole) -> dict[str, Any]:
    forward, _, up = device.axes
    look_at = mitsuba().ScalarTransform4f().look_at
    return {
        "to_world": look_at(
            origin=device.origin_m.tolist(),
            target=(device.origin_m + forward).tolist(),
            up=up.tolist(),
        ),
        "fov": float(np.degrees(2 * np.arctan(device.tan_half_field))),
    }
