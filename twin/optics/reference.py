"""Independent reference: Mitsuba's own projector, camera and path tracer, pattern by pattern.

It shares only the triangles with `transport`: emitter and integrator are others, and light is
traced in the opposite direction. With air it traces every scattering (`volpath`).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.errors import InputError
from twin.optics.devices import Device
from twin.optics.problem import LightProblem
from twin.optics.radiometry import cell_centres
from twin.optics.weather import Air
from twin.system.environment import BACKWARD_ASYMMETRY

_FILM = 64  # pixels along the detector's field
_FINE = 4  # texels along a cell: cos^3 in steps that cost below 0.1 %


class PatternRenderer:
    """Renders one square pattern at a time: irradiance on the pupil per radiant intensity, 1/m^2.

    Parameters
    ----------
    problem
        Scene, devices with square fields, and air. The sun is left out.
    max_depth
        Bounces, as in `Quality`; with air its scatterings count too: 1 is direct light and single
        backscatter.
    """

    def __init__(self, problem: LightProblem, *, max_depth: int) -> None:
        mi = mitsuba()
        emitter, detector, air = problem.emitter, problem.detector, problem.air
        if "disc" in (emitter.outline, detector.outline):
            raise InputError("outline: the reference renderer knows square fields only")
        self._emitter = emitter
        shapes = {f"s{i}": shape for i, shape in enumerate(problem.scene.shapes())}
        scene_dict = {
            "type": "scene",
            # Mitsuba counts the emitter's own vertex; roulette would only add noise.
            "integrator": {
                "type": "volpath" if air else "path",
                "max_depth": max_depth + 1,
                "rr_depth": 1000,
            },
            "sensor": {
                "type": "perspective",
                **_pose_entries(detector),
                "near_clip": 1e-5,  # rays begin here: light up to it would go through no air
                **({"medium": _medium(air)} if air else {}),
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
        u = cell_centres(_FILM) * tan
        # Radiance to irradiance on a flat pupil: cosine times solid angle, cos^4 per pixel.
        self._weight = (1 + u[:, None] ** 2 + u**2) ** -2 * (2 * tan / _FILM) ** 2
        self._mi, self._scene_dict = mi, scene_dict
        self._scenes: dict[tuple[int, ...], tuple[Any, Any]] = {}

    def render(self, pattern: NDArray[Any], *, samples: int, seed: int) -> float:
        """Bucket signal of one pattern (rows, columns) with ``samples`` paths per film pixel."""
        return float(self.render_columns(pattern, samples=samples, seed=seed).sum())

    def render_columns(
        self, pattern: NDArray[Any], *, samples: int, seed: int
    ) -> NDArray[np.float64]:
        """The same by column of the film, (64,): what the columns of a line sensor get."""
        texture = self._texture(pattern)[:, :, None]
        if pattern.shape not in self._scenes:
            self._scenes[pattern.shape] = self._with_projector(texture)
        scene, parameters = self._scenes[pattern.shape]
        parameters["projector.irradiance.data"] = texture
        parameters.update()
        image = np.array(self._mi.render(scene, spp=samples, seed=seed), dtype=np.float64)[..., 0]
        return np.asarray((image * self._weight).sum(axis=0))

    def _with_projector(self, texture: NDArray[np.float32]) -> tuple[Any, Any]:
        """Scene and its parameters for textures of this size; patterns are updated in place."""
        projector = {
            "type": "projector",
            **_pose_entries(self._emitter),
            "irradiance": {"type": "bitmap", "bitmap": self._mi.Bitmap(texture), "raw": True}
            | {"filter_type": "nearest"},
        }
        scene = self._mi.load_dict({**self._scene_dict, "projector": projector})
        return scene, self._mi.traverse(scene)

    def _texture(self, pattern: NDArray[Any]) -> NDArray[np.float32]:
        """The plugin gives pi x texture on the plane at distance 1; intensity 1 gives cos^3."""
        shape = (pattern.shape[0] * _FINE, pattern.shape[1] * _FINE)
        y, x = (cell_centres(n) * self._emitter.tan_half_field for n in shape)
        cos3 = (1 + y[:, None] ** 2 + x**2) ** -1.5
        return (np.kron(pattern, np.ones((_FINE, _FINE))) * cos3 / np.pi).astype(np.float32)


def _medium(air: Air) -> dict[str, Any]:
    lobe, rest = (
        {"type": "hg", "g": float(g)} for g in (BACKWARD_ASYMMETRY, air.forward_asymmetry)
    )
    return {
        "type": "homogeneous",
        "sigma_t": float(air.extinction_per_m),
        "albedo": air.scattering_per_m / (air.extinction_per_m or 1.0),
        "phase": {
            "type": "blendphase",
            "weight": float(air.backward_share),
            "phase_0": rest,
            "phase_1": lobe,
        },
    }


def _pose_entries(device: Device) -> dict[str, Any]:
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
