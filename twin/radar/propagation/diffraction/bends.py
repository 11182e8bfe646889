"""Where waves over edges bend last, and how they change from place to place behind.

Around a place to which a path over an edge is known, the path to another place is the shortest one
over the same edge's line, or over the same end of an edge; its knife-edge factor is that of its own
phase, on its own side of the shadow's border. Over two parallel edges it is the double knife edge's
(`double_bends`), over a sharp corner of two edges that of an end of each (`corner_bends`). Of paths
over two edges askew, and over other ends, the amplitude is taken as the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.corner_bends import CornerBends
from twin.radar.propagation.diffraction.double_bends import DoubleBends
from twin.radar.propagation.diffraction.knife_edge import (
    as_one,
    knife_edge_factor,
    on_one_side,
)
from twin.radar.propagation.diffraction.rims import DiffractedPaths
from twin.radar.propagation.diffraction.thick_corners import ThickCorners
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_PARALLEL = 0.999  # cosine of the angle between directions into the light of two edges, at least


class Change(NamedTuple):
    """What a wave is from one place to another, (n,): by how much longer beside the straight wave,
    and by which factor stronger.
    """

    longer_m: Array
    factor: Complex


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
        Into the light of both edges, (n, 2, 3), of a path over two parallel ones, or over a corner;
        else 0.
    corner
        Unit vectors along both edges of a corner, (n, 2, 3); else 0.
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
    corner: Array
    wavenumber: float

    @staticmethod
    def none(source: Array, known: Array, wavenumber: float) -> "Bends":
        """Of straight paths from one place (3,)."""
        places, nothing = np.tile(source, (len(known), 1)), np.zeros((len(known), 3))
        neither = np.zeros((len(known), 2, 3))
        return Bends(places, known, places, places, nothing, nothing, neither, neither, wavenumber)

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
        lit = np.where(is_twice, 0.0, diffracted.into_light(source))
        length = np.linalg.norm(diffracted.aside, axis=2, keepdims=True)  # 0 where there is no room
        aside = diffracted.aside / np.maximum(length, 1e-300)
        is_parallel = is_twice[:, 0] & (np.abs(dots(aside[:, 0], aside[:, 1])) > _PARALLEL)
        aside = np.where((is_parallel & is_edge[:, 0])[:, None, None], aside, 0.0)
        across = np.cross(diffracted.corner, (last - source)[:, None])
        across *= np.sign(np.sum(across * diffracted.aside, axis=2, keepdims=True))
        across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), 1e-300)
        count = len(known) - len(last)
        return replace(
            paths,
            begin=np.concatenate([paths.begin[:count], np.where(is_twice, first, source)]),
            stop=np.concatenate([paths.stop[:count], last]),
            along=np.concatenate([paths.along[:count], diffracted.along]),
            lit=np.concatenate([paths.lit[:count], lit]),
            aside=np.concatenate([paths.aside[:count], aside + across]),
            corner=np.concatenate([paths.corner[:count], diffracted.corner]),
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
        straight, k = lengths(self.source[path] - places), self.wavenumber
        longer, factor = np.zeros(len(path)), np.ones(len(path), dtype=complex)
        bent = np.flatnonzero(self._is_bent[path])
        longer[bent] = self._over(path[bent], places[bent], straight[bent])
        one = np.flatnonzero(self._is_single[path])
        number, q = path[one], k * longer[one]
        is_lit = self._is_lit(number, places[one])
        is_steady = is_lit == self._known_lit[number]
        waves = np.array([np.where(is_steady, 1, -1) * knife_edge_factor(q), ~is_steady])
        wave, phase = as_one(waves, np.array([q, np.zeros(len(q))]))
        longer[one], factor[one] = phase / k, wave / self._known_factor[number]
        longer -= self._known_longer_m[path]
        for some, number, bends in (
            (self._is_double, self._double_row, self._doubles),
            (self._is_corner, self._corner_row, self._corners),
            (self._is_thick_corner, self._thick_corner_row, self._thick_corners),
        ):
            rows = np.flatnonzero(some[path])
            if len(rows):
                factor[rows], phase = bends.wave(number[path[rows]], places[rows])
                longer[rows] = phase / k
        return Change(longer, factor)

    @property
    def is_twice(self) -> Flags:
        """Which paths lead over two edges, one after the other, (n,)."""
        return np.asarray((self.begin != self.source).any(axis=1))

    @cached_property
    def _is_bent(self) -> Flags:
        return np.asarray((self.stop != self.source).any(axis=1))

    @cached_property
    def _is_single(self) -> Flags:
        return np.asarray(self.lit.any(axis=1))

    @cached_property
    def _is_double(self) -> Flags:
        return np.asarray(self.aside.any(axis=(1, 2)) & ~self.corner.any(axis=(1, 2)))

    @cached_property
    def _is_corner(self) -> Flags:
        return np.asarray(self.corner.any(axis=(1, 2)) & ~self.is_twice)

    @cached_property
    def _corner_row(self) -> Indices:
        return np.cumsum(self._is_corner) - 1

    @cached_property
    def _corners(self) -> CornerBends:
        some = np.flatnonzero(self._is_corner)
        source, known, stop, edges, lit = (
            x[some] for x in (self.source, self.known, self.stop, self.corner, self.aside)
        )
        return CornerBends(source, known, self.wavenumber, stop, edges, lit)

    @cached_property
    def _is_thick_corner(self) -> Flags:
        return np.asarray(self.corner.any(axis=(1, 2)) & self.is_twice)

    @cached_property
    def _thick_corner_row(self) -> Indices:
        return np.cumsum(self._is_thick_corner) - 1

    @cached_property
    def _thick_corners(self) -> ThickCorners:
        some = np.flatnonzero(self._is_thick_corner)
        stops = np.stack([self.begin[some], self.stop[some]], axis=1)
        source, known, edges = (x[some] for x in (self.source, self.known, self.corner))
        return ThickCorners(source, known, self.wavenumber, stops, edges)

    @cached_property
    def _double_row(self) -> Indices:
        return np.cumsum(self._is_double) - 1

    @cached_property
    def _doubles(self) -> DoubleBends:
        some = np.flatnonzero(self._is_double)
        stops = np.stack([self.begin[some], self.stop[some]], axis=1)
        source, known, along, aside = (
            x[some] for x in (self.source, self.known, self.along, self.aside)
        )
        return DoubleBends(source, known, self.wavenumber, stops, along, aside)

    @cached_property
    def _known_longer_m(self) -> Array:
        """What `to` says of the places to which paths are known."""
        straight = lengths(self.known - self.source)
        return np.where(
            self._is_bent, self._over(np.arange(len(straight)), self.known, straight), 0.0
        )

    @cached_property
    def _known_factor(self) -> Complex:
        return knife_edge_factor(self.wavenumber * self._known_longer_m)

    @cached_property
    def _known_lit(self) -> Flags:
        return self._is_lit(np.arange(len(self.known)), self.known)

    def _is_lit(self, path: Indices, places: Array) -> Flags:
        """Whether the last edges leave the straight paths to places free."""
        source, stop, along = (x[path] for x in (self.source, self.stop, self.along))
        is_beside = dots(self.lit[path], places - source) > 0
        return np.asarray(is_beside | on_one_side(source - stop, places - stop, along))

    def _over(self, path: Indices, places: Array, straight: Array) -> Array:
        """By how much the shortest paths over the edges' lines are longer than straight ones."""
        begin, stop, along = (x[path] for x in (self.begin, self.stop, self.along))
        ends = (begin - stop, places - stop)
        at = [dots(end, along) for end in ends]
        off = [lengths(end - x[:, None] * along) for end, x in zip(ends, at, strict=True)]
        length = lengths(begin - self.source[path])
        length += np.hypot(off[0] + off[1], at[1] - at[0])
        return np.maximum(length - straight, 0)
