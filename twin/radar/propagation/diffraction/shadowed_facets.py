"""Facets of a body that face the radar, or images of it, in cells."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.blocking import NO_WAY, NOTHING
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.triangle_means import mean_phasors
from twin.radar.propagation.diffraction.views import TwoViews, View
from twin.radar.propagation.facets.uniform_subdivision import longest_edges
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.rows import alike, dots, lengths

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_THIN = 8.0  # square of the longest edge over the area, of one that is four times as long as wide
_ON_PLANE_M = 1e-9  # from a plane: a corner is on it
_SLIVER = 1e-9  # area over the square of the longest edge, down to which parts are none
_LOOKED_AT = 512  # facets of a body, about, where some are enough


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles (n, 3, 3) relative to the anchor, the numbers of their objects and of their cells,
    (n,) each.
    """

    corners: Array
    object: Indices
    cell: Indices

    def __len__(self) -> int:
        return len(self.object)

    @cached_property
    def middle(self) -> Array:
        """Centroids (n, 3)."""
        a, b, c = self.corners.swapaxes(0, 1)
        middle: Array = (a + b + c) / 3
        return middle

    @cached_property
    def across(self) -> Array:
        """Normals (n, 3) as long as the area."""
        a, b, c = self.corners.swapaxes(0, 1)
        across: Array = np.cross(b - a, c - a) / 2
        return across

    @property
    def sizes(self) -> Array:
        """Longest edges (n,)."""
        return longest_edges(*self.corners.swapaxes(0, 1))

    def normal(self, place: Array) -> Array:
        """Unit normals (n, 3) on the side of a place."""
        across = self.across
        side = np.sign(dots(place - self.middle, across))
        normal: Array = (side / lengths(across))[:, None] * across
        return normal

    def steepness(self, place: Array) -> Array:
        """Sines (n,) of the angle between the normal and the way to a place."""
        towards = place - self.middle
        cosine = dots(self.normal(place), towards) / lengths(towards)
        sine: Array = np.sqrt(np.clip(1 - cosine**2, 0, 1))
        return sine

    def mean(self, slope: Array) -> Complex:
        """Means (n,) of phasors whose phases are 0 at the centroids and have gradients (n, 3) in
        rad/m.
        """
        return mean_phasors(self.corners, slope)

    def take(self, which: Any) -> "Facets":
        """Only some of them, by index or mask."""
        return Facets(self.corners[which], self.object[which], self.cell[which])

    def of_cells(self, which: NDArray[np.bool_]) -> "Facets":
        """Only those of some cells, (n_cells,), which are numbered anew."""
        number = np.cumsum(which) - 1
        some = self.take(which[self.cell])
        return replace(some, cell=number[some.cell])

    def divided(self, size_m: Array) -> "Facets":
        """In parts of at most these sizes, (n,): in four, or thin ones across, in two."""
        parts, rest, limit = [], self, size_m
        while len(rest):
            is_wide = rest.sizes > limit
            parts.append(rest.take(~is_wide))
            wide, limit = rest.take(is_wide), limit[is_wide]
            is_thin = wide.sizes**2 > _THIN * lengths(wide.across)
            halves, quarters = wide.take(is_thin)._in_two(), wide.take(~is_thin)._in_four()
            rest = Facets.concatenate([halves, quarters])
            limit = np.concatenate([np.repeat(limit[is_thin], 2), np.repeat(limit[~is_thin], 4)])
        return Facets.concatenate([*parts, rest])

    def _in_four(self) -> "Facets":
        a, b, c = self.corners.swapaxes(0, 1)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        return self._in(np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]))

    def _in_two(self) -> "Facets":
        """At the middle of the longest edge."""
        edges = np.roll(self.corners, -1, axis=1) - self.corners
        longest = np.linalg.norm(edges, axis=2).argmax(axis=1)
        order = (longest[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(self.corners, order[..., None], axis=1).swapaxes(0, 1)
        middle = (a + b) / 2
        return self._in(np.array([[a, middle, c], [middle, b, c]]))

    def _in(self, corners: Array) -> "Facets":
        """In parts with corners (n_parts, 3, n, 3)."""
        n_parts = len(corners)
        each = corners.transpose(2, 0, 1, 3).reshape(-1, 3, 3)
        return Facets(each, np.repeat(self.object, n_parts), np.repeat(self.cell, n_parts))

    def cut(self, place: Array, normal: Array) -> "Facets":
        """Cut at planes through one place (3,), with normals (n, 3)."""
        height = np.einsum("nci,ni->nc", self.corners - place, normal)
        height[np.abs(height) < _ON_PLANE_M] = 0.0
        is_cut = (height.min(axis=1) < 0) & (height.max(axis=1) > 0)
        some, height = self.take(is_cut), height[is_cut]
        above = height > 0
        # The corner that is alone on its side comes first.
        alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), above.argmin(axis=1))
        order = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(some.corners, order[..., None], axis=1).swapaxes(0, 1)
        h, at_b, at_c = np.take_along_axis(height, order, axis=1).T
        ab, ac = (a + (h / (h - x))[:, None] * (y - a) for x, y in ((at_b, b), (at_c, c)))
        three = np.stack([[a, ab, ac], [ab, b, c], [ab, c, ac]])
        corners = three.transpose(0, 2, 1, 3).reshape(-1, 3, 3)
        parts = Facets(corners, np.tile(some.object, 3), np.tile(some.cell, 3))
        # A corner on the plane leaves slivers of rounding, whose parts have no normal.
        parts = parts.take(lengths(parts.across) > _SLIVER * parts.sizes**2)
        return Facets.concatenate([self.take(~is_cut), parts])

    @staticmethod
    def concatenate(parts: "list[Facets]") -> "Facets":
        """One after the other."""
        columns = zip(*((p.corners, p.object, p.cell) for p in parts), strict=True)
        return Facets(*(np.concatenate(column) for column in columns))


