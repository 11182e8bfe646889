"""Cells of bodies in which waves over edges may count, as small as the edges near them ask for.

What such waves add to the echo of a cell is estimated without rays: its echo without obstacles, or
that of facets askew to waves from aside, times the levels of the waves near it (`shadow_bounds`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.shadow_bounds import (
    Cells,
    borders_of,
    cells_of,
    knife_edge_bound,
)
from twin.radar.propagation.diffraction.shadowed_facets import (
    Facets,
    front_facets,
    in_voxels,
    shown_facets,
)
from twin.radar.propagation.diffraction.views import TwoViews, View
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
Gain = Callable[[Array], Array]

COARSE_M = 0.1  # facets that an estimate is made for before they are divided as finely as needed
_FINEST_M = 0.01  # cells
#: Change of the root of the phase q across a cell, near a shadow's border and away from it, at a
#: tolerance of 0.1.
_NEAR_BORDER, _AWAY = 0.4, 1.0
_BORDER = 1.0  # root of q that is near, at that tolerance
#: Facets at most, over their cell; and where a border, or several of them, may divide them.
_OF_A_CELL, _OF_A_BORDER = 0.5, 0.33
#: Difference of lengths there and back across a facet: 0.6 rad beside the middle at the ends of a
#: band of 4 GHz.
_MOST_M = 0.03


@dataclass(frozen=True, eq=False)
class Candidates:
    """Facets of a body in cells, what waves over edges on the ways of two views may change in each,
    (n_cells,), and the cells as each view's waves reach them.
    """

    body: int
    views: TwoViews
    facets: Facets
    change: Array
    cells: tuple[Cells, ...]

    @staticmethod
    def of(views: TwoViews, facets: Facets, body: int, gain: Gain, is_lit: Flags) -> "Candidates":
        """Of facets in cells, some of which each view lights, (n_views, n_cells)."""
        cells = tuple(cells_of(view, facets, body) for view in views.each)
        unknown = Candidates(body, views, facets, np.zeros(is_lit.shape[1]), cells)
        return Candidates(body, views, facets, _change(unknown, gain, is_lit), cells)

    def take(self, which: Flags) -> "Candidates":
        """Only those in some of the cells."""
        cells = tuple(cells.take(which) for cells in self.cells)
        facets = self.facets.of_cells(which)
        return Candidates(self.body, self.views, facets, self.change[which], cells)

    def other_ways(self, is_lit: Flags, apart: "Candidates | None" = None) -> Array:
        """Of what waves over edges add on the ways of each view, (n_views, n_cells): the level of
        the other way over the straight one. In the shadow of a single view either wave is counted
        once; but for those that are followed ``apart``, beside which the others alone are.
        """
        levels = np.array([np.minimum(cells.level, 1) for cells in self.cells])
        if apart is not None:
            levels += [np.minimum(cells.level, 1) for cells in apart.cells]
        return np.where(is_lit, 1, levels / 2)[::-1]


def coarse(views: TwoViews, body: int) -> tuple[Facets, Flags]:
    """Facets of a body that it does not hide itself, in cells, and which of these each view lights
    in part, (n_views, n_cells).
    """
    places = [view.place for view in views.each]
    facets = front_facets(views.one.obstacles, body, *places)
    if not len(facets):
        return facets, np.zeros((len(places), 0), dtype=bool)
    facets = facets.divided(np.full(len(facets), COARSE_M))
    return _seen(views, in_voxels(facets, np.full(1, COARSE_M)), body)


def finer(
    one: Candidates, gain: Gain, fineness: float, taken: Callable[[Array], Flags]
) -> tuple[Candidates, float]:
    """Those cells that are ``taken`` by what changes in them, in cells as small as edges near them
    ask for; and what the rest may change, in amplitude.
    """
    left_out = 0.0
    for part in (_AWAY, _NEAR_BORDER):
        is_taken = taken(one.change)
        left_out += float(np.linalg.norm(one.change[~is_taken]))
        some = one.take(is_taken)
        if not len(some.facets):
            return some, left_out
        size = np.minimum(_sizes(some.cells, part, fineness), COARSE_M)
        facets = in_voxels(some.facets.divided(size[some.facets.cell]), size)
        facets, is_lit = _seen(one.views, facets, one.body)
        if not len(facets):
            return some.take(np.zeros(len(some.change), dtype=bool)), left_out
        one = Candidates.of(one.views, facets, one.body, gain, is_lit)
    return one, left_out


def in_small_parts(one: Candidates, fineness: float) -> Facets:
    """Facets across each of which lengths and amplitudes of waves are about linear, all over the
    band, cut along the borders of shadows within their cell.
    """
    facets, has_border = one.facets, np.zeros(len(one.change), dtype=bool)
    for view in one.views.each:
        cell, normal = borders_of(view, one.facets, one.body)
        has_border[cell] = True
        facets = _cut(facets, view.place, cell, normal)
    size = np.where(has_border, _OF_A_BORDER, _OF_A_CELL)
    size *= np.minimum(_sizes(one.cells, _NEAR_BORDER, fineness), COARSE_M)
    steep = facets.steepness(one.views.one.place) + facets.steepness(one.views.other.place)
    return facets.divided(np.minimum(size[facets.cell], _MOST_M / np.maximum(steep, 1e-9)))


def _cut(facets: Facets, place: Array, cell: Indices, normal: Array) -> Facets:
    """Facets cut at planes through one place, those of each ``cell`` at its own ones, (n, ...)."""
    number = np.arange(len(cell)) - np.searchsorted(cell, cell)
    for n in range(int(number.max(initial=-1)) + 1):
        is_now = number == n
        plane = np.full(int(facets.cell.max()) + 1, -1)
        plane[cell[is_now]] = np.flatnonzero(is_now)
        has_plane = plane[facets.cell] >= 0
        some, rest = facets.take(has_plane), facets.take(~has_plane)
        facets = Facets.concatenate([rest, some.cut(place, normal[plane[some.cell]])])
    return facets


def strength(views: TwoViews, facets: Facets, gain: Gain) -> Array:
    """Echoes of facets, (n,), were each in phase all over, both ways if the views differ."""
    backs, lengths_m = _ways(views, facets)
    projected = np.abs(dots(facets.across, backs[0] + backs[-1])) / 2
    gains = [gain(-view.departure(back)) for view, back in zip(views.each, backs, strict=True)]
    level = projected / (4 * np.pi * lengths_m[0] * lengths_m[-1])
    level *= np.sqrt(gains[0] * gains[-1])
    for view in (views.one, views.other):
        level *= view.reflected(facets.middle)
    both: Array = level if views.are_same else 2 * level
    return both


def _ways(views: TwoViews, facets: Facets) -> tuple[list[Array], list[Array]]:
    """From facets to each view's place: unit vectors (n, 3), and lengths (n,)."""
    towards = [view.place - facets.middle for view in views.each]
    lengths_m = [lengths(way) for way in towards]
    return [way / m[:, None] for way, m in zip(towards, lengths_m, strict=True)], lengths_m


