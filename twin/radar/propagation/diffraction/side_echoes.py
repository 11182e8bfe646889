"""Echoes of bodies behind flat sides of obstacles, beyond what waves over black edges are.

Each facet's echo changes by what a side adds to the square of the field there (`flat_sides`), taken
at the carrier and with the delay of the straight path: near the plane of the side, where it
matters, the ways differ by little.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.blocking import first_hit
from twin.radar.propagation.diffraction.cell_echoes import middle_facets, radiated
from twin.radar.propagation.diffraction.flat_sides import (
    Side,
    changed_by,
    is_mirror,
    reflection,
)
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import Facets, in_voxels
from twin.radar.propagation.diffraction.two_way_echoes import Ways, summed
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.one_way.points import paths_to_points
from twin.radar.propagation.rows import lengths, phasors
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SMALL_M, _MOST = 0.01, 2.0e4  # size of facets, and about how many of a body
_CELL_M = 0.1
_COUNTS = 0.02  # of the straight wave, there and back: change of a coarse facet that counts
#: Of what sides change, by which it may be off: their roughness and material, and the reflection at
#: other angles than the radar's; screens 3 cm apart in place of a side differ by as much. And of
#: waves over both edges, whose amplitude is that in the middle of a cell: of random boxes
#: (`benchmarks.behind_boxes`).
_UNSURE, _KEPT = 0.5, 0.4
_BAND = np.array([-0.02, 0.0, 0.02])  # of the carrier, over which levels are rms


def side_echoes(
    obstacles: Screens,
    facets: Facets,
    body: int,
    surface_of_object: NDArray[np.uint32],
    gain: Callable[[Array], Array],
    sides: Sequence[Side],
) -> tuple[Contributions, float, float]:
    """Contributions of a body's facets, without gains; their amplitude, with gains; and by how much
    they, and the waves over both edges of sides, may be off.
    """
    parts, power, unsure = [Contributions.none()], 0.0, 0.0
    for side in sides:
        if obstacles.body[side.item] == body:
            continue
        is_known = is_mirror(obstacles, side, body)
        found = _by_side(obstacles, facets, surface_of_object, side, is_known)
        changed, over_both = (_level(part, gain, obstacles.wavenumber) for part in found)
        power += changed**2
        unsure += (_UNSURE * changed) ** 2 + (_KEPT * over_both) ** 2
        parts.append(found[0])
    return Contributions.concatenate(parts), float(np.sqrt(power)), float(np.sqrt(unsure))


def _by_side(
    obstacles: Screens,
    facets: Facets,
    surface_of_object: NDArray[np.uint32],
    side: Side,
    is_known: bool,
) -> tuple[Contributions, Contributions]:
    """What a side changes, and waves over both its edges that are there without it."""
    k, source = obstacles.wavenumber, obstacles.prepared.images[0].place
    at_most, _ = changed_by(side, facets.middle - source, k, -1.0, is_mirror=is_known)
    near = facets.take(np.abs(at_most) > _COUNTS)
    near = _free(obstacles, near, side)
    if not len(near):
        return Contributions.none(), Contributions.none()
    size = max(_SMALL_M, float(np.sqrt(2 * lengths(near.across).sum() / _MOST)))
    near = near.divided(np.full(len(near), size))
    near = in_voxels(near, np.full(int(near.cell.max()) + 1, _CELL_M))
    row = middle_facets(near)
    place, off = near.middle[row], (offset_m(near.middle) * near.normal(source))[row]
    straight = paths_to_points(obstacles.prepared.context, 0, place, off, unshadowed=True)
    every = np.arange(len(place))
    none = Bends.none(source, place, k)
    alone = Ways(every, straight, none, every, every, np.ones(len(place), dtype=complex))
    current = radiated(obstacles, near, straight.take(near.cell), surface_of_object)
    coefficient = reflection(obstacles, side, straight.field[0])
    factors = changed_by(side, near.middle - source, k, coefficient, is_mirror=is_known)
    changed, over_both = (
        summed(obstacles, near, current * factor, alone, straight.length)[0] for factor in factors
    )
    return changed, over_both


def _free(obstacles: Screens, facets: Facets, side: Side) -> Facets:
    """Facets between which and the radar nothing stands but the body of the side."""
    source = obstacles.prepared.images[0].place
    off = offset_m(facets.middle) * facets.normal(source)
    hit = first_hit(obstacles.prepared, facets.middle, off, source)
    own = obstacles.body[side.item]
    is_own = (obstacles.body[np.maximum(hit, 0)] == own) & (own >= 0)
    return facets.take((hit < 0) | (hit == side.item) | is_own)


def _level(echoes: Contributions, gain: Callable[[Array], Array], wavenumber: float) -> float:
    """Amplitude of the sum, rms over a band."""
    wave = echoes.amplitude * gain(echoes.departure)
    cycles = echoes.delay_s * speed_of_light * wavenumber
    sums = [np.sum(wave * phasors(-(cycles * (1 + part) % (2 * np.pi)))) for part in _BAND]
    return float(np.sqrt(np.mean(np.abs(sums) ** 2)))
