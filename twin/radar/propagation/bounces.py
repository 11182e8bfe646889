"""Echoes of all bodies by physical optics: facets lit by the radar, then by each other.

A first, coarse pass tells how strong every body answers; the second is as fine as this asks for.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.currents import Echoes, echoes_of
from twin.radar.propagation.facets import Budget, Leaves, facing, lit_facets, settled, sides_of
from twin.radar.propagation.images import Image
from twin.radar.propagation.legs import Station
from twin.radar.propagation.pieces import rays_of
from twin.radar.propagation.rays import Rays
from twin.radar.propagation.scatterers import Scatterers
from twin.radar.propagation.triangles import Triangles, quartered
from twin.radar.propagation.tubes import Tubes, heard, reflected_on

Array = NDArray[np.float64]

_DEEPEST = 8  # divisions by four
_COARSE_DEPTH = 2
_COARSE = 0.5  # tolerance of the first pass, at least


def scattered_by(
    s: Station,
    scatterers: Scatterers,
    images: Sequence[Image],
    wave_numbers: Array,
    tolerance: float,
    bounces: int,
    floor: float = 0.0,
) -> Rays:
    """Contributions of every body.

    Parameters
    ----------
    wave_numbers
        Over the band, at which bodies' echoes are summed, in rad/m.
    tolerance
        Error of every body's echo over the band, relative to its root mean square.
    bounces
        Between bodies, and within one: what is reflected more often is lost.
    floor
        Amplitude below which no error counts.
    """
    count = int(scatterers.body.max()) + 1
    facets = facing(s, scatterers, images)
    if facets is None:
        return Rays.joined([])
    whole = facets, echoes_of(s, scatterers, facets)
    roots = _roots(s, scatterers, images) if bounces > 1 else None
    coarse = Budget(count, max(tolerance, _COARSE), wave_numbers, floor)
    _all_bounces(s, scatterers, images, whole, roots, coarse, bounces, _COARSE_DEPTH)
    budget = Budget(count, tolerance, wave_numbers, floor, coarse)
    found = _all_bounces(s, scatterers, images, whole, roots, budget, bounces, _DEEPEST)
    leaves = [_worth_it(part, budget) for part in found]
    return Rays.joined([rays_of(s, scatterers, part) for part in leaves if len(part.weight)])


def _worth_it(leaves: Leaves, budget: Budget) -> Leaves:
    echo, known = leaves.weight * leaves.echoes.total, leaves.echoes
    faint = budget.negligible(leaves.body, echo, known.strength, known.length_m)
    return leaves.chosen(np.flatnonzero(~faint))


def _all_bounces(
    s: Station,
    scatterers: Scatterers,
    images: Sequence[Image],
    whole: tuple[Triangles, Echoes],
    roots: Triangles | None,
    budget: Budget,
    bounces: int,
    deepest: int,
) -> list[Leaves]:
    """Leaves, one for each number of bounces that there are."""
    found = [settled(s, scatterers, *whole, budget, deepest)]
    budget.end_direct()
    for lit in _lit_by_tubes(s, scatterers, images, roots, budget, bounces, deepest):
        found.append(settled(s, scatterers, lit, echoes_of(s, scatterers, lit), budget, deepest))
    return [Leaves.joined(parts) for parts in found if parts]


def _lit_by_tubes(
    s: Station,
    scatterers: Scatterers,
    images: Sequence[Image],
    roots: Triangles | None,
    budget: Budget,
    bounces: int,
    deepest: int,
) -> list[Triangles]:
    """What bodies light of each other, by every receiver; one for each number of bounces.

    Roots are divided while what their tubes may return after all their bounces is too uncertain.
    """
    lit: list[list[Triangles]] = [[] for _ in range(1, bounces)]
    for depth in range(deepest + 1):
        if roots is None or not len(roots):
            break
        tubes: Tubes | None = Tubes.begin(roots)
        error, grown = np.zeros(len(roots)), []
        for known in lit:
            tubes = reflected_on(s, scatterers, tubes) if tubes is not None else None
            if tubes is None:
                break
            at, row = heard(s, scatterers, tubes.triangles, images)
            if not len(row):
                continue
            answer = echoes_of(s, scatterers, at)
            # What a ray stands for may lie on other planes than the one that it meets.
            most = np.sqrt(answer.strength * answer.gain * np.abs(answer.amplitude))
            share = most * tubes.doubt[row] / budget.allowed(at.body)
            error += np.bincount(tubes.root[row], share**2, len(roots))
            grown.append((known, at, tubes.root[row]))
        done = budget.affordable(roots.body, np.sqrt(error) * budget.allowed(roots.body))
        if depth == deepest:
            done[:] = True
        for known, at, root in grown:
            kept = np.flatnonzero(done[root])
            if len(kept):
                known.append(at.taken(kept))
        rest = np.flatnonzero(~done)
        roots = quartered(s, roots.taken(rest)) if len(rest) else None
    return [Triangles.joined(parts) for parts in lit if parts]


def _roots(s: Station, scatterers: Scatterers, images: Sequence[Image]) -> Triangles | None:
    """All facets that a source faces."""
    rows = np.flatnonzero(scatterers.counts)
    faces, sources = [], []
    for number, side in enumerate(sides_of(s, images, rows)):
        lit = (side != 0) & (scatterers.outward[number, rows] * side >= 0)
        faces.append(rows[lit & scatterers.heard[number, rows]])
        sources.append(np.full(len(faces[-1]), number))
    face, source = np.concatenate(faces), np.concatenate(sources)
    return lit_facets(s, scatterers, face, source, source)
