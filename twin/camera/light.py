"""What is rendered once per scene and geometry: light from every cell and from the sun, and truth.

Nothing here knows watts, electrons or seconds: detector, filter, sky and integration time may
change without rendering again.
"""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.truth import Truth, render_truth
from twin.optics.matrix import Grid, transport_matrix
from twin.optics.radiometry import Collection, collection
from twin.optics.transport import Pinhole, Quality, sunlight, transport
from twin.scene import Scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System

Array = NDArray[np.float64]
#: Opens a named stage of the work; what is run inside belongs to it.
Stage = Callable[[str], AbstractContextManager[Any]]


@dataclass(frozen=True, eq=False)
class Light:
    """Per detector and cell, (n_detectors, n_cells): irradiance on the pupil per radiant intensity,
    1/m^2, with its Monte-Carlo standard error.
    """

    cells: Array
    error: Array


@dataclass(frozen=True, eq=False)
class Rendered:
    """Everything that light transport says about a scene seen by a system's geometry.

    ``sun``: irradiance on the pupil per irradiance of the sun, (n_detectors,). ``truth`` lies on
    the grid of the virtual image.
    """

    light: Light
    sun: Array
    truth: Truth


def render(
    scene: Scene,
    system: System,
    *,
    quality: Quality,
    seed: np.random.SeedSequence,
    world: Any = None,
    stage: Stage = lambda name: nullcontext(),
) -> Rendered:
    """Render a scene for a system; ``world`` is `mitsuba_scene(scene)`, when it is at hand."""
    emitter, detector, _ = devices(scene, system)
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    n = system.n_detectors
    seeds = [int(child.generate_state(1)[0]) for child in seed.spawn(2)]
    with stage("scene"):
        world = mitsuba_scene(scene) if world is None else world
    with stage("transport"):
        light = emitter_light(world, emitter, detector, shape, n, quality=quality, seed=seeds[0])
    with stage("sun"):
        direction = scene.sun.direction
        sun = sun_light(world, detector, direction, n, quality=quality, seed=seeds[1])
    with stage("truth"):
        truth = render_truth(world, emitter, (shape[0], shape[1] * n))
    return Rendered(light, sun, truth)


def devices(scene: Scene, system: System) -> tuple[Pinhole, Pinhole, Collection]:
    """Emitter and detector where the rig holds them, and the detector's lens."""
    lens = collection(system)
    half = np.radians(system.emitter.field_of_view_deg.value) / 2
    emitter = Pinhole(*scene.rig.device("emitter"), tan_half_field=float(np.tan(half)))
    origin, axes = scene.rig.device("detector")
    return emitter, Pinhole(origin, axes, lens.tan_half_field, lens.outline), lens


def emitter_light(
    world: Any,
    emitter: Pinhole,
    detector: Pinhole,
    shape: tuple[int, int],
    n_detectors: int,
    *,
    quality: Quality,
    seed: int,
) -> Light:
    """Transport from ``shape`` cells to one bucket, or to the columns of a line sensor."""
    if n_detectors == 1:
        found = transport(world, emitter, detector, shape, quality=quality, seed=seed)
        return Light(found.total.reshape(1, -1), found.standard_error.reshape(1, -1))
    cells, columns = Grid(emitter, *shape), Grid(detector, 1, n_detectors)
    finer, coarser = max(cells.size, n_detectors), min(cells.size, n_detectors)
    # As many paths per pair of cell and column as a bucket's cell would have, in two halves that
    # tell the error.
    side = math.ceil(math.sqrt(quality.samples * coarser / 2))
    halves = [
        transport_matrix(
            world,
            cells,
            columns,
            quality=Quality(side * side, quality.max_depth),
            seed=seed + half,
            role="scatter" if finer == n_detectors else "dual",
        )
        for half in range(2)
    ]
    return Light((halves[0] + halves[1]) / 2, np.abs(halves[0] - halves[1]) / 2)


def sun_light(
    world: Any,
    detector: Pinhole,
    direction: Array,
    n_detectors: int,
    *,
    quality: Quality,
    seed: int,
) -> Array:
    """Irradiance on the pupil per irradiance of the sun, by detector, (n_detectors,)."""
    columns = 32 if n_detectors == 1 else n_detectors
    parts = sunlight(
        world, detector, direction, shape=(32, columns), quality=quality, seed=seed
    ).total
    return parts.sum(axis=0) if n_detectors > 1 else parts.sum(keepdims=True).reshape(1)
