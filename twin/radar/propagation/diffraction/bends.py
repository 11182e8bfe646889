"""Where waves over edges bend last, and how they change from place to place behind.

Around a place to which a path over an edge is known, the path to another place is the shortest one
over the same edge's line, or over the same end of an edge; its knife-edge factor is that of its own
phase, on its own side of the shadow's border. Over two parallel edges it is the double knife edge's
(`double_bends`). Of paths over two edges askew, and over ends, the amplitude is taken as the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.double_bends import DoubleBends
from twin.radar.propagation.diffraction.knife_edge import knife_edge_factor
from twin.radar.propagation.diffraction.rims import DiffractedPaths
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_PARALLEL = 0.999  # cosine of the angle between directions into the light of two edges, at least


class Change(NamedTuple):
    """What a wave is from one place to another, (n,): by how much longer beside the straight wave,
    by which factor stronger; and there the unit vector ``back`` (n, 3) along which it came.
    """

    longer_m: Array
    factor: Complex
    back: Array


@dataclass(frozen=True, eq=False)
class Bends:
    """Last bends of paths, (n, ...).

    Parameters
    ----------
    source
        Where the straight wave of each comes from, (n, 3).
    known
        The place that each path leads to, (n, 3).
    begin
        Where it bends before, or begins, (n, 3).
    stop, along
        A place on the edge and its unit vector, (n, 3); 0 along for an end of an edge, and where
        nothing bends: there ``stop`` is the source.
    lit
        Unit vectors into the light, (n, 3), of a path over one edge; else 0.
    aside
        Into the light of both edges, (n, 2, 3), of a path over two parallel ones; else 0.
    wavenumber
        rad/m.
    """

    source: Array
    known: Array
    begin: Array
    stop: Array
    along: Array
    lit: Array
    aside: Array
    wavenumber: float

    @staticmethod
    def none(source: Array, known: Array, wavenumber: float) -> "Bends":
        """Of straight paths from one place (3,)."""
        places, nothing = np.tile(source, (len(known), 1)), np.zeros((len(known), 3))
        neither = np.zeros((len(known), 2, 3))
        return Bends(places, known, places, places, nothing, nothing, neither, wavenumber)

    @staticmethod
    def of(
        source: Array, known: Array, diffracted: DiffractedPaths | None, wavenumber: float
    ) -> "Bends":
        """Of paths from one place (3,), the last of which are diffracted."""
        paths = Bends.none(source, known, wavenumber)
        if diffracted is None:
            return paths
        first, last = diffracted.stops.swapaxes(0, 1)
        is_twice = (first != last).any(axis=1)[:, None]
        is_edge = (diffracted.along != 0).any(axis=1)[:, None]
        lit = np.cross(diffracted.along, last - source)
        lit *= np.sign(dots(lit, diffracted.aside[:, 0]))[:, None]
        lit /= np.maximum(lengths(lit), 1e-300)[:, None]
        aside = diffracted.aside / np.linalg.norm(diffracted.aside, axis=2, keepdims=True)
        is_parallel = is_twice[:, 0] & (np.abs(dots(aside[:, 0], aside[:, 1])) > _PARALLEL)
        aside = np.where((is_parallel & is_edge[:, 0])[:, None, None], aside, 0.0)
        count = len(known) - len(last)
        return replace(
            paths,
            begin=np.concatenate([paths.begin[:count], np.where(is_twice, first, source)]),
            stop=np.concatenate([paths.stop[:count], last]),
            along=np.concatenate([paths.along[:count], diffracted.along]),
            lit=np.concatenate([paths.lit[:count], np.where(is_edge & ~is_twice, lit, 0.0)]),
            aside=np.concatenate([paths.aside[:count], aside]),
        )

    @staticmethod
    def concatenate(parts: "Sequence[Bends]") -> "Bends":
        """One after the other, at least one."""
        names = [f.name for f in fields(Bends) if f.name != "wavenumber"]
        rows: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in names
        }
        return replace(parts[0], **rows)

    def to(self, path: Indices, places: Array) -> Change:
        """Of paths by number, (m,), from where they are known to places (m, 3).

        Across the border of a shadow the straight wave of the known place, or its absence, is kept:
        the wave over the edge goes on steadily and takes the step with it.
        """
        towards = self.source[path] - places
        straight = lengths(towards)
        longer, back = np.zeros(len(path)), towards / np.maximum(straight, 1e-300)[:, None]
        factor = np.ones(len(path), dtype=complex)
        bent = np.flatnonzero(self._is_bent[path])
        longer[bent], back[bent] = self._over(path[bent], places[bent], straight[bent])
        one = np.flatnonzero(self._is_single[path])
        number, q = path[one], self.wavenumber * longer[one]
        is_lit = dots(self.lit[number], towards[one]) < 0
        wave = knife_edge_factor(q)
        steady = np.where(is_lit == self._known_lit[number], wave, np.exp(1j * q) - wave)
        factor[one] = steady / self._known_factor[number]
        two = np.flatnonzero(self._is_double[path])
        if len(two):
            factor[two] = self._doubles.factor(self._double_row[path[two]], places[two])
        return Change(longer - self._known_longer_m[path], factor, back)

    @cached_property
    def _is_bent(self) -> Flags:
        return np.asarray((self.stop != self.source).any(axis=1))

    @cached_property
    def _is_single(self) -> Flags:
        return np.asarray(self.lit.any(axis=1))

    @cached_property
    def _is_double(self) -> Flags:
        return np.asarray(self.aside.any(axis=(1, 2)))

    @cached_property
    def _double_row(self) -> Indices:
        return np.cumsum(self._is_double) - 1

    @cached_property
    def _doubles(self) -> DoubleBends:
        some = np.flatnonzero(self._is_double)
        stops = np.stack([self.begin[some], self.stop[some]], axis=1)
        return DoubleBends(
            self.source[some],
            self.known[some],
            stops,
            self.along[some],
            self.aside[some],
            self.wavenumber,
        )

    @cached_property
    def _known_longer_m(self) -> Array:
        """What `to` says of the places to which paths are known."""
        straight = lengths(self.known - self.source)
        return np.where(
            self._is_bent, self._over(np.arange(len(straight)), self.known, straight)[0], 0.0
        )

    @cached_property
    def _known_factor(self) -> Complex:
        return knife_edge_factor(self.wavenumber * self._known_longer_m)

    @cached_property
    def _known_lit(self) -> Flags:
        return np.asarray(dots(self.lit, self.known - self.source) > 0)

    def _over(self, path: Indices, places: Array, straight: Array) -> tuple[Array, Array]:
        """By how much the shortest paths over the edges' lines are longer than straight ones, and
        unit vectors from places to the edges.
        """
        begin, stop, along = (x[path] for x in (self.begin, self.stop, self.along))
        ends = (begin - stop, places - stop)
        at = [dots(end, along) for end in ends]
        off = [lengths(end - x[:, None] * along) for end, x in zip(ends, at, strict=True)]
        share = off[0] / np.maximum(off[0] + off[1], 1e-300)
        towards = stop + (at[0] + share * (at[1] - at[0]))[:, None] * along - places
        distance = np.maximum(lengths(towards), 1e-300)
        before = lengths(begin - self.source[path])
        length = before + np.hypot(off[0] + off[1], at[1] - at[0])
        return np.maximum(length - straight, 0), towards / distance[:, None]
