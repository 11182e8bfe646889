"""Definition of a light transport problem: scene, emitter, detector, sun and air."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.optics.devices import CellGrid, Device
from twin.optics.interreflection import Body, indirect_bound
from twin.optics.paths import DeviceLight, SunLight, TracingQuality
from twin.optics.tracer import Tracer
from twin.optics.unseen import FacetsByLength, facet_light, facets_by_length
from twin.optics.weather import Air

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LightProblem:
    """Everything that light depends on, shared by all tracers and closed forms.

    Parameters
    ----------
    scene
        Mitsuba scene of Lambertian surfaces, as `twin.scene.mitsuba.mitsuba_scene` makes it.
    emitter, detector
        Position, axes and field of each.
    sun_direction : (3,) array, optional
        Unit vector towards the sun.
    air
        Fills all space; None: there is none.
    corners : function, optional
        Gives positions (n, 3), relative to the rig as the scene, and reflectances (n,) of the
        meshes' vertices: where details may be that paths miss.
    bodies : function, optional
        Gives the meshes as `indirect_bound` takes them.
    instants
        Of a scene that moves: of each cell from which paths start, as many instants of its own.
    """

    scene: Any
    emitter: Device
    detector: Device
    sun_direction: Array | None = None
    air: Air | None = None
    corners: Callable[[], tuple[Array, Array]] | None = None
    bodies: Callable[[], Sequence[Body]] | None = None
    instants: int | None = None

    def moved(self, rotation: Array, shift_m: Array) -> "LightProblem":
        """The problem with both devices after a rigid motion, as `Device.moved`."""
        emitter, detector = (d.moved(rotation, shift_m) for d in (self.emitter, self.detector))
        return replace(self, emitter=emitter, detector=detector)

    def from_emitter(self, shape: tuple[int, int], quality: TracingQuality, seed: int) -> Tracer:
        """Paths from the cells of the emitter, (rows, columns), to the detector's pupil."""
        cells, pupil = CellGrid(self.emitter, *shape), DeviceLight(self.detector, "pupil")
        return Tracer(self.scene, cells, "emitter", pupil, self.air, quality, seed, self.instants)

    def from_detector(self, shape: tuple[int, int], quality: TracingQuality, seed: int) -> Tracer:
        """Paths from the pixels of the detector, (rows, columns), to the emitter."""
        pixels, light = CellGrid(self.detector, *shape), DeviceLight(self.emitter, "emitter")
        return Tracer(self.scene, pixels, "pupil", light, self.air, quality, seed)

    def from_sun(self, shape: tuple[int, int], quality: TracingQuality, seed: int) -> Tracer:
        """Paths from parts of the detector's field, (rows, columns), to the sun."""
        parts = CellGrid(self.detector, *shape)
        return Tracer(self.scene, parts, "pupil", self.sun, self.air, quality, seed, self.instants)

    def largest_indirect(self, tracer: Tracer) -> float:
        """Bound of the light of a tracer's cells from the second surface on; infinite where none is
        known.
        """
        if self.bodies is None or tracer.scatters:
            return math.inf
        device = tracer.start.device
        return tracer.largest_weight * indirect_bound(self.bodies(), device, tracer.light)

    def facet_light(self, shape: tuple[int, int], columns: int = 1) -> Array:
        """Light that a facet which paths miss may bring to each cell of the emitter: see
        `twin.optics.unseen.facet_light`; through the air, and 0 without corners.
        """
        corners, _ = self._corners_and_ways
        return facet_light(CellGrid(self.emitter, *shape), self.detector, corners, columns)

    def facets_by_length(self, shape: tuple[int, int]) -> FacetsByLength:
        """The same in parts, by the lengths of the ways over the facets."""
        return facets_by_length(
            CellGrid(self.emitter, *shape), self.detector, *self._corners_and_ways
        )

    @cached_property
    def _corners_and_ways(self) -> tuple[tuple[Array, Array], Array]:
        """The `corners`, of reflectances as they look through the air, and the length of the way
        from emitter to detector over each, (n,).
        """
        if self.corners is None:
            return (np.empty((0, 3)), np.empty(0)), np.empty(0)
        corners_m, reflectance = self.corners()
        out_m, back_m = (
            np.linalg.norm(corners_m - device.origin_m, axis=1)
            for device in (self.emitter, self.detector)
        )
        if self.air:
            reflectance = reflectance * np.exp(-self.air.extinction_per_m * (out_m + back_m))
        return (corners_m, reflectance), out_m + back_m

    @property
    def sun(self) -> SunLight:
        """The sun as a light. Raises InputError without a direction."""
        if self.sun_direction is None:
            raise InputError("sun_direction: is not given")
        return SunLight(self.sun_direction)
