"""Light of the cells of a grid to a stated error: paths are added where they are needed.

A first look draws a few independent sets of paths in every cell; their scatter is the error of
their mean. Where it matters, the sets are continued, until the error of all cells together is as
small as asked.

Half of the sets are continued by what the other half has found. By their own, those that miss what
is bright and rare would agree, and be left as they are: the whole light was too little by 0.1 to
0.4 %. Of scattered and indirect light, most of which few paths bring, it is what the other half
found at first look. What it finds later depends on how many paths it was given, and so on what this
half had found before: indirect light was too little by 0.6 % in the yard, by 2.3 % in `crossing`.

In the end cells whose direct light scatters as no cell around them does have further sets.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.optics.path_numbers import affordable_paths, further_rays, wanted_paths
from twin.optics.path_sets import DRAWS, SETS, PathSets
from twin.optics.tracer import Tracer
from twin.optics.transport import CellLight
from twin.optics.unseen import contrast

Array = NDArray[np.float64]

#: Of the permitted error, what an effect that is left out may change at most.
LEFT_OUT = 0.1
#: Power of the number of paths with which the variance of direct light falls.
_FALLS = 1.7
_ROUNDS = 8
#: Cells whose sets agree by chance are the ones that are not continued: their variance is more than
#: its estimate, by this factor in the yard.
_CHOSEN = 1.15
#: Of the square of a cell's permitted error, what one cell may scatter by alone.
_OF_ONE = 2.0
#: Number of times that what happens as often is missed altogether in 5 of 100 cases.
_UNSEEN = 3
#: Of a path that the air scatters, beside those of one that it does not.
_SCATTERED_RAYS = 3
#: Paths of all cells together where the first look found no light at all.
_IN_THE_DARK = 2**20


@dataclass(frozen=True, eq=False)
class LightWithin:
    """Light to a tolerance, and whether its indirect part was traced for it.

    Parameters
    ----------
    light
        Of the cells.
    indirect_over
        Bound of indirect light over the permitted error, root mean square over the cells: that by
        which it was decided, or what its paths say, where that is less and still matters.
    indirect_taken
        Whether it was traced.
    left_out
        Bound of each cell's light that was left out.
    cost_s
        Time that indirect light took.
    unseen
        Where no path met any light, and rays ended before as many paths were traced as are enough:
        one over their number; else 0.
    """

    light: CellLight
    indirect_over: float
    indirect_taken: bool
    left_out: float
    cost_s: float
    unseen: float


def gather_within(
    tracer: Tracer,
    permitted: Callable[[Array], Array],
    facets: Array | None = None,
    largest_indirect: float = math.inf,
    in_the_dark: float = math.inf,
    permitted_alike: Callable[[Array], Array] | None = None,
    ray_share: float = 1.0,
) -> LightWithin:
    """Light that each cell receives, as `gather`, with as many paths as its error needs.

    ``permitted``: of light (rows, columns) the error that each cell may have, infinite where any
    is; the root mean square over the cells of error over permitted comes below 1, unless that takes
    more paths than a cell may have or, besides the first look, more rays than ``ray_share`` of
    `TracingQuality.rays`: `CellLight.standard_error` says what was reached. Bounces end by chance,
    and at `TracingQuality.most_bounces`, so that hardly any light is lost. ``largest_indirect``:
    bound of a cell's indirect light (`LightProblem.largest_indirect`), which is left out where that
    is below a tenth of what is permitted, or of ``permitted_alike``: of errors that cells share.
    ``in_the_dark``: paths of all cells together that are enough where the first ones find no light
    at all, at most a million.

    The standard error is from the scatter of independent sets of paths, half of it that of the
    cells around; with what all paths of a cell may miss: one path's share of the contrast to the
    cells around and of ``facets``, what a facet may bring (`LightProblem.facet_light`); and for
    indirect light what is as bright as the brightest path of all, but rare.
    """
    shape, alike = (tracer.start.rows, tracer.start.columns), permitted_alike or permitted
    shifts = [int(n) for n in np.random.SeedSequence([tracer.seed, DRAWS]).generate_state(3)]
    most_rays = ray_share * tracer.quality.rays
    direct = lambda rays: (tracer.direct(rays).value, 1)  # noqa: E731
    parts = [PathSets(tracer, shifts[0], direct, _FALLS, 1.0, 4, 3)]
    if tracer.scatters:
        scattered = lambda rays: (tracer.scattered(rays).value, _SCATTERED_RAYS)  # noqa: E731
        parts.append(PathSets(tracer, shifts[1], scattered, 1.0, 3.0, 4, 5))
    over = _over(largest_indirect, parts, alike, shape)
    taken = over > LEFT_OUT
    if taken:
        parts.append(PathSets(tracer, shifts[2], tracer.all_indirect, 1.0, 4.0, 2, 5))
    facets = np.zeros(tracer.start.size) if facets is None else facets.ravel()
    unseen = 0.0
    if not any(part.mean.any() for part in parts):
        unseen = _draw_in_the_dark(parts, min(_IN_THE_DARK, in_the_dark), most_rays)
    for turn in range(1, _ROUNDS + 1):
        light = np.sum([part.mean for part in parts], axis=0)
        limit = permitted(light.reshape(shape)).ravel()
        weight = 1 / np.maximum(limit, 1e-150) ** 2 / limit.size
        variances = _variances(parts, facets, shape, taken)
        left = sum(float(variance @ weight) for variance in variances)
        if turn == _ROUNDS or left <= 1:
            break
        told = [part * weight[:, None] for part in _by_other_halves(parts, facets, shape, taken)]
        scale = left / max(sum(float(part.sum()) for part in told), 1e-300)
        rays_left = most_rays - sum(part.rays for part in parts)
        wanted = wanted_paths(parts, [scale * part for part in told], up=turn > 1)
        if further_rays(parts, wanted) > rays_left:
            wanted = affordable_paths(parts, told, rays_left)
        drawn = [_draw_more(*pair, turn) for pair in zip(parts, wanted, strict=True)]
        if not any(drawn):
            break
    # Twice: a half that has further sets tells whether the other needs them.
    for turn in (_ROUNDS + 1, _ROUNDS + 2):
        rays_left = most_rays - sum(part.rays for part in parts)
        parts[0].settle(_OF_ONE * limit**2, facets, turn, rays_left / 2)
    light = np.sum([part.mean for part in parts], axis=0)
    variances = _variances(parts, facets, shape, taken)
    indirect = parts[-1].mean if taken else np.zeros_like(light)
    if taken:
        limit = np.maximum(alike(light.reshape(shape)).ravel(), 1e-150)
        known = float(np.sqrt(np.mean(((indirect + 2 * np.sqrt(variances[-1])) / limit) ** 2)))
        over = min(known, over) if known > LEFT_OUT else over
    error = np.sqrt(np.sum(variances, axis=0))
    return LightWithin(
        CellLight(*(x.reshape(shape) for x in (light - indirect, indirect, error))),
        indirect_over=over,
        indirect_taken=taken,
        left_out=0.0 if taken else largest_indirect,
        cost_s=parts[-1].cost_s if taken else 0.0,
        unseen=0.0 if light.any() else unseen,
    )


def _over(
    bound: float,
    parts: Sequence[PathSets],
    permitted: Callable[[Array], Array],
    shape: tuple[int, int],
) -> float:
    """A bound of every cell's light over the permitted error, root mean square over the cells."""
    light = np.sum([part.mean for part in parts], axis=0)
    limit = np.maximum(permitted(light.reshape(shape)), 1e-150)
    if not bound or np.isinf(limit).all():
        return 0.0
    return bound * math.sqrt(float(np.mean(1 / limit**2)))


