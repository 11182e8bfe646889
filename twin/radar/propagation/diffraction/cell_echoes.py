"""Echoes of cells of a body by waves over edges, there, back, or both.

To one place in each cell paths are sought. The facets of a cell answer as they do to the straight
wave, by the currents of physical optics, times the share of the waves there and back, which have at
every facet their own length, direction and knife-edge factor (`bends`): from cell to cell waves
over one edge go on without a step, which would echo by itself.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.rims import is_strong
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import Facets, shown_facets
from twin.radar.propagation.diffraction.two_way_echoes import Ways, summed, sums
from twin.radar.propagation.diffraction.views import TwoViews, View
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.one_way.points import PointPaths
from twin.radar.rows import dots, lengths, matching_pairs
from twin.radar.scattering.arrays import ComplexVector3
from twin.radar.scattering.kernel import coefficients_at, radiating, reflected
from twin.radar.synthesis import Contributions
from twin.transfer import aligned, host, vector

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

#: By how much more waves to a cell may be off where some lead over two edges in a row: those over
#: an end of either are left out.
_OVER_TWO = 2.0
_FAINT_PAIRS = 0.1  # of the faintest single path: pairs of paths; behind a fence many add up


def cell_echoes(
    views: TwoViews,
    facets: Facets,
    body: int,
    surface_of_object: NDArray[np.uint32],
    gain: Callable[[Array], Array],
) -> tuple[Contributions, float, float]:
    """Contributions of all facets of some cells of a body, by diffracted paths of two views,
    without gains; the root of the sum of squares of how much the echo of each cell, with gains,
    changes with each of the paths to it; and the same with as much more of cells as waves to them
    may be off by more than to others.
    """
    facets, is_lit = shown_facets(views, facets, body)
    if not len(facets):
        return Contributions.none(), 0.0, 0.0
    row = middle_facets(facets, *(view.place for view in views.each))
    place, normal = facets.middle[row], facets.normal(views.one.place)[row]
    off = offset_m(place) * normal
    straight = [view.straight(place, off) for view in views.each]
    found = [
        _OneWay.of(view, place, off, path, body)
        for view, path in zip(views.each, straight, strict=True)
    ]
    ways = _ways(found, views.one.obstacles.faintest)
    current = _radiated_both(views, facets, straight, surface_of_object)
    # Facets beyond a border that divides their cell.
    cell_is_lit = np.all([one.is_lit for one in found], axis=0)
    step = cell_is_lit[facets.cell].astype(np.float64) - is_lit.all(axis=0)
    echoes, over_edges = summed(views.one.obstacles, facets, current, ways)
    alone = _straight(views, place, straight)
    beyond, straight_on = summed(views.one.obstacles, facets, current * step, alone)
    of_paths = _of_paths(ways, over_edges, straight_on)
    gains = np.sqrt(gain(straight[0].departure) * gain(straight[-1].departure))
    level = np.abs(gains[ways.cell] * of_paths)
    has_twice = np.bincount(ways.cell, ways.bends.is_twice) > 0
    unsure = level * np.where(has_twice[ways.cell], _OVER_TWO, 1.0)
    both = Contributions.concatenate([*echoes, *beyond])
    return both, float(np.linalg.norm(level)), float(np.linalg.norm(unsure))


def _of_paths(ways: Ways, over_edges: Complex, beyond: Complex) -> Complex:
    """By how much an echo changes over how much each path over edges does, (n_paths,): by all ways
    that take it, there and back. What lies ``beyond`` a border in a cell, (n_cells,), continues the
    strongest.
    """
    both = np.concatenate([ways.one, ways.other])
    found = sums(both, np.tile(over_edges, 2), len(ways.cell))
    found[ways.paths.over < 0] = 0
    order = np.lexsort((np.abs(found), ways.cell))[::-1]
    cells, strongest = np.unique(ways.cell[order], return_index=True)
    found[order[strongest]] += beyond[cells]
    return found


def middle_facets(facets: Facets, *places: Array) -> Indices:
    """The facet in the middle of each cell as seen from places (3,), (n_cells,): not one that is
    far from square to any way, which the body may hide from waves that the others are reached by.
    """
    middle, cell = facets.middle, facets.cell
    towards = [place - middle for place in places]
    weight = np.min([np.abs(dots(facets.across, way)) / lengths(way) for way in towards], axis=0)
    total = np.maximum(np.bincount(cell, weight), 1e-300)
    center = np.stack([np.bincount(cell, weight * x) / total for x in middle.T], axis=1)
    facing = weight / lengths(facets.across)
    off = lengths(middle - center[cell]) / np.maximum(facing, 1e-3)
    order = np.lexsort((off, cell))
    return order[np.unique(cell[order], return_index=True)[1]]


class _OneWay(NamedTuple):
    """Paths by one view, direct ones and over edges, the ``cell`` that each leads to, their bends,
    and their waves over the straight ones, (n_paths,); and which cells are lit, (n_cells,).
    """

    paths: PointPaths
    cell: Indices
    bends: Bends
    share: Complex
    is_lit: NDArray[np.bool_]

    @staticmethod
    def of(view: View, place: Array, off: Array, straight: PointPaths, body: int) -> "_OneWay":
        """To a place in each cell."""
        obstacles, own = view.obstacles, np.full(len(place), body)
        context = obstacles.prepared.context
        found = all_paths_to_points(context, obstacles, view.number, place, off, own)
        cell = found.point
        bends = Bends.of(view.place, place[cell], found.diffracted, obstacles.wavenumber)
        is_lit = np.zeros(len(place), dtype=bool)
        is_lit[cell[found.paths.over < 0]] = True
        return _OneWay(found.paths, cell, bends, found.over(straight), is_lit)


def _ways(found: Sequence[_OneWay], faintest: float) -> Ways:
    """There by one of the paths of a view, and back by one of the other view's or of the same one,
    of which at least one is over an edge.
    """
    paths = PointPaths.concatenate([one.paths for one in found])
    bends = Bends.concatenate([one.bends for one in found])
    cell, share = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("cell", "share")
    )
    one, other = matching_pairs(found[0].cell, found[-1].cell)
    if len(found) == 1:
        one, other = one[one <= other], other[one <= other]
    else:
        other = other + len(found[0].cell)
    two_way = share[one] * share[other]
    is_kept = is_strong(np.abs(two_way), 0 * one, _FAINT_PAIRS * faintest)
    is_kept &= (paths.over[one] >= 0) | (paths.over[other] >= 0)
    return Ways(cell, paths, bends, one[is_kept], other[is_kept], two_way[is_kept])


def _straight(views: TwoViews, place: Array, straight: Sequence[PointPaths]) -> Ways:
    """There and back without obstacles."""
    k, every = views.one.obstacles.wavenumber, np.arange(len(place))
    bends = Bends.concatenate([Bends.none(view.place, place, k) for view in views.each])
    back = every + len(place) * (len(straight) - 1)
    share = np.ones(len(place), dtype=complex)
    cell = np.tile(every, len(straight))
    return Ways(cell, PointPaths.concatenate(straight), bends, every, back, share)


def _radiated_both(
    views: TwoViews,
    facets: Facets,
    straight: Sequence[PointPaths],
    surface_of_object: NDArray[np.uint32],
) -> Complex:
    """Amplitude of each facet as of `radiated`, of two different views in the mean of both
    directions, whose currents differ.
    """
    there, back = (straight[k].take(facets.cell) for k in (0, -1))
    one = radiated(views.one.obstacles, facets, there, back, surface_of_object)
    if views.are_same:
        return one
    return (one + radiated(views.one.obstacles, facets, back, there, surface_of_object)) / 2


def radiated(
    obstacles: Screens,
    facets: Facets,
    there: PointPaths,
    back: PointPaths,
    surface_of_object: NDArray[np.uint32],
) -> Complex:
    """Amplitude of each facet without spreading and without the phases across it: of the currents
    of the wave ``there``, as what goes ``back`` is received.
    """
    context, n = obstacles.prepared.context, len(facets.object)
    mi = context.mi
    across = facets.across
    area = lengths(across)
    facing = (np.sign(dots(across, there.back)) / area)[:, None] * across
    travel, normal, home = (vector(mi, v, "Vector3d") for v in (-there.back, facing, back.back))
    cosine = -(travel.x * normal.x + travel.y * normal.y + travel.z * normal.z)
    surface = mi.UInt32(aligned(surface_of_object[facets.object].astype(np.uint32)))
    row = coefficients_at(mi, context.table, surface, cosine, mi.Bool(True))
    parts = (there.field.real, there.field.imag)
    field = ComplexVector3(*(vector(mi, np.ascontiguousarray(v), "Vector3d") for v in parts))
    off = travel + 2 * cosine * normal
    current = radiating(field, reflected(field, travel, normal, row), travel, off, normal, home)
    current_re, current_im = host([current.re, current.im], n)
    received = np.sum(back.field * (current_re + 1j * current_im), axis=1)
    amplitude: Complex = -1j / (8 * np.pi) * area * received
    return amplitude
