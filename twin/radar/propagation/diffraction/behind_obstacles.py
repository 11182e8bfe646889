"""Echoes of bodies by diffracted paths around obstacles: a pedestrian behind a parked car.

Echoes whose forward and return paths are both direct are found elsewhere
(`twin.radar.propagation.physical_optics`), with hard shadows. Here is what is missing there: with T
the field over the straight wave, direct and over the edges of obstacles, and D = 1 in the light and
0 in the shadow, the share T^2 - D^2 of every facet's echo.

What flat sides of obstacles reflect is added apart (`side_echoes`).

A body is divided into cells, across which waves over edges take the same ways (`cell_echoes`).
Which cells count, an estimate decides that needs no rays (`shadow_bounds`): the echo of all facets
of a cell without obstacles, times what the edges near it may change. What is left out is told of
every body, the root of the sum of squares of: edges so far from the straight path that their waves
are below the faintest that are followed, which may meet facets at right angles (`unfollowed_waves`,
times a factor for what it leaves out); what cells are off by; and the estimates of cells that are
not computed. Estimates are several times too large, by how much the cells that are computed tell.
Paths over mirrors are not followed round obstacles.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.blocking import first_hit
from twin.radar.propagation.diffraction.cell_echoes import cell_echoes
from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadow_bounds import Cells, cells_of, knife_edge_bound
from twin.radar.propagation.diffraction.shadowed_facets import Facets, front_facets, in_voxels
from twin.radar.propagation.diffraction.side_echoes import side_echoes
from twin.radar.propagation.diffraction.unfollowed_waves import faint_waves
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.rows import dots, lengths
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SURE = 3.0  # over the root of the sum of squares, before any ray is sent
#: On waves that are not followed; on echoes of cells that are left out, by what others answer over
#: their estimate; and share by which each wave to a cell may be off, root of the sum of squares:
#: `benchmarks.round_obstacles` compares them with Kirchhoff's integral.
_UNFOLLOWED, _OF_RATIO, _OF_ECHOES = 2.0, 2.0, 0.35
_OF_CELLS = 0.3  # of the estimates of cells, at most
_DEEP = 3.0  # of a body's limit: faint waves of all cells where they are not followed, apart
_OF_OTHERS = 0.27  # of the error of cells: that of faint waves that are not followed for it
_COARSE_M = 0.1  # facets that an estimate is made for before they are divided as finely as needed
_FINEST_M = 0.01  # cells
_MOST_PAIRS = 1e8  # of coarse cells of all bodies and edges: some 10 s
#: Change of the root of the phase q across a cell, near a shadow's border and away from it, at a
#: tolerance of 0.1.
_NEAR_BORDER, _AWAY = 0.4, 1.0
_BORDER = 1.0  # root of q that is near, at that tolerance
#: Facets at most, over their cell; and where a border, or several of them, may divide them.
_OF_A_CELL, _OF_A_BORDER = 0.5, 0.33
#: Difference of lengths there and back across a facet: 0.6 rad at the ends of a band of 4 GHz.
_MOST_M = 0.03


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
    ``most`` cells are computed; ``fineness``: size of these over that at a tolerance of 0.1;
    ``faintest``: of diffracted waves, over the straight one, that are followed to every cell.
    """

    limit: Array
    most: int
    fineness: float
    faintest: float


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Facets of a body in cells, what waves over edges change in each cell, (n_cells,), and the
    edges, down to the level that is followed there.
    """

    body: int
    obstacles: Screens
    facets: Facets
    change: Array
    cells: Cells

    def take(self, which: NDArray[np.bool_]) -> "_Candidates":
        """Only those in some of the cells."""
        facets, cells = self.facets.of_cells(which), self.cells.take(which)
        return _Candidates(self.body, self.obstacles, facets, self.change[which], cells)


def echoes_behind(
    obstacles: Screens,
    surface_of_object: NDArray[np.uint32],
    bodies: Indices,
    gain: Callable[[Array], Array],
    accepted: Accepted,
) -> RoundObstacles:
    """Echoes of some ``bodies`` whose forward path, return path or both are diffracted.

    ``gain`` of directions (n, 3) in the world, of both antennas, in amplitude. The faintest wave of
    ``obstacles`` is followed to those cells where it counts.
    """
    bound, left_out, unfollowed = (np.zeros(len(accepted.limit)) for _ in range(3))
    too_large = _too_large(obstacles, bodies, len(bound))
    candidates = []
    for body in bodies[~too_large[bodies]].tolist():
        found = _of_body(obstacles, body, gain, accepted)
        bound[body], left_out[body], unfollowed[body] = found.bound, found.left_out, found.faint
        candidates += found.candidates
    echoes, of_cells = _contributions(surface_of_object, candidates, gain, accepted, left_out)
    of_sides, added, unsure = _by_sides(
        obstacles, surface_of_object, bodies[~too_large[bodies]], gain, accepted
    )
    # Independent of each other.
    parts = _UNFOLLOWED * unfollowed, left_out, of_cells, unsure
    return RoundObstacles(
        Contributions.concatenate([echoes, of_sides]),
        np.hypot(bound, added),
        np.linalg.norm(parts, axis=0),
        too_large,
    )


def _by_sides(
    obstacles: Screens,
    surface_of_object: NDArray[np.uint32],
    bodies: Indices,
    gain: Callable[[Array], Array],
    accepted: Accepted,
) -> tuple[Contributions, Array, Array]:
    """What flat sides of obstacles add where it counts, its amplitude, and by how much it may be
    off, (n_bodies,).
    """
    added, unsure = np.zeros((2, len(accepted.limit)))
    parts = [Contributions.none()]
    for body in bodies.tolist() if obstacles.sides else ():
        facets, _ = _coarse(obstacles, body)
        found = side_echoes(obstacles, facets, body, surface_of_object, gain)
        echoes, added[body], unsure[body] = found
        if added[body] > accepted.limit[body] / 4:
            parts.append(echoes)
        else:
            unsure[body] = added[body]
    return Contributions.concatenate(parts), added, unsure


class _OfBody(NamedTuple):
    """What waves over edges may change of a body, in amplitude: the ``bound`` of all, the cells
    that count, what is ``left_out`` of others, and waves too ``faint`` to be followed.
    """

    bound: float
    candidates: list[_Candidates]
    left_out: float
    faint: float


def _of_body(
    obstacles: Screens, body: int, gain: Callable[[Array], Array], accepted: Accepted
) -> _OfBody:
    """Waves that are fainter than those followed everywhere are followed where they count by
    themselves, and are not far below what the cells are off by for the stronger ones.
    """
    limit = accepted.limit[body]
    everywhere = replace(obstacles, faintest=max(accepted.faintest, obstacles.faintest))
    facets, is_lit = _coarse(obstacles, body)
    if not len(facets):
        return _OfBody(0.0, [], 0.0, 0.0)
    whole = _candidates(everywhere, facets, body, gain, is_lit)
    strength = _strength(obstacles, facets, gain)
    other_way = np.where(is_lit, 2, np.minimum(whole.cells.level, 1))
    faint = faint_waves(everywhere, facets, body, strength, other_way)
    is_deep = _taken(faint.of_cells(), _DEEP * limit, accepted.most)
    is_deep &= obstacles.faintest < everywhere.faintest
    deep = whole.take(is_deep)
    if is_deep.any():
        deep = _candidates(obstacles, deep.facets, body, gain, is_lit[is_deep])
    rest = whole.take(~is_deep)
    bound = _SURE * float(np.linalg.norm(np.concatenate([rest.change, deep.change])))
    if bound <= limit:
        followed = np.where(is_deep, obstacles.faintest, everywhere.faintest)
        return _OfBody(bound, [], bound, faint.of_body(followed))
    finer = [_finer(rest, gain, accepted), _finer(whole.take(is_deep), gain, accepted)]
    followed = np.full(len(is_deep), everywhere.faintest)
    changed = np.linalg.norm(np.concatenate([one.change for one, _ in finer]))
    of_cells = _OF_CELLS * accepted.fineness * float(changed)
    if is_deep.any() and _UNFOLLOWED * faint.of_body(followed) > _OF_OTHERS * of_cells:
        finer[1] = _finer(deep, gain, accepted)
        followed[is_deep] = obstacles.faintest
    candidates = [one for one, _ in finer if len(one.facets)]
    left_out = sum(left for _, left in finer)
    return _OfBody(bound, candidates, left_out, faint.of_body(followed))


def _too_large(obstacles: Screens, bodies: Indices, count: int) -> NDArray[np.bool_]:
    """Bodies, (count,), for whose cells and the edges around there is no time: in cities."""
    source = obstacles.prepared.images[0].place
    edges = sum(len(obstacles.outline(item, source).ends) for item in range(len(obstacles.items)))
    area = np.zeros(count)
    for body in bodies.tolist():
        area[body] = lengths(front_facets(obstacles, body).across).sum()
    order = np.argsort(area, kind="stable")
    is_too_large = np.zeros(count, dtype=bool)
    is_too_large[order] = np.cumsum(area[order]) / _COARSE_M**2 * edges > _MOST_PAIRS
    return is_too_large


def _coarse(obstacles: Screens, body: int) -> tuple[Facets, NDArray[np.bool_]]:
    """Facets of a body that it does not hide itself, in cells, and which of these are in part in
    the light, (n_cells,).
    """
    facets = front_facets(obstacles, body)
    if not len(facets):
        return facets, np.zeros(0, dtype=bool)
    facets = facets.divided(np.full(len(facets), _COARSE_M))
    return _seen(obstacles, in_voxels(facets, np.full(1, _COARSE_M)), body)


def _candidates(
    obstacles: Screens,
    facets: Facets,
    body: int,
    gain: Callable[[Array], Array],
    is_lit: NDArray[np.bool_],
) -> _Candidates:
    cells = cells_of(obstacles, facets, body)
    change = _change(obstacles, facets, cells, gain, is_lit)
    return _Candidates(body, obstacles, facets, change, cells)


def _finer(
    one: _Candidates, gain: Callable[[Array], Array], accepted: Accepted
) -> tuple[_Candidates, float]:
    """Those that count in cells as small as edges near them ask for; and what the rest may change,
    in amplitude.
    """
    left_out = 0.0
    for part in (_AWAY, _NEAR_BORDER):
        if not len(one.facets):
            break
        is_taken = _taken(one.change, accepted.limit[one.body] / 4, accepted.most)
        left_out += float(np.linalg.norm(one.change[~is_taken]))
        facets = one.facets.of_cells(is_taken)
        facets = _in_finer_cells(facets, one.cells.take(is_taken), part, accepted.fineness)
        facets, is_lit = _seen(one.obstacles, facets, one.body)
        if not len(facets):
            return one.take(np.zeros(len(one.change), dtype=bool)), left_out
        one = _candidates(one.obstacles, facets, one.body, gain, is_lit)
    return one, left_out


def _contributions(
    surface_of_object: NDArray[np.uint32],
    candidates: list[_Candidates],
    gain: Callable[[Array], Array],
    accepted: Accepted,
    left_out: Array,
) -> tuple[Contributions, Array]:
    """Of those cells that count the most, and what these are off by, (n_bodies,); the rest is added
    to ``left_out``, and all of it is by as much too large as the estimates of these.
    """
    estimate, level = np.zeros((2, len(left_out)))
    if not candidates:
        return Contributions.none(), level
    over = np.concatenate([c.change / accepted.limit[c.body] for c in candidates])
    most = accepted.most
    least = -np.partition(-over, most)[most] if most < len(over) else 0.0
    parts = []
    for one in candidates:
        limit = accepted.limit[one.body]
        is_taken = _taken(one.change, limit / 4, most) & (one.change > least * limit)
        left_out[one.body] += np.linalg.norm(one.change[~is_taken])
        if is_taken.any():
            facets, cells = one.facets.of_cells(is_taken), one.cells.take(is_taken)
            facets = _in_small_parts(one.obstacles, facets, cells, accepted.fineness)
            echoes, answered = cell_echoes(one.obstacles, facets, one.body, surface_of_object, gain)
            parts.append(echoes)
            changed = np.linalg.norm(one.change[is_taken])
            estimate[one.body] = np.hypot(estimate[one.body], changed)
            level[one.body] = np.hypot(level[one.body], answered)
    ratio = np.divide(level, estimate, out=np.ones_like(level), where=estimate > 0)
    left_out *= np.minimum(_OF_RATIO * ratio, 1.0)
    of_cells = np.minimum(_OF_CELLS * accepted.fineness * estimate, _OF_ECHOES * level)
    return Contributions.concatenate(parts), of_cells


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


def _in_finer_cells(facets: Facets, cells: Cells, part: float, fineness: float) -> Facets:
    """In cells as small as edges near them ask for."""
    size = np.minimum(_sizes(cells, part, fineness), _COARSE_M)
    return in_voxels(facets.divided(size[facets.cell]), size)


def _sizes(cells: Cells, part: float, fineness: float) -> Array:
    """Of cells, (n_cells,), across which the root of q changes by a ``part`` near shadows' borders
    and by `_AWAY` elsewhere.
    """
    share = np.where(cells.nearest < _BORDER / fineness, part, _AWAY)
    return np.maximum(fineness * share / np.maximum(cells.steepest, 1e-9), _FINEST_M)


def _seen(obstacles: Screens, facets: Facets, body: int) -> tuple[Facets, NDArray[np.bool_]]:
    """Facets that the body itself does not hide, and which of their cells are in part in the light,
    (n_cells,).
    """
    source = obstacles.prepared.images[0].place
    off = offset_m(facets.middle) * facets.normal(source)
    hit = first_hit(obstacles.prepared, facets.middle, off, source)
    is_seen = (hit < 0) | (obstacles.body[np.maximum(hit, 0)] != body)
    facets = facets.take(is_seen)
    _, cell = np.unique(facets.cell, return_inverse=True)
    facets = replace(facets, cell=cell.reshape(-1))
    is_lit = np.zeros(int(facets.cell.max(initial=-1)) + 1, dtype=bool)
    is_lit[facets.cell[hit[is_seen] < 0]] = True
    return facets, is_lit


def _in_small_parts(obstacles: Screens, facets: Facets, cells: Cells, fineness: float) -> Facets:
    """Facets across each of which waves are the same but for a linear phase, all over the band, cut
    along the border of the nearest edge's shadow where it is within their cell.
    """
    source = obstacles.prepared.images[0].place
    normal = np.where(cells.nearest[:, None] == 0, cells.across, 0.0)
    part = np.where(cells.nearest == 0, _OF_A_BORDER, _OF_A_CELL)
    size = part * np.minimum(_sizes(cells, _NEAR_BORDER, fineness), _COARSE_M)
    facets = facets.cut(source, normal[facets.cell])
    steep = facets.steepness(source)
    return facets.divided(np.minimum(size[facets.cell], _MOST_M / np.maximum(2 * steep, 1e-9)))


def _strength(obstacles: Screens, facets: Facets, gain: Callable[[Array], Array]) -> Array:
    """Echoes of facets, (n,), were each in phase all over."""
    towards = obstacles.prepared.images[0].place - facets.middle
    length = lengths(towards)
    back = towards / length[:, None]
    projected = np.abs(dots(facets.across, back))
    strength: Array = projected / (4 * np.pi * length**2) * gain(-back)
    return strength


def _change(
    obstacles: Screens,
    facets: Facets,
    cells: Cells,
    gain: Callable[[Array], Array],
    is_lit: NDArray[np.bool_],
) -> Array:
    """What waves over edges add to the echo of each cell, (n_cells,)."""
    k, cell, count = obstacles.wavenumber, facets.cell, len(cells.level)
    towards = obstacles.prepared.images[0].place - facets.middle
    length = lengths(towards)
    back, strength = towards / length[:, None], _strength(obstacles, facets, gain)
    wave = strength * facets.mean(2 * k * back) * np.exp(-2j * (k * length % (2 * np.pi)))
    echo = np.abs(np.bincount(cell, wave.real, count) + 1j * np.bincount(cell, wave.imag, count))
    # In the shadow both ways lead over edges.
    share = 2 * cells.level * is_lit + cells.level**2
    turned = strength * _turned(obstacles, facets, cells, back)
    turned_of_cell = np.sqrt(np.bincount(cell, turned**2, count))
    change: Array = echo * share
    change += turned_of_cell * np.where(is_lit, 2, np.minimum(cells.level, 1))
    return change


def _turned(obstacles: Screens, facets: Facets, cells: Cells, back: Array) -> Array:
    """Facets askew reflect waves that come over edges, from aside, by half the angle between the
    two ways: of each its share of an echo at right angles, (n,).
    """
    k, cell, across = obstacles.wavenumber, facets.cell, facets.across
    normal = across / np.maximum(lengths(across), 1e-300)[:, None]
    slope = 2 * k * (back - dots(back, normal)[:, None] * normal)
    aside = dots(slope, cells.across[cell])
    root_q = np.abs(aside) / k / np.sqrt(np.maximum(cells.aside[cell], 1e-300))
    is_there = root_q > cells.nearest[cell]
    is_there &= root_q**2 <= farthest(obstacles.faintest)
    in_phase = np.abs(facets.mean(slope - aside[:, None] * cells.across[cell]))
    return np.where(is_there, knife_edge_bound(root_q) * in_phase, 0.0)
