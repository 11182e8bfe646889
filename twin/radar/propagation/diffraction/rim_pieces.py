"""Outlines in short pieces, each of which is hidden by what stands close, or not."""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.rim_crossings import beside, crossings
from twin.radar.propagation.diffraction.rims import unsure_m
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.rows import lengths

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PIECE = 0.02  # of the root of wavelength and distance: pieces of rims that are hidden or not
_MOST_PIECES = 256, 2**15  # of an edge, and of an object
_ONE = 1e-6  # of an edge: closer cuts of it are one
#: How far aside rays look at most, of the same root, and at how many distances.
WIDEST, STEPS = 0.1, 4


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of outlines, (n,): of each the ``edge`` and its number there, ``piece``, of ``count``;
    the ``group`` of its object; its unit vector of ``sight`` (n, 3); and at distances aside,
    (n, steps), from which distance of points on what is met there hides it, inf: never, NaN: not
    known yet.
    """

    outline: Outline
    edge: Indices
    piece: Indices
    count: Indices
    group: Indices
    sight: Array
    aside_m: Array
    from_m: Array

    @staticmethod
    def of(rim: Outline, others: list[Outline], group: int, wavelength_m: float) -> "Pieces":
        """Of an outline, which it and others may cross, nothing known yet."""
        pieces, edge, piece, count = _pieces(rim, others, wavelength_m)
        middle = pieces.ends.mean(axis=1)
        sight = middle / lengths(middle)[:, None]
        aside_m = _aside_m(middle, wavelength_m)
        unknown, groups = np.full_like(aside_m, np.nan), np.full(len(edge), group)
        return Pieces(pieces, edge, piece, count[edge], groups, sight, aside_m, unknown)

    def take(self, which: Indices) -> "Pieces":
        """Only some of them, by index."""
        rest = (getattr(self, f.name)[which] for f in fields(Pieces)[1:])
        return Pieces(self.outline.take(which), *rest)

    @staticmethod
    def together(parts: "list[Pieces]") -> "Pieces":
        """As of one outline, with edges and corners numbered anew."""
        first = np.cumsum([0, *(int(part.edge.max(initial=-1)) + 1 for part in parts)])
        parts = [replace(part, edge=part.edge + n) for part, n in zip(parts, first, strict=False)]
        names = [f.name for f in fields(Pieces)[1:]]
        rest = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return Pieces(Outline.together([part.outline for part in parts]), *rest)

    @cached_property
    def middle(self) -> Array:
        """From the source, (n, 3)."""
        middle: Array = (self.outline.ends[:, 0] + self.outline.ends[:, 1]) / 2
        return middle

    @cached_property
    def distance_m(self) -> Array:
        """From the source, (n,)."""
        return lengths(self.middle)

    @cached_property
    def longest(self) -> float:
        """As an angle."""
        side = self.outline.ends[:, 1] - self.outline.ends[:, 0]
        return float(np.max(lengths(side) / self.distance_m, initial=0.0))


def _pieces(
    rim: Outline, others: list[Outline], wavelength_m: float
) -> tuple[Outline, Indices, Indices, Indices]:
    """Short pieces of edges, none of which goes on past a crossing with another edge, or past the
    end of one next to it; of each the edge and its number there; and of edges how many.
    """
    side = rim.ends[:, 1] - rim.ends[:, 0]
    size = piece_m(rim.ends.mean(axis=1), wavelength_m)
    parts = np.minimum(np.linalg.norm(side, axis=1) / size, _MOST_PIECES[0])
    parts *= min(_MOST_PIECES[1] / max(parts.sum(), 1), 1)
    count = np.maximum(np.ceil(parts), 1).astype(np.int64)
    edge = np.repeat(np.arange(len(count)), count)
    piece = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    some = np.flatnonzero(count > 1)
    reach_m = np.maximum(size[some], 3 * unsure_m(rim.ends[some].mean(axis=1)))
    crossed, at = crossings(rim, some, others)
    touched, there = beside(rim, some, others, reach_m)
    begins = np.stack(
        [np.concatenate([edge, crossed, touched]), np.concatenate([piece / count[edge], at, there])]
    )
    edge, begin = _once(*begins[:, np.lexsort(begins[::-1])])
    count = np.bincount(edge, minlength=len(count))
    piece = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    end = np.where(piece + 1 < count[edge], np.append(begin[1:], 1.0), 1.0)
    return _part(rim, edge, begin, end), edge, piece, count


def _once(edge: Array, begin: Array) -> tuple[Indices, Array]:
    """Sorted beginnings of pieces, of those next to each other one."""
    is_new = np.ones(len(edge), dtype=bool)
    is_new[1:] = (np.diff(edge) > 0) | (np.diff(begin) > _ONE)
    return edge[is_new].astype(np.int64), begin[is_new]


def _part(rim: Outline, edge: Indices, begin: Array, end: Array) -> Outline:
    """Of edges (n,) the part between two shares of their lengths."""
    some = rim.take(edge)
    first, side = some.ends[:, :1], some.ends[:, 1:] - some.ends[:, :1]
    return replace(some, ends=first + np.stack([begin, end], axis=1)[..., None] * side)


def _aside_m(middle: Array, wavelength_m: float) -> Array:
    """Distances aside of places (n, 3) on rims where rays look, (n, steps)."""
    nearest = unsure_m(middle)
    widest = WIDEST / PIECE * piece_m(middle, wavelength_m)
    share = np.arange(STEPS) / (STEPS - 1)
    aside: Array = nearest[:, None] * np.maximum(widest / nearest, 1)[:, None] ** share
    return aside


def piece_m(place: Array, wavelength_m: float) -> Array:
    """About how long pieces are at places (n, 3), (n,)."""
    size: Array = PIECE * np.sqrt(wavelength_m * np.linalg.norm(place, axis=1))
    return size
