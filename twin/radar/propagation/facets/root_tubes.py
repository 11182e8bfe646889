"""Ray tubes by their roots, and the echoes of what they light: chosen, parted, joined."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.currents import Echoes
from twin.radar.propagation.facets.error_budget import Budget
from twin.radar.propagation.facets.triangles import Triangles
from twin.radar.propagation.one_way.path import TracingContext

Array = NDArray[np.float64]

#: Where bounds decide, roots are not divided for the sake of paths of more reflections at bodies,
#: which would take as long again as all else, ...
DIVIDED_BOUNCES = 3
#: ... where the errors of these, of a body's roots of one size, are no more than so many tolerances
#: together. They count in its estimated error, and in the bound of what is reflected still more
#: often: on the yard's car 4 % of its echo. With twice as much the street's car is off by 5.1 % in
#: place of 2.9 %, with less nothing gains. Nor does it to end them root by root: at equal time the
#: yard's car is off by 6.9 % in place of 4.7 %, since what a coarse tube misses finer ones find.
DEEP_ERROR = 0.25
#: A large odd number, by which keys of paths differ in all digits.
_SCATTERED = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, eq=False)
class TubeEchoes:
    """Echoes of triangles that ray tubes light, one for each receiver: the ``root`` of the tube,
    (n,), whether the triangle ``is_lit``, and the possible ``error`` of its echo; ``rounding``: the
    part of the latter that no division lessens, which ``error`` does not hold.
    """

    lit: Triangles
    echoes: Echoes
    root: NDArray[np.integer]
    is_lit: NDArray[np.bool_]
    error: Array
    rounding: Array

    def take(self, rows: NDArray[np.intp]) -> "TubeEchoes":
        """Only some of them, by index."""
        if len(rows) == len(self.root):
            return self
        return TubeEchoes(
            self.lit.take(rows),
            self.echoes.take(rows),
            self.root[rows],
            self.is_lit[rows],
            self.error[rows],
            self.rounding[rows],
        )

    @property
    def is_deep(self) -> NDArray[np.bool_]:
        """Which are of many reflections, (n,)."""
        is_deep: NDArray[np.bool_] = self.lit.bounces > DIVIDED_BOUNCES
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
Portions = Sequence[TubeEchoes]


def parted(
    echoes: Portions, which: Callable[[TubeEchoes], NDArray[np.bool_]]
) -> tuple[list[TubeEchoes], list[TubeEchoes]]:
    """Some, and all others."""
    some, others = [], []
    for part in echoes:
        these = which(part)
        some.append(part.take(np.flatnonzero(these)))
        others.append(part.take(np.flatnonzero(~these)))
    return [p for p in some if len(p.root)], [p for p in others if len(p.root)]


def uncertain(
    roots: Triangles, echoes: Portions, budget: Budget, *, is_deep: bool = False
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
class RootTubes:
    """Roots of ray tubes that meet other facets, and the echoes of what they light, in portions."""

    roots: Triangles
    echoes: list[TubeEchoes]

    @staticmethod
    def concatenate(parts: "Sequence[RootTubes]") -> "RootTubes | None":
        """One after the other; None of none."""
        if len(parts) < 2:
            return parts[0] if parts else None
        begin = np.cumsum([0, *(len(part.roots) for part in parts)])
        echoes = [
            replace(some, root=first + some.root)
            for part, first in zip(parts, begin, strict=False)
            for some in part.echoes
        ]
        return RootTubes(Triangles.concatenate([part.roots for part in parts]), echoes)


def of_roots(part: TubeEchoes, roots: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which are of some roots (n_roots,)."""
    which: NDArray[np.bool_] = roots[part.root]
    return which


def deep_of_roots(part: TubeEchoes, roots: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of these are of many reflections."""
    return part.is_deep & roots[part.root]


def aligned_errors(context: TracingContext, lit: Triangles, echoes: Echoes, error: Array) -> Array:
    """Errors of echoes, (n,), each larger by as much as those of the same facets, with the phases
    of their echoes, add up to more than independent ones do: a straight border cuts a row of tubes
    alike, so that all are off to the same side.
    """
    first, face, source, receiver, bounces = (
        np.asarray(of, dtype=np.uint64)
        for of in (lit.first, lit.face, lit.source, lit.receiver, lit.bounces)
    )
    ends = (source << np.uint64(32)) | (receiver << np.uint64(8)) | bounces
    # Two paths of one key, by a chance of some 1e-9, would only count as one.
    path = (first << np.uint64(32)) | face
    _, group = np.unique(path ^ (ends * _SCATTERED), return_inverse=True)
    turns = echoes.length_m / float(context.wavelength[0])
    wave = error * np.exp(1j * (np.angle(echoes.total) - 2 * np.pi * (turns % 1.0)))
    together = np.hypot(np.bincount(group, wave.real), np.bincount(group, wave.imag))
    apart = np.sqrt(np.bincount(group, error**2))
    more = np.divide(together, apart, out=np.ones_like(apart), where=apart > 0)
    return np.asarray(error * np.maximum(more, 1.0)[group])
