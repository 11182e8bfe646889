"""Light of every emitter cell and of the sun, and truth, rendered once per scene and geometry.

All quantities are relative, so detector, filter, sky and integration time may change without a new
render.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.air import CellBackscatter, airlight_of, backscatter_of, where_air_scatters
from twin.camera.chain import Chain
from twin.camera.mounting import check_rig, field_points, light_problem, with_near_pupil
from twin.camera.permitted_error import permitted_error
from twin.camera.render_warnings import (
    forward_scattering_warnings,
    grazing_warnings,
    near_pupil_warnings,
    tolerance_warnings,
    truncation_warnings,
    undersampling_warnings,
)
from twin.camera.truth import Truth, incidence_cosines, render_truth
from twin.fidelity import Fidelity, Start
from twin.optics.adaptive import gather_within
from twin.optics.devices import Device
from twin.optics.matrix import transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.time_of_flight import Paths, trace_paths
from twin.optics.transport import CellLight, sunlight, transport
from twin.progress import OpenStage, silently
from twin.scene import Scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]
#: Of the field's height, and of its width for a bucket.
SUN_PARTS = 32
#: Relative error of the sun's light over the share of the noise that light may be off by.
_SUN_SHARE = 0.05
#: Paths of a cell where all cells have the same number: to begin with, and at most.
FIRST_SAMPLES, _MOST_SAMPLES = 4, 1024


@dataclass(frozen=True, eq=False)
class DetectorLight:
    """Per detector and cell, (n_detectors, n_cells): irradiance on the pupil per radiant intensity,
    1/m^2, with its Monte-Carlo standard error; and the share of light of more than one bounce,
    where known (not for line sensors).
    """

    cells: Array
    error: Array
    indirect_share: float = 0.0


@dataclass(frozen=True, eq=False)
class RenderedLight:
    """All results of light transport for a scene and the geometry of a system.

    ``sun``: irradiance on the pupil per irradiance of the sun, by part of the detector's field,
    (rows, columns); each detector of a line sensor is a column. ``truth`` is on the grid of the
    virtual image. ``paths``: with their lengths, for time of flight. ``backscatter``: the part of
    light and paths that the air scattered back. ``emitter``, ``detector``: the devices rendered.
    ``warnings``: uncertainties of the render, with their errors.
    """

    light: DetectorLight
    sun: Array
    truth: Truth
    emitter: Device
    detector: Device
    paths: Paths | None = None
    backscatter: CellBackscatter | None = None
    warnings: tuple[CaptureWarning, ...] = ()

    def angles_deg(self) -> tuple[Array, Array]:
        """Angle of incidence at the detector, to its axis: of each cell of the virtual image (rows,
        columns) at its true depth, and of each part of the detector's field.
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


def stages(system: System) -> tuple[str, ...]:
    """Names of the stages of `render`."""
    return ("scene", "truth", "sun", "transport", *(("air",) if system.weather else ()))


def render(
    scene: Scene,
    system: System,
    *,
    fidelity: Fidelity,
    seed: np.random.SeedSequence,
    mesh_scene: Any = None,
    stage: OpenStage = silently,
) -> RenderedLight:
    """Render a scene for a system; ``mesh_scene`` is `mitsuba_scene(scene)`, if already built."""
    check_rig(scene, system)
    with stage("scene"):
        problem = light_problem(scene, system, mesh_scene)
    with stage("truth"):
        truth = render_truth(problem.scene, problem.emitter, system.image_shape)
    chain = Chain.of(system, scene.sun)
    rendered = render_light(problem, chain, truth, fidelity, seed.spawn(2), stage=stage)
    uncertain = _uncertain(scene, problem, rendered, fidelity)
    return replace(rendered, warnings=(*rendered.warnings, *uncertain))


