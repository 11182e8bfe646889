"""Adaptive subdivision of facets, as finely as the permitted error of every body's echo asks.

Every facet that faces the source and the receiver is a triangle with an exact integral. It is
divided where the curvature of the phase across it, or the border of a shadow on it, may change the
echo of its body by more than its share of the tolerance. Of a body the estimated errors of all
triangles, taken as independent, add up to the tolerance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.band_sums import band_sums
from twin.radar.propagation.facets.currents import Echoes, echoes_of
from twin.radar.propagation.facets.front_facets import FrontFacets, largest, portions
from twin.radar.propagation.facets.hidden import wholly_hidden
from twin.radar.propagation.facets.reflections import Tally
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.shadows import (
    ALL_OVER,
    BETWEEN,
    INSIDE,
    ShadowClipping,
    agree_at,
    clip_at_shadow,
    visible_samples,
)
from twin.radar.propagation.facets.triangles import Triangles, split_in_four
from twin.radar.propagation.facets.uniform_subdivision import sizes, spacing_of, subdivided
from twin.radar.propagation.one_way.path import TracingContext

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_DEEPEST = 8  # divisions by four
_FEW = 500  # triangles, up to which they are divided by sixteen: kernel launches dominate then
#: Of the strongest body, -40 dB: errors of weaker ones are relative to this level.
WEAKEST = 0.01
_PER_LEVEL = 0.06  # of the squared tolerance, of triangles of one size
_LEFT_OUT = 0.1  # of a body's tolerance: triangles that together add less are left out
_OCTAVES = 40  # classes of strength, a factor of two each
_SAMPLED = 0.02  # of tolerance and body: triangles that may return less get a single ray
_CLOSER = 0.1  # likewise: triangles that may return more get six more rays
#: Likewise: triangles that may return more get 28 more rays, and 30 where a border crosses them.
_CLOSEST = 0.5
_CUT = 0.005
_MISSED_M = 0.1  # size of triangles on which a shadow may pass between four rays
_MISSED = 0.3  # of tolerance and body: triangles of that size that may return more are divided
_FINEST_M = 0.01
#: Triangles of one size, the strongest ones over what is allowed: some 2 GB. The others are divided
#: no further, and their errors and doubts count as they are.
MOST_TRIANGLES = 2**21
_MIXED = 0.25  # of its strength: error of a triangle that is partly seen
#: Of its strength: error of a triangle that different things hide, between which there may be gaps.
_GAP = 0.03
_GAP_FROM = (
    0.3  # of tolerance and body: triangles that may return less are not asked what hides them
)
#: Mean visible share of triangles, by the number of their visible corners, 0 to 3; first row: the
#: point inside is hidden, second row: it is visible.
_VISIBLE_SHARE = np.array([[0.0, 0.1, 0.3, 0.45], [0.7, 0.7, 0.85, 1.0]])
_CURVED = 1.0  # error by a border's curvature, over the change from one straight piece to two
_FALLEN = 2.0  # factor by which levels fall, and errors exceed, from which a pass is repeated


@dataclass(frozen=True, eq=False)
class Leaves:
    """Triangles that are not divided further, and their echoes; ``weight`` (n,): visible share, and
    -1 for hidden parts that are subtracted from a triangle.
    """

    triangles: Triangles
    echoes: Echoes
    weight: Array

    @property
    def body(self) -> NDArray[np.intp]:
        """Of each, (n,)."""
        return self.triangles.body

    @property
    def rows(self) -> NDArray[np.intp]:
        """Their numbers."""
        return np.arange(len(self.weight))

    @staticmethod
    def concatenate(parts: "Sequence[Leaves]") -> "Leaves":
        """One after the other; of equal bounces."""
        return Leaves(
            Triangles.concatenate([part.triangles for part in parts]),
            Echoes.concatenate([part.echoes for part in parts]),
            np.concatenate([part.weight for part in parts]),
        )

    def take(self, which: NDArray[np.integer]) -> "Leaves":
        """Only some of them, by index."""
        return Leaves(self.triangles.take(which), self.echoes.take(which), self.weight[which])


class Budget:
    """Levels of bodies' echoes over the band, as estimated so far, and the errors accepted.

    ``level`` (n_bodies,): root mean square over the band, at least that of the noise floor or of an
    echo 40 dB below the strongest. ``earlier_echoes`` (n_bodies, n_frequencies): valid echoes of an
    earlier frame. ``spacing_m``: size of the parts of facets between the rays that look for
    occluders; ``earlier_spacing_m``: that of an earlier frame, None if it is to be chosen. What is
    added and accepted is tallied by reflections in ``tally``, if there is one. ``counts_errors``:
    otherwise only levels are wanted, and no ray is sent for the sake of errors.
    """

    def __init__(
        self,
        n_bodies: int,
        tolerance: float,
        wave_numbers: Array,
        floor: float | Array,
        coarse: "Budget | None" = None,
        weakest: float = WEAKEST,
        earlier_echoes: Complex | None = None,
        tally: Tally | None = None,
        counts_errors: bool = True,
    ) -> None:
        self.tolerance = tolerance
        self.counts_errors = counts_errors
        self._weakest = weakest
        self._wave_numbers = wave_numbers
        self._floor = floor
        self._earlier_echoes = earlier_echoes
        self.tally = tally
        self._echo_sums = np.zeros((n_bodies, len(wave_numbers)), dtype=np.complex128)
        if earlier_echoes is not None:
            self._echo_sums += earlier_echoes
        self.earlier_spacing_m: float | None = None
        self.spacing_m = 0.0
        self._accepted = np.zeros(n_bodies)  # errors squared
        self._undivided = np.zeros(n_bodies)  # likewise, part of these
        self.level = np.zeros(n_bodies)
        self.direct = np.zeros_like(self._echo_sums)
        #: Echoes still to come: of further bounces, as the coarse pass found them.
        self.pending = np.zeros_like(self._echo_sums)
        if coarse is not None:
            self.level = coarse.level
            self.pending = coarse._echo_sums - coarse.direct
        self._highest = np.zeros(n_bodies)  # level that errors were accepted for
        self._most: Array | float = np.inf  # level, as a pass as fine as this one found it

    def overestimated(self) -> NDArray[np.bool_]:
        """Bodies to be done again, (n_bodies,): too large errors were accepted of them, since their
        level was overestimated.
        """
        fallen = self._highest > _FALLEN * self.level
        exceeds = self.accepted > _FALLEN * self.tolerance * self.level
        again: NDArray[np.bool_] = fallen & exceeds
        return again

    def again_of(self, bodies: NDArray[np.bool_]) -> "Budget":
        """A budget for another pass over some bodies (n_bodies,), which begins with the levels of
        this one. Echoes and errors of all others stay.
        """
        again = Budget(
            len(self.level),
            self.tolerance,
            self._wave_numbers,
            self._floor,
            self,
            self._weakest,
            self._earlier_echoes,
            self.tally and self.tally.fine(~bodies),
        )
        again._echo_sums[~bodies] = self._echo_sums[~bodies]
        again.pending[~bodies] = 0
        again._accepted[~bodies] = self._accepted[~bodies]
        again._undivided[~bodies] = self._undivided[~bodies]
        again._most = self.level
        again.earlier_spacing_m = self.earlier_spacing_m or self.spacing_m or None
        return again

    def initial_levels(self, body: NDArray[np.intp], strength: Array) -> None:
        """First estimate of the levels: all echoes with random phases."""
        if not self.level.any():
            power = np.mean(np.abs(self._echo_sums) ** 2, axis=1)
            self._rank(np.sqrt(power + np.bincount(body, strength**2, len(self.level))))

    def summed(
        self, body: NDArray[np.intp], echo: Complex, length_m: Array, count: int | None = None
    ) -> Complex:
        """Sum over the band of echoes given without the phase of their path, (count,
        n_frequencies).
        """
        count = len(self.level) if count is None else count
        return band_sums(body, count, echo, length_m, self._wave_numbers)

    def estimate_levels(self, parts: "Sequence[Leaves]") -> None:
        """Estimate levels from the final triangles and those that are still to be divided."""
        total = self._echo_sums + self.pending
        for part in parts:
            echo = part.weight * part.echoes.total
            total += self.summed(part.body, echo, part.echoes.length_m)
        self._rank(np.sqrt(np.mean(np.abs(total) ** 2, axis=1)))

    def end_direct(self) -> None:
        """Go on from direct illumination to further reflections."""
        self.direct = self._echo_sums.copy()
        self.pending[:] = 0

    def add_final(self, leaves: Leaves) -> None:
        """Add triangles that are not divided further."""
        echo, length_m = leaves.weight * leaves.echoes.total, leaves.echoes.length_m
        self._echo_sums += self.summed(leaves.body, echo, length_m)
        if self.tally is not None:
            self.tally.add(leaves.triangles, echo, length_m)

    def accept(self, lit: Triangles, error: Array, which: NDArray[np.bool_]) -> None:
        """Add the errors of triangles that are not divided further, affordable or not."""
        self._highest = np.maximum(self._highest, self.level)
        self._accepted += np.bincount(lit.body[which], error[which] ** 2, len(self._accepted))
        if self.tally is not None:
            self.tally.add_errors(lit, np.where(which, error, 0.0))

    def add_undivided(self, lit: Triangles, error: Array) -> None:
        """Accepted errors of what is divided no further, for there is no room."""
        self._undivided += np.bincount(lit.body, error**2, len(self._undivided))

    @property
    def undivided(self) -> Array:
        """Of each body's accepted error what was for want of room, (n_bodies,)."""
        return np.sqrt(self._undivided)

    @property
    def accepted(self) -> Array:
        """Error of each body's echo: all accepted errors as independent ones, (n_bodies,)."""
        return np.sqrt(self._accepted)

    def _rank(self, level: Array) -> None:
        strongest = float(level.max(initial=0.0))
        least = np.maximum(self._weakest * strongest, self._floor / self.tolerance)
        self.level = np.minimum(np.maximum(level, np.maximum(least, 1e-300)), self._most)

    def allowed(self, body: NDArray[np.intp]) -> Array:
        """Permitted error of the body of each triangle, (n,)."""
        return self.tolerance * self.level[body]

    def negligible(
        self,
        body: NDArray[np.intp],
        echo: Complex,
        strength: Array,
        length_m: Array,
        *,
        is_seen: bool,
    ) -> NDArray[np.bool_]:
        """The weakest of every body, as many as together, in phase or not, add little: their sum
        counts as an error that is accepted.

        ``is_seen``: whether echoes are of what is seen. Of others a shadow may hide any, and what
        cancels without it, as on a finely divided plate, does so no longer: they also have to add
        little with random phases, as rows of facets along a shadow's border do.
        """
        limit = _LEFT_OUT * self.tolerance * self.level
        if self.tally is not None:
            limit = np.minimum(limit, self.tally.faintest * self.level)
        ratio = limit[body] / np.maximum(strength, 1e-300)
        octave = np.clip(np.frexp(ratio)[1], 0, _OCTAVES - 1).astype(np.intp)
        count = len(self.level)
        sums = self.summed(body * _OCTAVES + octave, echo, length_m, count * _OCTAVES)
        # From the faintest on: what is left out if an octave and all below are.
        left = np.cumsum(sums.reshape(count, _OCTAVES, -1)[:, ::-1], axis=1)[:, ::-1]
        lost = np.mean(np.abs(left) ** 2, axis=2)
        if not is_seen:
            power = np.bincount(body * _OCTAVES + octave, np.abs(echo) ** 2, count * _OCTAVES)
            lost += np.cumsum(power.reshape(count, _OCTAVES)[:, ::-1], axis=1)[:, ::-1]
        small = np.sqrt(lost) <= limit[:, None]
        small[:, 0] = False  # nothing that alone is more than that
        run = np.cumprod(small[:, ::-1], axis=1).sum(axis=1)  # unbroken from the faintest on
        first_negligible = _OCTAVES - run
        some = np.flatnonzero(run)
        self._accepted[some] += lost[some, first_negligible[some]]
        is_negligible: NDArray[np.bool_] = octave >= first_negligible[body]
        return is_negligible

    def affordable(
        self, body: NDArray[np.intp], error: Array, share: float | Array
    ) -> NDArray[np.bool_]:
        """The smallest errors of every body that together stay within a share of its squared
        tolerance; ``share``: of all, or of each body, (n_bodies,).
        """
        order = np.lexsort((error, body))
        total = np.cumsum(error[order] ** 2)
        first = np.searchsorted(body[order], np.arange(len(self.level)))
        before = np.concatenate([[0.0], total])[first]
        most = share * (self.tolerance * self.level) ** 2
        is_affordable = np.empty(len(body), dtype=bool)
        is_affordable[order] = total - before[body[order]] <= most[body[order]]
        return is_affordable


