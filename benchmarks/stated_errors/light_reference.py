"""The true light of a case: renders of `light_truth` until their mean is exact enough."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.stated_errors.light_truth import Renderer, SunRenderer
from twin.camera.equal_paths import sun_shape
from twin.camera.permitted_error import PermittedError
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity
from twin.trade.camera import CameraCase

Array = NDArray[np.float64]

#: Per pixel of a render of the truth: of few paths all may miss a tiny facet, so that their scatter
#: tells nothing. In closed bright rooms, where each path bounces on, fewer.
_PATHS, _LEAST_PATHS = 64, 8
#: Times the limit that the least number of renders may take with more than those.
_LONGER = 3.0
#: How small the truth's error is to be over that stated, where time allows; the sun's share of the
#: time, and its paths.
_SMALL, _SUN_SHARE, _SUN_PATHS = 0.2, 0.3, 16
#: Groups of renders, from which figures of the truth have their errors.
GROUPS = 8


@dataclass(frozen=True, eq=False)
class LightReference:
    """Light (n_cells,) and its standard error; the noise of each pixel in its unit; light of groups
    of renders (GROUPS, n_cells); and the sun's light of such groups, (GROUPS, rows, columns), None
    with the sun in the detector's field.
    """

    light: Array
    error: Array
    noise: Array
    groups: Array
    sun_groups: Array | None

    def over_noise(self, values: Array) -> float:
        """Root mean square over the cells, over the noise."""
        return float(np.sqrt(np.mean((values.ravel() / self.noise) ** 2)))

    def error_of(self, *rendered: RenderedLight) -> float:
        """Root mean square over cells and renders of the errors over noise, without the truth's
        own.
        """
        off = [(one.light.cells.ravel() - self.light) / self.noise for one in rendered]
        square = np.mean([each**2 for each in off])
        return float(np.sqrt(max(square - self.over_noise(self.error) ** 2, 0.0)))

    def in_place_of(self, rendered: RenderedLight) -> RenderedLight:
        """A render with the true light in place of its own."""
        groups = None if self.sun_groups is None else self.sun_groups.mean(axis=0)
        return _with(rendered, self.light, groups)

    def without_each_group(self, rendered: RenderedLight) -> Iterator[RenderedLight]:
        """The same without one group of renders, of each group."""
        for i in range(GROUPS):
            sun = None if self.sun_groups is None else np.delete(self.sun_groups, i, 0).mean(axis=0)
            yield _with(rendered, np.delete(self.groups, i, 0).mean(axis=0), sun)


def _with(rendered: RenderedLight, light: Array, sun: Array | None) -> RenderedLight:
    cells = light.reshape(rendered.light.cells.shape)
    return replace(
        rendered,
        light=replace(rendered.light, cells=cells),
        sun=rendered.sun if sun is None else sun,
    )


def light_reference(case: CameraCase, rendered: RenderedLight, limit_s: float) -> LightReference:
    """Renders until their mean is exact enough beside what is stated, or the CPU time is over."""
    shape = case.system.image_shape
    noise = PermittedError(case.chain, rendered, Fidelity()).noise(rendered.light.cells).ravel()
    renderer = Renderer(case.problem, shape)
    paths = _paths(renderer, limit_s)
    groups, error = _rendered(
        lambda seed: renderer.render(paths, seed).ravel(),
        lambda error: _rms(error / noise),
        _SMALL * _rms(rendered.light.error.ravel() / noise),
        limit_s,
        case.seed,
    )
    try:
        sun = SunRenderer(case.problem, sun_shape(case.system))
    except ValueError:  # the sun is in the field
        return LightReference(groups.mean(axis=0), error, noise, groups, None)
    sun_groups, _ = _rendered(
        lambda seed: sun.render(_SUN_PATHS, seed),
        _norm,
        _SMALL * _norm(np.broadcast_to(rendered.sun_error, rendered.sun.shape)),
        _SUN_SHARE * limit_s,
        case.seed + 1,
    )
    return LightReference(groups.mean(axis=0), error, noise, groups, sun_groups)


def _paths(renderer: Renderer, limit_s: float) -> int:
    """Paths per pixel of a render."""
    renderer.render(1, 1)  # compiles
    begin = time.process_time()
    renderer.render(_LEAST_PATHS, 2)
    each_s = max(time.process_time() - begin, 1e-3) / _LEAST_PATHS
    most = int(_LONGER * limit_s / GROUPS / each_s)
    return min(max(most, _LEAST_PATHS), _PATHS)


def _rendered(
    render: Callable[[int], Array],
    size: Callable[[Array], float],
    small: float,
    limit_s: float,
    seed: int,
) -> tuple[Array, Array]:
    """Means of groups of renders, and the standard error of the mean of all, when its ``size`` is
    ``small`` or the CPU time is over.
    """
    seeds = np.random.default_rng([seed, 7])
    found, begin = list[Array](), time.process_time()
    while True:
        found += [render(int(seeds.integers(2**31))) for _ in range(GROUPS)]
        error = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
        if size(error) <= small or time.process_time() - begin > limit_s:
            return np.mean(np.reshape(found, (-1, GROUPS, *found[0].shape)), axis=0), error


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _norm(values: Array) -> float:
    return float(np.linalg.norm(values))
