"""Echoes of cells of a body by waves over edges, there, back, or both.

To one place in each cell paths are sought. The facets of a cell answer as they do to the straight
wave, by the currents of physical optics, times the share of the waves there and back, which have at
every facet their own length, direction and knife-edge factor (`bends`): from cell to cell waves
over one edge go on without a step, which would echo by itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.blocking import first_hit
from twin.radar.propagation.diffraction.rims import is_strong, matching_pairs
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.one_way.points import PointPaths, between, paths_to_points
from twin.radar.propagation.rows import dots, lengths
from twin.radar.scattering.arrays import ComplexVector3
from twin.radar.scattering.kernel import coefficients_at, radiating, reflected
from twin.radar.synthesis import Contributions
from twin.transfer import aligned, host, vector

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_BIN_M = 7.5e-3  # between lengths of contributions: 0.3 rad at the ends of a band of 4 GHz
_STEP = 20.0  # rad/m: half of what the wavenumber changes by to the ends of that band
_AT_ONCE = 2**18  # facets and pairs of paths: 100 MB


@dataclass(frozen=True, eq=False)
class _Ways:
    """Pairs of a forward and a return path to cells, (n,): ``cell``, ``forward`` and ``back`` path,
    where both bend, and the ``share`` of both waves over the straight one.
    """

    cell: Indices
    forward: PointPaths
    back: PointPaths
    bends: tuple[Bends, Bends]
    share: Complex


def cell_echoes(
    obstacles: Screens, facets: Facets, body: int, surface_of_object: NDArray[np.uint32]
) -> Contributions:
    """Contributions of all facets of some cells of a body, by diffracted paths, without gains."""
    source = obstacles.prepared.images[0].place
    normal = facets.normal(source)
    hit = first_hit(obstacles.prepared, facets.middle, offset_m(facets.middle) * normal, source)
    is_own = (hit >= 0) & (obstacles.body[np.maximum(hit, 0)] == body)
    facets, normal, is_lit = facets.take(~is_own), normal[~is_own], hit[~is_own] < 0
    if not len(facets):
        return Contributions.none()
    _, cell = np.unique(facets.cell, return_inverse=True)
    facets = replace(facets, cell=cell.reshape(-1))
    row = _places(facets)
    place, off = facets.middle[row], (offset_m(facets.middle) * normal)[row]
    straight = paths_to_points(obstacles.prepared.context, 0, place, off, unshadowed=True)
    ways, cell_is_lit = _ways(obstacles, place, off, straight, body)
    none = Bends.none(obstacles.prepared.images[0].place, place, obstacles.wavenumber)
    ones = np.ones(len(place), dtype=complex)
    alone = _Ways(np.arange(len(place)), straight, straight, (none, none), ones)
    current = _radiated(obstacles, facets, straight.take(facets.cell), surface_of_object)
    # Facets beyond a border that divides their cell.
    step = cell_is_lit[facets.cell].astype(np.float64) - is_lit
    parts = [
        _summed(obstacles, facets, current, ways, place, straight),
        _summed(obstacles, facets, current * step, alone, place, straight),
    ]
    return Contributions.concatenate(parts)


def _places(facets: Facets) -> Indices:
    """The facet in the middle of each cell, (n_cells,)."""
    middle, cell = facets.middle, facets.cell
    weight = lengths(facets.across)
    total = np.bincount(cell, weight)
    center = np.stack([np.bincount(cell, weight * x) / total for x in middle.T], axis=1)
    order = np.lexsort((lengths(middle - center[cell]), cell))
    return order[np.unique(cell[order], return_index=True)[1]]


def _ways(
    obstacles: Screens, place: Array, off: Array, straight: PointPaths, body: int
) -> tuple[_Ways, NDArray[np.bool_]]:
    """Of which at least one path is over an edge; and which cells are in the light, (n_cells,)."""
    own = np.full(len(place), body)
    context, source = obstacles.prepared.context, obstacles.prepared.images[0].place
    paths, at, diffracted = all_paths_to_points(context, obstacles, 0, place, off, own)
    bends = Bends.of(source, place[at], diffracted, obstacles.wavenumber)
    field = straight.field[at]
    power = np.sum(np.abs(field) ** 2, axis=1)
    share = np.sum(paths.field * field.conj(), axis=1) / np.where(power > 0, power, 1.0)
    there, back = matching_pairs(at, at)
    two_way = share[there] * share[back]
    is_kept = is_strong(np.abs(two_way), 0 * there, obstacles.faintest)
    is_kept &= (paths.over[there] >= 0) | (paths.over[back] >= 0)
    there, back = there[is_kept], back[is_kept]
    is_lit = np.zeros(len(place), dtype=bool)
    is_lit[at[paths.over < 0]] = True
    both = bends.take(there), bends.take(back)
    return _Ways(at[there], paths.take(there), paths.take(back), both, two_way[is_kept]), is_lit


def _summed(
    obstacles: Screens,
    facets: Facets,
    current: Complex,
    ways: _Ways,
    place: Array,
    straight: PointPaths,
) -> Contributions:
    """Contributions of facets with amplitudes (n,) by all ways to their cells; those of nearly the
    same path length as one.
    """
    size = np.bincount(facets.cell, minlength=len(place))[ways.cell]
    first = np.flatnonzero(np.diff(np.cumsum(size) // _AT_ONCE, prepend=-1))
    parts = []
    for rows in np.split(np.arange(len(size)), first[1:]):
        way, facet = matching_pairs(ways.cell[rows], facets.cell)
        way, facet = (x[current[facet] != 0] for x in (rows[way], facet))
        if len(way):
            some = facets.take(facet)
            parts.append(_of_ways(obstacles, some, current[facet], ways, way, place, straight))
    return Contributions.concatenate(parts)


def _of_ways(
    obstacles: Screens,
    facets: Facets,
    current: Complex,
    ways: _Ways,
    way: Indices,
    place: Array,
    straight: PointPaths,
) -> Contributions:
    """Of facets (n,) each by one way."""
    prepared, k, cell = obstacles.prepared, obstacles.wavenumber, facets.cell
    middle = facets.middle
    length = lengths(middle - prepared.images[0].place)
    one, other = (bends.to(way, middle) for bends in ways.bends)
    longer_m = 2 * (length - straight.length[cell]) + one.longer_m + other.longer_m
    both = one.back + other.back
    mean, less, more = facets.means(both, (k, k - _STEP, k + _STEP))
    amplitude = current * ways.share[way] * one.factor * other.factor
    # Of lengths beside that of the middle, with their waves.
    moment_m = amplitude * 1j * (more - less) / (2 * _STEP)
    amplitude = amplitude * mean
    # To two lengths each, beside the own one: right to first order all over the band, also where
    # facets next to each other nearly cancel.
    bin_number = np.floor(longer_m / _BIN_M).astype(np.int64)
    share = longer_m / _BIN_M - bin_number
    parts = [(1 - share) * amplitude - moment_m / _BIN_M, share * amplitude + moment_m / _BIN_M]
    bins = np.concatenate([bin_number, bin_number + 1])
    off_m = np.tile(longer_m, 2) - bins * _BIN_M
    sizes = (int(way.max()) + 1, int(facets.object.max()) + 1, int(np.ptp(bins)) + 1)
    keys = (np.tile(way, 2), np.tile(facets.object, 2), bins - bins.min())
    number = np.ravel_multi_index(keys, sizes)
    _, first, same = np.unique(number, return_index=True, return_inverse=True)
    count = len(first)
    wave = np.concatenate(parts) * np.exp(-1j * k * off_m)
    total = np.bincount(same, wave.real, count) + 1j * np.bincount(same, wave.imag, count)
    row = first % len(way)
    forward = ways.forward.take(way[row])
    forward = replace(forward, extra=forward.extra + bins[first] * _BIN_M)
    objects = facets.object[row]
    motion = prepared.motions.at(objects, middle[row])
    return between(forward, ways.back.take(way[row]), total, motion, objects)


def _radiated(
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
