"""Light of a frame in which things move: every exposure sees the world at its own time."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.camera.chain import Chain
from twin.camera.equal_paths import sun_shape
from twin.camera.exposure_noise import lit_share
from twin.camera.exposures import Exposures
from twin.camera.frozen import CountChange, count_change
from twin.camera.illumination import mean_signal
from twin.camera.light import render_light
from twin.camera.light_within import INDIRECT, SUN_INDIRECT, SUNLIT
from twin.camera.motion import WorldInMotion
from twin.camera.mounting import light_problem, with_near_pupil
from twin.camera.permitted_error import PermittedError
from twin.camera.rendered import RenderedLight
from twin.camera.scanned_frame import TIMES, scanned_light
from twin.camera.truth import Truth, depths
from twin.fidelity import Fidelity
from twin.optics.adaptive import LEFT_OUT
from twin.optics.direct_sunlight import direct_sunlight
from twin.optics.light_over_time import Effort, Part, light_over_time
from twin.optics.paths import SunLight
from twin.optics.problem import LightProblem
from twin.scene import Pose, Scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Instants whose signals are computed at once.
_AT_ONCE = 32
#: Shortest interval between instants, over an exposure's integration.
_FINEST = 1 / 8
#: What the sun's light is off by from instant to instant, over what its paths err by: those of
#: neighbouring instants are alike (in the yard; few instants tell it badly).
_OF_PATHS = 0.25
#: Instants at most at which all light is rendered.
_MOST_RENDERS = 32
#: Of indirect light, which has no edges and whose paths cost more: first instants that one is
#: enough of, and weights of its squared errors over those of direct light.
_INDIRECT = (4, 3.0, 3.0)
#: Paths of a set in a part of the sun's light to begin with, at least and at most, and over the
#: square of `CountChange.sun_range`: instants err apart by what moves, by some 0.5 of a count's
#: noise on the yard in full sun and by 0.02 from one exposure to the next in `crossing` at dusk.
_SUN_FIRST, _SUN_MOST, _SUN_OF_RANGE = 4, 32, 0.03
#: Of how many first instants one is enough for it: edges change the sum of the field, which alone
#: counts, less than single cells, and at instants in between paths would only err apart.
_SUN_STEP = 4
#: Of a count, what its noise is at least: a full well of 1e8 electrons.
_EXACT = 1e-4
#: Error of paths over what is permitted above which a warning is given; it is an estimate.
_FEW_PATHS = 1.5


@dataclass(frozen=True, eq=False)
class FrameLight:
    """Mean powers on the detectors in every exposure of a frame, W, (n_exposures, n_shutters,
    n_detectors): of the patterns, and of the sun while a shutter is open; None where motion changes
    counts by less than the tolerance, so that the light of the middle is that of all exposures.
    ``decision``: at how many instants light was rendered, and what interpolation may be off by.
    ``pose``: the rig's at the start. ``sun_scatter``: what the sun's light is off by from instant
    to instant, between exposures that are compared, over their noise.
    """

    signal_w: Array | None
    sun_w: Array | None
    pose: Pose
    decision: Decision
    warnings: tuple[CaptureWarning, ...] = ()
    sun_scatter: float = 0.0


def world_in_motion(scene: Scene, system: System, fidelity: Fidelity) -> WorldInMotion | None:
    """The world during a frame that begins with a scene; None where nothing moves in it, or is to.

    Raises InputError for a trajectory that ends before the frame does.
    """
    if fidelity.motion_tolerance is None or (scene.at_rest and not scene.rig.moves):
        return None
    world = WorldInMotion(scene, Exposures.of(system).duration_s)
    return None if world.is_at_rest else world


def frame_light(
    world: WorldInMotion,
    chain: Chain,
    rendered: RenderedLight,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
) -> FrameLight:
    """Light of all exposures of a frame.

    ``rendered``: light in the middle of the frame. To its noise the tolerances refer, and of it are
    the angles at which light meets the filter.
    """
    start, scene, system = time.perf_counter(), world.scene, chain.system
    tolerance, change = fidelity.motion_tolerance or 0.0, count_change(world, chain, rendered)

    def decided(effect: str, off: float, *, taken: bool) -> Decision:
        cost_s = time.perf_counter() - start if taken else math.nan
        unit = "of an exposure's noise"
        return Decision("camera", effect, off, tolerance, unit, taken, cost_s)

    whole = change.within(world.duration_s)
    if whole <= tolerance:
        decision = decided("motion within a frame", whole, taken=False)
        return FrameLight(None, None, scene.rig.pose, decision)
    problem = light_problem(scene, system, world)
    exposures = Exposures.of(system)
    if system.optics.is_scanned and problem.air is None:
        signal_w, sun_w = scanned_light(world, chain, problem, fidelity, seeds)
        # Of a mean of as many times, where light has a kink between two of them.
        off = change.within(exposures.integration_s) / (8 * TIMES**2)
        effect = f"motion within a frame, each cell at {TIMES} times of its own"
        decision = decided(effect, off, taken=True)
        return FrameLight(signal_w, sun_w, scene.rig.pose, decision)
    one_bucket = system.n_detectors == 1 and not system.time_of_flight
    if one_bucket and problem.air is None:
        light = _by_cell(world, chain, problem, rendered, fidelity, seeds, change)
    else:
        light = _by_render(world, chain, fidelity, seeds, change)
    signal_w, sun_w = light.exposed(chain, exposures)
    effect = f"motion within a frame, {light.n_instants} instants"
    if light.path_error and not fidelity.has_light_tolerance:
        # Over what is permitted to the emitter's light, half of all.
        error = light.path_error * tolerance / math.sqrt(2)
        effect += f"; besides, {fidelity.samples} paths of a cell err by up to {error:.2g}"
    decision = decided(effect, light.motion_error * tolerance, taken=True)
    # Of exposures that are compared.
    compared = 1.0
    if system.acquisition.mode.value == "differential":
        # An exposure and the next, between two instants of the sun's light.
        interval_s = world.duration_s / max(len(light.sun_times_s) - 1, 1)
        compared = min(system.acquisition.pattern_period_s.value / interval_s, 1.0)
    seen, by_paths = compared * light.sun_scatter_w, 0.0
    if np.ptp(light.sun_w) > 0:
        by_paths = compared * _OF_PATHS * float(chain.powers(rendered).sun_error_w.max())
    warnings = _warnings(light, seen / change.noise_w, tolerance, fidelity)
    scatter = math.hypot(seen, by_paths) / change.noise_w
    return FrameLight(signal_w, sun_w, scene.rig.pose, decision, warnings, scatter)


def _warnings(
    light: "_Light", sun_scatter: float, tolerance: float, fidelity: Fidelity
) -> tuple[CaptureWarning, ...]:
    """``sun_scatter``: of the sun's light between exposures that are compared, over their noise."""
    found = []
    if sun_scatter > tolerance:
        text = (
            f"the sun's light scatters by {sun_scatter:.2g} of an exposure's noise between "
            f"instants, {tolerance:g} permitted: by what moves in the sun, or what paths err by; a "
            "differential mode takes it out"
        )
        found.append(CaptureWarning("tolerance", text))
    if fidelity.has_light_tolerance and light.path_error > _FEW_PATHS:
        text = (
            f"paths of light of some instants err by {light.path_error:.2g} times what is "
            "permitted: fidelity.light_tolerance"
        )
        found.append(CaptureWarning("tolerance", text))
    if light.motion_error <= 1:
        return tuple(found)
    return (
        *found,
        CaptureWarning(
            "tolerance",
            f"light between instants is off by up to {light.motion_error * tolerance:.2g} of an "
            f"exposure's noise, {tolerance:g} permitted: what moves is too fast for as many "
            "instants as are rendered: fidelity.motion_tolerance",
        ),
    )


