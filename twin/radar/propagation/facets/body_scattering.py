"""Scattering by all bodies: facets lit by the radar, and by reflections from one another.

A first, coarse pass estimates how strong the echo of every body is; the second subdivides as finely
as that asks for, and is repeated where an echo turns out to be far weaker. Contributions of an
earlier frame that are still valid count in both.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.band_sums import band_sums
from twin.radar.propagation.facets.currents import Echoes
from twin.radar.propagation.facets.earlier import Sums, TracedEchoes
from twin.radar.propagation.facets.echo_search import Search
from twin.radar.propagation.facets.error_budget import Budget, Leaves
from twin.radar.propagation.facets.front_facets import (
    FrontFacets,
    bistatic_facets,
    illuminated_facets,
    portions,
)
from twin.radar.propagation.facets.reflections import (
    MOST_BOUNCES,
    Limits,
    ReflectionChoice,
    Tally,
)
from twin.radar.propagation.facets.root_tubes import RootTubes
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.uniform_subdivision import finer_spacing_of
from twin.radar.propagation.facets.validity import Valid
from twin.radar.propagation.facets.wideband import contributions_of
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.scene.images import Image

Array = NDArray[np.float64]

_DEEPEST = 12, 6  # divisions by four, of facets and of roots of tubes
_COARSE_DEPTH = 0, 0
_MOST_PASSES = 3  # further ones, where the level of bodies was overestimated
_COARSE = 0.5  # tolerance of the first pass, at least
#: Of the level that a body's error is relative to, since an earlier frame: from this factor on what
#: that frame left out or divided no further is held against the tolerance again.
LEAST_FALL = 1.05
#: Each effect that is left out may change a body's echo by so much.
OF_TOLERANCE = 0.1
#: Both kinds of reflections together, where levels turn out to be lower than the coarse pass found.
_OF_ALL_REFLECTIONS = 0.5


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
    further_images: Array | None = None,
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
    further_images
        Of bodies, (n_bodies,), as `FurtherPaths.objects`.
    floor
        Amplitude below which no error counts.
    valid
        What holds of an earlier frame: all else is found, and joined with that. Bodies of which too
        much was left out for their present levels (`_fell`) are found anew, with all ray tubes that
        light them.
    with_footprints
        Whether footprints are stored, so that later frames may reuse these echoes.
    """
    task = _Task(
        context,
        scatterers,
        images,
        wave_numbers,
        tolerance,
        bounces,
        floor,
        by_images=by_images,
        further_images=further_images,
    )
    found = task.traced(valid, with_footprints=with_footprints)
    while isinstance(found, _Fell):
        found = task.traced(found.rest, with_footprints=False)
    return found


class _Fell(NamedTuple):
    """Of an earlier frame too much was left out of some bodies; ``rest``: what holds of others."""

    rest: Valid | None


class _Begun(NamedTuple):
    """Undivided: facets with their echoes, and the roots of ray tubes; None of none."""

    facets: tuple[FrontFacets, Echoes] | None
    tubes: RootTubes | None


class _Refined(NamedTuple):
    """What was found to a tolerance: parts of facets, by which search, within which budget."""

    parts: list[Leaves]
    search: Search
    budget: Budget