def _uncertain(
    scene: Scene, problem: LightProblem, rendered: RenderedLight, fidelity: Fidelity
) -> tuple[CaptureWarning, ...]:
    light, truth, emitter = rendered.light, rendered.truth, rendered.emitter
    shape = truth.albedo.shape
    # Cells of a line sensor's detectors, side by side, are the cells of the image.
    image = np.hstack(list(light.cells.reshape(len(light.cells), shape[0], -1)))
    cosines = incidence_cosines(problem.scene, emitter, shape)
    samples, max_depth = float(fidelity.samples), float(fidelity.max_depth)
    if fidelity.light_tolerance is not None:
        # Of one bucket no bounce is lost, and what paths miss is in the stated error.
        one_bucket = rendered.paths is None and len(light.cells) == 1
        samples, max_depth = (math.inf, math.inf) if one_bucket else (FIRST_SAMPLES, max_depth)
    return (
        *undersampling_warnings(scene, emitter, image.size * samples),
        *grazing_warnings(image, cosines),
        *near_pupil_warnings(image, cosines, truth.depth_m, emitter, rendered.detector),
        *truncation_warnings(light.indirect_share, truth.albedo, max_depth),
        *forward_scattering_warnings(problem.air, float(truth.depth_m.min()), fidelity.air_orders),
    )


def render_light(
    problem: LightProblem,
    chain: Chain,
    truth: Truth,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
    *,
    sun_quality: TracingQuality | None = None,
    stage: OpenStage = silently,
) -> RenderedLight:
    """Light of emitter and sun, drawn from two seeds; air needs the truth's depth.

    ``chain``: of the system; to its noise a tolerance of the light refers. ``sun_quality``:
    settings of the path tracer for the sun; default: those of ``fidelity``.
    """
    system = chain.system
    quality, sun_quality = (
        where_air_scatters(problem.air, truth.depth_m, q)
        for q in (fidelity.quality, sun_quality or fidelity.quality)
    )
    problem = with_near_pupil(problem, system, truth.depth_m)
    first, second = (int(seed.generate_state(1)[0]) for seed in seeds)
    with stage("sun"):
        if fidelity.light_tolerance is None:
            sun = sun_light(problem, system.n_detectors, quality=sun_quality, seed=second)
        else:
            sun = _sun_within(
                problem, system.n_detectors, fidelity.light_tolerance, quality, second
            )
        if problem.air:
            sun = sun + airlight_of(problem, sun.shape)
    rendered = RenderedLight(_no_light(system), sun, truth, problem.emitter, problem.detector)
    with stage("transport"):
        if fidelity.light_tolerance is None:
            rendered = _lit(rendered, problem, system, quality, first, fidelity.start)
        else:
            rendered = _lit_within(rendered, problem, chain, fidelity, quality, first)
    if not problem.air:
        return rendered
    with stage("air"):
        backscatter = backscatter_of(system, problem, truth.depth_m)
        light = replace(rendered.light, cells=rendered.light.cells + backscatter.light)
        paths = rendered.paths and backscatter.added_to(rendered.paths)
        return replace(rendered, light=light, paths=paths, backscatter=backscatter)


def _no_light(system: System) -> DetectorLight:
    n_cells = system.emitter.rows.value * system.emitter.columns.value
    return DetectorLight(*np.zeros((2, system.n_detectors, n_cells)))


def _lit(
    rendered: RenderedLight,
    problem: LightProblem,
    system: System,
    quality: TracingQuality,
    seed: int,
    start: Start,
) -> RenderedLight:
    """The same with the emitter's light, and its paths for a system with time of flight."""
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    light = emitter_light(
        problem, shape, system.n_detectors, quality=quality, seed=seed, start=start
    )
    paths = None
    if system.time_of_flight:
        paths = trace_paths(problem, shape, quality=quality, seed=seed)
    return replace(rendered, light=light, paths=paths)


