"""Echoes by waves over edges that are too faint to be followed everywhere, from geometry alone.

Of each cell of a body and each edge of other objects whose shortest path to the cell meets it
between its ends: the knife-edge factor of every facet, with its own phase, and its answer to the
wave from the edge's direction; and likewise of ends of edges, where the wave is that of the middle
of the cell: of a sheet in the air they may be all there is. Nothing is looked for that blocks a
path, so that the sum is an estimate, not an echo. Facets at nearly one path length add up with
their phases; different lengths, which the band tells apart, by their powers (Parseval).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.diffraction.knife_edge import knife_edge_factor
from twin.radar.propagation.diffraction.rims import end_waves, farthest
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.meshes.silhouettes import Lines, Outline
from twin.radar.rows import dots, lengths, phasors

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_BIN_M = 7.5e-2  # of path lengths that a band of 4 GHz does not tell apart
_MOST_PAIRS = 2**18  # of cells and edges at once: 30 MB


@dataclass(frozen=True, eq=False)
class FaintWaves:
    """Echoes of facets in ``cells`` by waves over edges, (n,): the ``cell``, the ``level`` of the
    wave over the straight one, the path's ``length``, and the ``echo``.
    """

    cells: int
    cell: Indices
    level: Array
    length: Array
    echo: Complex

    @staticmethod
    def concatenate(parts: "Sequence[FaintWaves]") -> "FaintWaves":
        """Of the same cells, at least one."""
        names = ("cell", "level", "length", "echo")
        columns = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return FaintWaves(parts[0].cells, *columns)

    def of_cells(self) -> Array:
        """Amplitude of every cell by itself, rms over the band, (n_cells,)."""
        level: Array = np.sqrt(_powers(self.cell, self.length, self.echo, self.cells))
        return level

    def of_body(self, faintest: Array) -> float:
        """Amplitude by all waves that are fainter than the faintest that is followed in their cell,
        (n_cells,); rms over the band.
        """
        left = self.level < faintest[self.cell]
        length, echo = self.length[left], self.echo[left]
        return float(np.sqrt(_powers(np.zeros(len(length), np.int64), length, echo, 1)[0]))


def faint_waves(
    view: View,
    other: View,
    facets: Facets,
    body: int,
    strength: Array,
    other_way: Array,
    least_of_ends: float,
) -> FaintWaves:
    """Of a body, all that are fainter than those that obstacles' edges are asked for, on ways of a
    view, while the ``other`` way is straight.

    ``strength`` (n,): echo of each facet, were its waves in phase; ``other_way`` (n_cells,): of the
    waves on the other way, over the straight one; ``least_of_ends``: of waves over ends of edges,
    over the straight one.
    """
    of = _Lit.by(view, other, facets, strength, other_way)
    found = [
        FaintWaves(len(of.center), *(np.zeros(0, dtype=x) for x in (int, float, float, complex)))
    ]
    for rim in view.all_rims(body, of.center):
        step = max(_MOST_PAIRS // max(len(rim.ends), 1), 1)
        for first in range(0, len(of.center) if len(rim.ends) else 0, step):
            cells = slice(first, first + step)
            found += [_over_edges(of, rim, cells), _over_ends(of, rim, cells, least_of_ends)]
    return FaintWaves.concatenate(found)


@dataclass(frozen=True, eq=False)
class _Lit:
    """Facets that answer in order of their cells, (n, ...), as waves from a view light them:
    ``direct`` vectors from there (n, 3), unit vectors ``back`` to the other view, lengths of both
    straight ways, and the ``weight`` of echoes; of cells, (m, ...), the ``size`` and the ``center``
    from the view. Waves are fainter than ``faintest``.
    """

    facets: Facets
    direct: Array
    straight: Array
    back: Array
    again: Array
    weight: Array
    size: Indices
    center: Array
    wavenumber: float
    faintest: float

    @staticmethod
    def by(view: View, other: View, facets: Facets, strength: Array, other_way: Array) -> "_Lit":
        """As of `faint_waves`."""
        order = np.argsort(facets.cell, kind="stable")
        size = np.bincount(facets.cell)
        center = np.stack([np.bincount(facets.cell, x) / size for x in facets.middle.T], axis=1)
        weight = strength * other_way[facets.cell]
        order = order[weight[order] > 0]
        facets, weight = facets.take(order), weight[order]
        middle, size = facets.middle, np.bincount(facets.cell, minlength=len(size))
        direct, back = middle - view.place, other.place - middle
        straight, again = lengths(direct), lengths(back)
        back /= again[:, None]
        k, faintest = view.obstacles.wavenumber, view.obstacles.faintest
        center -= view.place
        return _Lit(facets, direct, straight, back, again, weight, size, center, k, faintest)

    def waves(
        self, row: Indices, longer: Array, towards: Array, level: Array, wave: Complex
    ) -> FaintWaves:
        """By facets, (p,), of waves over edges, over the straight one and without its phase."""
        k = self.wavenumber
        length = (self.straight + self.again)[row] + longer
        echo = self.weight[row] * wave * phasors(-(k * length % (2 * np.pi)))
        echo *= self.facets.take(row).mean(k * (self.back[row] + towards))
        return FaintWaves(len(self.size), self.facets.cell[row], level, length, echo)


def _over_edges(of: _Lit, rim: Outline, cells: slice) -> FaintWaves:
    """By edges between their ends."""
    k = of.wavenumber
    cell, edge = kernel(_met)(rim.lines, np.ascontiguousarray(of.center[cells]))
    pair, row = _of_sorted(cell + cells.start, of.size)
    far_m = farthest(of.faintest) / k
    some, longer, towards = kernel(_over)(rim.lines, edge[pair], of.direct, row, far_m)
    row, edge = row[some], edge[pair[some]]
    # Reversed in the light: past both sides of a post, half a cycle apart, they add up.
    wave = np.where(dots(rim.lit[edge], of.direct[row]) > 0, -1, 1) * knife_edge_factor(k * longer)
    return of.waves(row, longer, towards, 1 / np.sqrt(4 * np.pi * k * longer), wave)


def _over_ends(of: _Lit, rim: Outline, cells: slice, least: float) -> FaintWaves:
    """By ends of edges, at all of a cell as strong as in its middle."""
    cell, stop, amplitude = end_waves(rim, of.center[cells], of.wavenumber, least)
    faint = np.abs(amplitude) < of.faintest
    pair, row = _of_sorted(cell[faint] + cells.start, of.size)
    stop, amplitude = stop[faint][pair], amplitude[faint][pair]
    towards = stop - of.direct[row]
    rest = lengths(towards)
    longer = np.maximum(lengths(stop) + rest - of.straight[row], 0)
    towards /= np.maximum(rest, 1e-300)[:, None]
    return of.waves(row, longer, towards, np.abs(amplitude), amplitude)


def _of_sorted(cell: Indices, size: Indices) -> tuple[Indices, Indices]:
    """Pairs of a row of ``cell`` and a facet in that cell, of facets sorted by cells of sizes."""
    count = size[cell]
    pair = np.repeat(np.arange(len(cell)), count)
    first = np.cumsum(size)[cell] - np.cumsum(count)
    return pair, np.arange(len(pair)) + first[pair]


def _met(lines: Lines, direct: Array) -> tuple[Indices, Indices]:
    """Cells, at the ends of vectors (n, 3), and edges that shortest paths to them meet."""
    along, foot = lines.along, lines.foot
    cell, edge = [0 for _ in range(0)], [0 for _ in range(0)]
    for i in range(len(direct)):
        x, y, z = direct[i]
        square = x * x + y * y + z * z
        for j in range(len(foot)):
            forward = x * along[j, 0] + y * along[j, 1] + z * along[j, 2]
            across = x * foot[j, 0] + y * foot[j, 1] + z * foot[j, 2]
            off = lines.off_m[j]
            off_place = np.sqrt(max(square - forward * forward - 2 * across + off * off, 0.0))
            at = lines.at_m[j] + forward * off / max(off + off_place, 1e-300)
            if at < 0 or at > lines.length_m[j]:
                continue
            if 0 < across + (at - lines.at_m[j]) * forward < square:
                cell.append(i)
                edge.append(j)
    return np.array(cell), np.array(edge)


def _over(
    lines: Lines, edge: Indices, direct: Array, row: Indices, far_m: float
) -> tuple[Indices, Array, Array]:
    """Which paths over the lines of edges (n,) to the ends of vectors, by their rows (n,), are
    longer by more than ``far_m``; by how much, and unit vectors from there to the edge.
    """
    some, longer = np.empty(len(row), dtype=np.int64), np.empty(len(row))
    towards, off, way = np.empty((len(row), 3)), np.empty(3), np.empty(3)
    count = 0
    for i in range(len(row)):
        place, along, foot = direct[row[i]], lines.along[edge[i]], lines.foot[edge[i]]
        forward, square, off_square = 0.0, 0.0, 0.0
        for axis in range(3):
            forward += place[axis] * along[axis]
            square += place[axis] * place[axis]
        for axis in range(3):
            off[axis] = place[axis] - forward * along[axis] - foot[axis]
            off_square += off[axis] * off[axis]
        whole = lines.off_m[edge[i]] + np.sqrt(off_square)
        more = np.sqrt(whole * whole + forward * forward) - np.sqrt(square)
        if more > far_m:
            share, distance = lines.off_m[edge[i]] / max(whole, 1e-300), 0.0
            for axis in range(3):
                way[axis] = foot[axis] + forward * share * along[axis] - place[axis]
                distance += way[axis] * way[axis]
            towards[count, :] = way / max(np.sqrt(distance), 1e-300)
            some[count], longer[count] = i, more
            count += 1
    return some[:count], longer[:count], towards[:count]


def _powers(owner: Indices, length: Array, wave: Complex, count: int) -> Array:
    """Of every owner, (count,), of waves (n,): those of about one length by their phases. The power
    of each is divided between two lengths: parts of a facet that nearly cancel would not, were it
    cut between them.
    """
    number = np.floor(length / _BIN_M).astype(np.int64)
    least, most = np.full(count, np.iinfo(np.int64).max), np.full(count, -2)
    np.minimum.at(least, owner, number)
    np.maximum.at(most, owner, number)
    span = np.where(most < 0, 0, most - least + 2)
    key = (np.cumsum(span) - span - least)[owner] + number
    turn = np.pi / 2 * (length / _BIN_M - number)
    total = kernel(_divided)(key, turn, wave, int(span.sum()))
    powers = np.bincount(np.repeat(np.arange(count), span), np.abs(total) ** 2, count)
    return np.asarray(powers, dtype=np.float64)


def _divided(key: Indices, turn: Array, wave: Complex, count: int) -> Complex:
    """Sums of waves (n,), each divided between one of ``count`` lengths and the next."""
    total = np.zeros(count, dtype=np.complex128)
    for i in range(len(key)):
        total[key[i]] += np.cos(turn[i]) * wave[i]
        total[key[i] + 1] += np.sin(turn[i]) * wave[i]
    return total
