"""Echoes of facets by two paths each, one there and one back, of the paths to their cells.

Across a facet the length and the amplitude of a wave are linear between the corners: facets that
share corners go on without a step, which would echo by itself. A cell with p paths has
p (p + 1) / 2 pairs of them, so that what a path is at a corner is computed once for each path;
phasors and amplitudes of two paths multiply.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.diffraction.triangle_means import mean_waves
from twin.radar.propagation.one_way.points import PointPaths, between
from twin.radar.rows import alike, first_rows, lengths, matching_pairs, phasors
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_BIN_M = 0.01  # between lengths of contributions: 0.4 rad at the ends of a band of 4 GHz
#: Change of the wavenumber in rad/m to the outer two of that band's three Chebyshev nodes.
_STEP = 36.0
_AT_ONCE = 2**16  # facets and pairs of paths: 50 MB
_MOST_ASKEW = 5.0  # times as much of a facet's current: one along the straight wave has none
_ALIKE_M = 1e-8  # corners of facets that are one


@dataclass(frozen=True, eq=False)
class Ways:
    """Pairs of a forward and a return path to places in cells.

    ``paths`` and ``bends`` (m,) of single paths, and the ``cell`` (m,) of each; ``one`` and
    ``other`` (n,): rows of both paths of each pair, which stands for both directions; ``share``
    (n,): of both waves over the straight one.
    """

    cell: Indices
    paths: PointPaths
    bends: Bends
    one: Indices
    other: Indices
    share: Complex


@dataclass(frozen=True, eq=False)
class _Corners:
    """Corners of facets, those of one place in a cell as one, by cells: places (m, 3), the ``cell``
    (m,) of each, and their numbers in it of the facets' corners, (3, n).
    """

    place: Array
    cell: Indices
    of_facet: Indices

    @staticmethod
    def of(facets: Facets) -> "_Corners":
        place, cell = facets.corners.reshape(-1, 3), np.repeat(facets.cell, 3)
        grid = np.rint(place / _ALIKE_M).astype(np.int64)
        number = alike([cell, *grid.T])
        one = first_rows(number)
        first = np.searchsorted(cell[one], cell)
        return _Corners(place[one], cell[one], (number - first).reshape(-1, 3).T)


@dataclass(frozen=True, eq=False)
class _Legs:
    """Paths at corners of facets, path by path, (n,): by how much each is longer than the straight
    path to the place where it is known; its factor over that there; and phasors of that length, at
    the carrier and for `_STEP`. ``first``: row of each path's first corner.
    """

    first: Indices
    longer_m: Array
    factor: Complex
    phasor: Complex
    step: Complex

    @property
    def waves(self) -> tuple[Array, Complex, Complex, Complex]:
        """As `mean_waves` takes them."""
        return self.longer_m, self.factor, self.phasor, self.step

    @staticmethod
    def of(obstacles: Screens, corners: _Corners, ways: Ways, paths: Indices) -> "_Legs":
        """Of some paths, by number, at all corners of their cells."""
        row, corner = matching_pairs(ways.cell[paths], corners.cell)
        k, place, path = obstacles.wavenumber, corners.place[corner], paths[row]
        change = ways.bends.to(path, place)
        straight = lengths(place - ways.bends.source[path])
        longer_m = straight - ways.paths.length[path] + change.longer_m
        return _Legs(
            np.searchsorted(row, np.arange(len(paths))),
            longer_m,
            change.factor,
            phasors(-(k * longer_m % (2 * np.pi))),
            phasors(-_STEP * longer_m),
        )


def summed(
    obstacles: Screens, facets: Facets, current: Complex, ways: Ways
) -> tuple[list[Contributions], Complex]:
    """Contributions of facets with amplitudes (n,) by all ways to their cells; those of nearly the
    same path length as one. And the sum over each way at the carrier, (n_ways,), without the
    internal reflections of walls.
    """
    total = np.zeros(len(ways.one), dtype=np.complex128)
    some = np.flatnonzero(current)
    some = some[np.lexsort((facets.object[some], facets.cell[some]))]
    facets, current = facets.take(some), current[some]
    corners = _Corners.of(facets)
    rows = np.argsort(ways.cell[ways.one], kind="stable")
    count = int(ways.cell.max(initial=-1)) + 1
    size = np.bincount(facets.cell, minlength=count)[ways.cell[ways.one[rows]]]
    rows, size = rows[size > 0], size[size > 0]
    first = np.flatnonzero(np.diff(np.cumsum(size) // _AT_ONCE, prepend=-1))
    portions = np.split(rows, first[1:]) if len(rows) else []
    parts = []
    for portion in portions:
        found, total[portion] = _of_ways(obstacles, facets, corners, current, ways, portion)
        parts.append(found)
    return parts, total


def _of_ways(
    obstacles: Screens,
    facets: Facets,
    corners: _Corners,
    current: Complex,
    ways: Ways,
    rows: Indices,
) -> tuple[Contributions, Complex]:
    """By some of the ways, of facets sorted by cells and, in each, by objects; and of each way, at
    the carrier.
    """
    both = np.stack([ways.one[rows], ways.other[rows]])
    paths, number = np.unique(both, return_inverse=True)
    legs = _Legs.of(obstacles, corners, ways, paths)
    way, facet = matching_pairs(ways.cell[both[0]], facets.cell)
    ends, k = number.reshape(both.shape)[:, way], obstacles.wavenumber
    means, longer_m = mean_waves(legs.waves, legs.first[ends], corners.of_facet, facet, k, _STEP)
    askew = _askew(ways, paths, ends, facets.across, facet)
    less, mean, more = current[facet] * ways.share[rows][way] * askew * means
    total, pair, bins = _binned(
        less,
        mean,
        more,
        longer_m,
        way * (int(facets.object.max()) + 1) + facets.object[facet],
        k,
    )
    found = _both_ways(obstacles, facets.take(facet[pair]), total, ways, both[:, way[pair]], bins)
    return found, sums(way, mean, len(rows)) * _spread(obstacles, ways, both)


def _askew(ways: Ways, paths: Indices, ends: Indices, normal: Array, facet: Indices) -> Array:
    """By how much more current each ``facet`` (n,) of some with normals (m, 3) has of the waves of
    two paths, rows ``ends`` (2, n) of some ``paths``, than of the straight waves, whose currents
    they are given: currents grow with the cosines of these.
    """
    straight = ways.bends.source[paths] - ways.bends.known[paths]
    straight /= lengths(straight)[:, None]
    share: Array = kernel(_more_facing)(normal, facet, ways.paths.back[paths], straight, *ends)
    return share


def _more_facing(
    normals: Array, facet: Indices, own: Array, given: Array, one: Indices, other: Indices
) -> Array:
    share = np.ones(len(facet))
    for i in range(len(facet)):
        normal, p, q = normals[facet[i]], one[i], other[i]
        faces, facing = 0.0, 0.0
        for axis in range(3):
            faces += normal[axis] * (own[p, axis] + own[q, axis])
            facing += normal[axis] * (given[p, axis] + given[q, axis])
        # Edge-on to the straight waves, a facet has no current of them, whatever the factor.
        if facing != 0:
            share[i] = min(max(faces / facing, 0.0), _MOST_ASKEW)
    return share


def _spread(obstacles: Screens, ways: Ways, ends: Indices) -> Complex:
    """Phases and spreading, (n,), of pairs of paths (2, n), out by one and back by the other, and
    the reverse.
    """
    some = ways.paths.take(ends)
    length_m = some.length + some.extra
    waves = phasors(-(obstacles.wavenumber * length_m % (2 * np.pi))) / some.length
    spread: Complex = np.where(ends[0] == ends[1], 1, 2) * waves.prod(axis=0)
    return spread


def _both_ways(
    obstacles: Screens, facets: Facets, total: Complex, ways: Ways, ends: Indices, bins: Indices
) -> Contributions:
    """Contributions at facets (n,) by pairs of paths (2, n), out by one and back by the other and,
    where these differ, the reverse.
    """
    every = np.concatenate([np.arange(len(total)), np.flatnonzero(ends[0] != ends[1])])
    there, back = np.concatenate([ends, ends[::-1, ends[0] != ends[1]]], axis=1)
    forward = ways.paths.take(there)
    forward = replace(forward, extra=forward.extra + bins[every] * _BIN_M)
    objects, place = facets.object[every], facets.middle[every]
    motion = obstacles.prepared.motions.at(objects, place)
    return between(forward, ways.paths.take(back), total[every], motion, objects)


def sums(owner: Indices, wave: Complex, count: int) -> Complex:
    """Sums of waves by owner, (count,)."""
    real, imag = (np.bincount(owner, part, count) for part in (wave.real, wave.imag))
    return np.asarray(real + 1j * imag)


def _binned(
    less: Complex, mean: Complex, more: Complex, longer_m: Array, group: Indices, wavenumber: float
) -> tuple[Complex, Indices, Indices]:
    """Sums of waves (n,) of nearly one length and one ``group``, of which equal ones stand
    together; of each wave at the carrier less `_STEP`, at the carrier, and as much above. It is
    divided between the three lengths next to its own one so that it is right at all three, also
    where facets next to each other nearly cancel.

    Returns the sums without the phases of their lengths, the first wave of each, and the number of
    its length.
    """
    waves = [np.ascontiguousarray(wave) for wave in (less, mean, more)]
    total, first, number = kernel(_in_bins)(*waves, longer_m, group)
    return total * phasors(wavenumber * _BIN_M * number % (2 * np.pi)), first, number


def _in_bins(
    less: Complex,
    mean: Complex,
    more: Complex,
    longer_m: Array,
    group: Indices,
) -> tuple[Complex, Indices, Indices]:
    """As of `_binned`, with the phases of lengths.

    Amplitudes at lengths of -`_BIN_M`, 0 and `_BIN_M` whose sums are a wave at three wavenumbers
    solve three equations.
    """
    count = len(mean)
    total = np.zeros(3 * count, dtype=np.complex128)
    first, number = np.empty((2, 3 * count), dtype=np.int64)
    cosine, sine = np.cos(_STEP * _BIN_M), np.sin(_STEP * _BIN_M)
    middle, least = np.empty(count, dtype=np.int64), 2**62
    for i in range(count):
        middle[i] = np.int64(np.rint(longer_m[i] / _BIN_M))
        least = min(least, middle[i] - 1)
    steps = middle.max() + 2 - least if count else 0
    turn = np.exp(1j * (_STEP * _BIN_M * (least + np.arange(steps))))
    sums, owner = np.zeros(steps, dtype=np.complex128), np.full(steps, -1)
    begin, filled = 0, 0
    while begin < count:
        end, low, high = begin, middle[begin], middle[begin]
        while end < count and group[end] == group[begin]:
            low, high = min(low, middle[end]), max(high, middle[end])
            at = middle[end] - least
            lower, center, upper = less[end] * turn[at].conjugate(), mean[end], more[end] * turn[at]
            both = (center - (upper + lower) / 2) / (1 - cosine)
            difference = 1j * (upper - lower) / (2 * sine)
            sums[at - 1] += (both - difference) / 2
            sums[at] += center - both
            sums[at + 1] += (both + difference) / 2
            for k in range(at - 1, at + 2):
                if owner[k] < 0:
                    owner[k] = end
            end += 1
        for k in range(low - 1 - least, high + 2 - least):
            if owner[k] >= 0:
                total[filled], first[filled], number[filled] = sums[k], owner[k], k + least
                sums[k], owner[k] = 0, -1
                filled += 1
        begin = end
    return total[:filled], first[:filled], number[:filled]
