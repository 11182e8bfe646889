"""All results of light transport for a scene and the geometry of a system."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from twin.accuracy import Decision
from twin.camera.air import CellBackscatter
from twin.camera.mounting import field_points
from twin.camera.truth import Truth
from twin.optics.devices import Device
from twin.optics.time_of_flight import Paths
from twin.warned import CaptureWarning

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DetectorLight:
    """Per detector and cell, (n_detectors, n_cells): irradiance on the pupil per radiant intensity,
    1/m^2, with its Monte-Carlo standard error; the share of light of more than one bounce, where
    known (not for line sensors); and a bound of each cell's light that was left out, of all alike
    or (n_detectors, n_cells).
    """

    cells: Array
    error: Array
    indirect_share: float = 0.0
    left_out: Array | float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class RenderedLight(Described):
    """All results of light transport for a scene and the geometry of a system.

    ``sun``: irradiance on the pupil per irradiance of the sun, by part of the detector's field,
    (rows, columns); each detector of a line sensor is a column. ``truth`` is on the grid of the
    virtual image. ``paths``: over surfaces, with their lengths, for time of flight.
    ``backscatter``: the part of the light that the air scattered back. ``emitter``, ``detector``:
    the devices rendered. ``warnings``: uncertainties of the render, with their errors.
    ``decisions``: of a render to a tolerance, which effects it holds, and why. ``sun_error``:
    standard error of each part of the sun's light; ``sun_left_out``: bound of what the render left
    out of it.
    """

    light: DetectorLight
    sun: Array
    truth: Truth
    emitter: Device
    detector: Device
    paths: Paths | None = None
    backscatter: CellBackscatter | None = None
    warnings: tuple[CaptureWarning, ...] = ()
    decisions: tuple[Decision, ...] = ()
    sun_error: Array | float = 0.0
    sun_left_out: Array | float = 0.0

    def cell_parts(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Row and column of the part of the detector's field in which it sees each cell of the
        virtual image, at its true depth; beyond the field's border the nearest.
        """
        ahead, left, up = np.moveaxis(self._seen() @ self.detector.axes.T, -1, 0)
        half, (rows, columns) = self.detector.tan_half_field * ahead, self.sun.shape
        row, column = ((1 - side / half) / 2 * n for side, n in ((up, rows), (left, columns)))
        return (
            np.clip(np.floor(row), 0, rows - 1).astype(np.intp),
            np.clip(np.floor(column), 0, columns - 1).astype(np.intp),
        )

    def half_paths_m(self) -> Array:
        """Half the way from the emitter over the middle of each cell to the detector, infinite
        where there is no surface, (rows, columns).
        """
        depth = self.truth.depth_m
        out = np.sqrt(1 + sum(x**2 for x in field_points(depth.shape, self.emitter.tan_half_field)))
        return np.asarray(depth * (out + np.linalg.norm(self._seen(), axis=-1)) / 2)

    def _seen(self) -> Array:
        """Towards the middle of each cell of the virtual image."""
        depth_m = self.truth.depth_m
        return self.towards(*field_points(depth_m.shape, self.emitter.tan_half_field), depth_m)

    def towards(self, left: Array, up: Array, depth_m: Array) -> Array:
        """Towards points of the emitter's field, left and up on the plane at distance 1, at these
        depths, from the detector, in the world's axes, (rows, columns, 3).
        """
        seen = np.stack([np.ones_like(left), left, up], axis=-1) @ self.emitter.axes
        near = np.isfinite(depth_m)
        shift = self.emitter.origin_m - self.detector.origin_m
        seen[near] += shift / depth_m[near, None]
        return np.asarray(seen)
