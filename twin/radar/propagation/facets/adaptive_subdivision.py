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

from twin.radar.propagation.facets.currents import Echoes, echoes_of
from twin.radar.propagation.facets.error_budget import Budget, Leaves
from twin.radar.propagation.facets.front_facets import FrontFacets, largest, portions
from twin.radar.propagation.facets.hidden import wholly_hidden
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
_PER_LEVEL = 0.06  # of the squared tolerance, of triangles of one size
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
        error = seen.error + doubt
        budget.accept(current.triangles, error, done, current.echoes.length_m)
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
