"""How often a path may be reflected before what it adds to a body's echo no longer counts.

The coarse pass follows more reflections than are ever computed finely, and tallies echoes by body,
by reflections at bodies, and by reflections at large surfaces, on the way with more of these. What
further reflections add is bounded by what the coarse pass found of them: their sum over the band as
it stands, the rms of what it left out as faint, and three times the errors that it accepted of
them, as in the estimate of a body's error. Reflections beyond those that it follows are told with
the bound of the last ones: a reflection adds no power. At large surfaces further orders are
extrapolated: each is to the one before as the last is to its own, and their powers add. Of a body
that only the last order followed brings into sight, no bound is known.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.band_sums import band_sums
from twin.radar.propagation.facets.front_facets import FrontFacets
from twin.radar.propagation.facets.triangles import Triangles

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Counts = NDArray[np.intp]

#: Reflections at bodies that the coarse pass follows. Rays caught between touching objects go on
#: for ever; on the yard's car the fourth to sixth add 2 %, all later ones 0.1 %.
MOST_BOUNCES = 6
#: Reflections at large surfaces that it follows, on the way out and back each; the most where few
#: images of the radar and few facets let it.
LEAST_IMAGES, MOST_IMAGES = 2, 16
_ENDLESS = 0.95  # at most: what an order of images in a room adds over the one before
#: Over the echo by the last order of images: a body with less by all fewer reflections is hidden.
_HIDDEN = 0.2
_SURE = 3.0  # over the root of the sum of squares of errors, as of a body's estimated error
_FAINT = 0.5  # of what is permitted: bound of what the coarse pass leaves out as faint


@dataclass(frozen=True, eq=False)
class Limits:
    """Reflections that are computed of every body, (n_bodies,): most ``bounces`` at bodies, and
    most ``images``, reflections at large surfaces out or back.
    """

    bounces: Counts
    images: Counts

    def raised(self, other: "Limits", bodies: NDArray[np.bool_]) -> "Limits":
        """The more of each, of some bodies (n_bodies,)."""
        return Limits(
            np.where(bodies, np.maximum(self.bounces, other.bounces), self.bounces),
            np.where(bodies, np.maximum(self.images, other.images), self.images),
        )

    def exceed(self, other: "Limits") -> NDArray[np.bool_]:
        """Of which bodies these ask for more, (n_bodies,)."""
        more: NDArray[np.bool_] = (self.bounces > other.bounces) | (self.images > other.images)
        return more


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of what further ``bounces``, and further ``images``, add to the echo of every body, in
    amplitude, (n_bodies,).
    """

    bounces: Array
    images: Array

    @property
    def sum(self) -> Array:
        """Of both."""
        return self.bounces + self.images

    def __add__(self, other: "Bounds") -> "Bounds":
        """Of both together."""
        return Bounds(self.bounces + other.bounces, self.images + other.images)

    def of(self, pairs: Counts, count: int) -> "Bounds":
        """Of ``count`` other bodies, by pairs (n, 2) of a new number and an old one."""
        new = np.zeros((2, count))
        for row, values in zip(new, (self.bounces, self.images), strict=True):
            np.add.at(row, pairs[:, 0], values[pairs[:, 1]])
        return Bounds(*new)


@dataclass(frozen=True, eq=False)
class ReflectionChoice:
    """Reflections that are computed, and the bounds of what is ``left_out`` beyond these, and of
    what would be ``without`` the last of them as well; ``undivided`` (n_bodies,): bound of the
    errors of many reflections that are computed by coarse tubes alone, since there are too many;
    ``cost_s``: the time that reflections at bodies took.
    """

    limits: Limits
    left_out: Bounds
    without: Bounds
    undivided: Array
    cost_s: float


