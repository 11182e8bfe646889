"""What is rendered once per scene and geometry: light from every cell and from the sun, and truth.

Nothing here knows watts, electrons or seconds: detector, filter, sky and integration time may
change without rendering again.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.air import Veil, glow, veil_of, where_air_scatters
from twin.camera.limits import cut_off, grazing, unsampled, unspread
from twin.camera.mounting import check_rig, devices, field_points
from twin.camera.truth import Truth, incidence_cosines, render_truth
from twin.fidelity import Fidelity, Start
from twin.optics.devices import Device, Grid
from twin.optics.matrix import transport_matrix
from twin.optics.paths import Quality
from twin.optics.time_of_flight import Paths, trace_paths
from twin.optics.transport import sunlight, transport
from twin.optics.weather import Air, air_of_system
from twin.scene import Scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]
#: Of the field's height, and of its width for a bucket.
SUN_PARTS = 32
#: Opens a named stage of the work; what is run inside belongs to it.
Stage = Callable[[str], AbstractContextManager[Any]]


@dataclass(frozen=True, eq=False)
class Light:
    """Per detector and cell, (n_detectors, n_cells): irradiance on the pupil per radiant intensity,
    1/m^2, with its Monte-Carlo standard error; and the share of it that bounced more than once,
    where that is known (not for line sensors).
    """

    cells: Array
    error: Array
    indirect_share: float = 0.0


@dataclass(frozen=True, eq=False)
class Rendered:
    """Everything that light transport says about a scene seen by a system's geometry.

    ``sun``: irradiance on the pupil per irradiance of the sun, by part of the detector's field,
    (rows, columns); each detector of a line sensor is a column. ``truth`` lies on the grid of the
    virtual image. ``paths``: with their lengths, for time of flight. ``veil``: the share of light
    and paths that the air sent back. ``emitter``, ``detector``: what was rendered from, and to.
    ``warnings``: what rendering leaves uncertain, with the error.
    """

    light: Light
    sun: Array
    truth: Truth
    emitter: Device
    detector: Device
    paths: Paths | None = None
    veil: Veil | None = None
    warnings: tuple[CaptureWarning, ...] = ()

    def angles_deg(self) -> tuple[Array, Array]:
        """Angle to the detector's axis under which light arrives: from each cell of the virtual
        image (rows, columns), seen at its true depth, and from each part of the detector's field.
        """
        left, up = field_points(self.truth.depth_m.shape, self.emitter.tan_half_field)
        along, depth = np.stack([np.ones_like(left), left, up], axis=-1), self.truth.depth_m
        seen = along @ self.emitter.axes
        near = np.isfinite(depth)
        shift = self.emitter.origin_m - self.detector.origin_m
        seen[near] += shift / depth[near, None]
        cos = seen @ self.detector.axes[0] / np.linalg.norm(seen, axis=-1)
        parts = np.hypot(*field_points(self.sun.shape, self.detector.tan_half_field))
        return np.degrees(np.arccos(np.clip(cos, -1, 1))), np.degrees(np.arctan(parts))


def render(
    scene: Scene,
    system: System,
    *,
    fidelity: Fidelity,
    seed: np.random.SeedSequence,
    world: Any = None,
    stage: Stage = lambda name: nullcontext(),
) -> Rendered:
    """Render a scene for a system; ``world`` is `mitsuba_scene(scene)`, when it is at hand."""
    check_rig(scene, system)
    emitter, detector, _ = devices(scene, system)
    with stage("scene"):
        world = mitsuba_scene(scene) if world is None else world
    with stage("truth"):
        truth = render_truth(world, emitter, system.picture_shape)
    direction, sun_quality, seeds = scene.sun.direction, fidelity.quality, seed.spawn(2)
    rendered = render_light(
        world, system, emitter, detector, direction, truth, fidelity, sun_quality, seeds, stage
    )
    air = air_of_system(system)
    return replace(rendered, warnings=_uncertain(scene, world, rendered, fidelity, air))


def _uncertain(
    scene: Scene, world: Any, rendered: Rendered, fidelity: Fidelity, air: Air | None
) -> tuple[CaptureWarning, ...]:
    light, truth, emitter = rendered.light, rendered.truth, rendered.emitter
    shape = truth.albedo.shape
    # Of a line sensor's pixel and cell only the picture's cell is lit: side by side, they are it.
    picture = np.hstack(list(light.cells.reshape(len(light.cells), shape[0], -1)))
    return (
        *unsampled(scene, emitter, picture.size * fidelity.samples),
        *grazing(picture, incidence_cosines(world, emitter, shape)),
        *cut_off(light.indirect_share, truth.albedo, fidelity.max_depth),
        *unspread(air, float(truth.depth_m.min()), fidelity.air_orders),
    )


def render_light(
    world: Any,
    system: System,
    emitter: Device,
    detector: Device,
    sun_direction: Array,
    truth: Truth,
    fidelity: Fidelity,
    sun_quality: Quality,
    seeds: Sequence[np.random.SeedSequence],
    stage: Stage = lambda name: nullcontext(),
) -> Rendered:
    """Light of emitter and sun, drawn from two seeds; air needs the truth's depth."""
    air, n = air_of_system(system), system.n_detectors
    quality, sun_quality = (
        where_air_scatters(air, truth.depth_m, q) for q in (fidelity.quality, sun_quality)
    )
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    first, second = (int(seed.generate_state(1)[0]) for seed in seeds)
    paths = veil = None
    with stage("transport"):
        light = emitter_light(
            world,
            emitter,
            detector,
            shape,
            n,
            quality=quality,
            start=fidelity.start,
            seed=first,
            air=air,
        )
        if system.time_of_flight:
            paths = trace_paths(
                world,
                emitter,
                detector,
                shape,
                quality=quality,
                seed=first,
                air=air,
            )
    with stage("sun"):
        sun = sun_light(
            world,
            detector,
            sun_direction,
            n,
            quality=sun_quality,
            seed=second,
            air=air,
        )
    if air:
        with stage("air"):
            veil = veil_of(system, air, emitter, detector, truth.depth_m)
            light = replace(light, cells=light.cells + veil.light)
            paths = paths and veil.added_to(paths)
            sun = sun + glow(air, world, detector, sun.shape, sun_direction)
    return Rendered(light, sun, truth, emitter, detector, paths, veil)


