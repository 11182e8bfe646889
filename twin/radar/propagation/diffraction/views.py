"""How the radar, and images of it in mirrors, see bodies among obstacles.

By an image the way to a body goes straight on past its mirrors. On each leg of it, before each
mirror and behind the last, stand obstacles; what stands before a mirror is seen where the mirrors
behind it show it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.diffraction.blocking import (
    NO_WAY,
    NOTHING,
    PAST_MIRROR,
    blocker,
    straight_home,
)
from twin.radar.propagation.diffraction.mirror_borders import askew, between_mirrors, is_past
from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.one_way.points import PointPaths, paths_to_points
from twin.radar.propagation.scene.images import Image

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_TOGETHER = 256  # outlines of objects that are looked at together


@dataclass(frozen=True, eq=False)
class View:
    """The radar or an image of it, by ``number``, and the obstacles of ways from there."""

    obstacles: Screens
    number: int

    @property
    def image(self) -> Image:
        """Mirrors and places, the radar's own and after each reflection."""
        return self.obstacles.prepared.images[self.number]

    @property
    def place(self) -> Array:
        """From which the waves to bodies seem to come, (3,)."""
        return self.image.place

    @cached_property
    def turns(self) -> list[Array]:
        """Of each leg, (3, 3): from directions on it to those on the last one."""
        turns = [np.eye(3)]
        for patch in self.image.patches[::-1]:
            normal = self.obstacles.prepared.flats[patch].normal
            turns.append(turns[-1] @ (np.eye(3) - 2 * np.outer(normal, normal)))
        return turns[::-1]

    def departure(self, directions: Array) -> Array:
        """Directions (n, 3) in which the radar sends what leaves the image in others."""
        departure: Array = directions @ self.turns[0]
        return departure

    def straight(self, places: Array, off: Array) -> PointPaths:
        """Paths to points (n, 3) without obstacles; ``clear``: all mirrors are met."""
        context = self.obstacles.prepared.context
        return paths_to_points(context, self.number, places, off, unshadowed=True)

    def reflected(self, places: Array) -> Array:
        """Level of waves at points (n, 3) after all mirrors, over that without, (n,)."""
        if not self.image.patches:
            return np.ones(len(places))
        return self.straight(places, np.zeros_like(places)).level

    def first_met(self, places: Array, off: Array, body: int) -> Indices:
        """Number of the object that ways home from points (n, 3) of a body first meet, `NOTHING`,
        `PAST_MIRROR` where they go past the border of their only mirror, whose waves are followed
        and may be free where the straight way is not, or `NO_WAY` where a mirror is not on the way.
        """
        prepared = self.obstacles.prepared
        met = blocker(prepared, straight_home(prepared, self.image, places), off)
        if not self.image.patches:
            return met
        is_met = self.straight(places, off).clear
        found = np.where(is_met, met, NO_WAY)
        if self.obstacles.border(self.image) is not None:
            flats, number = prepared.flats, self.image.patches[0]
            is_other = ~np.isin(met, flats.object) | np.isin(met, askew(flats, number))
            is_other &= (met >= 0) & (self.obstacles.body[np.maximum(met, 0)] != body)
            free = np.flatnonzero(~is_met & ((met == NOTHING) | is_other))
            past = free[is_past(prepared, self.image, places[free])]
            found[past] = PAST_MIRROR
        return found

    def goes_past_mirror(self, places: Array, off: Array, body: int) -> bool:
        """Whether the way home from any of some points (n, 3) of a body goes past the border of the
        only mirror.
        """
        if self.obstacles.border(self.image) is None or not len(places):
            return False
        return bool((self.first_met(places, off, body) == PAST_MIRROR).any())

    def others(self, body: int) -> Indices:
        """Numbers of the objects that may be obstacles of ways to a body: no mirror of these ways
        is.
        """
        mirrors = self.obstacles.prepared.flats.object[list(self.image.patches)]
        return np.setdiff1d(np.flatnonzero(self.obstacles.body != body), mirrors)

    def rims(
        self, body: int, direct: Array, radius: Array
    ) -> Iterator[tuple[Outline, NDArray[np.intp]]]:
        """Outer rims near ways to spheres, at the ends of vectors (n, 3) from here and of radii
        (n,), of every obstacle and leg, as seen from here, and the spheres that each is near to;
        and the border of an only mirror.
        """
        others = self.others(body)
        for leg in range(len(self.turns)):
            seen, source = direct @ self.turns[leg], self.image.places[leg]
            beside = are_beside(self.obstacles, others, seen, radius, source)
            for column in np.flatnonzero(beside.any(axis=0)):
                rows = np.flatnonzero(beside[:, column])
                length_m = float(np.mean(np.linalg.norm(seen[rows], axis=1)))
                rim = self.obstacles.rim(int(others[column]), source, length_m, body)
                yield self._shown(rim, leg), rows
        if (border := self.obstacles.border(self.image)) is not None:
            yield border, np.arange(len(direct))

    def all_rims(self, body: int, direct: Array) -> Iterator[Outline]:
        """Of what stands near the ways to places, at vectors (n, 3) from here, the outer rims; of
        all else the whole outlines, many together: rays for all of a city take seconds. And the
        border of an only mirror.
        """
        others = self.others(body)
        reach_m = float(np.mean(np.linalg.norm(direct, axis=1)))
        for leg in range(len(self.turns)):
            seen, source = direct @ self.turns[leg], self.image.places[leg]
            beside = are_beside(self.obstacles, others, seen, np.zeros(len(seen)), source)
            is_near = np.atleast_1d(np.any(beside, axis=0))
            for item in others[is_near].tolist():
                yield self._shown(self.obstacles.rim(item, source, reach_m, body), leg)
            far = others[~is_near]
            for some in np.split(far, range(_TOGETHER, len(far), _TOGETHER)):
                outlines = [self.obstacles.outline(item, source) for item in some.tolist()]
                if outlines:
                    yield self._shown(Outline.together(outlines), leg)
        if (border := self.obstacles.border(self.image)) is not None:
            yield border

    def _shown(self, rim: Outline, leg: int) -> Outline:
        """Edges of a leg, relative to where it begins, as they are seen from here."""
        if not self.image.patches:
            return rim
        rim, turn = (
            between_mirrors(self.obstacles.prepared, self.image, leg, rim),
            self.turns[leg].T,
        )
        turned = {name: getattr(rim, name) @ turn for name in ("ends", "lit", "aside", "onwards")}
        return replace(rim, **turned)


