"""Echoes of facets by two paths each, one there and one back, of the paths to their cells.

A cell with p paths has p (p + 1) / 2 pairs of them, so that what a path is at a facet is computed
once for each path: how much longer it is, its factor, and phasors of its lengths to the corners,
which multiply for two paths.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.rims import matching_pairs
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import FLAT_RAD, Facets
from twin.radar.propagation.one_way.points import PointPaths, between
from twin.radar.rows import dots, lengths, phasors
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_BIN_M = 7.5e-3  # between lengths of contributions: 0.3 rad at the ends of a band of 4 GHz
_STEP = 20.0  # rad/m: half of what the wavenumber changes by to the ends of that band
_AT_ONCE = 2**16  # facets and pairs of paths: 50 MB
_SHORT_RAD = 1e-3  # half the phase along an edge, below which its square is enough
#: Corners in the order of their values x, y, z, by the number x > y, plus 2 where x > z, plus 4
#: where y > z; 2 and 5 do not occur.
_ORDER = np.array(
    [[0, 1, 2], [1, 0, 2], [0, 1, 2], [1, 2, 0], [0, 2, 1], [2, 1, 0], [2, 0, 1], [2, 1, 0]]
)


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
class _Legs:
    """Paths at facets, path by path, (n, ...): by how much each is longer than the straight path
    to the place where it is known; its factor over that there; path lengths from the centroid to
    the corners, (3, n), phasors of half of these at the carrier, and by how much these turn over
    `_STEP`; and the phasor of what is longer. ``first``: row of each path's first facet.
    """

    first: Indices
    longer_m: Array
    factor: Complex
    corners_m: Array
    half: Complex
    half_step: Complex
    turn: Complex

    @staticmethod
    def of(obstacles: Screens, facets: Facets, ways: Ways, paths: Indices) -> "_Legs":
        """Of some paths, by number, at all facets of their cells."""
        row, facet = matching_pairs(ways.cell[paths], facets.cell)
        k, some = obstacles.wavenumber, facets.take(facet)
        middle = some.middle
        change = ways.bends.to(paths[row], middle)
        straight = lengths(middle - ways.bends.source[paths[row]])
        longer_m = straight - ways.paths.length[paths[row]] + change.longer_m
        corners = some.corners - middle[:, None]
        corners_m = np.stack([dots(corners[:, i], change.back) for i in range(3)])
        return _Legs(
            np.searchsorted(row, np.arange(len(paths))),
            longer_m,
            change.factor,
            corners_m,
            phasors(k * corners_m / 2),
            phasors(_STEP * corners_m / 2),
            phasors(-(k * longer_m % (2 * np.pi))),
        )


def summed(
    obstacles: Screens, facets: Facets, current: Complex, ways: Ways
) -> tuple[Contributions, Complex]:
    """Contributions of facets with amplitudes (n,) by all ways to their cells; those of nearly the
    same path length as one. And the sum over each way at the carrier, (n_ways,), without the
    internal reflections of walls.
    """
    total = np.zeros(len(ways.one), dtype=np.complex128)
    some = np.flatnonzero(current)
    some = some[np.lexsort((facets.object[some], facets.cell[some]))]
    facets, current = facets.take(some), current[some]
    rows = np.argsort(ways.cell[ways.one], kind="stable")
    count = int(ways.cell.max(initial=-1)) + 1
    size = np.bincount(facets.cell, minlength=count)[ways.cell[ways.one[rows]]]
    rows, size = rows[size > 0], size[size > 0]
    first = np.flatnonzero(np.diff(np.cumsum(size) // _AT_ONCE, prepend=-1))
    portions = np.split(rows, first[1:]) if len(rows) else []
    parts = []
    for portion in portions:
        found, total[portion] = _of_ways(obstacles, facets, current, ways, portion)
        parts.append(found)
    return Contributions.concatenate(parts), total


def _of_ways(
    obstacles: Screens,
    facets: Facets,
    current: Complex,
    ways: Ways,
    rows: Indices,
) -> tuple[Contributions, Complex]:
    """By some of the ways, of facets sorted by cells and, in each, by objects; and of each way, at
    the carrier.
    """
    both = np.stack([ways.one[rows], ways.other[rows]])
    paths, number = np.unique(both, return_inverse=True)
    legs = _Legs.of(obstacles, facets, ways, paths)
    way, facet = matching_pairs(ways.cell[both[0]], facets.cell)
    size = np.bincount(way, minlength=len(rows))
    within = np.arange(len(way)) - np.repeat(np.cumsum(size) - size, size)
    p, q = (legs.first[ends][way] + within for ends in number.reshape(both.shape))
    less, mean, more = _means(
        legs.corners_m[:, p] + legs.corners_m[:, q],
        legs.half[:, p] * legs.half[:, q],
        legs.half_step[:, p] * legs.half_step[:, q],
        obstacles.wavenumber,
    )
    wave = current[facet] * ways.share[rows][way] * legs.factor[p] * legs.factor[q]
    wave *= legs.turn[p] * legs.turn[q]
    # Of lengths beside that of the middle, with their waves.
    moment_m = wave * 1j * (more - less) / (2 * _STEP)
    total, pair, bins = _binned(
        wave * mean,
        moment_m,
        legs.longer_m[p] + legs.longer_m[q],
        way * (int(facets.object.max()) + 1) + facets.object[facet],
        obstacles.wavenumber,
    )
    found = _both_ways(obstacles, facets.take(facet[pair]), total, ways, both[:, way[pair]], bins)
    return found, sums(way, wave * mean, len(rows)) * _spread(obstacles, ways, both)


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
    wave: Complex, moment_m: Complex, longer_m: Array, group: Indices, wavenumber: float
) -> tuple[Complex, Indices, Indices]:
    """Sums of waves (n,) of nearly one length and one ``group``, of which equal ones stand
    together: each is divided between the two lengths beside its own one, so that it is right to
    first order all over the band, also where facets next to each other nearly cancel.

    Returns the sums without the phases of their lengths, the first wave of each, and the number of
    its length.
    """
    lower = np.floor(longer_m / _BIN_M).astype(np.int64)
    share = longer_m / _BIN_M - lower
    first = np.flatnonzero(np.diff(group, prepend=-1))
    least = np.minimum.reduceat(lower, first)
    span = np.maximum.reduceat(lower, first) - least + 2
    begin = np.cumsum(span) - span
    number = lower + np.repeat(begin - least, np.diff(first, append=len(group)))
    lowest = int(lower.min())
    steps = np.arange(int(np.ptp(lower)) + 2)
    turn = phasors(np.asarray(wavenumber * _BIN_M * (lowest + steps) % (2 * np.pi), np.float64))
    count = int(span.sum())
    total, row = np.zeros(count, dtype=np.complex128), np.full(count, -1)
    low = ((1 - share) * wave - moment_m / _BIN_M) * turn[lower - lowest]
    high = (share * wave + moment_m / _BIN_M) * turn[lower - lowest + 1]
    for at, part in ((number + 1, high), (number, low)):
        total += sums(at, part, count)
        row[at[::-1]] = np.arange(len(at))[::-1]
    some = np.flatnonzero(row >= 0)
    which = np.searchsorted(begin, some, side="right") - 1
    return total[some], row[some], some - begin[which] + least[which]


def _means(corners_m: Array, half: Complex, half_step: Complex, wavenumber: float) -> list[Complex]:
    """Means over triangles (n,) of phasors of lengths given at the corners, (3, n), which are 0 at
    the centroids: at the carrier less `_STEP`, at the carrier, and as much above; with half the
    phasors at the corners, and those of half the step.
    """
    x, y, z = corners_m
    code = (x > y) + 2 * (x > z) + 4 * (y > z)
    order = _ORDER.T[:, code] * len(code) + np.arange(len(code))
    corners_m, half, half_step = (
        corners_m.ravel()[order],
        half.ravel()[order],
        half_step.ravel()[order],
    )
    return [
        _mean(corners_m, half * half_step.conj(), wavenumber - _STEP),
        _mean(corners_m, half, wavenumber),
        _mean(corners_m, half * half_step, wavenumber + _STEP),
    ]


def _mean(corners_m: Array, half: Complex, wavenumber: float) -> Complex:
    """As `shadowed_facets.Facets.mean`, of lengths in ascending order and half the phasors."""
    span = wavenumber * (corners_m[2] - corners_m[0])
    upper, lower = (
        _along(half[i], half[i + 1], wavenumber * (corners_m[i + 1] - corners_m[i]) / 2)
        for i in (1, 0)
    )
    is_flat = span <= FLAT_RAD
    mean: Complex = 2 * (upper - lower) / (1j * np.where(is_flat, 1.0, span))
    flat = np.flatnonzero(is_flat)
    mean[flat] = 1 - wavenumber**2 * np.sum(corners_m[:, flat] ** 2, axis=0) / 24
    return mean


def _along(near: Complex, far: Complex, half_rad: Array) -> Complex:
    """Mean of the phasor along edges, given the half phasors at their ends and half the phase
    between these.
    """
    is_short = half_rad < _SHORT_RAD
    sine = far.imag * near.real - far.real * near.imag
    sinc = np.where(is_short, 1 - half_rad**2 / 6, sine / np.where(is_short, 1.0, half_rad))
    value: Complex = near * far * sinc
    return value
