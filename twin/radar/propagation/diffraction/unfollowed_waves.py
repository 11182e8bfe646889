"""Echoes by waves over edges that are too faint to be followed everywhere, from geometry alone.

Of each cell of a body and each edge of other objects whose shortest path to the cell meets it
between its ends: the knife-edge factor of every facet, with its own phase, and its answer to the
wave from the edge's direction. Nothing is looked for that blocks a path, so that the sum is an
estimate, not an echo. Facets at nearly one path length add up with their phases; different lengths,
which the band tells apart, by their powers (Parseval).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import knife_edge_factor
from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.meshes.silhouettes import Outline

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_BIN_M = 7.5e-2  # of path lengths that a band of 4 GHz does not tell apart
_MOST_PAIRS = 2**18  # of cells and edges at once: 30 MB


@dataclass(frozen=True, eq=False)
class FaintWaves:
    """Echoes of facets in ``cells`` by waves over edges, (n,): the ``cell``, the ``level`` of the
    wave over the straight one, the number of the path's ``length``, and the ``echo``.
    """

    cells: int
    cell: Indices
    level: Array
    length: Indices
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
        return float(np.sqrt(_powers(np.zeros_like(length), length, echo, 1)[0]))


def faint_waves(
    view: View,
    other: View,
    facets: Facets,
    body: int,
    strength: Array,
    other_way: Array,
) -> FaintWaves:
    """Of a body, all that are fainter than those that obstacles' edges are asked for, on ways of a
    view, while the ``other`` way is straight.

    ``strength`` (n,): echo of each facet, were its waves in phase; ``other_way`` (n_cells,): of the
    waves on the other way, over the straight one.
    """
    order = np.argsort(facets.cell, kind="stable")
    facets, strength = facets.take(order), strength[order]
    middle, size = facets.middle, np.bincount(facets.cell)
    center = np.stack([np.bincount(facets.cell, x) / size for x in middle.T], axis=1) - view.place
    weight = strength * other_way[facets.cell]
    direct, back = middle - view.place, other.place - middle
    straight, again = (np.linalg.norm(way, axis=1) for way in (direct, back))
    back /= again[:, None]
    k, deepest = view.obstacles.wavenumber, farthest(view.obstacles.faintest)
    found = [FaintWaves(len(size), *(np.zeros(0, dtype=x) for x in (int, float, int, complex)))]
    for rim in view.all_rims(body, center):
        step = max(_MOST_PAIRS // max(len(rim.ends), 1), 1)
        for first in range(0, len(center) if len(rim.ends) else 0, step):
            cell, edge = _met(rim, center[first : first + step])
            pair, row = _of_sorted(cell + first, size)
            longer, towards = _over(rim, edge[pair], direct[row], straight[row])
            is_shadow = np.sum(rim.lit[edge[pair]] * direct[row], axis=1) <= 0
            is_far = (k * longer > deepest) & (weight[row] > 0)
            row, longer, towards = row[is_far], longer[is_far], towards[is_far]
            # Reversed in the light: past both sides of a post, half a cycle apart, they add up.
            wave = np.where(is_shadow[is_far], 1, -1) * weight[row] * knife_edge_factor(k * longer)
            wave *= facets.take(row).mean(k * (back[row] + towards))
            length = straight[row] + again[row] + longer
            wave *= np.exp(-1j * (k * length % (2 * np.pi)))
            number = np.floor(length / _BIN_M).astype(np.int64)
            level = 1 / np.sqrt(4 * np.pi * k * longer)
            found.append(FaintWaves(len(size), facets.cell[row], level, number, wave))
    return FaintWaves.concatenate(found)


def _of_sorted(cell: Indices, size: Indices) -> tuple[Indices, Indices]:
    """Pairs of a row of ``cell`` and a facet in that cell, of facets sorted by cells of sizes."""
    count = size[cell]
    pair = np.repeat(np.arange(len(cell)), count)
    first = np.cumsum(size)[cell] - np.cumsum(count)
    return pair, np.arange(len(pair)) + first[pair]


def _met(rim: Outline, direct: Array) -> tuple[Indices, Indices]:
    """Cells, at the ends of vectors (n, 3), and edges that shortest paths to them meet."""
    first, side = rim.ends[:, 0], rim.ends[:, 1] - rim.ends[:, 0]
    length = np.linalg.norm(side, axis=1)
    along = side / length[:, None]
    at_source = -np.sum(first * along, axis=1)
    foot = first + at_source[:, None] * along
    off_source = np.linalg.norm(foot, axis=1)
    forward, square = direct @ along.T, np.sum(direct**2, axis=1)[:, None]
    off_place = np.sqrt(np.maximum(square - forward**2 - 2 * direct @ foot.T + off_source**2, 0))
    at = at_source + forward * off_source / np.maximum(off_source + off_place, 1e-300)
    depth = (direct @ first.T + at * forward) / square
    cell, edge = np.nonzero((at >= 0) & (at <= length) & (depth > 0) & (depth < 1))
    return cell, edge


def _over(rim: Outline, edge: Indices, direct: Array, straight: Array) -> tuple[Array, Array]:
    """By how much paths over the lines of edges (n,) to the ends of vectors (n, 3) are longer, and
    unit vectors from there to the edge.
    """
    first, side = rim.ends[edge, 0], rim.ends[edge, 1] - rim.ends[edge, 0]
    along = side / np.linalg.norm(side, axis=1)[:, None]
    at_source = -np.sum(first * along, axis=1)
    foot = first + at_source[:, None] * along
    off_source = np.linalg.norm(foot, axis=1)
    forward = np.sum(direct * along, axis=1)
    off_place = np.linalg.norm(direct - forward[:, None] * along - foot, axis=1)
    share = off_source / np.maximum(off_source + off_place, 1e-300)
    towards = foot + (forward * share)[:, None] * along - direct
    distance = np.linalg.norm(towards, axis=1)
    longer = np.maximum(np.hypot(off_source + off_place, forward) - straight, 0)
    return longer, towards / np.maximum(distance, 1e-300)[:, None]


def _powers(owner: Indices, length: Indices, wave: Complex, count: int) -> Array:
    """Of every owner, (count,), of waves (n,): those of one length by their phases."""
    first = length.min(initial=0)
    span = int(length.max(initial=0) - first) + 1
    keys, same = np.unique(owner * span + (length - first), return_inverse=True)
    real, imag = (np.bincount(same, part, len(keys)) for part in (wave.real, wave.imag))
    powers = np.bincount(keys // span, real**2 + imag**2, count)
    return np.asarray(powers, dtype=np.float64)
