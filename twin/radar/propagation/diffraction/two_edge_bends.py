"""How the last wave of a field behind two edges changes from place to place.

The field is continuous: the straight wave where nothing hides it, the wave over each edge where
that is there alone, and the last one, by way of both. From a place to which the paths are known,
the first three are continued as they are there, past borders of shadows (`bends`); what is left of
the whole field is the last wave.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.knife_edge import as_one, knife_edge_factor

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FieldBehind:
    """A field over the straight wave, whether that is there, (n,), and which edges leave its path
    free, (n, 2); phases ``q`` (n, 2) by which paths over each edge are longer, and whether the
    waves over these are there ``alone``; and the ``last`` wave, (n,), and its ``longer`` phase.
    """

    is_straight: Flags
    is_lit: Flags
    q: Array
    alone: Flags
    last: Complex
    longer: Array


@dataclass(frozen=True, eq=False)
class TwoEdgeBends(ABC):
    """Paths from ``source`` (n, 3) by way of two edges to ``known`` places (n, 3)."""

    source: Array
    known: Array
    wavenumber: float

    @abstractmethod
    def field(self, path: Indices, places: Array) -> FieldBehind:
        """Behind the edges of some paths (m,), by number, at places (m, 3)."""

    def wave(self, path: Indices, places: Array) -> tuple[Complex, Array]:
        """Factors of the last waves of some paths (m,), by number, at places (m, 3), over what they
        are where they are known; and by which phases they are longer than there, beside straight
        ones.
        """
        here, known = self.field(path, places), self._known
        is_lit, alone = known.is_lit[path], known.alone[path]
        over_edges = ((here.alone * 1.0 - alone) * _sign(here.is_lit)).astype(np.complex128)
        changes = over_edges != 0
        over_edges[changes] *= knife_edge_factor(here.q[changes])
        straight = here.is_straight * 1.0 - known.is_straight[path]
        straight -= np.sum(alone * (here.is_lit != is_lit) * _sign(is_lit), axis=1)
        wave, longer = as_one(
            np.array([here.last, *over_edges.T, straight]),
            np.array([here.longer, *here.q.T, np.zeros(len(path))]),
        )
        return wave / known.last[path], longer - known.longer[path]

    @cached_property
    def _known(self) -> FieldBehind:
        return self.field(np.arange(len(self.known)), self.known)


def _sign(is_lit: Flags) -> Array:
    sign: Array = np.where(is_lit, -1.0, 1.0)
    return sign
