"""How a wave over the corner of two edges changes from place to place behind it.

Near a corner the field is that of a sector between two edges: the straight wave where the sector
leaves it free, the wave over each edge where the path over it meets it on the corner's side, and
that over the corner, which makes up for the steps of the others. From a place to which the paths
are known, the straight wave and those over edges are continued as they are there (`bends`); what is
left of the whole field is the wave over the corner.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import (
    as_one,
    knife_edge_factor,
    missing_edge_factor,
)
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

#: Of the straight way: by how much a path over a corner that it meets is longer, about the rounding
#: of lengths; and how far aside of it waves are taken.
_MEETS, _ASIDE = 1e-14, 1e-6


@dataclass(frozen=True, eq=False)
class _Parts:
    """Of the field over the straight wave: whether that is there, (n,), and on which side of each
    edge; phases ``q`` (n, 2) by which paths over the edges' lines are longer, ``longer`` (n,) of
    that over the corner; whether the paths over edges meet these, (n, 2); and the factor of the
    wave over the ``corner``, (n,).
    """

    is_straight: Flags
    is_lit: Flags
    q: Array
    longer: Array
    is_there: Flags
    corner: Complex


@dataclass(frozen=True, eq=False)
class CornerBends:
    """Paths from ``source`` (n, 3) over corners at ``stop`` (n, 3) to ``known`` places (n, 3).

    ``edges`` (n, 2, 3): unit vectors along both, away from the corner; ``lit`` (n, 2, 3): across
    these and the line of sight, into the light.
    """

    source: Array
    known: Array
    stop: Array
    edges: Array
    lit: Array
    wavenumber: float

    def wave(self, path: Indices, places: Array) -> tuple[Complex, Array]:
        """Factors of the waves by some paths (m,), by number, at places (m, 3), over what they are
        where they are known; and by which phases they are longer than there, beside straight ones.
        """
        here, known = self._parts(path, places), self._known
        is_lit, is_there = known.is_lit[path], known.is_there[path]
        over_edges = _sign(here.is_lit) * knife_edge_factor(here.q)
        over_edges *= here.is_there * 1.0 - is_there
        straight = here.is_straight * 1.0 - known.is_straight[path]
        straight -= np.sum(is_there * (here.is_lit != is_lit) * _sign(is_lit), axis=1)
        wave, longer = as_one(
            np.array([here.corner, *over_edges.T, straight]),
            np.array([here.longer, *here.q.T, np.zeros(len(path))]),
        )
        return wave / known.corner[path], longer - known.longer[path]

    @cached_property
    def _known(self) -> _Parts:
        return self._parts(np.arange(len(self.known)), self.known)

    @cached_property
    def _is_convex(self) -> Flags:
        """Whether the sector is narrower than a half plane."""
        return np.asarray(dots(self.lit[:, 0], self.edges[:, 1]) < 0)

    def _parts(self, path: Indices, places: Array) -> _Parts:
        k, stop = self.wavenumber, self.stop[path] - self.source[path]
        direct = _beside_corner(places - self.source[path], stop, self.edges[path])
        straight, onwards = lengths(direct), direct - stop
        longer = k * (lengths(stop) + lengths(onwards) - straight)
        q, is_there = np.empty((len(path), 2)), np.empty((len(path), 2), dtype=bool)
        for edge in (0, 1):
            along = self.edges[path, edge]
            at = [dots(end, along) for end in (-stop, onwards)]
            off = [
                lengths(end - x[:, None] * along)
                for end, x in zip((-stop, onwards), at, strict=True)
            ]
            is_there[:, edge] = at[0] * off[1] + at[1] * off[0] > 0
            q[:, edge] = k * (np.hypot(off[0] + off[1], at[1] - at[0]) - straight)
        is_lit = np.einsum("nej,nj->ne", self.lit[path], direct) > 0
        q = np.clip(q, 1e-12, np.maximum(longer, 1e-12)[:, None])
        missing = missing_edge_factor(q.ravel(), (longer[:, None] - q).clip(0).ravel())
        corner = np.sum(_sign(is_lit) * _sign(is_there) * missing.reshape(q.shape), axis=1)
        convex = self._is_convex[path]
        is_straight = np.where(convex, is_lit.any(axis=1), is_lit.all(axis=1))
        return _Parts(is_straight, is_lit, q, longer, is_there, corner)


def _beside_corner(direct: Array, stop: Array, edges: Array) -> Array:
    """Straight ways (n, 3), turned aside where they meet a corner: all waves are steady there, but
    each depends on the side.
    """
    straight = lengths(direct)
    meets = lengths(stop) + lengths(direct - stop) - straight < _MEETS * straight
    aside = (edges[:, 0] + edges[:, 1] / 2) * (_ASIDE * straight * meets)[:, None]
    return np.asarray(direct + aside)


def _sign(is_lit: Flags) -> Array:
    sign: Array = np.where(is_lit, -1.0, 1.0)
    return sign