def emitter_light(
    world: Any,
    emitter: Device,
    detector: Device,
    shape: tuple[int, int],
    n_detectors: int,
    *,
    quality: Quality,
    seed: int,
    start: Start = "auto",
    air: Air | None = None,
) -> Light:
    """Transport from ``shape`` cells to one bucket, or to the columns of a line sensor."""
    if n_detectors == 1:
        found = transport(
            world,
            emitter,
            detector,
            shape,
            quality=quality,
            seed=seed,
            air=air,
        )
        total = found.total
        share = float(found.indirect.sum() / total.sum()) if total.any() else 0.0
        return Light(total.reshape(1, -1), found.standard_error.reshape(1, -1), share)
    cells, columns = Grid(emitter, *shape), Grid(detector, 1, n_detectors)
    if start == "auto":
        start = "scatter" if n_detectors > cells.size else "dual"
    ends = cells.size if start == "scatter" else n_detectors
    # As many paths per pair of cell and column as a bucket's cell would have, in two halves that
    # tell the error.
    side = math.ceil(math.sqrt(quality.samples * ends / 2))
    halves = [
        transport_matrix(
            world,
            cells,
            columns,
            quality=replace(quality, samples=side * side),
            seed=seed + half,
            role=start,
            air=air,
        )
        for half in range(2)
    ]
    return Light((halves[0] + halves[1]) / 2, np.abs(halves[0] - halves[1]) / 2)


def sun_light(
    world: Any,
    detector: Device,
    direction: Array,
    n_detectors: int,
    *,
    quality: Quality,
    seed: int,
    air: Air | None = None,
) -> Array:
    """Irradiance on the pupil per irradiance of the sun, by part of the field, (rows, columns); the
    columns are those of a line sensor.
    """
    shape = (SUN_PARTS, SUN_PARTS if n_detectors == 1 else n_detectors)
    found = sunlight(
        world,
        detector,
        direction,
        shape=shape,
        quality=quality,
        seed=seed,
        air=air,
    )
    return found.total
