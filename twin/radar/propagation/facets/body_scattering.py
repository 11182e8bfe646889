"""Scattering by all bodies: facets lit by the radar, and by reflections from one another.

A first, coarse pass estimates how strong the echo of every body is; the second subdivides as finely
as that asks for, and is repeated where an echo turns out to be far weaker. Contributions of an
earlier frame that are still valid count in both.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.adaptive_subdivision import subdivided_adaptively
from twin.radar.propagation.facets.band_sums import band_sums
from twin.radar.propagation.facets.currents import Echoes, echoes_of
from twin.radar.propagation.facets.earlier import Footprints, Sums, TracedEchoes
from twin.radar.propagation.facets.error_budget import Budget, Leaves
from twin.radar.propagation.facets.front_facets import (
    FrontFacets,
    bistatic_facets,
    illuminated_facets,
    largest,
    portions,
)
from twin.radar.propagation.facets.reflection_candidates import reflection_candidates
from twin.radar.propagation.facets.reflections import (
    MOST_BOUNCES,
    Limits,
    ReflectionChoice,
    Tally,
)
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.shadows import visible_samples
from twin.radar.propagation.facets.triangles import Triangles, split_in_four
from twin.radar.propagation.facets.tubes import Tubes, receivers_of, reflected_on
from twin.radar.propagation.facets.uniform_subdivision import sizes, spacing_of, subdivided
from twin.radar.propagation.facets.validity import Valid
from twin.radar.propagation.facets.wideband import contributions_of
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.scene.images import Image

Array = NDArray[np.float64]

_DEEPEST = 12, 6  # divisions by four, of facets and of roots of tubes
_COARSE_DEPTH = 0, 0
_FEW = 1000  # roots that are divided by sixteen: launching kernels costs more than these
_MOST_PASSES = 3  # further ones, where the level of bodies was overestimated
#: Roots of one size, the most uncertain ones: what their tubes light takes some 2 GB. The rest is
#: divided no further, and its error counts as it is.
MOST_ROOTS = 2**16
#: Likewise, of roots that are divided further those whose tubes are followed for more than
#: `_DIVIDED_BOUNCES`: in a street of touching boxes as many tubes are alive after the sixth
#: reflection as after the second.
MOST_DEEP_ROOTS = 2**14
_PER_LEVEL = 0.04  # of the squared tolerance, of roots of one size
_COARSE = 0.5  # tolerance of the first pass, at least
#: Of the level that a body's error is relative to, since an earlier frame: from this factor on what
#: that frame left out or divided no further is held against the tolerance again.
LEAST_FALL = 1.05
_SMALL_M = 0.02  # footprints, of which the rays to four points tell whether any part is seen
#: Each effect that is left out may change a body's echo by so much.
OF_TOLERANCE = 0.1
#: Both kinds of reflections together, where levels turn out to be lower than the coarse pass found.
_OF_ALL_REFLECTIONS = 0.5
#: Where bounds decide, roots are not divided for the sake of paths of more reflections at bodies,
#: which would take as long again as all else, ...
_DIVIDED_BOUNCES = 3
#: ... where the errors of these, of a body's roots of one size, are no more than so many tolerances
#: together. They count in its estimated error, and in the bound of what is reflected still more
#: often: on the yard's car 4 % of its echo. With twice as much the street's car is off by 5.1 % in
#: place of 2.9 %, with less nothing gains. Nor does it to end them root by root: at equal time the
#: yard's car is off by 6.9 % in place of 4.7 %, since what a coarse tube misses finer ones find.
_DEEP_ERROR = 0.25


def scattered_by(
    context: TracingContext,
    scatterers: Scatterers,
    images: Sequence[Image],
    wave_numbers: Array,
    tolerance: float,
    bounces: int | None,
    floor: float = 0.0,
    valid: Valid | None = None,
    *,
    by_images: bool = False,
    has_more_images: NDArray[np.bool_] | None = None,
    with_footprints: bool = False,
) -> TracedEchoes:
    """Contributions of every body, and errors that their sums may have, with the antenna's gain.

    Parameters
    ----------
    wave_numbers
        Equally spaced over the band, at which bodies' echoes are summed, in rad/m.
    tolerance
        Error of every body's echo over the band, relative to its root mean square.
    bounces
        Most reflections, between bodies and within one: echoes of more are left out. None: of
        every body as many as may add more than a tenth of the tolerance.
    by_images
        Whether of reflections on the way to bodies, too, only as many are computed.
    has_more_images
        Of bodies, (n_bodies,): whether there are paths by more reflections than those of any image.
    floor
        Amplitude below which no error counts.
    valid
        What holds of an earlier frame: all else is found, and joined with that. Bodies of which too
        much was left out for their present levels (`_fell`) are found anew, with all ray tubes that
        light them.
    with_footprints
        Whether footprints are stored, so that later frames may reuse these echoes.
    """

    def without(fell: NDArray[np.bool_]) -> TracedEchoes:
        assert valid is not None
        return scattered_by(
            context,
            scatterers,
            images,
            wave_numbers,
            tolerance,
            bounces,
            floor,
            valid.without(fell),
            by_images=by_images,
            has_more_images=has_more_images,
        )

    count = int(scatterers.body.max()) + 1
    facets = bistatic_facets(context, scatterers, images, None if valid is None else valid.paths)
    tally, most = None, bounces or MOST_BOUNCES
    if bounces is None or by_images:
        order = np.array([len(image.patches) for image in images])
        permitted = OF_TOLERANCE * tolerance
        tally = Tally(
            count,
            wave_numbers,
            order,
            permitted,
            bounces,
            by_images=by_images,
            has_more_images=has_more_images,
        )
    search = _Search(
        context,
        scatterers,
        images,
        most,
        [] if with_footprints else None,
        by_bounds=tally is not None,
    )
    earlier_echoes = None
    if valid is not None:
        sums = valid.sums
        owner = scatterers.body[sums.face]
        earlier_echoes = band_sums(owner, count, sums.echo, sums.length_m, wave_numbers)
    coarse = Budget(
        count,
        max(tolerance, _COARSE),
        wave_numbers,
        floor,
        earlier_echoes=earlier_echoes,
        tally=tally,
        counts_errors=tally is not None,  # which bounds errors of reflections by these
    )
    whole = (facets, facets.echoes()) if len(facets) else None
    if whole is None:
        coarse.estimate_levels([])
    tubes, spacing_m = None, 0.0
    if most > 1:
        begin = illuminated_facets(
            context, scatterers, images, None if valid is None else valid.tubes
        )
        spacing_m = spacing_of(context, begin.sizes()) if valid is None else valid.spacing_m[1]
        tubes = search.root_tubes(begin, spacing_m) if len(begin) else None
    search.leaves(whole, tubes, coarse, _COARSE_DEPTH)
    if valid is not None and (fell := _fell(valid, coarse.level, tolerance)).any():
        return without(fell)
    found = whole, tubes
    if tally is not None:
        search = search.within(tally.limits(coarse.level))
        whole, tubes = search.part_of(*found)
    budget = Budget(
        count,
        tolerance,
        wave_numbers,
        floor,
        coarse,
        earlier_echoes=earlier_echoes,
        tally=tally and tally.fine(),
    )
    budget.earlier_spacing_m = (valid and valid.spacing_m[0]) or None
    parts = search.leaves(whole, tubes, budget, _DEEPEST)
    for _ in range(_MOST_PASSES):
        again = budget.overestimated()
        if tally and search.limits:
            # Levels have fallen, so that more reflections count.
            limits, more = search.limits, tally.limits(budget.level)
            again |= (further := more.exceed(limits) & _leaves_out_too_much(tally, limits, budget))
            search = search.within(limits.raised(more, further))
        if not again.any():
            break
        budget = budget.again_of(again)
        kept = [part.take(np.flatnonzero(~again[part.body])) for part in parts]
        search = search.of(again)
        parts = [*kept, *search.leaves(*search.part_of(*found), budget, _DEEPEST)]
        parts = [part for part in parts if len(part.weight)]
    leaves = list(_portioned([_worth_it(part, budget) for part in parts]))
    error = budget.accepted
    if valid is not None:
        if (fell := _fell(valid, budget.level, tolerance)).any():
            return without(fell)
        error = np.hypot(error, valid.error)
    contributions = [contributions_of(context, scatterers, part) for part in leaves]
    return TracedEchoes(
        contributions=tuple(contributions)
        if valid is None
        else (valid.contributions, *contributions),
        sums=tuple(map(Sums.of, leaves)) if with_footprints else (),
        is_direct=tuple(part.triangles.waves is None for part in leaves),
        error=error,
        level=budget.level,
        footprints=tuple(search.footprints or ()),
        spacing_m=(budget.spacing_m, spacing_m),
        n_reused=0 if valid is None else len(valid.contributions),
        choice=_choice(tally, search.limits, budget, valid),
    )


def _fell(valid: Valid, level: Array, tolerance: float) -> NDArray[np.bool_]:
    """Bodies whose level is so much lower than in the earlier frame that the error of what is kept
    of them, with what was left out, exceeds the tolerance, (n_bodies,).
    """
    fell: NDArray[np.bool_] = valid.level > LEAST_FALL * level
    fell &= valid.error > tolerance * level
    return fell


def _leaves_out_too_much(tally: Tally, limits: Limits, budget: Budget) -> NDArray[np.bool_]:
    """Bodies of whose echo limits leave out more than further reflections may add, (n_bodies,)."""
    most = _OF_ALL_REFLECTIONS * budget.tolerance * budget.level
    exceeds: NDArray[np.bool_] = tally.left_out(limits).sum > most
    return exceeds


def _choice(
    tally: Tally | None, limits: Limits | None, budget: Budget, valid: Valid | None
) -> ReflectionChoice | None:
    """What limits leave out, of an earlier frame's echoes that are reused, too."""
    if tally is None or limits is None or budget.tally is None:
        return None
    own = tally.choice(limits, budget.tally, budget.undivided)
    if valid is None or valid.left_out is None:
        return own
    return replace(own, left_out=own.left_out + valid.left_out)