def front_facets(obstacles: Screens, body: int, *places: Array) -> Facets:
    """Facets of a body of which places (3,) all see the same side, of closed meshes the outside, in
    one cell.
    """
    corners, number = [], []
    for i in np.flatnonzero(obstacles.body == body).tolist():
        geometry = obstacles.items[i].geometry
        at = obstacles.items[i].vertices_m[geometry.faces] - obstacles.prepared.anchor_m
        low, high = at.min(axis=(0, 1)), at.max(axis=(0, 1))
        a, b, c = at.swapaxes(0, 1)
        is_facing, shown = ~geometry.shape.is_double, 0.0
        for place in places:
            side = np.sign(np.sum((place - a) * np.cross(b - a, c - a), axis=1))
            is_within = (low <= place).all() and (place <= high).all()
            outward = np.zeros(len(at)) if is_within else geometry.shape.outward
            is_facing = is_facing & (side != 0) & (outward * side >= 0) & (shown * side >= 0)
            shown = side
        rows = np.flatnonzero(is_facing)
        corners.append(at[rows])
        number.append(np.full(len(rows), i))
    objects = np.concatenate(number)
    return Facets(np.concatenate(corners), objects, np.zeros(len(objects), dtype=np.int64))


def shown_facets(views: TwoViews, facets: Facets, body: int) -> tuple[Facets, NDArray[np.bool_]]:
    """Facets that the body itself hides from neither view, and to which their mirrors lead, in
    cells that are numbered anew; and which of them each view lights, (n_views, n).
    """
    obstacles = views.one.obstacles
    off = offset_m(facets.middle) * facets.normal(views.one.place)
    met = np.array([view.first_met(facets.middle, off, body) for view in views.each])
    is_hidden = (met == NO_WAY) | ((met >= 0) & (obstacles.body[np.maximum(met, 0)] == body))
    is_shown = ~is_hidden.any(axis=0)
    facets = facets.take(is_shown)
    _, cell = np.unique(facets.cell, return_inverse=True)
    return replace(facets, cell=cell.reshape(-1)), met[:, is_shown] == NOTHING


def some_facets(view: View, body: int) -> tuple[Facets, NDArray[np.bool_]]:
    """Of a body's facets that face a view, and that it does not hide itself, some hundreds, and
    which of them others leave in the light.
    """
    facets = front_facets(view.obstacles, body, view.place)
    facets = facets.take(np.arange(0, len(facets), max(1, len(facets) // _LOOKED_AT)))
    if not len(facets):
        return facets, np.zeros(0, dtype=bool)
    facets, is_lit = shown_facets(TwoViews(view, view), facets, body)
    return facets, is_lit[0]


def in_voxels(facets: Facets, size_m: Array) -> Facets:
    """With each cell divided into smaller ones of a size, (n_cells,)."""
    voxel = np.floor(facets.middle / size_m[facets.cell][:, None]).astype(np.int64)
    return replace(facets, cell=alike([facets.cell, *voxel.T]))
