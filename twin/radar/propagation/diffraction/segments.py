"""Segments of paths by an image, before and between its mirrors and behind the last: clear paths
over edges of obstacles that stand beside one, and over the border of an only mirror.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.blocking import NOTHING, blocker, folded
from twin.radar.propagation.diffraction.mirror_borders import between_mirrors, on_plane
from twin.radar.propagation.diffraction.past_thin import pass_thin
from twin.radar.propagation.diffraction.rims import (
    DiffractedPaths,
    beside_corners,
    edge_paths,
    farthest,
    near_edges,
    rim_paths,
)
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.thick_corners import CornerPairs, by_thick_corners
from twin.radar.propagation.diffraction.two_edges import (
    ONE_EDGE,
    consecutive_edges,
    double_edge_paths,
)
from twin.radar.propagation.diffraction.two_obstacles import (
    candidates,
    open_beside,
    over_two_obstacles,
)
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.scene.images import Image, mirrored
from twin.radar.propagation.scene.mesh_scene import Flat
from twin.radar.rows import alike, lengths

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_PAIRS = 2**20  # of points and edges, at once
#: Of points beside where they are: a way that is reflected right at the foot of an edge passes it
#: on one of the segments before and behind the mirror, not on neither.
_ASIDE_M = 1e-7
#: Likewise: of a way exactly in the plane of a side all must agree on which side of it that is.
_HAIR_M = 1e-10 * np.array([0.36, 0.48, 0.8])
_LEVEL = 0.1  # cosine between the way beside an edge and a mirror on which it stands, at least


class _Singles(NamedTuple):
    """Paths over one edge or over an end of one; whether each is open; and what blocks it."""

    paths: DiffractedPaths
    is_open: NDArray[np.bool_]
    blocker: Indices


class Segment:
    """One segment of the paths to points (n, 3) by an image: after ``level`` of its mirrors.

    On it the wave seems to come from the radar's image in the mirrors before it, and to go to the
    points' images in the mirrors behind it.
    """

    def __init__(
        self, obstacles: Screens, image: Image, level: int, places: Array, off: Array
    ) -> None:
        self.obstacles, self.image, self.level = obstacles, image, level
        self.places, self.off = places, off
        self.source = image.places[level]
        flats = obstacles.prepared.flats
        self.seen = places + _ASIDE_M * flats.normal[list(image.patches)].sum(axis=0) + _HAIR_M
        for number in reversed(image.patches[level:]):
            self.seen = mirrored(self.seen, flats[number])

    def paths(self, active: NDArray[np.bool_], own: Indices) -> Iterator[DiffractedPaths]:
        """Clear diffracted paths to active points, around every obstacle but their own body: over
        one edge, over two where the points see another one than the source, over that alone, and
        over two of two obstacles.
        """
        parts = list(self._parts(active, own))
        if not parts:
            return
        over = [self._over(item, rim, rows) for item, rim, rows in parts]
        paths = DiffractedPaths.concatenate(over)
        blocker = self._blocker(paths)
        each_open = np.split(blocker == NOTHING, np.cumsum([len(one.point) for one in over])[:-1])
        others, is_open = [], []
        for part, one, is_clear in zip(parts, over, each_open, strict=True):
            more, remains = self._twice(*part, one, is_clear)
            others.append(more)
            is_open.append(remains)
        twice = DiffractedPaths.concatenate(others)
        is_stopped = (blocker != paths.item) | ~_begin_as(paths, twice)
        close = self._over_close(paths, np.where(is_stopped, blocker, NOTHING), own)
        yield close
        yield twice.take(self._is_open(twice) & ~_begin_as(twice, close))
        yield from self._round_two(_Singles(paths, np.concatenate(is_open), blocker))

    def _parts(
        self, active: NDArray[np.bool_], own: Indices
    ) -> Iterator[tuple[int, Outline, Indices]]:
        """Obstacles, edges of each, and active points of one body that these may diffract to."""
        for item in self.near_any(active):
            strange = (own < 0) | (own != self.obstacles.body[item])
            rows = np.flatnonzero(active & strange & self.beside(item))
            for group in _groups(rows, own):
                rim = self.rim(item, group, int(own[group[0]]))
                self._move_beside_corners(rim, group)
                step = max(1, _PAIRS // max(len(rim.ends), 1))
                if len(rim.ends):
                    for part in np.split(group, range(step, len(group), step)):
                        yield item, rim, part

    def rim(self, item: int, rows: Indices, own: int, around_m: float = 0.0) -> Outline:
        """Edges of an obstacle's outline that may diffract a wave to points of a body, or to a
        distance around them; none of an obstacle that is one of the image's mirrors.
        """
        o = self.obstacles
        if item in {o.prepared.flats[number].object for number in self.image.patches}:
            return o.outline(item, self.source).take(np.zeros(0, dtype=np.intp))
        middle = self.seen[rows].mean(axis=0)
        direct = middle - self.source
        rim = o.rim(item, self.source, float(np.linalg.norm(direct)), own)
        rim = between_mirrors(o.prepared, self.image, self.level, rim)
        reach = np.linalg.norm(self.seen[rows] - middle, axis=1).max() + around_m
        return rim.take(near_edges(rim, direct, reach, o.wavenumber, o.faintest))

    def turns(self, paths: DiffractedPaths, edges: Array) -> Array:
        """Vertices of paths from the points to the radar, (m, n, 3); ``edges``: at (n, 2, 3)."""
        prepared = self.obstacles.prepared
        return folded(prepared, self.image, self.level, self.places[paths.point], edges)

    def pass_thin(self, paths: DiffractedPaths, dark: Indices, lit: Indices) -> NDArray[np.bool_]:
        """Whether ways in the dark of one edge, (n,), pass the obstacle beside another, lit one."""
        o = self.obstacles
        return pass_thin(o.items, o.prepared.anchor_m, self.source, self.seen, paths, dark, lit)

    def velocity(self, paths: DiffractedPaths) -> Array:
        """Of the edges, (n, 3), m/s."""
        motions, edge = self.obstacles.prepared.motions, paths.stops.mean(axis=1)
        return motions.at(paths.item, edge)[0]

    @property
    def mirrors_before(self) -> int:
        """How many mirrors paths meet between the radar and the edges."""
        return self.level

    def shown(self, paths: DiffractedPaths) -> DiffractedPaths:
        """Paths as the mirrors behind the segment show them, to the points themselves."""
        stops, beside = paths.stops, paths.stops + paths.aside
        along, corner = paths.stops[:, 1] + paths.along, paths.stops + paths.corner
        for number in self.image.patches[self.level :]:
            flat = self.obstacles.prepared.flats[number]
            stops, beside, along, corner = (
                mirrored(x, flat) for x in (stops, beside, along, corner)
            )
        return replace(
            paths,
            stops=stops,
            aside=beside - stops,
            along=along - stops[:, 1],
            corner=corner - stops,
        )

    def near_any(self, active: NDArray[np.bool_], around_m: float = 0.0) -> list[int]:
        """Obstacles that may reach into the Fresnel ellipsoid of the path to any active point, or
        to a distance around it: of thousands most stand elsewhere.
        """
        o, ends = self.obstacles, np.vstack([self.source[None], self.seen[active]])
        longest = 2 * float(np.linalg.norm(ends - self.source, axis=1).max())
        reach = 0.5 * np.sqrt(self._more_m * (longest + self._more_m)) + around_m
        box = np.array([ends.min(axis=0), ends.max(axis=0)])
        off = np.maximum(np.maximum(box[0] - o.centers, o.centers - box[1]), 0)
        near: list[int] = np.flatnonzero(np.linalg.norm(off, axis=1) <= o.radii + reach).tolist()
        return near

    @property
    def _more_m(self) -> float:
        """By how much the path over the farthest edge that counts is longer."""
        return float(farthest(self.obstacles.faintest)) / self.obstacles.wavenumber

    def beside(self, item: int, around_m: float = 0.0) -> NDArray[np.bool_]:
        """Whether an obstacle reaches into the Fresnel ellipsoids of the direct paths to points, or
        to a distance around these, (n,); their half minor axis is sqrt((R + d)^2 - R^2) / 2.
        """
        o, direct = self.obstacles, self.seen - self.source
        length = np.linalg.norm(direct, axis=1)
        more = self._more_m
        towards = o.centers[item] - self.source
        along = np.clip(direct @ towards / np.maximum(length**2, 1e-300), 0, 1)
        gap = np.linalg.norm(towards - along[:, None] * direct, axis=1) - o.radii[item]
        widest = 0.5 * np.sqrt(more * (2 * length + more))
        beside: NDArray[np.bool_] = gap <= widest + around_m
        return beside

    def _round_two(self, one: _Singles) -> Iterator[DiffractedPaths]:
        """Over an edge each of one or two obstacles."""
        o, is_open = self.obstacles, one.is_open
        at_m = np.linalg.norm(one.paths.stops[:, 0] - self.source, axis=1)
        reach_m = np.linalg.norm(self.seen - self.source, axis=1)
        for pairs in candidates(one.paths, self.source):
            reach = reach_m[one.paths.point[pairs[:, 0]]]
            singly = o.rims_from(self.source).passed_singly(
                one.paths.item[pairs], at_m[pairs], reach
            )
            if singly.any():
                k = o.wavenumber
                two = over_two_obstacles(
                    one.paths, pairs[singly], self.source, self.seen, k, o.faintest
                )
                is_open = open_beside(two, one.paths, is_open, one.blocker)
                both = two.paths.take(np.abs(two.paths.amplitude) >= o.faintest)
                yield both.take(self._is_open(both))
        yield one.paths.take(is_open)

    def _move_beside_corners(self, rim: Outline, rows: Indices) -> None:
        k = self.obstacles.wavenumber
        self.seen[rows] = beside_corners(rim, self.source, self.seen[rows], k)

    def _over(
        self,
        item: int,
        rim: Outline,
        rows: Indices,
        along: Callable[..., DiffractedPaths] = rim_paths,
    ) -> DiffractedPaths:
        o = self.obstacles
        paths = along(rim, self.source, self.seen[rows], o.wavenumber, o.faintest)
        paths = self._beside_mirrors(paths)
        return replace(paths, point=rows[paths.point], item=np.full(len(paths.point), item))

    def _beside_mirrors(self, paths: DiffractedPaths) -> DiffractedPaths:
        """Paths over edges next to a mirror on which these stand: it shows how they go on, so that
        rays pass beside them along the mirror instead of round their ends, into it.
        """
        aside, size = paths.aside.copy(), np.linalg.norm(paths.aside[:, 0], axis=1)
        is_edge = (paths.along != 0).any(axis=1)
        for number in self.image.patches[max(self.level - 1, 0) : self.level + 1]:
            flat = self.obstacles.prepared.flats[number]
            height = np.abs((paths.stops[:, 0] - flat.point) @ flat.normal)
            level = aside - (aside @ flat.normal)[..., None] * flat.normal
            length = np.linalg.norm(level, axis=2, keepdims=True)
            is_near = is_edge & (height < size) & (length[:, 0, 0] > _LEVEL * size)
            turned = level * (size[:, None, None] / np.maximum(length, 1e-300))
            aside[is_near] = turned[is_near]
        return replace(paths, aside=aside)

    def _twice(
        self,
        item: int,
        rim: Outline,
        rows: Indices,
        paths: DiffractedPaths,
        is_open: NDArray[np.bool_],
    ) -> tuple[DiffractedPaths, NDArray[np.bool_]]:
        """Paths over two edges, where the points see other edges of the obstacle than the source.

        Returns these with paths over one of the edges that the points see, and those by corners of
        both; and which of ``paths`` are clear, without those that a path over two edges replaces.
        """
        o, far_rims = self.obstacles, self._far_rims(item, rows)
        far = DiffractedPaths.concatenate(
            [self._over(item, rim, rows, edge_paths) for rim in far_rims]
        )
        edges = np.flatnonzero(np.isfinite(paths.lit_m))
        i, j = consecutive_edges(paths.take(edges), far, self.source, self.seen)
        i = edges[i]
        one, other = paths.take(i), far.take(j)
        two, apart, alone = double_edge_paths(
            self.source, self.seen[one.point], one, other, o.wavenumber
        )
        matters = (apart > ONE_EDGE) | (~is_open[i] & (one.lit_m <= 0))
        is_open = is_open.copy()
        is_open[i[matters & ~alone[:, 0]]] = False
        rest = other.take(matters & alone[:, 1])
        _, once = np.unique(np.stack([rest.point, rest.edge]), axis=1, return_index=True)
        towards = self.seen[rows].mean(axis=0) - self.source
        pairs = CornerPairs.of(Outline.together([rim, *far_rims]), towards)
        corners, row = by_thick_corners(
            pairs, paths, self.source, self.seen, o.wavenumber, o.faintest
        )
        is_open[row] = False
        others = DiffractedPaths.concatenate([two.take(matters), rest.take(once), corners])
        return others, is_open

    def _over_close(
        self, paths: DiffractedPaths, blocker: Indices, own: Indices
    ) -> DiffractedPaths:
        """Clear paths over an edge in the shadow that another obstacle stops, or another part of
        the same, so close behind that both have one outline: these bend again over an edge of it
        that the points see.
        """
        o, rims = self.obstacles, self.obstacles.rims_from(self.source)
        is_stopped = np.isfinite(paths.lit_m) & (paths.lit_m <= 0) & (blocker >= 0)
        is_stopped &= (own[paths.point] < 0) | (own[paths.point] != o.body[blocker])
        mirrors = {o.prepared.flats[number].object for number in self.image.patches}
        both = np.stack([paths.item, blocker], axis=1)
        found = [paths.take(np.zeros(0, dtype=np.intp))]
        for item, other in np.unique(both[is_stopped], axis=0).tolist():
            if other in mirrors or (other != item and other not in rims.close_to(item)):
                continue
            near = paths.take(is_stopped & (both == [item, other]).all(axis=1))
            rows = np.unique(near.point)
            middle = self.seen[rows].mean(axis=0)
            rim = o.outline(other, middle).from_elsewhere(self.source - middle)
            far = self._over(other, rim, rows, edge_paths)
            if other == item:
                far = far.take(~np.isin(far.edge, near.edge))
            i, j = consecutive_edges(near, far, self.source, self.seen)
            near, far, places = near.take(i), far.take(j), self.seen[near.point[i]]
            at_m = np.stack([lengths(x.stops[:, 0] - self.source) for x in (near, far)], axis=1)
            pairs = np.broadcast_to([item, other], at_m.shape)
            singly = rims.passed_singly(pairs, at_m, lengths(places - self.source))
            two, apart, _ = double_edge_paths(self.source, places, near, far, o.wavenumber)
            found.append(two.take(~singly & (apart > ONE_EDGE) & (at_m[:, 0] <= at_m[:, 1])))
        over = DiffractedPaths.concatenate(found)
        return over.take(self._is_open(over))

    def _far_rims(self, item: int, rows: Indices) -> list[Outline]:
        """Edges that points see, from the source; of sides along which the source looks those that
        are seen from its own side of the plane: the wave over one edge passes the other one also
        where the points see but one of them.
        """
        o, middle = self.obstacles, self.seen[rows].mean(axis=0)
        seen = o.outline(item, middle).from_elsewhere(self.source - middle)
        rims, way = [], middle - self.source
        for side in o.sides if self.level == 0 else ():
            over_m = float(side.over_m(way))
            is_across = (over_m > side.edge_on_m) != side.is_source_over
            if side.item == item and is_across and side.is_along(way):
                seen = seen.take(np.flatnonzero(~side.has(seen.ends)))
                place = middle - 2 * over_m * side.normal
                other = o.outline(item, place).from_elsewhere(self.source - place)
                rims.append(other.take(np.flatnonzero(side.has(other.ends))))
        return [seen, *rims]

    def _is_open(self, paths: DiffractedPaths) -> NDArray[np.bool_]:
        return self._blocker(paths) == NOTHING

    def _blocker(self, paths: DiffractedPaths) -> Indices:
        turns = self.turns(paths, paths.stops + paths.aside)
        return blocker(self.obstacles.prepared, turns, self.off[paths.point])


class Opening(Segment):
    """The border of an image's only mirror, through which the radar is seen: on its edges paths
    are reflected, so that they reach points past the mirror, too.
    """

    def paths(self, active: NDArray[np.bool_], own: Indices) -> Iterator[DiffractedPaths]:
        """Clear paths over the border to all points on the radar's side of the mirror."""
        o, flat, rim = self.obstacles, self._flat, self.obstacles.border(self.image)
        here, there = ((x - flat.point) @ flat.normal for x in (self.image.places[0], self.places))
        rows = np.flatnonzero(here * there > 0)
        if rim is None or not len(rows):
            return
        self._move_beside_corners(rim, rows)
        paths = rim_paths(rim, self.source, self.seen[rows], o.wavenumber, o.faintest)
        item = np.full(len(paths.point), flat.object)
        paths = replace(paths, point=rows[paths.point], item=item)
        yield paths.take(self._is_open(paths))

    def turns(self, paths: DiffractedPaths, edges: Array) -> Array:
        """As of a segment; a little before the mirror."""
        o, flat = self.obstacles, self._flat
        side = np.sign((self.image.places[0] - flat.point) @ flat.normal)
        on_it = on_plane(flat, self.source, edges.reshape(-1, 3))
        before = (on_it + 2 * side * offset_m(on_it) * flat.normal).reshape(edges.shape)
        places = self.places[paths.point]
        return folded(o.prepared, self.image, self.level, places, before, at_mirror=True)

    def pass_thin(self, paths: DiffractedPaths, dark: Indices, lit: Indices) -> NDArray[np.bool_]:
        """None: an opening is no obstacle."""
        return np.zeros(len(dark), dtype=bool)

    def velocity(self, paths: DiffractedPaths) -> Array:
        """None beside the image's, which moves as the mirror does."""
        return np.zeros((len(paths.point), 3))

    @property
    def mirrors_before(self) -> int:
        """The mirror itself is where the edges are."""
        return self.level - 1

    @property
    def _flat(self) -> Flat:
        return self.obstacles.prepared.flats[self.image.patches[0]]


def _begin_as(paths: DiffractedPaths, others: DiffractedPaths) -> NDArray[np.bool_]:
    """Which paths bend over the same edge first as others to the same point."""
    if not len(others.point):
        return np.zeros(len(paths.point), dtype=bool)
    both = DiffractedPaths.concatenate([paths, others])
    same = alike([both.point, both.item, both.edge])
    return np.isin(same[: len(paths.point)], same[len(paths.point) :])


def _groups(rows: Indices, own: Indices) -> list[Indices]:
    """Points grouped by the body that they belong to; each without a body by itself."""
    lone = rows[own[rows] < 0]
    bodies = [rows[own[rows] == body] for body in np.unique(own[rows]) if body >= 0]
    return [*bodies, *np.split(lone, np.arange(1, len(lone)))] if len(lone) else bodies