@dataclass(frozen=True, eq=False)
class _Light:
    """Powers of cells at instants, (n, n_shutters, n_detectors, n_cells), and of the sun at its own
    ones, (m, n_detectors), of a scanner (m, n_patterns, 1, n_detectors), W.
    """

    times_s: Array
    cells_w: Array
    sun_times_s: Array
    sun_w: Array
    motion_error: float
    path_error: float = 0.0

    @property
    def sun_scatter_w(self) -> float:
        """Root mean square of what the sun's light at each instant is off its neighbours' by, as
        independent errors of all of them; kinks in time count as well.
        """
        if len(self.sun_times_s) < 3 or self.sun_w.ndim != 2:
            return 0.0
        before, at, after = (self.sun_times_s[i : len(self.sun_times_s) - 2 + i] for i in range(3))
        share = ((at - before) / (after - before))[:, None]
        between = (1 - share) * self.sun_w[:-2] + share * self.sun_w[2:]
        off2 = np.square(self.sun_w[1:-1] - between) / (1 + share**2 + (1 - share) ** 2)
        return float(np.sqrt(off2.mean(axis=0).max()))

    @property
    def n_instants(self) -> int:
        """At which light of the emitter, or of the sun, was rendered."""
        return len(np.union1d(self.times_s, self.sun_times_s))

    def exposed(self, chain: Chain, exposures: Exposures) -> tuple[Array, Array]:
        """Mean signal and sunlight of every exposure, (n_exposures, n_shutters, n_detectors)."""
        n_shutters, n_detectors = len(chain.shutters), chain.system.n_detectors
        shape = (-1, n_shutters, n_detectors)
        weights = exposures.means(self.times_s).tocsc()
        signal = np.zeros((len(exposures.starts_s), n_detectors))
        for first in range(0, len(self.times_s), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            # Instants beside each other, like detectors.
            cells = np.moveaxis(self.cells_w[some], 0, 1).reshape(
                n_shutters, -1, self.cells_w.shape[-1]
            )
            each = mean_signal(chain.system, cells).reshape(len(signal), -1, n_detectors)
            part = weights[:, some].tocoo()
            np.add.at(signal, part.row, part.data[:, None] * each[part.row, part.col])
        means = exposures.means(self.sun_times_s)
        if self.sun_w.ndim == 2:
            sun = means @ self.sun_w
        else:
            each = np.broadcast_to(self.sun_w, (len(self.sun_w), *signal.reshape(shape).shape))
            sun = np.einsum("km,mkd->kd", means.toarray(), each.reshape(len(each), *signal.shape))
        return signal.reshape(shape), sun.reshape(shape)


def _by_cell(
    world: WorldInMotion,
    chain: Chain,
    problem: LightProblem,
    rendered: RenderedLight,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
    change: CountChange,
) -> _Light:
    """Of one detector: each cell at as many instants as its light needs."""
    system, (first, second) = chain.system, (int(s.generate_state(1)[0]) for s in seeds)
    shape, noise_w, tolerance = system.image_shape, change.noise_w, fidelity.motion_tolerance or 0.0
    small = change.of_light(world.duration_s) * math.sqrt(2) / tolerance
    if small <= 1:
        ends, cells_w = np.array([0.0, world.duration_s]), chain.powers(rendered).cells_w
        still = np.repeat(cells_w[None], 2, axis=0)
        sun = _sun(world, change, chain, problem, rendered, fidelity, second)
        return _Light(ends, still, *sun[:2], math.hypot(small, sun[2]) / math.sqrt(2))
    times = change.first_instants(world.duration_s, tolerance, change.of_light)
    problem = with_near_pupil(problem, system, np.array([change.seen.nearest_m]))
    ones = np.ones_like(rendered.light.cells)
    lit = replace(rendered.light, cells=ones, error=ones)
    watt = chain.powers(replace(rendered, light=lit)).error_w[0]
    # As errors of the lit cells add up in a count, of all cells alike.
    with np.errstate(divide="ignore"):
        noise = noise_w / math.sqrt(max(lit_share(chain), 1e-12) * watt.size) / watt
    parts = _traced(world, chain, _limit(fidelity, noise, rendered), rendered, fidelity)
    tracer = problem.from_emitter(shape, fidelity.quality, first)
    changes = world.changes(times, problem.emitter, problem.detector, shape)
    found = light_over_time(
        lambda at: replace(tracer, scene=world.scene_at(at)),
        parts,
        times,
        changes if len(parts) == 1 else np.ones_like(changes),
        Effort(
            _limit(fidelity, noise, rendered) if fidelity.has_light_tolerance else fidelity.samples,
            tolerance / math.sqrt(2) * noise,
            _finest(chain),
            system.acquisition.integration_time_s.value,
            lambda light: _noise_growth(chain, light @ watt, rendered, noise_w),
            lit_share=lit_share(chain),
            overlooked=partial(
                world.overlooked, emitter=problem.emitter, detector=problem.detector, shape=shape
            ),
        ),
    )
    sun = _sun(world, change, chain, problem, rendered, fidelity, second)
    cells_w = (watt * found.light)[:, None, None]
    error = math.hypot(found.motion_error, sun[2]) / math.sqrt(2)
    return _Light(found.times_s, cells_w, *sun[:2], error, found.path_error)


def _noise_growth(chain: Chain, light_w: Array, rendered: RenderedLight, noise_w: float) -> Array:
    """Square of an exposure's noise over that in the middle of the frame, where all cells together
    give this light, W (n,): more light has more shot noise. No chain tells `_EXACT` of a count.
    """
    share = lit_share(chain)
    middle_w = float(chain.powers(rendered).cells_w.sum())
    shot = np.maximum(light_w - middle_w, 0) * share / chain.front_end.electrons_per_watt
    return np.asarray(1 + (shot + (_EXACT * share * light_w) ** 2) / noise_w**2)


def _limit(fidelity: Fidelity, noise: Array, rendered: RenderedLight) -> Array:
    """Error of each cell that finitely many paths may leave."""
    light, relative = rendered.light.cells[0], fidelity.light_tolerance_relative
    limit = np.full(light.shape, np.inf)
    if fidelity.light_tolerance is not None:
        limit = fidelity.light_tolerance * noise
    if relative is not None:
        limit = np.minimum(limit, relative * np.maximum(light, light.mean()))
    return limit


def _traced(
    world: WorldInMotion, chain: Chain, limit: Array, rendered: RenderedLight, fidelity: Fidelity
) -> list[Part]:
    """Parts of the emitter's light that are traced: direct light, and indirect light where it may
    matter at the frame's start, middle or end.
    """
    if not fidelity.has_light_tolerance:
        return _parts(fidelity.max_depth > 1, by_chance=False)
    over = 0.0
    for seconds in (0.0, world.duration_s):
        if _taken(rendered, INDIRECT):
            break
        problem = light_problem(world.scene.after(seconds), chain.system, world)
        tracer = problem.from_emitter(chain.system.image_shape, fidelity.quality, 0)
        bound = problem.largest_indirect(tracer)
        over = max(over, bound * math.sqrt(float(np.mean(1 / np.maximum(limit, 1e-150) ** 2))))
    return _parts(_taken(rendered, INDIRECT) or over > LEFT_OUT)


def _taken(rendered: RenderedLight, effect: str) -> bool:
    """Whether a render to a tolerance holds an effect."""
    return any(each.taken for each in rendered.decisions if each.effect == effect)


def _parts(indirect: bool, *, by_chance: bool = True) -> list[Part]:
    """Direct light, and indirect light whose paths end ``by_chance`` or after some bounces."""
    parts = [Part(lambda tracer, rays: tracer.direct(rays).value, 1.7)]
    if indirect and by_chance:
        further = Part(lambda tracer, rays: tracer.all_indirect(rays), 1.0, True, *_INDIRECT)
        parts.append(further)
    elif indirect:
        parts.append(Part(lambda tracer, rays: tracer.indirect(rays), 1.0, True, *_INDIRECT))
    return parts


def _sun(
    world: WorldInMotion,
    change: CountChange,
    chain: Chain,
    problem: LightProblem,
    rendered: RenderedLight,
    fidelity: Fidelity,
    seed: int,
) -> tuple[Array, Array, float]:
    """Instants, the sun's power at each, (n, 1), and its error between them over what is permitted.

    The sum of all parts of the field counts, so that they are followed together. To a tolerance
    what its paths err by, which is the same at neighbouring instants, may be what it is in a still
    frame: differences of exposures do not hold it.
    """
    shape, weight = sun_shape(chain.system), chain.sun_weight(rendered).ravel()
    if not weight.any():
        return np.array([0.0, world.duration_s]), np.zeros((2, 1)), 0.0
    tolerance = (fidelity.motion_tolerance or 0.0) / math.sqrt(2)
    with np.errstate(divide="ignore"):
        noise = change.noise_w / math.sqrt(weight.size) / weight
    tracer = problem.from_sun(shape, fidelity.quality, seed)
    limit: Array | int = fidelity.samples
    if fidelity.has_light_tolerance:
        largest = SUNLIT * tracer.largest_weight
        error = PermittedError(chain, rendered, fidelity).sun_error(rendered.sun, largest)
        limit = np.full(weight.size, float(error.min()) / math.sqrt(weight.size))
        wanted = np.clip(_SUN_OF_RANGE * change.sun_range**2, _SUN_FIRST, _SUN_MOST)
        first = 2 ** round(math.log2(wanted))
        parts = [replace(x, first=first) for x in _parts(_taken(rendered, SUN_INDIRECT))]
    else:
        parts = _parts(fidelity.max_depth > 1, by_chance=False)
    small = change.of_sun(world.duration_s) / tolerance
    if small <= 1:
        still = np.full((2, 1), float(weight @ rendered.sun.ravel()))
        return np.array([0.0, world.duration_s]), still, small
    times = change.first_instants(world.duration_s, tolerance, change.of_sun)
    # A shadow of as much area, where the nearest surface is, is worth what is permitted.
    least_m = change.seen.nearest_m * math.sqrt(tolerance * change.noise_w / float(weight.max()))

    def overlooked(first_s: Array, last_s: Array) -> Flags:
        passed = world.shadows_overlooked(first_s, last_s, least_m)
        return np.repeat(passed[:, None], weight.size, axis=1)

    found = light_over_time(
        lambda at: replace(
            tracer, scene=world.scene_at(at), light=SunLight(world.sun_directions(at))
        ),
        [replace(part, step=_SUN_STEP * part.step) for part in parts],
        times,
        np.ones((len(times) - 1, weight.size), dtype=bool),
        Effort(
            limit,
            tolerance * noise,
            _finest(chain),
            chain.system.acquisition.integration_time_s.value,
            together=True,
            overlooked=overlooked,
        ),
    )
    light = (found.light + _straight(world, problem, found.times_s, shape)) @ weight
    # What paths err by, the same at all instants, is that of the frame's middle.
    middle = np.interp(world.duration_s / 2, found.times_s, light)
    light = np.maximum(light + float(weight @ rendered.sun.ravel()) - middle, 0)
    return found.times_s, light[:, None], found.motion_error


def _finest(chain: Chain) -> float:
    """Shortest interval between instants."""
    return _FINEST * chain.system.acquisition.integration_time_s.value


def _straight(
    world: WorldInMotion, problem: LightProblem, times: Array, shape: tuple[int, int]
) -> Array:
    """Sunlight that comes straight from the sun, at instants, by part of the field (n, n_parts)."""
    scene, directions = world.scene_at(times), world.sun_directions(times)
    return np.array(
        [
            direct_sunlight(
                replace(problem, scene=scene.at(i), sun_direction=towards), shape
            ).ravel()
            for i, towards in enumerate(directions)
        ]
    )


def _by_render(
    world: WorldInMotion,
    chain: Chain,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
    change: CountChange,
) -> _Light:
    """Of line sensors, time of flight and air: all light at every instant, until the middles of
    intervals are what interpolation says.
    """
    system = chain.system
    whole = light_problem(world.scene, system, world)
    tolerance = fidelity.motion_tolerance or 0.0
    first = change.first_instants(world.duration_s, tolerance, change.within)
    # As many as leave room for the middles that say what is off.
    n_first = min(len(first), _MOST_RENDERS // 2)
    times: list[float] = np.linspace(0, world.duration_s, n_first).tolist()
    noise_w = change.noise_w
    found = [_rendered_at(world, chain, whole, fidelity, seeds, t) for t in times]
    share, worst = lit_share(chain) / noise_w**2, 0.0
    permitted = tolerance**2
    finest = _finest(chain)
    opened = [(i, i + 1) for i in range(len(times) - 1)]
    while opened:
        one, other = opened.pop()
        middle = (times[one] + times[other]) / 2
        here = _rendered_at(world, chain, whole, fidelity, seeds, middle)
        times.append(middle)
        found.append(here)
        off = here.off(found[one], found[other], share, 1 / noise_w**2)
        if off > permitted and middle - times[one] > finest and len(times) < _MOST_RENDERS:
            # The longest ones first, so that none is left out when there are enough.
            opened = [(one, len(times) - 1), (len(times) - 1, other), *opened]
        else:
            worst = max(worst, off)
    order = np.argsort(times)
    at = np.array(times)[order]
    cells_w, sun_w = (
        np.array([getattr(found[i], name) for i in order]) for name in ("cells_w", "sun_w")
    )
    error = math.sqrt(worst / permitted) if permitted else 0.0
    return _Light(at, cells_w, at, sun_w, error)


@dataclass(frozen=True, eq=False)
class _Render:
    """All light at an instant, as in `Powers`."""

    cells_w: Array
    error_w: Array
    sun_w: Array
    sun_error_w: Array

    def off(self, one: "_Render", other: "_Render", share: float, sun_share: float) -> float:
        """Squared error that is left beside this middle of two renders, in exposures: half of what
        it differs by from their mean, less what paths differ by.
        """
        further = self.cells_w - (one.cells_w + other.cells_w) / 2
        light = np.maximum(further**2 - 1.5 * self.error_w**2, 0).sum(axis=-1).max()
        further = self.sun_w - (one.sun_w + other.sun_w) / 2
        sun = np.maximum(further**2 - 1.5 * self.sun_error_w**2, 0).max()
        return float(share * light + sun_share * sun) / 4


def _rendered_at(
    world: WorldInMotion,
    chain: Chain,
    whole: LightProblem,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
    seconds: float,
) -> _Render:
    times = np.array([seconds])
    # Corners and bodies, of which bounds are made, stand where they are if the rig does not turn.
    later = (
        whole
        if world.turns
        else light_problem(world.scene.after(seconds), chain.system, whole.scene)
    )
    problem = replace(
        later,
        scene=world.scene_at(times).at(0),
        emitter=whole.emitter,
        detector=whole.detector,
        sun_direction=world.sun_directions(times)[0],
        corners=None if world.turns else later.corners,
        bodies=None if world.turns else later.bodies,
    )
    shape = chain.system.image_shape
    depth = depths(problem.scene, problem.emitter, shape)
    rendered = render_light(problem, chain, Truth(np.zeros(shape), depth), fidelity, seeds)
    power = chain.powers(rendered)
    sun_w = power.sun_by_exposure(chain.patterns)
    return _Render(power.cells_w, power.error_w, sun_w, power.sun_error_w)