def _variances(
    parts: Sequence[PathSets], facets: Array, shape: tuple[int, int], taken: bool
) -> list[Array]:
    """Of each part: from its scatter, and of what all its paths may have missed; ``taken``: the
    last part is indirect light.
    """
    direct, indirect = parts[0], parts[-1]
    variances = [_CHOSEN * part.variance for part in parts]
    variances[0] += _missed(facets, direct.mean, direct.paths, shape)
    if taken:
        variances[-1] += _too_rare(direct, indirect, indirect.paths)
    return variances


def _by_other_halves(
    parts: Sequence[PathSets], facets: Array, shape: tuple[int, int], taken: bool
) -> list[Array]:
    """The same of each half as the other tells it, (n_cells, 2); both as many paths as each has."""
    direct, indirect = parts[0], parts[-1]
    variances = [_CHOSEN * part.by_other_half for part in parts]
    for half in (0, 1):
        other = direct.halves[:, 1 - half]
        variances[0][:, half] += _missed(facets, other, SETS * direct.samples[:, half], shape) / 2
        if taken:
            paths = SETS * indirect.samples[:, half]
            variances[-1][:, half] += _too_rare(direct, indirect, paths) / 2
    return variances


def _missed(
    facets: Array, light: Array, paths: NDArray[np.integer], shape: tuple[int, int]
) -> Array:
    """Variance of direct light that all paths of a cell may have missed: up to one path's share,
    any of which is as likely as any other.
    """
    missed = np.maximum(facets, contrast(light.reshape(shape)))
    return np.asarray((missed / paths) ** 2 / 3)


def _too_rare(direct: PathSets, indirect: PathSets, paths: NDArray[np.integer]) -> Array:
    """Variance of indirect light as bright as any path so far, and too rare for those of a window.

    Elsewhere paths would have met it, so that it is in one window of the image, up to three times
    (95 %) one path's share.
    """
    brightest, window = max(float(direct.mean.max()), indirect.brightest), indirect.window**2
    windows = min(1.0, _UNSEEN**2 * window / direct.mean.size)
    return np.asarray(windows * (brightest / (paths * window)) ** 2)


def _draw_in_the_dark(parts: Sequence[PathSets], paths: float, rays: float) -> float:
    """Continue all sets to so many paths of all cells together, as far as rays allow; one over
    their number where these were too few, else 0.
    """
    sets = SETS * parts[0].tracer.start.size
    samples = 2 ** math.ceil(math.log2(max(paths / sets, 1)))
    most = max(rays / sets / sum(part.rays_per_path for part in parts), 1)
    is_enough = samples <= most
    if not is_enough:
        samples = 2 ** math.floor(math.log2(most))
    for part in parts:
        _draw_more(part, np.full((parts[0].tracer.start.size, 2), samples), 0)
    return 0.0 if is_enough else 1 / (sets * samples)


def _draw_more(part: PathSets, samples: NDArray[np.int64], turn: int) -> bool:
    """Continue the sets of paths that are shorter; whether there are such cells."""
    more = np.flatnonzero((samples > part.samples).any(axis=1))
    if len(more):
        part.draw(more, samples[more], turn)
    return bool(len(more))