def subdivided_adaptively(
    context: TracingContext,
    scatterers: Scatterers,
    lit: Triangles | FrontFacets,
    echoes: Echoes,
    budget: Budget,
    deepest: int = _DEEPEST,
    is_open: bool = False,
) -> list[Leaves]:
    """Divide triangles until the errors of all bodies are within the tolerance, ``deepest`` times
    by four at most. ``is_open``: there are no occluders, so no rays are sent.
    """
    budget.initial_levels(lit.body, np.abs(echoes.total))
    total = echoes.total
    faint = budget.negligible(lit.body, total, echoes.strength, echoes.length_m, is_seen=is_open)
    if budget.tally is not None:
        budget.tally.add_errors(lit, np.where(faint, np.abs(total), 0.0))
    bright = np.flatnonzero(~faint)
    final_leaves: list[Leaves] = []
    if not len(bright):
        budget.estimate_levels([])
        return final_leaves
    partly, spacing_m = np.zeros(len(bright), dtype=bool), 0.0
    if deepest and lit.waves is None and not is_open:
        partly, spacing_m = _partly_hidden(context, lit, bright, budget.earlier_spacing_m)
        budget.spacing_m = spacing_m

    def visible_parts(
        some: Triangles, some_echoes: Echoes, is_partly: NDArray[np.bool_]
    ) -> _VisibleParts:
        if is_open:
            return _unobstructed(some, some_echoes)
        return _visible_parts(
            context, scatterers, some, some_echoes, budget, is_partly, spacing_m
        ).without_dark()

    def further(some: Triangles, is_partly: NDArray[np.bool_], times: int) -> _VisibleParts:
        for _ in range(times):
            some, is_partly = split_in_four(context, some), np.repeat(is_partly, 4)
        return visible_parts(some, echoes_of(context, scatterers, some), is_partly)

    seen = _VisibleParts.concatenate(
        [
            visible_parts(lit.take(bright[rows]), echoes.take(bright[rows]), partly[rows])
            for rows in portions(np.arange(len(bright)))
        ]
    )
    depth = 0
    while True:
        budget.estimate_levels([seen.leaves, seen.fragments])
        current, done = seen.leaves, np.ones(len(seen.error), dtype=bool)
        if depth < deepest:
            done = budget.affordable(current.body, seen.error, _PER_LEVEL)
            done &= ~seen.is_doubtful & ~seen.is_wide
            share = current.echoes.strength / budget.allowed(current.body)
            done |= ~largest(np.where(done, 0.0, share), MOST_TRIANGLES // 4)
        doubt = np.where(seen.is_doubtful, _MIXED * current.echoes.strength, 0.0)
        budget.accept(current.triangles, seen.error + doubt, done)
        for part, is_final in ((seen.leaves, done), (seen.fragments, done[seen.row])):
            left = np.flatnonzero(is_final & (part.weight != 0))
            if len(left):
                final_leaves.append(part.take(left))
                budget.add_final(final_leaves[-1])
        rest = np.flatnonzero(~done)
        if not len(rest):
            break
        some, is_partly = seen.leaves.triangles.take(rest), seen.is_partly[rest]
        times = min(2 if len(rest) < _FEW else 1, deepest - depth)
        parts = portions(np.arange(len(rest)), 4**times)
        seen = _VisibleParts.concatenate(
            [further(some.take(rows), is_partly[rows], times) for rows in parts]
        )
        depth += times
    return final_leaves


def _partly_hidden(
    context: TracingContext,
    lit: Triangles | FrontFacets,
    rows: NDArray[np.intp],
    spacing_m: float | None,
) -> tuple[NDArray[np.bool_], float]:
    """Which of some triangles have visible and hidden parts, and the size of these parts in m: as
    given, or as the number of rays allows.
    """
    size = lit.subset(rows).sizes() if isinstance(lit, FrontFacets) else sizes(lit.take(rows))
    spacing_m = spacing_of(context, size) if spacing_m is None else spacing_m
    is_partly = np.zeros(len(rows), dtype=bool)
    for some in portions(np.flatnonzero(size > spacing_m), 4):
        parts, row = subdivided(context, lit.take(rows[some]), spacing_m)
        clear = visible_samples(context, parts, np.zeros(len(parts), dtype=bool))[3]
        seen = np.bincount(row, clear, len(some))
        is_partly[some] = (seen > 0) & (seen < np.bincount(row, minlength=len(some)))
    return is_partly, spacing_m


@dataclass(frozen=True, eq=False)
class _VisibleParts:
    """Triangles with their visible parts.

    leaves
        One for each triangle.
    fragments, row
        Parts that borders of shadows cut off, and the row of the triangle that each belongs to.
    error
        Possible error of each triangle's echo.
    is_doubtful
        Whether shadows may pass between its rays.
    is_partly
        Whether rays to parts of the whole facet show that it is partly hidden.
    is_wide
        Whether it is, and is larger than these parts.
    """

    leaves: Leaves
    fragments: Leaves
    row: NDArray[np.intp]
    error: Array
    is_doubtful: NDArray[np.bool_]
    is_partly: NDArray[np.bool_]
    is_wide: NDArray[np.bool_]

    def without_dark(self) -> "_VisibleParts":
        """Without those that are certainly hidden."""
        is_dark = (self.leaves.weight == 0) & (self.error == 0) & ~self.is_doubtful & ~self.is_wide
        is_dark[self.row] = False
        if not is_dark.any():
            return self
        rows = np.flatnonzero(~is_dark)
        return _VisibleParts(
            self.leaves.take(rows),
            self.fragments,
            (np.cumsum(~is_dark) - 1)[self.row],
            self.error[rows],
            self.is_doubtful[rows],
            self.is_partly[rows],
            self.is_wide[rows],
        )

    @staticmethod
    def concatenate(parts: "Sequence[_VisibleParts]") -> "_VisibleParts":
        """One after the other."""
        if len(parts) == 1:
            return parts[0]
        first = np.cumsum([0, *(len(part.error) for part in parts)])
        return _VisibleParts(
            Leaves.concatenate([part.leaves for part in parts]),
            Leaves.concatenate([part.fragments for part in parts]),
            np.concatenate([part.row + n for part, n in zip(parts, first, strict=False)]),
            np.concatenate([part.error for part in parts]),
            np.concatenate([part.is_doubtful for part in parts]),
            np.concatenate([part.is_partly for part in parts]),
            np.concatenate([part.is_wide for part in parts]),
        )


def _unobstructed(lit: Triangles, echoes: Echoes) -> _VisibleParts:
    none, leaves = np.zeros(0, dtype=np.intp), Leaves(lit, echoes, np.ones(len(lit)))
    no = np.zeros(len(lit), dtype=bool)
    return _VisibleParts(leaves, leaves.take(none), none, echoes.curved, no, no, no)


def _visible_parts(
    context: TracingContext,
    scatterers: Scatterers,
    lit: Triangles,
    echoes: Echoes,
    budget: Budget,
    partly: NDArray[np.bool_],
    spacing_m: float,
) -> _VisibleParts:
    """Visible parts of triangles; ``partly``: facets that are partly hidden, by parts of this
    size.
    """
    allowed = budget.allowed(lit.body)
    clear = visible_samples(context, lit, partly | (echoes.strength > _SAMPLED * allowed))
    corners = clear[:3].sum(axis=0)
    weight = _VISIBLE_SHARE[clear[3].astype(np.intp), corners]
    size = sizes(lit)
    error, is_doubtful = np.zeros(len(lit)), np.zeros(len(lit), dtype=bool)
    if budget.counts_errors:
        error, is_doubtful = _doubts(context, scatterers, lit, echoes, allowed, clear, size)
        error += np.where(weight > 0, echoes.curved, 0.0)
    odd = (corners == 1) | (corners == 2)
    row = np.flatnonzero(odd & (partly | (_MIXED * echoes.strength > _CUT * allowed)))
    weight[row] = corners[row] >= 2
    leaves = Leaves(lit, echoes, weight)
    flags = is_doubtful, partly, partly & (size > spacing_m)
    if not len(row):
        return _VisibleParts(leaves, leaves.take(row), row, error, *flags)
    off = clip_at_shadow(context, lit.take(row), clear[:3, row])
    parts = echoes_of(context, scatterers, off.parts)
    if budget.counts_errors:
        strength = echoes.strength[row]
        is_strong = off.is_known & (strength > _CLOSEST * allowed[row])
        off.is_known[is_strong] = _is_confirmed(context, off, np.flatnonzero(is_strong))
        # The border as two straight pieces against one, with the phases of both paths.
        whole = echoes_of(context, scatterers, off.whole)
        wave = _with_path_phase(parts, context).reshape(2, -1).sum(axis=0)
        error[row] += _CURVED * np.abs(wave - _with_path_phase(whole, context))
        error[row] -= np.where(off.is_known, _MIXED, 0) * strength
        error[row] += parts.curved[: len(row)] + parts.curved[len(row) :]
    sign: Array = off.is_seen - weight[row]
    twice = np.concatenate([row, row])
    return _VisibleParts(
        leaves, Leaves(off.parts, parts, np.concatenate([sign, sign])), twice, error, *flags
    )


def _doubts(
    context: TracingContext,
    scatterers: Scatterers,
    lit: Triangles,
    echoes: Echoes,
    allowed: Array,
    clear: NDArray[np.bool_],
    size: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    """Errors of triangles by shadows that more rays find on them, and whether shadows may still
    pass between these; by the visibility of four samples of each, (4, n).
    """
    agree = (clear == clear[3]).all(axis=0)
    doubt = echoes.strength * np.minimum(size / _MISSED_M, 1) > _MISSED * allowed
    is_doubtful = doubt & (size > _FINEST_M) & ~lit.is_ray
    # What certainly is hidden needs no more rays.
    hidden = agree & ~clear[3] & ~lit.is_ray
    hidden = np.flatnonzero(hidden & (is_doubtful | (echoes.strength > _CLOSER * allowed)))
    is_gap = np.zeros(len(lit), dtype=bool)
    is_gap[hidden] = ~wholly_hidden(context, scatterers.parts, lit.take(hidden))
    is_open = agree & ~lit.is_ray
    is_open[hidden] = is_gap[hidden]
    for points, share in ((BETWEEN, _CLOSER), (ALL_OVER, _CLOSEST)):
        some = np.flatnonzero(is_open & agree & (echoes.strength > share * allowed))
        if len(some):
            agree[some] = agree_at(context, lit.take(some), clear[3, some], points)
    error = np.where(agree, 0.0, _MIXED * echoes.strength)
    is_doubtful &= agree
    is_doubtful[hidden] &= is_gap[hidden]
    is_gap &= agree & (is_doubtful | (echoes.strength > _GAP_FROM * allowed))
    error[is_gap] += _GAP * echoes.strength[is_gap]
    return error, is_doubtful


def _is_confirmed(
    context: TracingContext, off: ShadowClipping, rows: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Whether what lies on both sides of some borders is seen, or not, all over."""
    n, confirmed = len(off.is_seen), np.ones(len(rows), dtype=bool)
    if not len(rows):
        return confirmed
    for part, count, wanted in ((off.parts, 2, off.is_seen), (off.others, 3, ~off.is_seen)):
        which = (rows + n * np.arange(count)[:, None]).ravel()
        same = agree_at(context, part.take(which), np.tile(wanted[rows], count), INSIDE)
        confirmed &= same.reshape(count, -1).all(axis=0)
    return confirmed


def _with_path_phase(echoes: Echoes, context: TracingContext) -> Complex:
    wave_number = 2 * np.pi / float(context.wavelength[0])
    wave: Complex = echoes.total * np.exp(-1j * (wave_number * echoes.length_m % (2 * np.pi)))
    return wave