def _worth_it(leaves: Leaves, budget: Budget) -> Leaves:
    echo, echoes = leaves.weight * leaves.echoes.total, leaves.echoes
    faint = budget.negligible(leaves.body, echo, echoes.strength, echoes.length_m, is_seen=True)
    return leaves.take(np.flatnonzero(~faint))


def _portioned(parts: Iterable[Leaves]) -> Iterator[Leaves]:
    """The same in portions, of each part one where that is enough."""
    for part in parts:
        for rows in portions(part.rows):
            yield part if len(rows) == len(part.rows) else part.take(rows)


@dataclass(frozen=True, eq=False)
class _TubeEchoes:
    """Echoes of triangles that ray tubes light, one for each receiver: the ``root`` of the tube,
    (n,), whether the triangle ``is_lit``, and the possible ``error`` of its echo.
    """

    lit: Triangles
    echoes: Echoes
    root: NDArray[np.integer]
    is_lit: NDArray[np.bool_]
    error: Array

    def take(self, rows: NDArray[np.intp]) -> "_TubeEchoes":
        """Only some of them, by index."""
        if len(rows) == len(self.root):
            return self
        return _TubeEchoes(
            self.lit.take(rows),
            self.echoes.take(rows),
            self.root[rows],
            self.is_lit[rows],
            self.error[rows],
        )

    @property
    def is_deep(self) -> NDArray[np.bool_]:
        """Which are of many reflections, (n,)."""
        is_deep: NDArray[np.bool_] = self.lit.bounces > _DIVIDED_BOUNCES
        return is_deep

    def deep(self, bodies: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which are of many reflections and return from some bodies (n_bodies,)."""
        is_deep: NDArray[np.bool_] = self.is_deep & bodies[self.lit.body]
        return is_deep

    def to_keep(self) -> tuple[Triangles, Echoes]:
        """Lit triangles that are divided no further as roots are, and their echoes."""
        some = np.flatnonzero(self.is_lit)
        return self.lit.take(some).with_own_waves(), self.echoes.take(some)


#: Echoes in portions.
_Portions = Sequence[_TubeEchoes]


def _parted(
    echoes: _Portions, which: Callable[[_TubeEchoes], NDArray[np.bool_]]
) -> tuple[list[_TubeEchoes], list[_TubeEchoes]]:
    """Some, and all others."""
    some, others = [], []
    for part in echoes:
        these = which(part)
        some.append(part.take(np.flatnonzero(these)))
        others.append(part.take(np.flatnonzero(~these)))
    return [p for p in some if len(p.root)], [p for p in others if len(p.root)]


def _uncertain(
    roots: Triangles, echoes: _Portions, budget: Budget, *, is_deep: bool = False
) -> Array:
    """Squared errors of what each root's tubes light over what is permitted, (n_roots,);
    ``is_deep``: those of many reflections alone.
    """
    square = np.zeros(len(roots))
    for part in echoes:
        share = part.error / budget.allowed(part.lit.body)
        counts = part.is_deep if is_deep else np.ones(len(share), dtype=bool)
        square += np.bincount(part.root, share**2 * counts, len(roots))
    return square


@dataclass(frozen=True, eq=False)
class _RootTubes:
    """Roots of ray tubes that meet other facets, and the echoes of what they light, in portions."""

    roots: Triangles
    echoes: list[_TubeEchoes]

    @staticmethod
    def concatenate(parts: "Sequence[_RootTubes]") -> "_RootTubes | None":
        """One after the other; None of none."""
        if len(parts) < 2:
            return parts[0] if parts else None
        begin = np.cumsum([0, *(len(part.roots) for part in parts)])
        echoes = [
            replace(some, root=first + some.root)
            for part, first in zip(parts, begin, strict=False)
            for some in part.echoes
        ]
        return _RootTubes(Triangles.concatenate([part.roots for part in parts]), echoes)


@dataclass(frozen=True, eq=False)
class _Search:
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

    def within(self, limits: Limits) -> "_Search":
        """The same with limits of each body."""
        return replace(self, bounces=int(limits.bounces.max(initial=1)), limits=limits)

    def of(self, bodies: NDArray[np.bool_]) -> "_Search":
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
        self, whole: tuple[FrontFacets, Echoes] | None, tubes: "_RootTubes | None"
    ) -> tuple[tuple[FrontFacets, Echoes] | None, "_RootTubes | None"]:
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
        tubes: "_RootTubes | None",
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
        if tubes is not None:
            lit = self._lit_by_tubes(tubes, budget, deepest[1])
            if lit is not None:
                generations.append(
                    subdivided_adaptively(self.context, self.scatterers, *lit, budget, deepest[0])
                )
        return [Leaves.concatenate(parts) for parts in generations if parts]

    def root_tubes(self, facets: FrontFacets, spacing_m: float) -> "_RootTubes | None":
        """Ray tubes of the facets that may reflect to others, divided to the spacing of the rays
        that look for these.
        """
        rows = reflection_candidates(self.context, self.scatterers, facets, spacing_m)
        wholes = (facets.take(some) for some in portions(rows))
        return self._root_tubes(subdivided(self.context, whole, spacing_m)[0] for whole in wholes)

    def _root_tubes(self, parts: Iterable[Triangles]) -> "_RootTubes | None":
        """Of all candidates the roots whose tubes meet other facets, with the echoes of these."""
        roots: list[Triangles] = []
        echoes: list[_TubeEchoes] = []
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
        return _RootTubes(Triangles.concatenate(roots), echoes) if roots else None

    def lit_by(self, roots: Triangles) -> "_TubeEchoes | None":
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
        error = most * tubes.doubt[row]
        return _TubeEchoes(lit, echoes, tubes.root[row], tubes.is_lit[row], error)

    def _divided(self, roots: Triangles, times: int) -> Triangles:
        """Roots divided by four, ``times`` times."""
        for _ in range(times):
            roots = split_in_four(self.context, roots)
        return roots

    def _may_stay_coarse(self, echoes: _Portions, budget: Budget) -> NDArray[np.bool_]:
        """Bodies of whose paths of many reflections the errors are small enough, (n_bodies,)."""
        if not self.by_bounds:
            return np.zeros(len(budget.level), dtype=bool)
        square = np.zeros(len(budget.level))
        for part in echoes:
            square += np.bincount(part.lit.body, part.error**2 * part.is_deep, len(square))
        coarse: NDArray[np.bool_] = np.sqrt(square) <= _DEEP_ERROR * budget.tolerance * budget.level
        return coarse

    def _lit_by_tubes(
        self, tubes: "_RootTubes", budget: Budget, deepest: int
    ) -> tuple[Triangles, Echoes] | None:
        """Triangles that ray tubes light, one for each receiver, and their echoes.

        Roots are divided while the echoes of their tubes, after all bounces, are too uncertain.
        """
        kept: list[tuple[Triangles, Echoes]] = []

        def keep(echoes: _Portions) -> None:
            for part in echoes:
                budget.accept(part.lit, part.error, np.ones(len(part.root), dtype=bool))
                kept.append(part.to_keep())

        root_tubes: _RootTubes | None = tubes
        stays_coarse, depth = np.zeros(len(budget.level), dtype=bool), 0
        while root_tubes is not None:
            roots = root_tubes.roots
            # Deep paths to these were accepted as they were before the last division.
            _, echoes = _parted(root_tubes.echoes, partial(_TubeEchoes.deep, bodies=stays_coarse))
            further = self._may_stay_coarse(echoes, budget) & ~stays_coarse
            deep, echoes = _parted(echoes, partial(_TubeEchoes.deep, bodies=further))
            keep(deep)
            stays_coarse |= further
            square = _uncertain(roots, echoes, budget)
            error = np.sqrt(square) * budget.allowed(roots.body)
            done = budget.affordable(roots.body, error, _PER_LEVEL)
            if depth == deepest:
                done[:] = True
            done |= ~largest(np.where(done, 0.0, square), MOST_ROOTS // 4)
            final, echoes = _parted(echoes, partial(_of_roots, roots=done))
            keep(final)
            if done.all():
                break
            goes_deep = ~done & ~stays_coarse.all()
            if self.by_bounds and np.count_nonzero(goes_deep) > MOST_DEEP_ROOTS // 4:
                square = _uncertain(roots, echoes, budget, is_deep=True)
                goes_deep = largest(square, MOST_DEEP_ROOTS // 4)
                deep, echoes = _parted(echoes, partial(_deep_of_roots, roots=~goes_deep))
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
    ) -> tuple["_RootTubes | None", int]:
        """Tubes of parts of roots that are not done, some for few reflections; and their depth."""
        few = replace(self, bounces=min(self.bounces, _DIVIDED_BOUNCES))
        times = min(2 if np.count_nonzero(~done) < _FEW else 1, deepest - depth)
        found = [
            search._root_tubes(
                self._divided(roots.take(rows), times)
                for rows in portions(np.flatnonzero(which), 4**times)
            )
            for search, which in ((few, ~done & ~goes_deep), (self, ~done & goes_deep))
            if which.any()
        ]
        return _RootTubes.concatenate([part for part in found if part is not None]), depth + times


def _of_roots(part: _TubeEchoes, roots: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which are of some roots (n_roots,)."""
    which: NDArray[np.bool_] = roots[part.root]
    return which


def _deep_of_roots(part: _TubeEchoes, roots: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of these are of many reflections."""
    return part.is_deep & roots[part.root]
