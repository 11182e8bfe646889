"""Echoes of all bodies by physical optics: facets lit by the radar, then by each other.

A first, coarse pass tells how strong every body answers; the second is as fine as this asks for.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.currents import Echoes, echoes_of
from twin.radar.propagation.facets import (
    Budget,
    Leaves,
    facing,
    lit_facets,
    settled,
    sides_of,
)
from twin.radar.propagation.images import Image
from twin.radar.propagation.legs import Station
from twin.radar.propagation.parts import parted
from twin.radar.propagation.pieces import rays_of
from twin.radar.propagation.rays import Rays
from twin.radar.propagation.scatterers import Scatterers
from twin.radar.propagation.triangles import Triangles, quartered
from twin.radar.propagation.tubes import Tubes, heard, reflected_on

Array = NDArray[np.float64]

_DEEPEST = 8, 3  # divisions of facets by four, and of roots of tubes by sixteen
_COARSE_DEPTH = 2, 0
_COARSE = 0.5  # tolerance of the first pass, at least


def scattered_by(
    s: Station,
    scatterers: Scatterers,
    images: Sequence[Image],
    wave_numbers: Array,
    tolerance: float,
    bounces: int,
    floor: float = 0.0,
) -> tuple[Rays, Array]:
    """Contributions of every body, and the errors that their sums may have, (n_bodies,), with the
    antenna's gain.

    Parameters
    ----------
    wave_numbers
        Equally spaced over the band, at which bodies' echoes are summed, in rad/m.
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
        return Rays.joined([]), np.zeros(count)
    whole = facets, echoes_of(s, scatterers, facets)
    roots = _roots(s, scatterers, images) if bounces > 1 else None
    search = _Search(s, scatterers, images, bounces)
    first = None if roots is None else search.landed(roots)
    coarse = Budget(count, max(tolerance, _COARSE), wave_numbers, floor)
    search.leaves(whole, roots, first, coarse, _COARSE_DEPTH)
    budget = Budget(count, tolerance, wave_numbers, floor, coarse)
    found = search.leaves(whole, roots, first, budget, _DEEPEST)
    leaves = [_worth_it(part, budget) for part in found]
    rays = Rays.joined([rays_of(s, scatterers, part) for part in leaves if len(part.weight)])
    return rays, budget.accepted


def _worth_it(leaves: Leaves, budget: Budget) -> Leaves:
    echo, known = leaves.weight * leaves.echoes.total, leaves.echoes
    faint = budget.negligible(leaves.body, echo, known.strength, known.length_m)
    return leaves.chosen(np.flatnonzero(~faint))


@dataclass(frozen=True, eq=False)
class _Landed:
    """What tubes light, by receiver: the ``root`` of each, (n,), whether it ``is_lit``, and the
    ``error`` that its echo may have.
    """

    lit: Triangles
    echoes: Echoes
    root: NDArray[np.integer]
    is_lit: NDArray[np.bool_]
    error: Array


@dataclass(frozen=True, eq=False)
class _Search:
    """For echoes of bodies, by up to some ``bounces``."""

    s: Station
    scatterers: Scatterers
    images: Sequence[Image]
    bounces: int

    def leaves(
        self,
        whole: tuple[Triangles, Echoes],
        roots: Triangles | None,
        first: "_Landed | None",
        budget: Budget,
        deepest: tuple[int, int],
    ) -> list[Leaves]:
        """Those lit directly, and those lit by tubes; ``first``: where the roots' tubes land."""
        found = [settled(self.s, self.scatterers, *whole, budget, deepest[0])]
        budget.end_direct()
        if roots is not None and first is not None:
            lit = self._lit_by_tubes(roots, first, budget, deepest[1])
            if lit is not None:
                found.append(settled(self.s, self.scatterers, *lit, budget, deepest[0]))
        return [Leaves.joined(parts) for parts in found if parts]

    def landed(self, roots: Triangles) -> "_Landed | None":
        """Where the tubes of roots land, after every number of bounces; None where none does."""
        found = [Tubes.begin(roots)]
        for _ in range(1, self.bounces):
            further = reflected_on(self.s, self.scatterers, found[-1])
            if further is None:
                break
            found.append(further)
        if len(found) == 1:
            return None
        tubes = Tubes.joined(found[1:])
        lit, row = heard(self.s, self.scatterers, tubes.triangles, self.images)
        if not len(row):
            return None
        echoes = echoes_of(self.s, self.scatterers, lit)
        # What a ray stands for may lie on other planes than the one that it meets.
        most = np.sqrt(echoes.strength * echoes.gain * np.abs(echoes.amplitude))
        error = most * tubes.doubt[row]
        return _Landed(lit, echoes, tubes.root[row], tubes.is_lit[row], error)

    def _lit_by_tubes(
        self, roots: Triangles, first: "_Landed", budget: Budget, deepest: int
    ) -> tuple[Triangles, Echoes] | None:
        """What bodies light of each other, by every receiver.

        Roots are divided while what their tubes may return after all their bounces is too
        uncertain.
        """
        lit: list[tuple[Triangles, Echoes]] = []
        landed: _Landed | None = first
        for depth in range(deepest + 1):
            if landed is None:
                break
            share = landed.error / budget.allowed(landed.lit.body)
            error = np.sqrt(np.bincount(landed.root, share**2, len(roots)))
            done = budget.affordable(roots.body, error * budget.allowed(roots.body))
            if depth == deepest:
                done[:] = True
            ends = done[landed.root]
            budget.accept(landed.lit, landed.error, ends)
            some = np.flatnonzero(ends & landed.is_lit)
            if len(some):
                lit.append((landed.lit.taken(some), landed.echoes.chosen(some)))
            rest = np.flatnonzero(~done)
            if not len(rest):
                break
            roots = quartered(self.s, quartered(self.s, roots.taken(rest)))
            landed = self.landed(roots)
        if not lit:
            return None
        triangles, echoes = zip(*lit, strict=True)
        return Triangles.joined(triangles), Echoes.joined(echoes)


def _roots(s: Station, scatterers: Scatterers, images: Sequence[Image]) -> Triangles | None:
    """All facets that a source faces, divided until what they may show lies between their rays."""
    rows = np.flatnonzero(scatterers.counts)
    faces, sources = [], []
    for number, side in enumerate(sides_of(s, images, rows)):
        lit = (side != 0) & (scatterers.outward[number, rows] * side >= 0)
        faces.append(rows[lit & scatterers.heard[number, rows]])
        sources.append(np.full(len(faces[-1]), number))
    face, source = np.concatenate(faces), np.concatenate(sources)
    lit = lit_facets(s, scatterers, face, source, source)
    return None if lit is None else parted(s, lit)[0]
