"""How a wave over two parallel edges changes from place to place behind them: the last one of the
field of the double knife edge.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import double_knife_edge, on_one_side
from twin.radar.propagation.diffraction.two_edge_bends import FieldBehind, TwoEdgeBends
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class DoubleBends(TwoEdgeBends):
    """``stops`` (n, 2, 3) on both edges, unit vectors ``along`` them (n, 3), and into their light
    ``aside`` (n, 2, 3).
    """

    stops: Array
    along: Array
    aside: Array

    def field(self, path: Indices, places: Array) -> FieldBehind:
        """Of both edges, one behind the other."""
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
            is_beside = dots(across, direct) > 0
            is_lit[:, edge] = is_beside | on_one_side(-stop, direct - stop, along)
        gap = self.stops[path, 1] - self.stops[path, 0]
        gap_m = lengths(gap - dots(gap, along)[:, None] * along)
        once = np.hypot(off[0] + off[1], forward).T
        twice = np.hypot(off[0, 0] + gap_m + off[1, 1], forward)
        q = np.maximum(k * (once - straight[:, None]), 0)
        a, c = off[0, 0], off[1, 1]
        correlation = np.sqrt(a * c / np.maximum((a + gap_m) * (gap_m + c), 1e-300))
        correlation *= np.sign(dots(self.aside[path, 0], self.aside[path, 1]))
        both, alone = double_knife_edge(q, is_lit, correlation)
        is_straight = np.asarray(is_lit.all(axis=1))
        return FieldBehind(is_straight, is_lit, q, alone, both, k * (twice - straight))