@dataclass(frozen=True, eq=False)
class _Task:
    """What is asked for, as of `scattered_by`."""

    context: TracingContext
    scatterers: Scatterers
    images: Sequence[Image]
    wave_numbers: Array
    tolerance: float
    bounces: int | None
    floor: float
    by_images: bool
    further_images: Array | None

    def traced(self, valid: Valid | None, *, with_footprints: bool) -> TracedEchoes | _Fell:
        """All echoes; or what holds of an earlier frame, if that is less than ``valid``."""
        tally = self._tally()
        by_bounds = tally is not None
        search = Search(
            self.context,
            self.scatterers,
            self.images,
            self.bounces or MOST_BOUNCES,
            [] if with_footprints else None,
            by_bounds=by_bounds,
        )
        begun, spacing_m = self._begun(search, valid)
        # Errors of reflections are bounded by those of a coarse pass.
        coarse = self._budget(
            max(self.tolerance, _COARSE), valid, tally=tally, counts_errors=by_bounds
        )
        if begun.facets is None:
            coarse.estimate_levels([])
        search.leaves(*begun, coarse, _COARSE_DEPTH)
        if valid is not None and (fell := _fell(valid, coarse.level, self.tolerance)).any():
            return _Fell(valid.without(fell))
        budget = self._budget(
            self.tolerance, valid, coarse, tally=tally and tally.fine(), counts_ranges=True
        )
        budget.earlier_spacing_m = (valid and valid.spacing_m[0]) or None
        if tally is not None:
            search = search.within(tally.limits(coarse.level))
        fine = _refined(search, begun, budget, tally)
        if valid is not None and (fell := _fell(valid, fine.budget.level, self.tolerance)).any():
            return _Fell(valid.without(fell))
        return self._echoes(fine, valid, tally, spacing_m)

    def _tally(self) -> Tally | None:
        """Of reflections, where bounds decide on them."""
        if self.bounces is not None and not self.by_images:
            return None
        return Tally(
            self._n_bodies,
            self.wave_numbers,
            np.array([len(image.patches) for image in self.images]),
            OF_TOLERANCE * self.tolerance,
            self.bounces,
            by_images=self.by_images,
            further_images=self.further_images,
        )

    @property
    def _n_bodies(self) -> int:
        return int(self.scatterers.body.max()) + 1

    def _budget(
        self,
        tolerance: float,
        valid: Valid | None,
        coarse: Budget | None = None,
        *,
        tally: Tally | None,
        counts_errors: bool = True,
        counts_ranges: bool = False,
    ) -> Budget:
        """With the echoes of an earlier frame that are ``valid``."""
        count, earlier_echoes = self._n_bodies, None
        if valid is not None:
            owner, sums = self.scatterers.body[valid.sums.face], valid.sums
            earlier_echoes = band_sums(owner, count, sums.echo, sums.length_m, self.wave_numbers)
        return Budget(
            count,
            tolerance,
            self.wave_numbers,
            self.floor,
            coarse,
            earlier_echoes=earlier_echoes,
            tally=tally,
            counts_errors=counts_errors,
            counts_ranges=counts_ranges,
        )

    def _begun(self, search: Search, valid: Valid | None) -> tuple[_Begun, float]:
        """What is not ``valid`` of an earlier frame, and the spacing of ray tubes' roots."""
        setting = self.context, self.scatterers, self.images
        facets = bistatic_facets(*setting, None if valid is None else valid.paths)
        whole = (facets, facets.echoes()) if len(facets) else None
        if search.bounces == 1:
            return _Begun(whole, None), 0.0
        begin = illuminated_facets(*setting, None if valid is None else valid.tubes)
        spacing_m = valid.spacing_m[1] if valid else finer_spacing_of(self.context, begin.sizes())
        tubes = search.root_tubes(begin, spacing_m) if len(begin) else None
        return _Begun(whole, tubes), spacing_m

    def _echoes(
        self, fine: _Refined, valid: Valid | None, tally: Tally | None, tube_spacing_m: float
    ) -> TracedEchoes:
        """With those of an earlier frame that are ``valid``."""
        budget = fine.budget
        leaves = list(_portioned([_worth_it(part, budget) for part in fine.parts]))
        contributions = [contributions_of(self.context, self.scatterers, part) for part in leaves]
        error, by_range = budget.accepted, budget.by_range
        if valid is not None:
            contributions = [valid.contributions, *contributions]
            error = np.hypot(error, valid.error)
            by_range = by_range.and_of(valid.by_range)
        footprints = fine.search.footprints
        return TracedEchoes(
            contributions=tuple(contributions),
            sums=() if footprints is None else tuple(map(Sums.of, leaves)),
            is_direct=tuple(part.triangles.waves is None for part in leaves),
            error=error,
            by_range=by_range,
            level=budget.level,
            footprints=tuple(footprints or ()),
            spacing_m=(budget.spacing_m, tube_spacing_m),
            n_reused=0 if valid is None else len(valid.contributions),
            choice=_choice(tally, fine.search, budget, valid),
        )


def _refined(search: Search, begun: _Begun, budget: Budget, tally: Tally | None) -> _Refined:
    """Of what is within the limits, and again of bodies whose level was overestimated."""
    some = begun if tally is None else _Begun(*search.part_of(*begun))
    parts = search.leaves(*some, budget, _DEEPEST)
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
        parts = [*kept, *search.leaves(*search.part_of(*begun), budget, _DEEPEST)]
        parts = [part for part in parts if len(part.weight)]
    return _Refined(parts, search, budget)


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
    tally: Tally | None, search: Search, budget: Budget, valid: Valid | None
) -> ReflectionChoice | None:
    """What limits leave out, of an earlier frame's echoes that are reused, too."""
    if tally is None or search.limits is None or budget.tally is None:
        return None
    own = tally.choice(search.limits, budget.tally, budget.undivided, sum(search.reflected_s))
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
