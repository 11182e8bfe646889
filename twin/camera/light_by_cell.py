"""A frame in which things move, of one detector: each cell, and the sun, is followed at as many
instants as its light needs.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain
from twin.camera.equal_paths import SUNLIT, sun_shape
from twin.camera.exposure_noise import lit_share
from twin.camera.frozen import CountChange
from twin.camera.light_at_instants import LightAtInstants, finest_s
from twin.camera.light_within import INDIRECT, SUN_INDIRECT
from twin.camera.motion import WorldInMotion
from twin.camera.mounting import light_problem, with_near_pupil
from twin.camera.permitted_error import PermittedError
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity
from twin.optics.adaptive import LEFT_OUT
from twin.optics.direct_sunlight import direct_sunlight
from twin.optics.light_over_time import light_over_time
from twin.optics.path_drawing import Effort, Part
from twin.optics.paths import SunLight
from twin.optics.problem import LightProblem
from twin.optics.tracer import Tracer
from twin.scene import Scene
from twin.scene.texture import Texture

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

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


def light_by_cell(
    world: WorldInMotion,
    chain: Chain,
    problem: LightProblem,
    rendered: RenderedLight,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
    change: CountChange,
) -> LightAtInstants:
    """Of one detector: each cell at as many instants as its light needs."""
    system, (first, second) = chain.system, (int(s.generate_state(1)[0]) for s in seeds)
    shape, noise_w, tolerance = system.image_shape, change.noise_w, fidelity.motion_tolerance or 0.0
    small = change.of_light(world.duration_s) * math.sqrt(2) / tolerance
    if small <= 1:
        ends, cells_w = np.array([0.0, world.duration_s]), chain.powers(rendered).cells_w
        still = np.repeat(cells_w[None], 2, axis=0)
        sun = _sun(world, change, chain, problem, rendered, fidelity, second)
        return LightAtInstants(ends, still, *sun[:2], math.hypot(small, sun[2]) / math.sqrt(2))
    times = change.first_instants(world.duration_s, tolerance, change.of_light)
    problem = with_near_pupil(problem, system, np.array([change.seen.nearest_m]))
    watt = chain.watts_of(rendered)[0]
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
        changes,
        Effort(
            _limit(fidelity, noise, rendered) if fidelity.has_light_tolerance else fidelity.samples,
            tolerance / math.sqrt(2) * noise,
            finest_s(chain),
            system.acquisition.integration_time_s.value,
            lambda light: _noise_growth(chain, light @ watt, rendered, noise_w),
            lit_share=lit_share(chain),
            overlooked=partial(
                world.overlooked, emitter=problem.emitter, detector=problem.detector, shape=shape
            ),
            many_edges=_texture_moves(world.scene),
        ),
    )
    sun = _sun(world, change, chain, problem, rendered, fidelity, second)
    cells_w = (watt * found.light)[:, None, None]
    error = math.hypot(found.motion_error, sun[2]) / math.sqrt(2)
    if fidelity.has_light_tolerance:
        permitted = _limit(fidelity, noise, rendered)
    else:
        permitted = tolerance / math.sqrt(2) * noise
    paths_w = found.path_error * (permitted * watt)[None]
    return LightAtInstants(found.times_s, cells_w, *sun[:2], error, found.path_error, paths_w)


def _texture_moves(scene: Scene) -> bool:
    """Whether a texture moves before the camera."""
    return any(
        isinstance(item.reflectance, Texture) and (item.moves or scene.rig.moves)
        for item in scene.objects
    )


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
    parts = [Part(lambda tracer, rays: (tracer.direct(rays).value, int(by_chance)), 1.7)]
    if indirect:
        trace = Tracer.all_indirect if by_chance else _fixed_indirect
        parts.append(Part(trace, 1.0, True, *_INDIRECT, everywhere=True))
    return parts


def _fixed_indirect(tracer: Tracer, rays: Any) -> tuple[Any, int]:
    """Indirect light of as many bounces as are set, whose rays are not counted."""
    return tracer.indirect(rays), 0


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
            finest_s(chain),
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
