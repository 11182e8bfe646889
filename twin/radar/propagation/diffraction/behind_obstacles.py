"""Echoes of bodies by diffracted paths around obstacles: a pedestrian behind a parked car.

Echoes whose forward and return paths both have no edge on them are found elsewhere
(`twin.radar.propagation.physical_optics`), with hard shadows. Here is what is missing there: with T
the field over the straight wave of a view, direct and over the edges of obstacles, and D = 1 in the
light and 0 in the shadow, the share T^2 - D^2 of every facet's echo; where it is lit from one view
and answers to another, as over a ground on one of both ways, T T' - D D'.

What flat sides of obstacles reflect is added apart (`side_echoes`).

A body is divided into cells, across which waves over edges take the same ways (`cell_echoes`).
Which cells count, an estimate decides that needs no rays (`shadow_bounds`): the echo of all facets
of a cell without obstacles, times what the edges near it may change. What is left out is told of
every body, the root of the sum of squares of: edges so far from the straight path that their waves
are below the faintest that are followed, which may meet facets at right angles (`unfollowed_waves`,
times a factor for what it leaves out); what cells are off by; and the estimates of cells that are
not computed. Estimates are several times too large, by how much the cells that are computed tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.cell_echoes import cell_echoes
from twin.radar.propagation.diffraction.cell_estimates import (
    COARSE_M,
    Candidates,
    Gain,
    coarse,
    finer,
    in_small_parts,
    strength,
)
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import front_facets
from twin.radar.propagation.diffraction.side_echoes import side_echoes
from twin.radar.propagation.diffraction.unfollowed_waves import FaintWaves, faint_waves
from twin.radar.propagation.diffraction.views import TwoViews, two_views
from twin.radar.rows import lengths
from twin.radar.synthesis import Contributions
from twin.radar.synthesis.joined import Resolution, joined

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SURE = 3.0  # over the root of the sum of squares, before any ray is sent
#: Of all bodies together, about, before those that the radar does not tell apart become one: some
#: 0.4 GB. They are off by some per cent of independent waves then, which `_OF_ECHOES` has room for.
_MOST_ECHOES = 2**21
#: On waves that are not followed; on echoes of cells that are left out, by what others answer over
#: their estimate; and share by which each wave to a cell may be off, root of the sum of squares:
#: `benchmarks.round_obstacles` compares them with Kirchhoff's integral.
_UNFOLLOWED, _OF_RATIO, _OF_ECHOES = 2.0, 2.0, 0.18
_OF_CELLS = 0.15  # of the estimates of cells, at most
_DEEP = 3.0  # of a body's limit: faint waves of all cells where they are not followed, apart
_WHOLE = 64  # cells at most of a body that faint waves are followed to all of, or none
#: Waves over ends of edges that are stated, over the straight wave: by what else a body may be off
#: by, over its limit, by the root of its number of cells, and between these. All of them would take
#: the yard and the street 2 s more.
_ENDS, _LEAST_OF_ENDS = (5e-5, 1e-4), (0.001, 0.01)
#: Facets by which faint waves are stated, where a body has at most so many: of larger ones that are
#: far from square to the way they are up to three times too faint.
_SMALL_M, _FEW = 0.05, 1000
_OF_OTHERS = 0.27  # of the error of cells: that of faint waves that are not followed for it
#: Cells on ways over mirrors, at most, over those on direct ways: as many of both tell of the
#: yard's car 46 % instead of 47, in 0.6 s more.
_OVER_MIRRORS = 0.5
_MOST_PAIRS = 1e8  # of coarse cells of all bodies and edges: some 10 s


@dataclass(frozen=True, eq=False)
class RoundObstacles:
    """Contributions of bodies by diffracted paths, without gains; and of every body, (n_bodies,) in
    amplitude, the ``bound`` of these, and of what is ``left_out``; and which are too large, among
    too many edges, to be looked at.
    """

    contributions: Contributions
    bound: Array
    left_out: Array
    too_large: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Accepted:
    """What is left out: amplitudes ``limit`` (n_bodies,) of bodies' echoes that do not count;
    ``most`` cells are computed of direct ways, and `_OVER_MIRRORS` as many of others; ``fineness``:
    size of these over that at a tolerance of 0.1; ``faintest``: of diffracted waves, over the
    straight one, that are followed to every cell; ``resolution``: within which echoes become one.
    """

    limit: Array
    most: int
    fineness: float
    faintest: float
    resolution: Resolution


def echoes_behind(
    obstacles: Screens,
    surface_of_object: NDArray[np.uint32],
    bodies: Indices,
    over_mirrors: Sequence[tuple[int, int, int]],
    gain: Gain,
    accepted: Accepted,
) -> RoundObstacles:
    """Echoes of some ``bodies`` whose forward path, return path or both are diffracted.

    ``over_mirrors``: by the numbers of a body and of two images, ways one of which at least leads
    over a mirror; ``gain`` of directions (n, 3) in the world, of both antennas, in amplitude. The
    faintest wave of ``obstacles`` is followed to those cells where it counts.
    """
    too_large = _too_large(obstacles, bodies, len(accepted.limit))
    bodies = bodies[~too_large[bodies]]
    direct = [(body, two_views(obstacles, 0, 0)) for body in bodies.tolist()]
    over = [
        (body, two_views(obstacles, *images)) for body, *images in over_mirrors if body in bodies
    ]
    fewer = replace(accepted, most=int(np.ceil(_OVER_MIRRORS * accepted.most)))
    straight = _followed(direct, surface_of_object, gain, accepted, np.zeros(len(accepted.limit)))
    parts = [
        straight,
        _followed(over, surface_of_object, gain, fewer, straight.bound),
        _by_sides(obstacles, surface_of_object, bodies, gain, accepted),
    ]
    # Independent of each other.
    bound, left_out = (
        np.linalg.norm([getattr(part, name) for part in parts], axis=0)
        for name in ("bound", "left_out")
    )
    echoes = Contributions.concatenate([echoes for part in parts for echoes in part.echoes])
    return RoundObstacles(echoes, bound, left_out, too_large)


class _Part(NamedTuple):
    """Echoes by some ways, and of every body, (n_bodies,) in amplitude, the ``bound`` of them, and
    what is ``left_out`` or uncertain.
    """

    echoes: list[Contributions]
    bound: Array
    left_out: Array


def _followed(
    ways: list[tuple[int, TwoViews]],
    surface_of_object: NDArray[np.uint32],
    gain: Gain,
    accepted: Accepted,
    beside: Array,
) -> _Part:
    """By ways to bodies, those of all bodies in the same number of cells; ``beside`` what waves on
    other ways may change, (n_bodies,).
    """
    bound, left_out, unfollowed = np.zeros((3, len(accepted.limit)))
    candidates = []
    for body, views in ways:
        found = _of_body(views, body, gain, accepted, float(np.hypot(beside, bound)[body]))
        bound[body] = np.hypot(bound[body], found.bound)
        left_out[body] += found.left_out
        unfollowed[body] = np.hypot(unfollowed[body], found.faint)
        candidates += found.candidates
    echoes, of_cells = _contributions(surface_of_object, candidates, gain, accepted, left_out)
    parts = _UNFOLLOWED * unfollowed, left_out, of_cells
    return _Part(echoes, bound, np.linalg.norm(parts, axis=0))


def _by_sides(
    obstacles: Screens,
    surface_of_object: NDArray[np.uint32],
    bodies: Indices,
    gain: Gain,
    accepted: Accepted,
) -> _Part:
    """What flat sides of obstacles add on direct ways, where it counts."""
    added, unsure = np.zeros((2, len(accepted.limit)))
    parts, views = [], two_views(obstacles, 0, 0)
    for body in bodies.tolist() if obstacles.sides else ():
        facets, _ = coarse(views, body)
        found = side_echoes(obstacles, facets, body, surface_of_object, gain)
        echoes, added[body], unsure[body] = found
        if added[body] > accepted.limit[body] / 4:
            parts.append(echoes)
        else:
            unsure[body] = added[body]
    return _Part(parts, added, unsure)


class _OfBody(NamedTuple):
    """What waves over edges may change of a body, in amplitude: the ``bound`` of all, the cells
    that count, what is ``left_out`` of others, and waves too ``faint`` to be followed.
    """

    bound: float
    candidates: list[Candidates]
    left_out: float
    faint: float


def _of_body(views: TwoViews, body: int, gain: Gain, accepted: Accepted, beside: float) -> _OfBody:
    """Waves that are fainter than those followed everywhere are followed where they count by
    themselves, and are not far below what the cells are off by for the stronger ones. Those over
    ends of edges are looked for down to amplitudes that may count ``beside`` what else may change.
    """
    limit, faintest = accepted.limit[body], views.one.obstacles.faintest
    everywhere = views.down_to(max(accepted.faintest, faintest))
    facets, is_lit = coarse(everywhere, body)
    if not len(facets):
        return _OfBody(0.0, [], 0.0, 0.0)
    whole = Candidates.of(everywhere, facets, body, gain, is_lit)
    has_fainter = faintest < everywhere.one.obstacles.faintest
    deepest = Candidates.of(views, facets, body, gain, is_lit) if has_fainter else whole
    off = _OF_CELLS * np.hypot(beside / _SURE, np.linalg.norm(whole.change))
    ends = max(_ENDS[0] * off / limit, _ENDS[1] * np.sqrt(len(whole.change)))
    ends = float(np.clip(ends, *_LEAST_OF_ENDS))
    faint = _faint(whole, deepest, is_lit, gain, ends)
    is_deep = _taken(faint.of_cells(), _DEEP * limit, accepted.most) & has_fainter
    if len(is_deep) <= _WHOLE:
        is_deep[:] = is_deep.any()
    deep = deepest.take(is_deep)
    rest = whole.take(~is_deep)
    bound = _SURE * float(np.linalg.norm(np.concatenate([rest.change, deep.change])))
    followed = np.full(len(is_deep), everywhere.one.obstacles.faintest)
    if bound <= limit:
        followed[is_deep] = faintest
        return _OfBody(bound, [], bound, faint.of_body(followed))
    parts = [_finer(rest, gain, accepted), _finer(whole.take(is_deep), gain, accepted)]
    changed = np.linalg.norm(np.concatenate([one.change for one, _ in parts]))
    of_cells = _OF_CELLS * accepted.fineness * float(changed)
    if is_deep.any() and _UNFOLLOWED * faint.of_body(followed) > _OF_OTHERS * of_cells:
        parts[1] = _finer(deep, gain, accepted)
        followed[is_deep] = faintest
    candidates = [one for one, _ in parts if len(one.facets)]
    left_out = sum(left for _, left in parts)
    return _OfBody(bound, candidates, left_out, faint.of_body(followed))


def _faint(
    followed: Candidates,
    deepest: Candidates,
    is_lit: NDArray[np.bool_],
    gain: Gain,
    least_of_ends: float,
) -> FaintWaves:
    """Of waves over edges that are fainter than ``followed`` ones on one way, while the other is
    straight, or led over edges; over ends of edges from an amplitude on.
    """
    views, facets = followed.views, followed.facets
    if len(facets) <= _FEW:
        facets = facets.divided(np.full(len(facets), _SMALL_M))
    level = strength(views, facets, gain)
    other_way = deepest.other_ways(is_lit, apart=followed) * (2 if views.are_same else 1)
    return FaintWaves.concatenate(
        [
            faint_waves(view, other, facets, followed.body, level, way, least_of_ends)
            for view, other, way in zip(views.each, views.each[::-1], other_way, strict=True)
        ]
    )


def _too_large(obstacles: Screens, bodies: Indices, count: int) -> NDArray[np.bool_]:
    """Bodies, (count,), for whose cells and the edges around there is no time: in cities."""
    source = obstacles.prepared.images[0].place
    edges = sum(len(obstacles.outline(item, source).ends) for item in range(len(obstacles.items)))
    area = np.zeros(count)
    for body in bodies.tolist():
        area[body] = lengths(front_facets(obstacles, body, source).across).sum()
    order = np.argsort(area, kind="stable")
    is_too_large = np.zeros(count, dtype=bool)
    is_too_large[order] = np.cumsum(area[order]) / COARSE_M**2 * edges > _MOST_PAIRS
    return is_too_large


def _finer(one: Candidates, gain: Gain, accepted: Accepted) -> tuple[Candidates, float]:
    """Those that count in cells as small as edges near them ask for; and what the rest may change,
    in amplitude.
    """
    limit = accepted.limit[one.body] / 4
    return finer(one, gain, accepted.fineness, lambda change: _taken(change, limit, accepted.most))


def _contributions(
    surface_of_object: NDArray[np.uint32],
    candidates: list[Candidates],
    gain: Gain,
    accepted: Accepted,
    left_out: Array,
) -> tuple[list[Contributions], Array]:
    """Of those cells that count the most, and what these are off by, (n_bodies,); the rest is added
    to ``left_out``, and all of it is by as much too large as the estimates of these.
    """
    estimate, level, unsure = np.zeros((3, len(left_out)))
    if not candidates:
        return [], level
    over = np.concatenate([c.change / accepted.limit[c.body] for c in candidates])
    most = accepted.most
    least = -np.partition(-over, most)[most] if most < len(over) else 0.0
    parts, many = [], _MOST_ECHOES // len(candidates)
    for one in candidates:
        limit = accepted.limit[one.body]
        is_taken = _taken(one.change, limit / 4, most) & (one.change > least * limit)
        left_out[one.body] += np.linalg.norm(one.change[~is_taken])
        if is_taken.any():
            facets = in_small_parts(one.take(is_taken), accepted.fineness)
            echoes, answered, off = cell_echoes(
                one.views, facets, one.body, surface_of_object, gain
            )
            parts.append(joined(echoes, accepted.resolution, gain, many))
            changed = np.linalg.norm(one.change[is_taken])
            estimate[one.body] = np.hypot(estimate[one.body], changed)
            level[one.body] = np.hypot(level[one.body], answered)
            unsure[one.body] = np.hypot(unsure[one.body], off)
    ratio = np.divide(level, estimate, out=np.ones_like(level), where=estimate > 0)
    left_out *= np.minimum(_OF_RATIO * ratio, 1.0)
    more = np.divide(unsure, level, out=np.ones_like(level), where=level > 0)
    of_cells = more * np.minimum(_OF_CELLS * accepted.fineness * estimate, _OF_ECHOES * level)
    return parts, of_cells


def _taken(change: Array, limit: float, most: int) -> NDArray[np.bool_]:
    """Which cells are taken: all but the faintest, which together stay within a limit, and at
    ``most`` so many.
    """
    order = np.argsort(change, kind="stable")
    below = np.sqrt(np.cumsum(change[order] ** 2))
    count = max(int(np.searchsorted(below, limit, side="right")), len(change) - most)
    is_taken = np.ones(len(change), dtype=bool)
    is_taken[order[:count]] = False
    return is_taken
