"""Echoes of cells of a body by waves over edges, there, back, or both.

To one place in each cell paths are sought. The facets of a cell answer as they do to the straight
wave, by the currents of physical optics, times the share of the waves there and back, which have at
every facet their own length, direction and knife-edge factor (`bends`): from cell to cell waves
over one edge go on without a step, which would echo by itself.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.blocking import first_hit
from twin.radar.propagation.diffraction.rims import is_strong, matching_pairs
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.diffraction.two_way_echoes import Ways, summed, sums
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.one_way.points import PointPaths, paths_to_points
from twin.radar.propagation.rows import dots, lengths
from twin.radar.scattering.arrays import ComplexVector3
from twin.radar.scattering.kernel import coefficients_at, radiating, reflected
from twin.radar.synthesis import Contributions
from twin.transfer import aligned, host, vector

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_FAINT_PAIRS = 0.1  # of the faintest single path: pairs of paths; behind a fence many add up


def cell_echoes(
    obstacles: Screens,
    facets: Facets,
    body: int,
    surface_of_object: NDArray[np.uint32],
    gain: Callable[[Array], Array],
) -> tuple[Contributions, float]:
    """Contributions of all facets of some cells of a body, by diffracted paths, without gains; and
    the root of the sum of squares of how much the echo of each cell, with gains, changes with each
    of the paths to it.
    """
    source = obstacles.prepared.images[0].place
    normal = facets.normal(source)
    hit = first_hit(obstacles.prepared, facets.middle, offset_m(facets.middle) * normal, source)
    is_own = (hit >= 0) & (obstacles.body[np.maximum(hit, 0)] == body)
    facets, normal, is_lit = facets.take(~is_own), normal[~is_own], hit[~is_own] < 0
    if not len(facets):
        return Contributions.none(), 0.0
    _, cell = np.unique(facets.cell, return_inverse=True)
    facets = replace(facets, cell=cell.reshape(-1))
    row = middle_facets(facets)
    place, off = facets.middle[row], (offset_m(facets.middle) * normal)[row]
    straight = paths_to_points(obstacles.prepared.context, 0, place, off, unshadowed=True)
    ways, cell_is_lit = _ways(obstacles, place, off, straight, body)
    none = Bends.none(source, place, obstacles.wavenumber)
    every = np.arange(len(place))
    alone = Ways(every, straight, none, every, every, np.ones(len(place), dtype=complex))
    current = radiated(obstacles, facets, straight.take(facets.cell), surface_of_object)
    # Facets beyond a border that divides their cell.
    step = cell_is_lit[facets.cell].astype(np.float64) - is_lit
    echoes, over_edges = summed(obstacles, facets, current, ways, straight.length)
    beyond, straight_on = summed(obstacles, facets, current * step, alone, straight.length)
    of_paths = _of_paths(ways, over_edges, straight_on)
    level = np.linalg.norm(gain(-straight.back)[ways.cell] * of_paths)
    return Contributions.concatenate([echoes, beyond]), float(level)


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


def middle_facets(facets: Facets) -> Indices:
    """The facet in the middle of each cell, (n_cells,)."""
    middle, cell = facets.middle, facets.cell
    weight = lengths(facets.across)
    total = np.bincount(cell, weight)
    center = np.stack([np.bincount(cell, weight * x) / total for x in middle.T], axis=1)
    order = np.lexsort((lengths(middle - center[cell]), cell))
    return order[np.unique(cell[order], return_index=True)[1]]


def _ways(
    obstacles: Screens, place: Array, off: Array, straight: PointPaths, body: int
) -> tuple[Ways, NDArray[np.bool_]]:
    """Of which at least one path is over an edge; and which cells are in the light, (n_cells,)."""
    own = np.full(len(place), body)
    context, source = obstacles.prepared.context, obstacles.prepared.images[0].place
    found = all_paths_to_points(context, obstacles, 0, place, off, own)
    paths, at, diffracted = found
    bends = Bends.of(source, place[at], diffracted, obstacles.wavenumber)
    share = found.over(straight)
    one, other = matching_pairs(at, at)
    one, other = one[one <= other], other[one <= other]
    two_way = share[one] * share[other]
    is_kept = is_strong(np.abs(two_way), 0 * one, _FAINT_PAIRS * obstacles.faintest)
    is_kept &= (paths.over[one] >= 0) | (paths.over[other] >= 0)
    is_lit = np.zeros(len(place), dtype=bool)
    is_lit[at[paths.over < 0]] = True
    return Ways(at, paths, bends, one[is_kept], other[is_kept], two_way[is_kept]), is_lit


def radiated(
    obstacles: Screens,
    facets: Facets,
    path: PointPaths,
    surface_of_object: NDArray[np.uint32],
) -> Complex:
    """Amplitude of each facet without spreading and without the phases across it: of its
    currents.
    """
    context, n = obstacles.prepared.context, len(facets.object)
    mi = context.mi
    across = facets.across
    area = lengths(across)
    facing = (np.sign(dots(across, path.back)) / area)[:, None] * across
    travel, normal, back = (vector(mi, v, "Vector3d") for v in (-path.back, facing, path.back))
    cosine = -(travel.x * normal.x + travel.y * normal.y + travel.z * normal.z)
    surface = mi.UInt32(aligned(surface_of_object[facets.object].astype(np.uint32)))
    row = coefficients_at(mi, context.table, surface, cosine, mi.Bool(True))
    parts = (path.field.real, path.field.imag)
    field = ComplexVector3(*(vector(mi, np.ascontiguousarray(v), "Vector3d") for v in parts))
    off = travel + 2 * cosine * normal
    current = radiating(field, reflected(field, travel, normal, row), travel, off, normal, back)
    current_re, current_im = host([current.re, current.im], n)
    received = np.sum(path.field * (current_re + 1j * current_im), axis=1)
    amplitude: Complex = -1j / (8 * np.pi) * area * received
    return amplitude
