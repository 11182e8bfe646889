"""Light of every emitter cell and of the sun, and truth, rendered once per scene and geometry.

All quantities are relative, so detector, filter, sky and integration time may change without a new
render.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.air import (
    airlight_of,
    backscatter_of,
    lost_airlight_of,
    lost_orders,
    where_air_scatters,
)
from twin.camera.chain import Chain
from twin.camera.effects import decisions_on_effects
from twin.camera.equal_paths import sun_light, sun_shape, unseen_sun, with_light
from twin.camera.left_out import (
    bounces_share,
    lie_in_a_plane,
    rounding_share,
    typical_reflectance,
)
from twin.camera.light_within import with_light_within, with_sun_within
from twin.camera.mounting import check_rig, light_problem, with_near_pupil
from twin.camera.render_warnings import (
    forward_scattering_warnings,
    grazing_warnings,
    lost_airlight_warnings,
    lost_orders_warnings,
    near_pupil_warnings,
    truncation_warnings,
    undersampling_warnings,
)
from twin.camera.rendered import DetectorLight, RenderedLight
from twin.camera.truth import Truth, incidence_cosines, render_truth
from twin.fidelity import Fidelity
from twin.optics.direct_sunlight import direct_sunlight
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.progress import OpenStage, silently
from twin.scene import Scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]

#: Share of the light that bounces bring which no path has.
_NOTHING = 1e-12


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
    sun_chain: Chain | None = None,
) -> RenderedLight:
    """Render a scene for a system; ``mesh_scene`` is `mitsuba_scene(scene)`, if already built.

    ``sun_chain``: to its noise a tolerance refers for the sun's light; default: the system's own.
    """
    check_rig(scene, system)
    with stage("scene"):
        problem = light_problem(scene, system, mesh_scene)
    with stage("truth"):
        truth = render_truth(problem.scene, problem.emitter, system.image_shape)
    chain = Chain.of(system, scene.sun)
    rendered = render_light(
        problem, chain, truth, fidelity, seed.spawn(2), stage=stage, sun_chain=sun_chain
    )
    cosines = incidence_cosines(problem.scene, rendered.emitter, truth.albedo.shape)
    left_out = rendered.light.left_out + _left_out(scene, system, rendered, cosines, fidelity)
    lost_sun = lost_airlight_of(problem, rendered.sun.shape)
    told: list[CaptureWarning] = []
    if chain.sky.illuminance_lx:
        told = lost_airlight_warnings(lost_sun, rendered.sun)
    return replace(
        rendered,
        light=replace(rendered.light, left_out=left_out),
        sun_left_out=_sun_left_out(scene, rendered, fidelity) + lost_sun,
        warnings=(
            *rendered.warnings,
            *_uncertain(scene, problem, rendered, cosines, fidelity),
            *told,
        ),
    )


def _left_out(
    scene: Scene, system: System, rendered: RenderedLight, cosines: Array, fidelity: Fidelity
) -> Array:
    """Bound of what the render leaves out of each cell: bounces, and rounding of rays. A detector
    that follows the lit cell is lit by the first bounce.
    """
    light, n_detectors = rendered.light, len(rendered.light.cells)
    shares = np.stack(np.hsplit(rounding_share(cosines), n_detectors)).reshape(n_detectors, -1)
    if not system.optics.is_scanned:
        by_chance = fidelity.has_light_tolerance and rendered.paths is None and n_detectors == 1
        indirect = light.indirect_share if n_detectors == 1 else None
        shares = shares + _beyond(scene, rendered, fidelity, indirect, by_chance=by_chance)
    # An unbounded share of nothing is nothing.
    return np.multiply(shares, light.cells, out=np.zeros_like(light.cells), where=light.cells > 0)


def _sun_left_out(scene: Scene, rendered: RenderedLight, fidelity: Fidelity) -> Array | float:
    """The same of each part of the sun's light, without rounding; to a tolerance besides what the
    render says.
    """
    share = _beyond(scene, rendered, fidelity, None, by_chance=fidelity.has_light_tolerance)
    if not share:
        return rendered.sun_left_out
    beyond = np.multiply(
        share, rendered.sun, out=np.zeros_like(rendered.sun), where=rendered.sun > 0
    )
    return np.asarray(beyond + rendered.sun_left_out)


def _beyond(
    scene: Scene,
    rendered: RenderedLight,
    fidelity: Fidelity,
    indirect: float | None,
    *,
    by_chance: bool,
) -> float:
    """Light of bounces beyond the largest number, as `bounces_share`; ``by_chance``: bounces end
    so, nearly all of them before that.
    """
    max_depth = fidelity.quality.most_bounces if by_chance else fidelity.max_depth
    reflectance = typical_reflectance(scene.objects, rendered.truth.albedo)
    share = bounces_share(reflectance, float(max_depth), indirect)
    if by_chance and share <= _NOTHING:
        return 0.0
    return 0.0 if lie_in_a_plane(item.vertices_m for item in scene.objects) else share


def _uncertain(
    scene: Scene,
    problem: LightProblem,
    rendered: RenderedLight,
    cosines: Array,
    fidelity: Fidelity,
) -> tuple[CaptureWarning, ...]:
    light, truth, emitter = rendered.light, rendered.truth, rendered.emitter
    shape = truth.albedo.shape
    # Cells of a line sensor's detectors, side by side, are the cells of the image.
    image = np.hstack(list(light.cells.reshape(len(light.cells), shape[0], -1)))
    samples, max_depth = float(fidelity.samples), float(fidelity.max_depth)
    by_chance = fidelity.has_light_tolerance and rendered.paths is None and len(light.cells) == 1
    if fidelity.has_light_tolerance:  # what paths miss is in the stated error
        samples = math.inf
    if by_chance:
        max_depth = fidelity.quality.most_bounces
    scattering: list[CaptureWarning] = []
    if not fidelity.has_light_tolerance:  # else a decision tells of light that the air scatters
        nearest_m = float(truth.depth_m.min())
        scattering = forward_scattering_warnings(problem.air, nearest_m, fidelity.air_orders)
    return (
        *undersampling_warnings(scene, emitter, image.size * samples),
        *grazing_warnings(image, cosines),
        *near_pupil_warnings(image, cosines, truth.depth_m, emitter, rendered.detector),
        *truncation_warnings(
            light.indirect_share,
            typical_reflectance(scene.objects, truth.albedo),
            max_depth,
            by_chance=by_chance,
        ),
        *scattering,
    )


def render_light(
    problem: LightProblem,
    chain: Chain,
    truth: Truth,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
    *,
    sun_quality: TracingQuality | None = None,
    sun_problem: LightProblem | None = None,
    sun_chain: Chain | None = None,
    stage: OpenStage = silently,
) -> RenderedLight:
    """Light of emitter and sun, drawn from two seeds; air needs the truth's depth.

    ``chain``: of the system; to its noise a tolerance of the light refers, for the sun's light to
    that of ``sun_chain``, if it is given. ``sun_quality``:
    settings of the path tracer for the sun; default: those of ``fidelity``. ``sun_problem``: in
    place of the problem, where the parts of the sun's light have times of their own.
    """
    system = chain.system
    quality, sun_quality = (
        where_air_scatters(problem.air, truth.depth_m, q)
        for q in (fidelity.quality, sun_quality or fidelity.quality)
    )
    problem, sun_problem = (
        with_near_pupil(each, system, truth.depth_m) for each in (problem, sun_problem or problem)
    )
    first, second = (int(seed.generate_state(1)[0]) for seed in seeds)
    with stage("sun"):
        rendered = RenderedLight(
            _no_light(system), _no_sun(system), truth, problem.emitter, problem.detector
        )
        if fidelity.has_light_tolerance:
            rendered = with_sun_within(
                rendered, sun_problem, sun_chain or chain, fidelity, quality, second
            )
        else:
            sun = sun_light(sun_problem, sun_shape(system), quality=sun_quality, seed=second)
            rendered = replace(rendered, sun=sun.total, sun_error=sun.standard_error)
            if not sun.total.any():
                missed = unseen_sun(sun_problem, sun_shape(system), sun_quality)
                rendered = replace(rendered, sun_left_out=missed)
        direct = direct_sunlight(sun_problem, rendered.sun.shape)
        rendered = replace(rendered, sun=rendered.sun + direct)
        if problem.air:
            airlight = airlight_of(problem, rendered.sun.shape)
            rendered = replace(rendered, sun=rendered.sun + airlight)
    with stage("transport"):
        if fidelity.has_light_tolerance:
            rendered = with_light_within(rendered, problem, chain, fidelity, quality, first)
        else:
            rendered = with_light(rendered, problem, system, quality, first, fidelity.start)
    began_s = time.perf_counter()
    lost = 0.0
    if problem.air:
        with stage("air"):
            lost = lost_orders(problem, truth, rendered.light.cells, quality.air_orders)
            beyond = rendered.light.left_out + lost * rendered.light.cells
            backscatter = backscatter_of(system, problem)
            cells = rendered.light.cells + backscatter.light
            light = replace(rendered.light, cells=cells, left_out=beyond)
            rendered = replace(rendered, light=light, backscatter=backscatter)
    if not fidelity.has_light_tolerance:
        warnings = lost_orders_warnings(lost, quality.air_orders)
        return replace(rendered, warnings=(*rendered.warnings, *warnings))
    cost_s = time.perf_counter() - began_s
    further = decisions_on_effects(rendered, problem, chain, fidelity, cost_s, lost)
    return replace(rendered, decisions=(*rendered.decisions, *further))


def _no_light(system: System) -> DetectorLight:
    n_cells = system.emitter.rows.value * system.emitter.columns.value
    return DetectorLight(*np.zeros((2, system.n_detectors, n_cells)))


def _no_sun(system: System) -> Array:
    return np.zeros(sun_shape(system))
