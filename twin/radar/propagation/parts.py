"""Parts of large facets, so that what is small before or beside them lies between few rays."""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.legs import Station
from twin.radar.propagation.triangles import Triangles, quartered
from twin.transfer import host

Array = NDArray[np.float64]

_CLOSEST = 2.0  # wavelengths between rays
_MORE = 20_000  # parts of facets, which keep rays wider apart


def parted(s: Station, lit: Triangles) -> tuple[Triangles, NDArray[np.intp], float]:
    """Triangles in parts, the row that each is of, and the most of their sizes in m: two
    wavelengths, or what some twenty thousand more of them allow.
    """
    spacing_m = _spacing_m(sizes(lit), _CLOSEST * float(s.wavelength[0]))
    found, rows, row = [], [], np.arange(len(lit))
    while (is_wide := sizes(lit) > spacing_m).any():
        found.append(lit.taken(np.flatnonzero(~is_wide)))
        rows.append(row[~is_wide])
        lit, row = quartered(s, lit.taken(np.flatnonzero(is_wide))), np.repeat(row[is_wide], 4)
    return Triangles.joined([*found, lit]), np.concatenate([*rows, row]), spacing_m


def sizes(lit: Triangles) -> Array:
    """Longest edges, (n,)."""
    a, b, c = host(lit.corners, len(lit))
    return np.sqrt(
        np.max([((q - p) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    )


def _spacing_m(size_m: Array, closest_m: float) -> float:
    low, high = closest_m, max(closest_m, float(size_m.max(initial=0.0)))
    for _ in range(30):
        middle = np.sqrt(low * high)
        more = np.sum(np.maximum(size_m / middle, 1) ** 2 - 1)
        low, high = (middle, high) if more > _MORE else (low, middle)
    return high
