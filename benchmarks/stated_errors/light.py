"""Light: stated against true errors, and times against those of the cheapest sufficient knobs."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count

import numpy as np
from numpy.typing import NDArray

from benchmarks.stated_errors.choosing import Choosing
from benchmarks.stated_errors.judged import Cheapest, Judged
from benchmarks.stated_errors.light_cases import LightCase
from benchmarks.stated_errors.light_truth import Renderer
from benchmarks.timing import processor_time
from twin.camera.permitted_error import PermittedError
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity, Tolerance
from twin.trade.camera import CameraCase

Array = NDArray[np.float64]

#: Standard deviations within which 95 of 100 draws of a normal distribution lie.
_WITHIN_95 = 1.96
_DEPTHS, _SAMPLES = (1, 2, 4, 8, 16), tuple(4**power for power in range(7))
#: Per pixel of a render of the truth: of few paths all may miss a tiny facet, so that their scatter
#: tells nothing; how small the truth's error is to be over that stated, where time allows; and
#: renders whose scatter tells it.
_PATHS, _SMALL, _LEAST_RENDERS = 64, 0.2, 8


@dataclass(frozen=True, eq=False)
class _Truth:
    """Light (n_cells,) with its standard error; and the noise of each pixel in its unit."""

    light: Array
    error: Array
    noise: Array

    def over_noise(self, values: Array) -> float:
        """Root mean square over the cells, over the noise."""
        return float(np.sqrt(np.mean((values.ravel() / self.noise) ** 2)))

    def off(self, rendered: RenderedLight) -> Array:
        """Error of each cell, over its noise."""
        return np.asarray((rendered.light.cells.ravel() - self.light) / self.noise)

    def error_of(self, *rendered: RenderedLight) -> float:
        """Root mean square over cells and renders of the errors over noise, without the truth's
        own.
        """
        square = np.mean([self.off(one) ** 2 for one in rendered])
        return float(np.sqrt(max(square - self.over_noise(self.error) ** 2, 0.0)))


def judged(drawn: LightCase, limit_s: float, *, search: bool = True) -> Iterator[Judged]:
    """The image, root mean square over its cells, and its whole light, of one case.

    ``limit_s``: of one thread's time, for the truth.
    """
    case = _lit(drawn)
    fidelity = Tolerance(drawn.tolerance).knobs()
    case.light(fidelity, 0)  # compiles
    choosing = Choosing()
    with choosing:
        seconds, (rendered, *others) = processor_time(lambda: case.light(fidelity, 1))
    truth = _truth(case, rendered, limit_s)
    left_out = np.broadcast_to(rendered.light.left_out, rendered.light.error.shape).ravel()
    stated = _WITHIN_95 * rendered.light.error.ravel() + left_out
    common = {
        "name": drawn.name,
        "tolerance": drawn.tolerance,
        "warnings": tuple(str(w) for w in rendered.warnings),
    }
    off = np.abs(rendered.light.cells.ravel() - truth.light)
    inside = off <= np.hypot(stated, _WITHIN_95 * truth.error)
    cheapest = _cheapest(case, drawn, truth, seconds) if search else None
    yield Judged(
        figure="image",
        stated=truth.over_noise(stated),
        true=truth.error_of(rendered),
        truth_error=truth.over_noise(truth.error),
        unit="of a pixel's noise",
        seconds=seconds,
        cheapest=cheapest,
        searched=search,
        choosing=choosing.seconds / (1 + len(others)) / seconds,
        inside=float(inside.mean()),
        **common,
    )
    total = float(truth.light.sum())
    if total:
        error = float(np.sqrt(np.sum(truth.error**2)))
        scatter = _WITHIN_95 * float(np.sqrt(np.sum(rendered.light.error**2)))
        bias = rendered.light.cells.size * rendered.light.left_out
        yield Judged(
            figure="whole light",
            stated=(scatter + bias) / total,
            true=abs(float(rendered.light.cells.sum()) / total - 1),
            truth_error=error / total,
            unit="of it",
            **common,
        )


def _lit(drawn: LightCase) -> CameraCase:
    """With an emitter of the power that the case's signal over noise takes."""
    system, draft_fidelity = drawn.system, Fidelity(samples=16, max_depth=3)
    for _ in range(3):
        case = CameraCase.of(drawn.scene, system, drawn.seed)
        draft = case.light(draft_fidelity, 99)
        noise = PermittedError(case.chain, draft, draft_fidelity).noise(draft.light.cells)
        ratio = float(np.sqrt(np.mean((draft.light.cells / noise) ** 2)))
        if not ratio:
            break
        power = system.emitter.radiant_intensity_w_per_sr.value * drawn.light_over_noise / ratio
        system = system.with_({"emitter.radiant_intensity_w_per_sr": power})
    return CameraCase.of(drawn.scene, system, drawn.seed)


def _truth(case: CameraCase, rendered: RenderedLight, limit_s: float) -> _Truth:
    """Renders until their mean is exact enough beside what is stated, or the time is over."""
    renderer, shape = Renderer(case.problem), case.system.image_shape
    seeds = np.random.default_rng([case.seed, 7])
    permitted = PermittedError(case.chain, rendered, Fidelity())
    noise = permitted.noise(rendered.light.cells).ravel()
    stated = float(np.sqrt(np.mean((_WITHIN_95 * rendered.light.error.ravel() / noise) ** 2)))
    found, begin = list[Array](), time.process_time()
    while True:
        found.append(renderer.render(shape, _PATHS, int(seeds.integers(2**31))).ravel())
        if len(found) < _LEAST_RENDERS:
            continue
        error = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
        truth = _Truth(np.mean(found, axis=0), error, noise)
        is_exact = truth.over_noise(truth.error) <= _SMALL * stated
        if is_exact or time.process_time() - begin > limit_s:
            return truth


def _cheapest(case: CameraCase, drawn: LightCase, truth: _Truth, most_s: float) -> Cheapest | None:
    """The cheapest of all settings of paths and bounces whose error is within the tolerance, if it
    takes less than ``most_s``.

    Of one number of bounces paths are added until the error is small enough or the time too long.
    """
    best: Cheapest | None = None
    for depth in _DEPTHS:
        for samples in _SAMPLES:
            fidelity = Fidelity(samples=samples, max_depth=depth)
            render = partial(_of_next_seed, case, fidelity, count())
            render()  # compiles
            seconds, runs = processor_time(render)
            if seconds > most_s:
                break
            if truth.error_of(*runs) <= drawn.tolerance:
                best, most_s = Cheapest(seconds, f"{samples} paths, {depth} bounces"), seconds
                break
    return best


def _of_next_seed(case: CameraCase, fidelity: Fidelity, seeds: Iterator[int]) -> RenderedLight:
    return case.light(fidelity, 2, fidelity.samples, fidelity.max_depth, next(seeds))