def _sun_within(
    problem: LightProblem, n_detectors: int, share: float, quality: TracingQuality, seed: int
) -> Array:
    """`sun_light` to an error of each detector's sum: what the sun adds to an image is its shot
    noise, which is off by half of the sun's relative error.
    """
    rows, columns = SUN_PARTS, SUN_PARTS if n_detectors == 1 else n_detectors
    together = (0, 1) if n_detectors == 1 else 0

    def permitted(light: Array) -> Array:
        total = light.sum(axis=together, keepdims=True)
        parts = light.size / total.size
        return np.broadcast_to(_SUN_SHARE * share * total / math.sqrt(parts), light.shape)

    return gather_within(problem.from_sun((rows, columns), quality, seed), permitted).total


def _lit_within(
    rendered: RenderedLight,
    problem: LightProblem,
    chain: Chain,
    fidelity: Fidelity,
    quality: TracingQuality,
    seed: int,
) -> RenderedLight:
    """The same to a tolerance of the light. Of one detector without time of flight each cell has as
    many paths as it needs; else all have the same number, until their error is small enough.
    """
    system, share = chain.system, fidelity.light_tolerance
    assert share is not None
    if system.n_detectors == 1 and not system.time_of_flight:
        tracer = problem.from_emitter(system.image_shape, quality, seed)

        def permitted(cells: Array) -> Array:
            limit = permitted_error(chain, rendered, cells.reshape(1, -1), share)
            return limit.reshape(system.image_shape)

        light = _of_bucket(gather_within(tracer, permitted, problem.corners))
        over = _rms(light.error / permitted_error(chain, rendered, light.cells, share))
        return replace(rendered, light=light, warnings=tolerance_warnings(over * share, share))
    samples = FIRST_SAMPLES
    while True:
        quality = replace(quality, samples=samples, indirect_samples=None)
        lit = _lit(rendered, problem, system, quality, seed, fidelity.start)
        over = _rms(lit.light.error / permitted_error(chain, lit, lit.light.cells, share))
        if over <= 1 or samples >= _MOST_SAMPLES:
            return replace(lit, warnings=tolerance_warnings(over * share, share))
        # Their number by its square root; the error falls as their number to the power -0.75.
        side = math.isqrt(samples) * min(max(1.1 * over ** (2 / 3), 1.4), 4.0)
        samples = min(math.ceil(side) ** 2, _MOST_SAMPLES)


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def emitter_light(
    problem: LightProblem,
    shape: tuple[int, int],
    n_detectors: int,
    *,
    quality: TracingQuality,
    seed: int,
    start: Start = "auto",
) -> DetectorLight:
    """Transport from ``shape`` cells to one bucket, or to the columns of a line sensor."""
    if n_detectors == 1:
        return _of_bucket(transport(problem, shape, quality=quality, seed=seed))
    n_cells = shape[0] * shape[1]
    if start == "auto":
        start = "scatter" if n_detectors > n_cells else "dual"
    ends = n_cells if start == "scatter" else n_detectors
    # As many paths per pair of cell and column as per cell of a bucket detector, in two halves
    # whose difference gives the error.
    side = math.ceil(math.sqrt(quality.samples * ends / 2))
    quality = replace(quality, samples=side * side)
    halves = [
        transport_matrix(
            problem, shape, (1, n_detectors), quality=quality, seed=seed + half, start=start
        )
        for half in range(2)
    ]
    return DetectorLight((halves[0] + halves[1]) / 2, np.abs(halves[0] - halves[1]) / 2)


def _of_bucket(gathered: CellLight) -> DetectorLight:
    total = gathered.total
    share = float(gathered.indirect.sum() / total.sum()) if total.any() else 0.0
    return DetectorLight(total.reshape(1, -1), gathered.standard_error.reshape(1, -1), share)


def sun_light(
    problem: LightProblem, n_detectors: int, *, quality: TracingQuality, seed: int
) -> Array:
    """Irradiance on the pupil per irradiance of the sun, by part of the field, (rows, columns); the
    columns are those of a line sensor.
    """
    shape = (SUN_PARTS, SUN_PARTS if n_detectors == 1 else n_detectors)
    return sunlight(problem, shape, quality=quality, seed=seed).total
