"""Light of a system to a tolerance: paths where they are needed, effects where they matter."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain
from twin.camera.equal_paths import MISSED, SUNLIT, of_bucket, sun_shape, with_light
from twin.camera.permitted_error import SUN_SHARE, PermittedError
from twin.camera.render_warnings import sun_warnings, tolerance_warnings
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity
from twin.optics.adaptive import LEFT_OUT, gather_within
from twin.optics.paths import RAYS, TracingQuality
from twin.optics.problem import LightProblem

Array = NDArray[np.float64]
#: Effects that a decision is about.
INDIRECT, SUN_INDIRECT = "indirect light", "the sun's indirect light, by its shot noise"
#: Paths of a cell where all cells have the same number: to begin with, and at most with the usual
#: number of rays, unless all cells together have fewer than so many, times their bounces.
_FIRST_SAMPLES, _MOST_SAMPLES, _FEW_PATHS = 4, 1024, 2**22
#: Of all rays, those for the sun's light.
_OF_SUN = 0.25


def with_light_within(
    rendered: RenderedLight,
    problem: LightProblem,
    chain: Chain,
    fidelity: Fidelity,
    quality: TracingQuality,
    seed: int,
) -> RenderedLight:
    """The same with the emitter's light. Of one detector without time of flight each cell has as
    many paths as it needs; else all have the same number, until their error is small enough.
    """
    system = chain.system
    if system.n_detectors > 1 or system.time_of_flight:
        return _equally(rendered, problem, chain, fidelity, quality, seed)
    tracer, permitted = (
        problem.from_emitter(system.image_shape, quality, seed),
        PermittedError(chain, rendered, fidelity),
    )

    def limit(cells: Array) -> Array:
        return permitted.of(cells.reshape(1, -1)).reshape(system.image_shape)

    def limit_of_alike(cells: Array) -> Array:
        return permitted.of_alike(cells.reshape(1, -1)).reshape(system.image_shape)

    found = gather_within(
        tracer,
        limit,
        problem.facet_light(system.image_shape),
        problem.largest_indirect(tracer),
        permitted_alike=limit_of_alike,
        ray_share=1 - _OF_SUN,
    )
    light = replace(of_bucket(found.light), left_out=found.left_out)
    return _told(
        replace(rendered, light=light),
        permitted,
        found.indirect_over,
        taken=found.indirect_taken,
        cost_s=found.cost_s,
    )


def _told(
    rendered: RenderedLight,
    permitted: PermittedError,
    indirect_over: float,
    *,
    taken: bool,
    cost_s: float = math.nan,
) -> RenderedLight:
    """The same with a warning of an error beyond the permitted one, and the decision on indirect
    light, whose bound is ``indirect_over`` the permitted error.
    """
    (cells, _), over = permitted.collected(rendered.light), permitted.over(rendered.light)
    tolerance = permitted.tolerance_of(cells)
    decision = permitted.decision(
        "indirect light", (indirect_over, LEFT_OUT), tolerance, taken, cost_s
    )
    return replace(
        rendered,
        warnings=(*rendered.warnings, *tolerance_warnings(over, permitted, cells)),
        decisions=(*rendered.decisions, decision),
    )


def _equally(
    rendered: RenderedLight,
    problem: LightProblem,
    chain: Chain,
    fidelity: Fidelity,
    quality: TracingQuality,
    seed: int,
) -> RenderedLight:
    system, samples, taken = chain.system, _FIRST_SAMPLES, True
    most = _most_samples(rendered, quality)
    largest = problem.largest_indirect(problem.from_emitter(system.image_shape, quality, seed))
    largest *= system.receiver_share
    while True:
        quality = replace(quality, samples=samples, indirect_samples=None)
        lit = with_light(rendered, problem, system, quality, seed, fidelity.start)
        permitted = PermittedError(chain, lit, fidelity)
        over, (cells, _) = permitted.over(lit.light), permitted.collected(lit.light)
        # It may come when the shutters collect the most.
        indirect = largest * chain.largest_share * _rms(1 / permitted.of_alike(cells))
        taken = taken and not system.optics.is_scanned
        if over <= 1 or samples >= most:
            break
        if indirect <= LEFT_OUT:
            quality, taken = replace(quality, max_depth=1), False
        # Their number by its square root; the error falls as their number to the power -0.75.
        side = math.isqrt(samples) * min(max(1.1 * over ** (2 / 3), 1.4), 4.0)
        samples = min(math.ceil(side) ** 2, most)
    left_out = 0.0 if taken else largest
    lit = replace(lit, light=replace(lit.light, left_out=left_out))
    return _told(lit, permitted, indirect, taken=taken)


def _most_samples(rendered: RenderedLight, quality: TracingQuality) -> int:
    """Paths of each cell at most, a square number: each cell of each detector has as many, and all
    of them as many bounces.
    """
    per_cell = 1 / rendered.light.cells.size / quality.max_depth
    usual = max(_MOST_SAMPLES, _FEW_PATHS * per_cell) * max(1.0, quality.rays / RAYS)
    most = min((1 - _OF_SUN) * quality.rays * per_cell, usual)
    return max(math.isqrt(int(most)) ** 2, _FIRST_SAMPLES)


def with_sun_within(
    rendered: RenderedLight,
    problem: LightProblem,
    chain: Chain,
    fidelity: Fidelity,
    quality: TracingQuality,
    seed: int,
) -> RenderedLight:
    """The same with the sun's light, to an error of each detector's sum: what the sun adds to an
    image is its shot noise.
    """
    system = chain.system
    shape = sun_shape(system)
    tracer = problem.from_sun(shape, quality, seed)
    permitted = PermittedError(chain, rendered, fidelity)
    one = system.n_detectors == 1
    parts, largest = rendered.sun.size if one else shape[0], SUNLIT * tracer.largest_weight
    if system.optics.is_scanned:  # each part is the whole sun of an exposure
        parts = parts**2

    def limit(light: Array) -> Array:
        error = permitted.sun_error(light, largest)
        return np.broadcast_to(error / math.sqrt(parts), light.shape)

    # What is left out is off the same way in all parts, whose paths err independently.
    largest_indirect = problem.largest_indirect(tracer)
    indirect = largest_indirect * math.sqrt(parts)
    # Where no path met the sun, as many that what all of them miss is too little to matter.
    least = float(permitted.sun_error(np.zeros(shape), largest).min(initial=math.inf))
    paths = MISSED * rendered.sun.size * largest / least if least else math.inf
    found = gather_within(
        tracer, limit, largest_indirect=indirect, in_the_dark=paths, ray_share=_OF_SUN
    )
    # Where light is without limit, any error is within it.
    over = _rms(found.light.standard_error / np.maximum(limit(found.light.total), 1e-150))
    decision = permitted.decision(
        SUN_INDIRECT,
        (found.indirect_over * SUN_SHARE, LEFT_OUT * SUN_SHARE),
        permitted.tolerance,
        found.indirect_taken,
        found.cost_s,
    )
    return replace(
        rendered,
        sun=found.light.total,
        sun_error=found.light.standard_error,
        sun_left_out=MISSED * largest * found.unseen
        + (0.0 if found.indirect_taken else largest_indirect),
        warnings=(*rendered.warnings, *sun_warnings(over)),
        decisions=(*rendered.decisions, decision),
    )


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))
