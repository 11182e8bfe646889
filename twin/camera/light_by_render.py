"""A frame in which things move, of line sensors, time of flight and air: all light is rendered at
as many instants as are needed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain
from twin.camera.exposure_noise import lit_share
from twin.camera.frozen import CountChange
from twin.camera.light import render_light
from twin.camera.light_at_instants import LightAtInstants, finest_s
from twin.camera.motion import WorldInMotion
from twin.camera.mounting import light_problem
from twin.camera.truth import Truth, depths
from twin.fidelity import Fidelity
from twin.optics.problem import LightProblem

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Instants from which on no interval is halved any more; the middles of those that are left are
#: rendered once more, all in all at fewer than twice as many.
_MOST_RENDERS = 32


def light_by_render(
    world: WorldInMotion,
    chain: Chain,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
    change: CountChange,
) -> LightAtInstants:
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
    shortest_s = finest_s(chain)
    opened = [(i, i + 1) for i in range(len(times) - 1)]
    while opened:
        one, other = opened.pop()
        middle = (times[one] + times[other]) / 2
        here = _rendered_at(world, chain, whole, fidelity, seeds, middle)
        times.append(middle)
        found.append(here)
        off = here.off(found[one], found[other], share, 1 / noise_w**2)
        if off > permitted and middle - times[one] > shortest_s and len(times) < _MOST_RENDERS:
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
    paths_w = np.max([here.error_w for here in found], axis=0)
    return LightAtInstants(at, cells_w, at, sun_w, error, paths_error_w=paths_w)


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
