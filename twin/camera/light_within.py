"""Light of a system to a tolerance: paths where they are needed, effects where they matter."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain
from twin.camera.equal_paths import of_bucket, sun_shape, with_light
from twin.camera.permitted_error import PermittedError
from twin.camera.render_warnings import tolerance_warnings
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity
from twin.optics.adaptive import LEFT_OUT, gather_within
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem

Array = NDArray[np.float64]
#: Error of the image's noise by the sun's light, over that which light may be off by.
_SUN_SHARE = 0.025
#: Relative error of the sun's light at most: noise is then linear in it.
_MOST_OF_SUN = 0.1
#: Paths of a cell where all cells have the same number: to begin with, and at most.
FIRST_SAMPLES, _MOST_SAMPLES = 4, 1024


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

    found = gather_within(tracer, limit, problem.corners, problem.largest_indirect(tracer))
    light = replace(of_bucket(found.light), left_out=found.left_out)
    over = _rms(light.error / permitted.of(light.cells))
    decision = permitted.decision(
        "indirect light", found.indirect_over, LEFT_OUT, found.indirect_taken, found.cost_s
    )
    return replace(
        rendered,
        light=light,
        warnings=tolerance_warnings(over, permitted),
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
    system, samples, taken = chain.system, FIRST_SAMPLES, True
    largest = problem.largest_indirect(problem.from_emitter(system.image_shape, quality, seed))
    while True:
        quality = replace(quality, samples=samples, indirect_samples=None)
        lit = with_light(rendered, problem, system, quality, seed, fidelity.start)
        permitted = PermittedError(chain, lit, fidelity)
        limit = permitted.of(lit.light.cells)
        over, indirect = _rms(lit.light.error / limit), largest * _rms(1 / limit)
        if over <= 1 or samples >= _MOST_SAMPLES:
            break
        if indirect <= LEFT_OUT:
            quality, taken = replace(quality, max_depth=1), False
        # Their number by its square root; the error falls as their number to the power -0.75.
        side = math.isqrt(samples) * min(max(1.1 * over ** (2 / 3), 1.4), 4.0)
        samples = min(math.ceil(side) ** 2, _MOST_SAMPLES)
    decision = permitted.decision("indirect light", indirect, LEFT_OUT, taken, math.nan)
    return replace(
        lit,
        light=replace(lit.light, left_out=0.0 if taken else largest),
        warnings=tolerance_warnings(over, permitted),
        decisions=(*rendered.decisions, decision),
    )


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
    shape = sun_shape(system.n_detectors)
    tracer = problem.from_sun(shape, quality, seed)
    permitted = PermittedError(chain, rendered, fidelity)
    parts = rendered.sun.size if system.n_detectors == 1 else shape[0]
    together = (0, 1) if system.n_detectors == 1 else 0

    def limit(light: Array) -> Array:
        total = light.sum(axis=together, keepdims=True)
        share = permitted.sun_share(np.broadcast_to(total / parts, light.shape))
        relative = min(2 * _SUN_SHARE * permitted.tolerance / max(share, 1e-30), _MOST_OF_SUN)
        return np.broadcast_to(relative * total / math.sqrt(parts), light.shape)

    # What is left out is off the same way in all parts, whose paths err independently.
    largest = problem.largest_indirect(tracer) * math.sqrt(parts)
    found = gather_within(tracer, limit, largest_indirect=largest)
    decision = permitted.decision(
        "the sun's indirect light, by its shot noise",
        found.indirect_over * _SUN_SHARE,
        LEFT_OUT * _SUN_SHARE,
        found.indirect_taken,
        found.cost_s,
    )
    return replace(rendered, sun=found.light.total, decisions=(*rendered.decisions, decision))


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))
