"""Waves past obstacles to many places close to each other, as a few waves of common lengths each.

Paths are sought to one place in each cell, and bend from there to all others (`bends`). At each
place waves of nearly one length are one: each is divided between the two lengths beside its own, so
that their sum is right at the carrier, and to first order all over the band.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.two_way_echoes import sums
from twin.radar.propagation.one_way.points import paths_to_points
from twin.radar.rows import alike, lengths, matching_pairs, phasors

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_CELL_M = 0.05  # to one place in each of which paths are sought
_BEFORE_M = 1e-3  # of the places: where rays to the radar begin
#: Between common lengths: 0.3 rad at the ends of a band of 4 GHz.
BIN_M = 7.5e-3
_MORE_BINS = 4  # beyond what is longest in the middles of cells
_AT_ONCE = 2**17  # waves at places: 60 MB


class PassedWaves(NamedTuple):
    """Waves from the radar to places over the straight ones, (n_places, n_lengths), without the
    phase of being longer by multiples of `BIN_M`; likewise how fast the motion of edges makes those
    of each length longer, in the mean; the mean of all directions of ``departure``, (n_places, 3),
    unit vectors; and the ``cell`` that each place is in, (n_places,).
    """

    wave: Complex
    rate_m_per_s: Array
    departure: Array
    cell: Indices


def waves_past(obstacles: Screens, places: Array, body: int) -> PassedWaves:
    """Of the radar at places (n, 3) on the side of a body that it faces, past all others."""
    source, k = obstacles.prepared.images[0].place, obstacles.wavenumber
    row, cell = _cells(places)
    known = places[row]
    back = source - known
    off = _BEFORE_M * back / lengths(back)[:, None]
    context, own = obstacles.prepared.context, np.full(len(known), body)
    found = all_paths_to_points(context, obstacles, 0, known, off, own)
    straight = paths_to_points(context, 0, known, off, unshadowed=True)
    bends = Bends.of(source, known[found.point], found.diffracted, k)
    known_m = found.paths.extra - straight.extra[found.point]
    share = found.over(straight)

    count = int(known_m.max(initial=0.0) / BIN_M) + _MORE_BINS
    wave: Complex = np.zeros(len(places) * count, dtype=np.complex128)
    weight, rate = np.zeros((2, len(wave)))
    departure = np.zeros((len(places), 3))
    ways = np.bincount(found.point, minlength=len(known))[cell]
    portions = np.flatnonzero(np.diff(np.cumsum(ways) // _AT_ONCE)) + 1
    for some in np.split(np.arange(len(places)), portions):
        number, path = matching_pairs(cell[some], found.point)
        place = some[number]
        change = bends.to(path, places[place])
        longer_m = np.maximum(known_m[path] + change.longer_m, 0.0)
        one = share[path] * change.factor * phasors(-(k * longer_m))
        lower = np.minimum((longer_m / BIN_M).astype(np.int64), count - 2)
        upper = longer_m / BIN_M - lower
        for at, part in ((lower, one * (1 - upper)), (lower + 1, one * upper)):
            to = place * count + at
            wave += sums(to, part * phasors(k * BIN_M * at), len(wave))
            weight += np.bincount(to, np.abs(part), len(wave))
            rate += np.bincount(to, np.abs(part) * found.paths.rate[path], len(wave))
        for axis in range(3):
            towards = np.abs(one) * found.paths.departure[path, axis]
            departure[:, axis] += np.bincount(place, towards, len(places))
    shape = len(places), count
    rate /= np.maximum(weight, 1e-300)
    departure /= np.maximum(lengths(departure), 1e-300)[:, None]
    return PassedWaves(wave.reshape(shape), rate.reshape(shape), departure, cell)


def _cells(places: Array) -> tuple[Indices, Indices]:
    """The place in the middle of each cell, (n_cells,), and the cell of every place, (n,)."""
    cell = alike(list(np.floor(places / _CELL_M).astype(np.int64).T))
    size = np.bincount(cell)
    middle = np.stack([np.bincount(cell, x) / size for x in places.T], axis=1)
    order = np.lexsort((lengths(places - middle[cell]), cell))
    return order[np.unique(cell[order], return_index=True)[1]], cell
