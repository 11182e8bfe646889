"""The error that each body's echo may have, and what of it triangles have used up.

Errors are relative to the level of a body's echo over the band, which is itself estimated while
facets are divided, and refined in passes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.band_sums import band_sums
from twin.radar.propagation.facets.currents import Echoes
from twin.radar.propagation.facets.errors_by_range import ErrorsByRange
from twin.radar.propagation.facets.reflections import Tally
from twin.radar.propagation.facets.triangles import Triangles

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Of the strongest body, -40 dB: errors of weaker ones are relative to this level.
WEAKEST = 0.01
_LEFT_OUT = 0.1  # of a body's tolerance: triangles that together add less are left out
_OCTAVES = 40  # classes of strength, a factor of two each
_BINS_OF_A_CELL = 2  # of a range cell of the band, in which errors are summed
_EVERYTHING_M = 1e12  # likewise of a band without width
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
    otherwise only levels are wanted, and no ray is sent for the sake of errors. ``by_range``: the
    accepted errors by range, if ``counts_ranges``.
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
        *,
        counts_ranges: bool = False,
    ) -> None:
        self.tolerance = tolerance
        self.counts_errors = counts_errors
        self.counts_ranges = counts_ranges
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
        self.by_range = ErrorsByRange.none(bin_m(wave_numbers))
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
            counts_ranges=self.counts_ranges,
        )
        again._echo_sums[~bodies] = self._echo_sums[~bodies]
        again.pending[~bodies] = 0
        again._accepted[~bodies] = self._accepted[~bodies]
        again.by_range = self.by_range.of(~bodies)
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

    def accept(
        self, lit: Triangles, error: Array, which: NDArray[np.bool_], length_m: Array
    ) -> None:
        """Add the errors of triangles that are not divided further, affordable or not;
        ``length_m``: of the path of each.
        """
        self._highest = np.maximum(self._highest, self.level)
        body, square = lit.body[which], error[which] ** 2
        self._accepted += np.bincount(body, square, len(self._accepted))
        if self.counts_ranges:
            self.by_range = self.by_range.plus(body, length_m[which], square)
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
        if self.counts_ranges:
            self._spread(body, np.where(is_negligible, np.abs(echo) ** 2, 0.0), length_m, lost, run)
        return is_negligible

    def _spread(
        self,
        body: NDArray[np.intp],
        power: Array,
        length_m: Array,
        lost: Array,
        run: NDArray[np.integer],
    ) -> None:
        """Errors by what is left out, over the ranges of it as its power is."""
        first = np.minimum(_OCTAVES - run, _OCTAVES - 1)
        square = np.where(run > 0, lost[np.arange(len(lost)), first], 0.0)
        whole = np.bincount(body, power, len(square))
        share = np.divide(square, whole, out=np.zeros_like(square), where=whole > 0)
        self.by_range = self.by_range.plus(body, length_m, power * share[body])

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


def bin_m(wave_numbers: Array) -> float:
    """Width of the bins of path lengths in which errors are summed, m."""
    span = float(np.ptp(wave_numbers))
    return 2 * np.pi / span / _BINS_OF_A_CELL if span > 0 else _EVERYTHING_M
