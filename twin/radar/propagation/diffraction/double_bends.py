"""How a wave over two parallel edges changes from place to place behind them.

The field behind both edges is continuous: the straight wave, the wave over each alone, and that
over both (`double_knife_edge`). From a place to which the paths are known, the first three are
continued as they are there, past the border of a shadow and past that of the other edge; what is
left of the whole field is the wave over both edges.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import (
    as_one,
    double_knife_edge,
    knife_edge_factor,
)
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Parts:
    """Of the field over the straight wave: phases ``q`` (n, 2) by which paths over each edge are
    longer, and ``q_both`` (n,); whether each edge leaves the straight path free, and whether the
    wave over each is there ``alone``, (n, 2); and the factor of that over ``both``, (n,).
    """

    q: Array
    q_both: Array
    is_lit: Flags
    alone: Flags
    both: Complex


@dataclass(frozen=True, eq=False)
class DoubleBends:
    """Paths from ``source`` (n, 3) over two parallel edges to ``known`` places (n, 3).

    ``stops`` (n, 2, 3) on both edges, unit vectors ``along`` them (n, 3), and ``aside`` (n, 2, 3)
    into their light.
    """

    source: Array
    known: Array
    stops: Array
    along: Array
    aside: Array
    wavenumber: float

    def wave(self, path: Indices, places: Array) -> tuple[Complex, Array]:
        """Factors of the waves by some paths (m,), by number, at places (m, 3), over what they are
        where they are known; and by which phases they are longer than there, beside straight ones.
        """
        here, known = self._parts(path, places), self._known
        lit, alone = known.is_lit[path], known.alone[path]
        over_edges = np.where(here.alone, _sign(here.is_lit), 0) * knife_edge_factor(here.q)
        is_steady = here.is_lit == lit
        over_edges -= np.where(alone, _sign(here.is_lit), 0) * knife_edge_factor(here.q)
        straight = here.is_lit.all(axis=1) * 1.0 - lit.all(axis=1)
        straight -= np.sum(np.where(alone & ~is_steady, _sign(lit), 0), axis=1)
        wave, longer = as_one(
            np.array([here.both, *over_edges.T, straight]),
            np.array([here.q_both, *here.q.T, np.zeros(len(path))]),
        )
        return wave / known.both[path], longer - known.q_both[path]

    @cached_property
    def _known(self) -> _Parts:
        return self._parts(np.arange(len(self.known)), self.known)

    def _parts(self, path: Indices, places: Array) -> _Parts:
        along, k = self.along[path], self.wavenumber
        source = self.source[path]
        direct = places - source
        forward, straight = dots(direct, along), lengths(direct)
        off = np.empty((2, 2, len(path)))  # of the source and the places, of each edge
        is_lit = np.empty((len(path), 2), dtype=bool)
        for edge in (0, 1):
            stop = self.stops[path, edge] - source
            for end, away in enumerate((stop, stop - direct)):
                off[end, edge] = lengths(away - dots(away, along)[:, None] * along)
            across = np.cross(along, stop)
            across *= np.sign(dots(across, self.aside[path, edge]))[:, None]
            is_lit[:, edge] = dots(across, direct) > 0
        gap = self.stops[path, 1] - self.stops[path, 0]
        gap_m = lengths(gap - dots(gap, along)[:, None] * along)
        once = np.hypot(off[0] + off[1], forward).T
        twice = np.hypot(off[0, 0] + gap_m + off[1, 1], forward)
        q = np.maximum(k * (once - straight[:, None]), 0)
        a, c = off[0, 0], off[1, 1]
        correlation = np.sqrt(a * c / np.maximum((a + gap_m) * (gap_m + c), 1e-300))
        correlation *= np.sign(dots(self.aside[path, 0], self.aside[path, 1]))
        both, alone = double_knife_edge(q, is_lit, correlation)
        return _Parts(q, k * (twice - straight), is_lit, alone, both)


def _sign(is_lit: Flags) -> Array:
    sign: Array = np.where(is_lit, -1.0, 1.0)
    return sign