class TwoViews(NamedTuple):
    """From which a body is lit, and to which it answers; the same one twice, or both ways."""

    one: View
    other: View

    @property
    def are_same(self) -> bool:
        """Whether there is only one."""
        return self.one.number == self.other.number

    @property
    def each(self) -> tuple[View, ...]:
        """Once."""
        return (self.one,) if self.are_same else (self.one, self.other)

    @property
    def numbers(self) -> tuple[int, int]:
        """Of both images."""
        return self.one.number, self.other.number

    def down_to(self, faintest: float) -> "TwoViews":
        """With waves over edges that are at least so strong."""
        obstacles = replace(self.one.obstacles, faintest=faintest)
        return two_views(obstacles, *self.numbers)


def two_views(obstacles: Screens, one: int, other: int) -> TwoViews:
    """By two images, by their numbers."""
    first = View(obstacles, one)
    return TwoViews(first, first if one == other else View(obstacles, other))


def are_beside(
    obstacles: Screens, others: Indices, direct: Array, radius: Array, source: Array
) -> NDArray[np.bool_]:
    """Whether paths round the bounding spheres of obstacles may be followed to cells at the ends of
    vectors (n_cells, 3) from a ``source``, (n_cells, n).
    """
    towards = obstacles.centers[others] - source
    farthest_q, k = farthest(obstacles.faintest), obstacles.wavenumber
    beside: NDArray[np.bool_] = kernel(_are_beside)(
        towards, obstacles.radii[others], np.ascontiguousarray(direct), radius, k, farthest_q
    )
    return beside


def _are_beside(
    towards: Array, size: Array, direct: Array, radius: Array, wavenumber: float, farthest_q: float
) -> NDArray[np.bool_]:
    """Whether the phase q of a path round the bounding sphere of each obstacle, at vectors (n, 3)
    and of radii (n,), is at least no more than the farthest, (n_cells, n).
    """
    beside = np.empty((len(direct), len(towards)), dtype=np.bool_)
    for i in range(len(direct)):
        length = np.sqrt(np.sum(direct[i] ** 2))
        x, y, z = direct[i] / length
        for j in range(len(towards)):
            a, b, c = towards[j]
            forward = x * a + y * b + z * c
            along = min(max(forward, 0.0), length)
            square = a * a + b * b + c * c - 2 * along * forward + along * along
            share = max(along / length, 1e-6)
            gap = max(np.sqrt(max(square, 0.0)) - size[j] - radius[i] * share, 0.0)
            bend = wavenumber / (2 * length * share * max(1 - share, 1e-6))
            beside[i, j] = bend * gap * gap <= farthest_q
    return beside
