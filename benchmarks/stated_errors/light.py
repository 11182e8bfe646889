"""Light: stated against true errors, and times against those of the cheapest sufficient knobs."""

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from itertools import count
from typing import Any

import numpy as np

from benchmarks.stated_errors.cells import compared
from benchmarks.stated_errors.choosing import Choosing
from benchmarks.stated_errors.judged import Cheapest, Judged
from benchmarks.stated_errors.light_cases import LightCase
from benchmarks.stated_errors.light_reference import LightReference, light_reference
from benchmarks.stated_errors.printed import printed_figures
from benchmarks.timing import processor_time
from twin.camera.light import render
from twin.camera.permitted_error import PermittedError
from twin.camera.rendered import DetectorLight, RenderedLight
from twin.camera.verdict import LIT
from twin.fidelity import Fidelity, Tolerance
from twin.trade.camera import CameraCase

_DEPTHS, _SAMPLES = (1, 2, 4, 8, 16), tuple(4**power for power in range(7))


def judged(drawn: LightCase, limit_s: float, *, search: bool = True) -> Iterator[Judged]:
    """The image by its cells, and printed figures: whole light, sun, median SNR, PSNR and SSIM.

    ``limit_s``: of CPU time, for the truth.
    """
    case = _lit(drawn)
    fidelity = Tolerance(drawn.tolerance).knobs()
    case.light(fidelity, 0)  # compiles
    choosing = Choosing()
    with choosing:
        seconds, (_, *others) = processor_time(lambda: case.light(fidelity, 1))
    # As `capture` renders it, with all bounds.
    seed = np.random.SeedSequence([case.seed, 1])
    rendered = render(case.scene, case.system, fidelity=fidelity, seed=seed)
    truth = light_reference(case, rendered, limit_s)
    common = {
        "name": drawn.name,
        "tolerance": drawn.tolerance,
        "warnings": tuple(str(w) for w in rendered.warnings),
    }
    yield Judged(
        **of_image(rendered.light, truth),
        truth="stock Mitsuba",
        seconds=seconds,
        cheapest=_cheapest(case, drawn, truth, seconds) if search else None,
        searched=search,
        choosing=choosing.seconds / (1 + len(others)) / seconds,
        **common,
    )
    for figure in printed_figures(case, rendered, truth):
        yield Judged(**asdict(figure), **common)


def of_image(light: DetectorLight, truth: LightReference) -> dict[str, Any]:
    """Fields of `Judged`: root mean squares over the cells, over a pixel's noise, and the cells."""
    left_out = np.broadcast_to(light.left_out, light.error.shape).ravel()
    error, off = light.error.ravel(), light.cells.ravel() - truth.light
    bound = truth.over_noise(left_out)
    return {
        "figure": "image",
        "stated": bound + truth.over_noise(error),
        "systematic": bound,
        "true": truth.over_noise(off),
        "truth_error": truth.over_noise(truth.error),
        "unit": "of a pixel's noise",
        # A lens's blur leaves light of 1e-250 far away, which no path finds.
        "cells": compared(off, error, left_out, truth.error, LIT * float(truth.light.max())),
    }


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


def _cheapest(
    case: CameraCase, drawn: LightCase, truth: LightReference, most_s: float
) -> Cheapest | None:
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