class Tally:
    """Echoes of a coarse pass by body, number of bounces, and order of the images.

    ``order``: of each image; ``permitted``: of each effect that is left out, relative to a body's
    level; ``faintest``: what the coarse pass may leave out, likewise; ``bounces`` as given, or
    None; ``by_images``: whether images are left out; ``further_images`` (n_bodies,): as
    `FurtherPaths.objects`.
    """

    def __init__(
        self,
        n_bodies: int,
        wave_numbers: Array,
        order: Counts,
        permitted: float,
        bounces: int | None = None,
        *,
        by_images: bool = True,
        further_images: Array | None = None,
    ) -> None:
        self._order, self._bounces, self._by_images = order, bounces, by_images
        self._further_images = np.ones(n_bodies) if further_images is None else further_images
        self.permitted = permitted
        self.faintest = _FAINT * permitted / _SURE
        self._shape = n_bodies, MOST_BOUNCES, int(order.max(initial=0)) + 1
        self._wave_numbers = wave_numbers
        count = int(np.prod(self._shape))
        self._echo = np.zeros((count, len(wave_numbers)), dtype=np.complex128)
        self._square = np.zeros(count)

    def add(self, lit: Triangles, echo: Complex, length_m: Array) -> None:
        """Echoes without the phase of their path."""
        kind = self._kind(lit)
        self._echo += band_sums(kind, len(self._square), echo, length_m, self._wave_numbers)

    def add_errors(self, lit: Triangles | FrontFacets, error: Array) -> None:
        """Errors of echoes, or what is left out of them, as independent ones."""
        self._square += np.bincount(self._kind(lit), error**2, len(self._square))

    def _kind(self, lit: Triangles | FrontFacets) -> Counts:
        source, receiver = np.array(lit.source), np.array(lit.receiver)
        order = np.maximum(self._order[source], self._order[receiver])
        bounce = np.minimum(lit.bounces.astype(np.intp), MOST_BOUNCES) - 1
        kind: Counts = np.ravel_multi_index((lit.body, bounce, order), self._shape)
        return kind

    def limits(self, level: Array) -> Limits:
        """The least reflections beyond which no more is left out than is permitted of bodies of
        these levels (n_bodies,), by bounces and by images each.
        """
        bodies, bounces, orders = self._shape
        permitted = self.permitted * level
        kept, images = np.ones(bodies, dtype=np.intp), np.zeros(bodies, dtype=np.intp)
        kept += 0 if self._bounces is None else self._bounces - 1
        images += 0 if self._by_images else orders
        for n in range(1, bounces if self._bounces is None else 1):
            kept[self._beyond(range(n, bounces), range(orders)) > permitted] = n + 1
        for order in range(1, orders if self._by_images else 1):
            images[self._beyond(range(bounces), range(order, orders)) > permitted] = order
        return Limits(kept, images)

    def fine(self, kept: NDArray[np.bool_] | None = None) -> "Tally":
        """An empty one for a fine pass, which leaves out as much as without it; with what this one
        has of the bodies that are ``kept``, (n_bodies,).
        """
        fine = Tally(
            self._shape[0],
            self._wave_numbers,
            self._order,
            self.permitted,
            self._bounces,
            by_images=self._by_images,
            further_images=self._further_images,
        )
        fine.faintest = np.inf
        if kept is not None:
            rows = np.repeat(kept, self._shape[1] * self._shape[2])
            fine._echo[rows], fine._square[rows] = self._echo[rows], self._square[rows]
        return fine

    def choice(
        self, limits: Limits, fine: "Tally", undivided: Array, cost_s: float
    ) -> ReflectionChoice:
        """What limits leave out. Of more reflections than were followed that is the bound of the
        last ones, as a ``fine`` pass found it; nothing where no path has more of them.
        ``undivided``: accepted errors of what coarse tubes alone follow, (n_bodies,); ``cost_s``:
        time that reflections at bodies took.
        """
        fewer = Limits(limits.bounces - 1, limits.images - 1)
        beyond = fine.left_out(Limits(*(n - 1 for n in (limits.bounces, limits.images))))
        left_out = self.left_out(limits)
        _, bounces, orders = self._shape
        return ReflectionChoice(
            limits,
            Bounds(
                np.where(limits.bounces < bounces, left_out.bounces, beyond.bounces),
                np.where(
                    limits.images < orders - 1,
                    left_out.images,
                    fine.beyond_all_images(beyond.images),
                ),
            ),
            self.left_out(fewer),
            _SURE * undivided,
            cost_s,
        )

    def beyond_all_images(self, last: Array) -> Array:
        """Bound of what more reflections at large surfaces than those of any image add, by that of
        the ``last`` ones, (n_bodies,). Of bodies round a corner, which come into sight by the last
        ones, none is known.
        """
        _, bounces, orders = self._shape
        before = self._beyond(range(bounces), range(max(orders - 2, 0), orders - 1))
        ratio = np.minimum(last / np.maximum(before, 1e-300), _ENDLESS)
        further: Array = last / np.sqrt(1 - ratio**2)
        further[self._beyond(range(bounces), range(orders - 1)) < _HIDDEN * last] = np.inf
        return np.where(self._further_images > 0, further, 0.0)

    def left_out(self, limits: Limits) -> Bounds:
        """Bounds of what limits leave out of the reflections that were followed."""
        bodies, bounces, orders = self._shape
        of_bounces, of_images = np.zeros(bodies), np.zeros(bodies)
        for n in range(bounces if self._bounces is None else 0):
            these = limits.bounces == n
            of_bounces[these] = self._beyond(range(n, bounces), range(orders))[these]
        for order in range(-1, orders - 1 if self._by_images else -1):
            these = limits.images == order
            of_images[these] = self._beyond(range(bounces), range(order + 1, orders))[these]
        return Bounds(of_bounces, of_images)

    def _beyond(self, bounces: range, orders: range) -> Array:
        """Bound of the echo of every body by so many reflections, (n_bodies,)."""
        some = np.ix_(range(self._shape[0]), bounces, orders)
        echo = self._echo.reshape(*self._shape, -1)[some].sum(axis=(1, 2))
        error = np.sqrt(self._square.reshape(self._shape)[some].sum(axis=(1, 2)))
        bound: Array = np.sqrt(np.mean(np.abs(echo) ** 2, axis=1)) + _SURE * error
        return bound
