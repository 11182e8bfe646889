"""How a wave over the corner of two edges changes from place to place behind it: the last one of
the field of a sector between both, which makes up for the steps of the others where the paths over
edges no longer meet these.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import missing_edge_factor, on_one_side
from twin.radar.propagation.diffraction.two_edge_bends import FieldBehind, TwoEdgeBends
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

#: Of the straight way: by how much a path over a corner that it meets is longer, about the rounding
#: of lengths; and how far aside of it waves are taken.
_MEETS, _ASIDE = 1e-14, 1e-6


@dataclass(frozen=True, eq=False)
class CornerBends(TwoEdgeBends):
    """Corners at ``stop`` (n, 3); ``edges`` (n, 2, 3): unit vectors along both, away from the
    corner; ``lit`` (n, 2, 3): across these and the line of sight, into the light.
    """

    stop: Array
    edges: Array
    lit: Array

    @cached_property
    def _is_convex(self) -> Flags:
        """Whether the sector is narrower than a half plane."""
        return np.asarray(dots(self.lit[:, 0], self.edges[:, 1]) < 0)

    def field(self, path: Indices, places: Array) -> FieldBehind:
        """Of a sector between both edges."""
        k, stop = self.wavenumber, self.stop[path] - self.source[path]
        direct = _beside_corner(places - self.source[path], stop, self.edges[path])
        straight, onwards = lengths(direct), direct - stop
        longer = k * (lengths(stop) + lengths(onwards) - straight)
        q, alone = np.empty((len(path), 2)), np.empty((len(path), 2), dtype=bool)
        is_lit = np.einsum("nej,nj->ne", self.lit[path], direct) > 0
        for edge in (0, 1):
            along = self.edges[path, edge]
            at = [dots(end, along) for end in (-stop, onwards)]
            off = [
                lengths(end - x[:, None] * along)
                for end, x in zip((-stop, onwards), at, strict=True)
            ]
            is_lit[:, edge] |= on_one_side(-stop, onwards, along)
            alone[:, edge] = at[0] * off[1] + at[1] * off[0] > 0
            q[:, edge] = k * (np.hypot(off[0] + off[1], at[1] - at[0]) - straight)
        q = np.clip(q, 1e-12, np.maximum(longer, 1e-12)[:, None])
        missing = missing_edge_factor(q.ravel(), (longer[:, None] - q).clip(0).ravel())
        corner = np.sum(np.where(is_lit == alone, 1, -1) * missing.reshape(q.shape), axis=1)
        convex = self._is_convex[path]
        is_straight = np.where(convex, is_lit.any(axis=1), is_lit.all(axis=1))
        return FieldBehind(is_straight, is_lit, q, alone, corner, longer)


def _beside_corner(direct: Array, stop: Array, edges: Array) -> Array:
    """Straight ways (n, 3), turned aside where they meet a corner: all waves are steady there, but
    each depends on the side.
    """
    straight = lengths(direct)
    meets = lengths(stop) + lengths(direct - stop) - straight < _MEETS * straight
    aside = (edges[:, 0] + edges[:, 1] / 2) * (_ASIDE * straight * meets)[:, None]
    return np.asarray(direct + aside)
