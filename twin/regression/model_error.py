"""What the model may move mean figures by: the error of the render, or of the traced echoes.

Figures of one render share its error, and no scatter over seeds of the sensor's noise shows it. So
truths are drawn anew within what their model says that it is off by, and the same method runs on
records of them, with the same draws of the noise: what the mean figures change by is the error.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Interval
from twin.accuracy.interval import TWO_SIDED_95
from twin.camera.rendered import RenderedLight
from twin.radar import RadarCapture
from twin.radar.propagation.result import Propagation

Array = NDArray[np.float64]
#: Mean figures of a truth over some seeds, by metric.
Means = Mapping[str, float]
T = TypeVar("T")

#: Draws of a truth, and the factor by which their scatter is to be larger so that 1.96 of it hold
#: 95 % of cases (Student's distribution); seeds of the noise with each.
_DRAWS, _FEW = 8, 1.207
ERROR_SEEDS = 4
_SEED = 17


def light_errors(
    light: RenderedLight, means: Callable[[RenderedLight], Means]
) -> dict[str, Interval]:
    """Mean figures of a render with their errors; ``means`` gives those of any light. What nothing
    bounds does not count.
    """
    rng, left_out = np.random.default_rng(_SEED), light.light.left_out
    drawn = (
        with_light(
            light,
            light.light.cells + light.light.error * rng.standard_normal(light.light.cells.shape),
            light.sun + light.sun_error * rng.standard_normal(light.sun.shape),
        )
        for _ in range(_DRAWS)
    )
    bounded = np.where(np.isfinite(left_out), left_out, 0.0)
    sun = np.where(np.isfinite(light.sun_left_out), light.sun_left_out, 0.0)
    with_all = (
        with_light(light, light.light.cells + bounded, light.sun + sun)
        if bounded.any() or sun.any()
        else None
    )
    has_errors = bool(np.any(light.light.error) or np.any(light.sun_error))
    return _intervals(means, light, drawn if has_errors else (), with_all)


def with_light(light: RenderedLight, cells: Array, sun: Array) -> RenderedLight:
    """The same with other light in the cells and of the sun, neither below 0, on the same paths."""
    air = 0.0 if light.backscatter is None else light.backscatter.light
    cells, before = np.maximum(cells, air), light.light.cells - air
    factor = np.divide(cells - air, before, out=np.ones_like(cells), where=before > 0)
    paths = light.paths and replace(
        light.paths, value=(light.paths.value * factor.reshape(-1, 1)).astype(np.float32)
    )
    return replace(
        light, light=replace(light.light, cells=cells), sun=np.maximum(sun, 0), paths=paths
    )


def echo_errors(
    capture: RadarCapture, means: Callable[[RadarCapture], Means]
) -> dict[str, Interval]:
    """Mean figures of a capture with their errors; ``means`` gives those of any."""
    rng = np.random.default_rng(_SEED)
    drawn = (
        replace(capture, bursts=tuple(_drawn(burst, rng) for burst in capture.bursts))
        for _ in range(_DRAWS)
    )
    has_errors = any(burst.bodies for burst in capture.bursts)
    return _intervals(means, capture, drawn if has_errors else (), None)


def _drawn(echo: Propagation, rng: np.random.Generator) -> Propagation:
    """Every body's echo off by as much as its estimated error, which 95 of 100 bodies keep: as a
    whole, and as much again in equal parts in all its contributions.
    """
    amplitude, number = echo.contributions.amplitude.copy(), echo.contributions.object
    first = len(echo.names)  # single paths are before, and of no body
    for body in echo.bodies:
        members = [i for i, name in enumerate(echo.objects) if name in body.objects]
        own = first + np.flatnonzero(np.isin(number[first:], members))
        statistical = body.accepted_error / TWO_SIDED_95
        error = np.hypot(statistical, body.systematic) * body.level_amplitude
        if own.size and body.amplitude:
            amplitude[own] *= 1 + min(error / body.amplitude, 1.0) * _complex(rng, 1)
            amplitude[own] += error / np.sqrt(own.size) * _complex(rng, own.size)
    return replace(echo, contributions=replace(echo.contributions, amplitude=amplitude))


def _complex(rng: np.random.Generator, n: int) -> NDArray[np.complex128]:
    """Complex normal numbers whose squares are 1 in the mean."""
    return (rng.standard_normal(n) + 1j * rng.standard_normal(n)) / np.sqrt(2)


def _intervals(
    means: Callable[[T], Means], truth: T, drawn: Iterable[T], with_all: T | None
) -> dict[str, Interval]:
    """Figures of a truth: their scatter over ``drawn`` ones, and what these shift on the whole,
    with what changes under ``with_all`` that was left out.
    """
    here = means(truth)
    others, most = [means(each) for each in drawn], here if with_all is None else means(with_all)

    def interval(name: str) -> Interval:
        change = np.array([other[name] for other in others]) - here[name]
        bound = abs(most[name] - here[name])
        if not change.size:
            return Interval(here[name], 0.0, bound)
        return Interval(
            here[name], _FEW * float(change.std(ddof=1)), abs(float(change.mean())) + bound
        )

    return {name: interval(name) for name in here}


def of_views(errors: Sequence[Mapping[str, Interval]]) -> dict[str, Interval]:
    """Errors of figures over several views alike, whose statistical errors are independent."""
    return {
        name: Interval(
            float(np.mean([view[name].value for view in errors])),
            float(np.linalg.norm([view[name].standard_error for view in errors])) / len(errors),
            float(np.mean([view[name].systematic for view in errors])),
        )
        for name in errors[0]
    }