def _seen(views: TwoViews, facets: Facets, body: int) -> tuple[Facets, Flags]:
    """Facets that the body itself does not hide, and which of their cells each view lights in part,
    (n_views, n_cells).
    """
    facets, is_lit = shown_facets(views, facets, body)
    cells = np.zeros((len(is_lit), int(facets.cell.max(initial=-1)) + 1), dtype=bool)
    for view, lit in enumerate(is_lit):
        cells[view, facets.cell[lit]] = True
    return facets, cells


def _sizes(cells: tuple[Cells, ...], part: float, fineness: float) -> Array:
    """Of cells, (n_cells,), across which the root of q changes by a ``part`` near shadows' borders
    and by `_AWAY` elsewhere.
    """
    sizes = []
    for one in cells:
        share = np.where(one.nearest < _BORDER / fineness, part, _AWAY)
        sizes.append(np.maximum(fineness * share / np.maximum(one.steepest, 1e-9), _FINEST_M))
    smallest: Array = np.min(sizes, axis=0)
    return smallest


def _change(one: Candidates, gain: Gain, is_lit: Flags) -> Array:
    """What waves over edges add to the echo of each cell, (n_cells,)."""
    views, facets, cells = one.views, one.facets, one.cells
    k, cell, count = views.one.obstacles.wavenumber, facets.cell, len(one.change)
    backs, lengths_m = _ways(views, facets)
    level, both = strength(views, facets, gain), k * (backs[0] + backs[-1])
    wave = (
        level * facets.mean(both) * np.exp(-1j * (k * (lengths_m[0] + lengths_m[-1]) % (2 * np.pi)))
    )
    echo = np.abs(np.bincount(cell, wave.real, count) + 1j * np.bincount(cell, wave.imag, count))
    # In the shadow both ways lead over edges.
    whole = [lit + of_view.level for lit, of_view in zip(is_lit, cells, strict=True)]
    change: Array = echo * (whole[0] * whole[-1] - (is_lit[0] & is_lit[-1]))
    for view, of_view, way in zip(views.each, cells, one.other_ways(is_lit), strict=True):
        turned = level * _turned(view, facets, of_view, both)
        times = 2 if views.are_same else 1
        change += times * way * np.sqrt(np.bincount(cell, turned**2, count))
    return change


def _turned(view: View, facets: Facets, cells: Cells, both: Array) -> Array:
    """Facets askew reflect waves that come over edges, from aside, by half the angle between the
    two ways: of each its share of an echo at right angles, (n,). ``both`` (n, 3): the sum of unit
    vectors along both straight ways, in rad/m.
    """
    k, cell, across = view.obstacles.wavenumber, facets.cell, facets.across
    normal = across / np.maximum(lengths(across), 1e-300)[:, None]
    slope = both - dots(both, normal)[:, None] * normal
    aside = dots(slope, cells.across[cell])
    root_q = np.abs(aside) / k / np.sqrt(np.maximum(cells.aside[cell], 1e-300))
    is_there = root_q > cells.nearest[cell]
    is_there &= root_q**2 <= farthest(view.obstacles.faintest)
    in_phase = np.abs(facets.mean(slope - aside[:, None] * cells.across[cell]))
    return np.where(is_there, knife_edge_bound(root_q) * in_phase, 0.0)
