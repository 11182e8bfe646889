"""The search for echoes of bodies: of facets that the radar lights, and of what ray tubes light
after some reflections, divided until their errors are as small as a budget asks for.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.adaptive_subdivision import subdivided_adaptively
from twin.radar.propagation.facets.currents import Echoes, echoes_of
from twin.radar.propagation.facets.earlier import Footprints
from twin.radar.propagation.facets.error_budget import Budget, Leaves
from twin.radar.propagation.facets.front_facets import FrontFacets, largest, portions
from twin.radar.propagation.facets.reflection_candidates import reflection_candidates
from twin.radar.propagation.facets.reflections import Limits
from twin.radar.propagation.facets.root_tubes import (
    DEEP_ERROR,
    DIVIDED_BOUNCES,
    Portions,
    RootTubes,
    TubeEchoes,
    aligned_errors,
    deep_of_roots,
    of_roots,
    parted,
    uncertain,
)
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.shadows import visible_samples
from twin.radar.propagation.facets.triangles import Triangles, split_in_four
from twin.radar.propagation.facets.tubes import Tubes, receivers_of, reflected_on
from twin.radar.propagation.facets.uniform_subdivision import sizes, subdivided
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.scene.images import Image

Array = NDArray[np.float64]

_FEW = 1000  # roots that are divided by sixteen: launching kernels costs more than these
#: Roots of one size, the most uncertain ones: what their tubes light takes some 2 GB. The rest is
#: divided no further, and its error counts as it is.
MOST_ROOTS = 2**16
#: Likewise, of roots that are divided further those whose tubes are followed for more than
#: `DIVIDED_BOUNCES`: in a street of touching boxes as many tubes are alive after the sixth
#: reflection as after the second.
MOST_DEEP_ROOTS = 2**14
_PER_LEVEL = 0.04  # of the squared tolerance, of roots of one size

_SMALL_M = 0.02  # footprints, of which the rays to four points tell whether any part is seen


@dataclass(frozen=True, eq=False)
class Search:
    """The search for echoes of bodies with up to ``bounces`` reflections, and within the
    ``limits`` of each body, if there are any; of some ``bodies``.
    """

    context: TracingContext
    scatterers: Scatterers
    images: Sequence[Image]
    bounces: int
    footprints: list[Footprints] | None  # None: not stored for later frames
    limits: Limits | None = None
    bodies: NDArray[np.bool_] | None = None  # those whose echoes count, (n_bodies,); None: all
    by_bounds: bool = False
    #: Times spent on reflections, also by what is made of this one.
    reflected_s: list[float] = field(default_factory=list)

    def may_be_seen(self, lit: Triangles) -> NDArray[np.bool_]:
        """Which footprints their receivers may see: any corner or the point inside; of large ones
        other parts, too.
        """
        seen = sizes(lit) > _SMALL_M
        for is_thorough in (False, True):  # most are seen at the point inside
            rest = np.flatnonzero(~seen & ~(lit.is_ray & is_thorough))
            for rows in portions(rest, 4):
                thoroughly = np.full(len(rows), is_thorough)
                clear = visible_samples(self.context, lit.gather(rows), thoroughly)
                seen[rows] = clear.any(axis=0)
        return seen

    def within(self, limits: Limits) -> "Search":
        """The same with limits of each body."""
        return replace(self, bounces=int(limits.bounces.max(initial=1)), limits=limits)

    def of(self, bodies: NDArray[np.bool_]) -> "Search":
        """The same for some bodies, (n_bodies,)."""
        bounces = self.bounces
        if self.limits is not None:
            bounces = int(self.limits.bounces[bodies].max(initial=1))
        return replace(self, bodies=bodies, bounces=bounces)

    def counts(self, lit: Triangles | FrontFacets) -> NDArray[np.bool_]:
        """Whether paths are echoes of bodies that count, and within these bodies' limits."""
        ends = np.array(lit.source), np.array(lit.receiver)
        return self._count(lit.body, lit.bounces, *ends)

    def _count(
        self,
        body: NDArray[np.intp],
        bounces: NDArray[np.uint8],
        source: NDArray[np.integer],
        receiver: NDArray[np.integer],
    ) -> NDArray[np.bool_]:
        counts = np.ones(len(body), dtype=bool)
        if self.bodies is not None:
            counts &= self.bodies[body]
        if self.limits is not None:
            order = np.array([len(image.patches) for image in self.images])
            counts &= bounces <= self.limits.bounces[body]
            counts &= np.maximum(order[source], order[receiver]) <= self.limits.images[body]
        return counts

    def part_of(
        self, whole: tuple[FrontFacets, Echoes] | None, tubes: RootTubes | None
    ) -> tuple[tuple[FrontFacets, Echoes] | None, RootTubes | None]:
        """What is within the limits, of facets and of ray tubes."""
        if whole is not None:
            rows = np.flatnonzero(self.counts(whole[0]))
            whole = (whole[0].subset(rows), whole[1].take(rows)) if len(rows) else None
        if tubes is not None:
            echoes = [part.take(np.flatnonzero(self.counts(part.lit))) for part in tubes.echoes]
            echoes = [part for part in echoes if len(part.root)]
            tubes = replace(tubes, echoes=echoes) if echoes else None
        return whole, tubes

    def leaves(
        self,
        whole: tuple[FrontFacets, Echoes] | None,
        tubes: RootTubes | None,
        budget: Budget,
        deepest: tuple[int, int],
    ) -> list[Leaves]:
        """Leaves lit directly, and leaves lit by ray ``tubes``."""
        generations = []
        if whole is not None:
            generations.append(
                subdivided_adaptively(self.context, self.scatterers, *whole, budget, deepest[0])
            )
        budget.end_direct()
        began_s = perf_counter()
        if tubes is not None:
            lit = self._lit_by_tubes(tubes, budget, deepest[1])
            if lit is not None:
                generations.append(
                    subdivided_adaptively(self.context, self.scatterers, *lit, budget, deepest[0])
                )
        self.reflected_s.append(perf_counter() - began_s)
        return [Leaves.concatenate(parts) for parts in generations if parts]

    def root_tubes(self, facets: FrontFacets, spacing_m: float) -> RootTubes | None:
        """Ray tubes of the facets that may reflect to others, divided to the spacing of the rays
        that look for these.
        """
        began_s = perf_counter()
        rows = reflection_candidates(self.context, self.scatterers, facets, spacing_m)
        wholes = (facets.take(some) for some in portions(rows))
        found = self._root_tubes(subdivided(self.context, whole, spacing_m)[0] for whole in wholes)
        self.reflected_s.append(perf_counter() - began_s)
        return found

    def _root_tubes(self, parts: Iterable[Triangles]) -> RootTubes | None:
        """Of all candidates the roots whose tubes meet other facets, with the echoes of these."""
        roots: list[Triangles] = []
        echoes: list[TubeEchoes] = []
        count = 0
        for part in parts:
            for rows in portions(np.arange(len(part)), 4):  # a tube may go on in so many parts
                some = part if len(rows) == len(part) else part.take(rows)
                lit = self.lit_by(some)
                if lit is None:
                    continue
                used, number = np.unique(lit.root, return_inverse=True)
                roots.append(some.take(used))
                echoes.append(replace(lit, root=count + number.reshape(-1)))
                count += len(used)
        return RootTubes(Triangles.concatenate(roots), echoes) if roots else None

    def lit_by(self, roots: Triangles) -> TubeEchoes | None:
        """Echoes of what the tubes of roots light after any number of bounces; None if nothing."""
        generations = [Tubes.from_roots(roots)]
        for _ in range(1, self.bounces):
            further = reflected_on(self.context, self.scatterers, generations[-1])
            if further is None:
                break
            generations.append(further)
        if len(generations) == 1:
            return None
        tubes = Tubes.concatenate(generations[1:])
        every = tubes.triangles
        row, receiver = receivers_of(self.context, self.scatterers, every, self.images)
        if self.footprints is not None:
            times = np.repeat(
                np.arange(1, len(generations)), [len(part.root) for part in generations[1:]]
            )
            goes_on = tubes.is_lit & (times < self.bounces - 1)
            self.footprints.append(Footprints.of(self.context, tubes, goes_on, row, receiver))
        if self.by_bounds or self.bodies is not None:
            source = np.array(every.source)[row]
            some = self._count(every.body[row], every.bounces[row], source, receiver)
            row, receiver = row[some], receiver[some]
        if not len(row):
            return None
        lit = every.towards(row, receiver)
        if self.by_bounds:
            seen = np.flatnonzero(self.may_be_seen(lit))
            lit, row = lit.take(seen), row[seen]
        if not len(row):
            return None
        portion = list(portions(np.arange(len(lit))))
        parts = [lit] if len(portion) == 1 else (lit.take(rows) for rows in portion)
        echoes = Echoes.concatenate(
            [echoes_of(self.context, self.scatterers, part) for part in parts]
        )
        # A tube that one ray represents may also meet other planes than that ray does.
        most = np.sqrt(echoes.strength * echoes.gain * np.abs(echoes.amplitude))
        error = aligned_errors(self.context, lit, echoes, most * tubes.doubt[row])
        rounding = most * tubes.rounding[row]
        return TubeEchoes(lit, echoes, tubes.root[row], tubes.is_lit[row], error, rounding)

    def _divided(self, roots: Triangles, times: int) -> Triangles:
        """Roots divided by four, ``times`` times."""
        for _ in range(times):
            roots = split_in_four(self.context, roots)
        return roots

    def _may_stay_coarse(self, echoes: Portions, budget: Budget) -> NDArray[np.bool_]:
        """Bodies of whose paths of many reflections the errors are small enough, (n_bodies,)."""
        if not self.by_bounds:
            return np.zeros(len(budget.level), dtype=bool)
        square = np.zeros(len(budget.level))
        for part in echoes:
            square += np.bincount(part.lit.body, part.error**2 * part.is_deep, len(square))
        coarse: NDArray[np.bool_] = np.sqrt(square) <= DEEP_ERROR * budget.tolerance * budget.level
        return coarse

    def _lit_by_tubes(
        self, tubes: RootTubes, budget: Budget, deepest: int
    ) -> tuple[Triangles, Echoes] | None:
        """Triangles that ray tubes light, one for each receiver, and their echoes.

        Roots are divided while the echoes of their tubes, after all bounces, are too uncertain.
        """
        kept: list[tuple[Triangles, Echoes]] = []

        def keep(echoes: Portions) -> None:
            for part in echoes:
                error, whole = np.hypot(part.error, part.rounding), np.ones(len(part.root), bool)
                budget.accept(part.lit, error, whole, part.echoes.length_m)
                kept.append(part.to_keep())

        root_tubes: RootTubes | None = tubes
        stays_coarse, depth = np.zeros(len(budget.level), dtype=bool), 0
        while root_tubes is not None:
            roots = root_tubes.roots
            # Deep paths to these were accepted as they were before the last division.
            _, echoes = parted(root_tubes.echoes, partial(TubeEchoes.deep, bodies=stays_coarse))
            further = self._may_stay_coarse(echoes, budget) & ~stays_coarse
            deep, echoes = parted(echoes, partial(TubeEchoes.deep, bodies=further))
            keep(deep)
            stays_coarse |= further
            square = uncertain(roots, echoes, budget)
            error = np.sqrt(square) * budget.allowed(roots.body)
            done = budget.affordable(roots.body, error, _PER_LEVEL)
            if depth == deepest:
                done[:] = True
            done |= ~largest(np.where(done, 0.0, square), MOST_ROOTS // 4)
            final, echoes = parted(echoes, partial(of_roots, roots=done))
            keep(final)
            if done.all():
                break
            goes_deep = ~done & ~stays_coarse.all()
            if self.by_bounds and np.count_nonzero(goes_deep) > MOST_DEEP_ROOTS // 4:
                square = uncertain(roots, echoes, budget, is_deep=True)
                goes_deep = largest(square, MOST_DEEP_ROOTS // 4)
                deep, echoes = parted(echoes, partial(deep_of_roots, roots=~goes_deep))
                keep(deep)
                for part in deep:
                    budget.add_undivided(part.lit, part.error)
            root_tubes, depth = self._further(roots, done, goes_deep, depth, deepest)
        if not kept:
            return None
        triangles, of_triangles = zip(*kept, strict=True)
        return Triangles.concatenate(triangles), Echoes.concatenate(of_triangles)

    def _further(
        self,
        roots: Triangles,
        done: NDArray[np.bool_],
        goes_deep: NDArray[np.bool_],
        depth: int,
        deepest: int,
    ) -> tuple[RootTubes | None, int]:
        """Tubes of parts of roots that are not done, some for few reflections; and their depth."""
        few = replace(self, bounces=min(self.bounces, DIVIDED_BOUNCES))
        times = min(2 if np.count_nonzero(~done) < _FEW else 1, deepest - depth)
        found = [
            search._root_tubes(
                self._divided(roots.take(rows), times)
                for rows in portions(np.flatnonzero(which), 4**times)
            )
            for search, which in ((few, ~done & ~goes_deep), (self, ~done & goes_deep))
            if which.any()
        ]
        return RootTubes.concatenate([part for part in found if part is not None]), depth + times
