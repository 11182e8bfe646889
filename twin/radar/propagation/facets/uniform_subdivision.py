"""Uniform subdivision of large facets to the spacing of rays, which small obstacles then meet."""

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.triangles import Triangles, split_in_four
from twin.radar.propagation.one_way.path import TracingContext
from twin.transfer import host

Array = NDArray[np.float64]

_CLOSEST = 0.5  # wavelengths between rays
_MORE = 80_000  # parts of facets, which keep rays wider apart
_FINER, _FEW = 0.125, 40_000  # closer, in wavelengths, and parts up to which they are
_STEPS = 64  # of sizes, in an octave


def subdivided(
    context: TracingContext, lit: Triangles, spacing_m: float
) -> tuple[Triangles, NDArray[np.intp]]:
    """Triangles in parts of at most this size, and the row that each is of."""
    parts, rows, row = [], [], np.arange(len(lit))
    while (is_wide := sizes(lit) > spacing_m).any():
        parts.append(lit.take(np.flatnonzero(~is_wide)))
        rows.append(row[~is_wide])
        lit, row = (
            split_in_four(context, lit.take(np.flatnonzero(is_wide))),
            np.repeat(row[is_wide], 4),
        )
    return Triangles.concatenate([*parts, lit]), np.concatenate([*rows, row])


def sizes(lit: Triangles) -> Array:
    """Longest edges, (n,)."""
    a, b, c = lit.corners
    square = dr.maximum(dr.squared_norm(b - a), dr.squared_norm(c - b))
    (size_m,) = host([dr.sqrt(dr.maximum(square, dr.squared_norm(a - c)))], len(lit))
    return size_m


def longest_edges(a: Array, b: Array, c: Array) -> Array:
    """Of triangles by their corners (n, 3), in m, (n,)."""
    return np.sqrt(
        np.max([((q - p) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    )


def finer_spacing_of(context: TracingContext, size_m: Array) -> float:
    """The same for ray tubes, which pass by what lies between their rays: an eighth of a wavelength
    where few parts are enough, as of a small hollow body, but no more than `spacing_of`.
    """
    finer_m = _finest(size_m, _FINER * float(context.wavelength[0]), _FEW)
    return min(finer_m, spacing_of(context, size_m))


def spacing_of(context: TracingContext, size_m: Array) -> float:
    """The most of the sizes of parts in m, of triangles of sizes (n,): half a wavelength, or what
    some eighty thousand more of them allow.
    """
    return _finest(size_m, _CLOSEST * float(context.wavelength[0]), _MORE)


def _finest(size_m: Array, closest_m: float, most: int) -> float:
    """The least size of parts, from the closest on, with which at most so many are added. What is
    larger by any share becomes four.
    """
    wide = size_m[size_m > closest_m]
    if not len(wide):
        return closest_m
    step = np.ceil(_STEPS * np.log2(wide / closest_m)).astype(np.intp)
    count = np.bincount(step)
    step = np.arange(len(count))
    for spacing in step:
        halvings = np.ceil(np.maximum(step - spacing, 0) / _STEPS)
        if np.sum(count * (4.0**halvings - 1)) <= most:
            break
    return float(closest_m * 2 ** (spacing / _STEPS))
