"""The outline of obstacles that stand close behind each other, seen from a point: the rims of each
without what of them lies within another's outline.

Parts of a body overlap, one folds in front of itself, and objects stand close before others. A rim
within the outline of the whole diffracts nothing: beside it the whole goes on, a little nearer or
farther. Far before or behind the rim, or behind the point that the wave goes to, it does not
matter: two screens far behind each other are passed one after the other. Rays decide just beside
the rim. Of several rims one behind the other, as where the rim of a mesh turns back for a face, one
counts. Where one rim passes below another both end, and the light is between them.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.geometry.near_boxes import near_pairs
from twin.radar.propagation.diffraction.rim_pieces import PIECE, STEPS, WIDEST, Pieces, piece_m
from twin.radar.propagation.diffraction.rims import unsure_m
from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.rows import dots, lengths
from twin.scene import SceneObject
from twin.scene.boxes import boxes_of
from twin.transfer import host, vector

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

#: Gap between a rim and what goes on before or behind it, times the sum of the inverse distances
#: from the source to the nearer and from the farther to the point: from there on waves pass between
#: both: of objects that touch, and of others, whose waves over both edges are known.
_APART, _APART_SINGLY = 0.3, 0.1
#: Of a ground the farthest point is so many times as far as the nearest one, and its box so high at
#: most, of the shorter level side.
_GROUND, _LOW = 4.0, 0.3
#: Of a way, and besides, by which rays go on behind an object that does not count.
_ON, _ON_M = 1e-5, 1e-4
_MEET = 3.0  # pieces: angle between two ends of rims where one passes below the other
_MEETING = 6  # ends of rims next to each, itself among them, that may belong to it
_ASKEW = 0.1  # sine of the angle at which they meet, at least
_AROUND = 8  # pieces next to each, that may be on one line of sight with it
_SAME = 1e-9  # of a distance, by which rims at one place may differ
_OPPOSITE = 0.5  # cosine between directions at corners that touch, at least
_ALIKE = 0.9  # cosine between directions across rims one behind the other


class OuterRims:
    """Of the outlines of objects what is on the outline of all that stands close, seen from a
    source relative to the anchor, by waves that go to points at a distance from it.

    ``owner`` (n,) numbers the bodies that objects are parts of. Mirrors that the source is an image
    in are not in its way, and stand alone; so does a ground among them: it is close to everything.
    """

    def __init__(
        self,
        prepared: PreparedScene,
        items: tuple[SceneObject, ...],
        owner: Indices,
        outline: Callable[[int], Outline],
        source: Array,
    ) -> None:
        self._prepared, self._owner, self._source = prepared, owner, source
        self._outline, self._wavelength_m = outline, prepared.wavelength_m
        boxes = boxes_of(items) - prepared.anchor_m - source
        alone = _alone(prepared, boxes, source)
        self._close = _close(boxes, alone, prepared.wavelength_m)
        # What touches is looked at together, which takes less time.
        self._group = len(items) + np.arange(len(items))
        rest = np.setdiff1d(np.arange(len(items)), alone)
        self._group[rest] = bodies_of([items[k] for k in rest])
        self._around: dict[int, tuple[Indices, Indices]] = {}
        self._pieces: dict[tuple[int, int], Pieces] = {}
        self._groups: dict[tuple[int, int], _Group] = {}

    def of(self, item: int, reach_m: float, own: int = -1) -> Outline:
        """Of an object, to points so far from the source: what is behind them hides no rim, nor do
        parts of the body that is the points' ``own``.
        """
        group = int(self._group[item])
        if group not in self._around:
            members = np.flatnonzero(self._group == group)
            close = np.unique(np.concatenate([members, *(self._close[k] for k in members)]))
            self._around[group] = members, close
        members, close = self._around[group]
        own = own if own in self._owner[close] else -1
        if (group, own) not in self._groups:
            is_own = (self._owner == own) & (own >= 0)
            members, close = members[~is_own[members]], close[~is_own[close]]
            self._groups[group, own] = self._grouped(members, close, own)
        return self._groups[group, own].up_to(reach_m)[item]

    def close_to(self, item: int) -> Indices:
        """Objects that may have one outline with another."""
        return self._close[item]

    def _grouped(self, members: Indices, close: Indices, own: int) -> "_Group":
        """Pieces of members, and of what is close those on their lines of sight; of several at one
        place that of the first object comes first.
        """
        parts = {member: self._of(member, own) for member in members.tolist()}
        self._find({member: np.arange(len(part.edge)) for member, part in parts.items()}, own)
        tree = cKDTree(np.concatenate([part.sight for part in parts.values()]))
        longest = max(part.longest for part in parts.values())
        beside: dict[int, Indices] = {}
        for other in np.setdiff1d(close, members).tolist() if tree.n else ():
            rest = self._of(other, own)
            size = 2 * _MEET * PIECE * np.sqrt(self._wavelength_m / rest.distance_m)
            reach = size.max(initial=0) + (longest + rest.longest) / 2
            near = np.isfinite(tree.query(rest.sight, distance_upper_bound=reach)[0])
            if near.any():
                beside[other] = np.flatnonzero(near)
        self._find(beside, own)
        parts |= {other: self._of(other, own).take(rows) for other, rows in beside.items()}
        return _Group({k: parts[k] for k in sorted(parts)}, self._wavelength_m)

    def _of(self, item: int, own: int) -> Pieces:
        own = own if own in self._owner[self._close[item]] else -1
        if (item, own) not in self._pieces:
            others = [self._outline(k) for k in (item, *self._close[item].tolist())]
            self._pieces[item, own] = Pieces.of(
                others[0], others, int(self._group[item]), self._wavelength_m
            )
        return self._pieces[item, own]

    def _find(self, wanted: dict[int, Indices], own: int) -> None:
        """What hides some pieces of objects, by their rows, where that is not known yet."""
        new = {}
        for item, rows in wanted.items():
            unknown = rows[np.isnan(self._of(item, own).from_m[rows, 0])]
            if len(unknown):
                new[item] = unknown
        if new:
            parts = [self._of(item, own).take(rows) for item, rows in new.items()]
            found = self._hidden_from_m(list(new), own, parts)
            for (item, rows), from_m in zip(new.items(), found, strict=True):
                self._of(item, own).from_m[rows] = from_m

    def _hidden_from_m(self, items: list[int], own: int, parts: list[Pieces]) -> list[Array]:
        """Pieces of each object by itself or what is close to it, but for parts of a body."""
        is_part = np.zeros((len(items), len(self._prepared.originals)), dtype=bool)
        for row, item in enumerate(items):
            is_part[row, [item, *self._close[item]]] = True
        is_part[:, : len(self._owner)] &= (self._owner != own) | (own < 0)
        every, sizes = Pieces.together(parts), [len(part.edge) for part in parts]
        towards = every.middle[:, None] + every.aside_m[..., None] * every.outline.lit[:, None]
        which = np.repeat(np.arange(len(items)), sizes).repeat(STEPS)
        met_m, what = _first_met(
            self._prepared, is_part, which, self._source, towards.reshape(-1, 3)
        )
        met_m, what = met_m.reshape(every.aside_m.shape), what.reshape(every.aside_m.shape)
        rim_m = every.distance_m[:, None]
        touches = (what >= 0) & (self._group[what] == every.group[:, None])
        from_m = _one_from_m(rim_m, met_m, np.where(touches, _APART, _APART_SINGLY))
        # What touches the object before the rim hides it however far before.
        from_m = np.where(touches & (met_m < rim_m), 0.0, from_m)
        return np.split(from_m, np.cumsum(sizes)[:-1])

    def passed_singly(self, items: Indices, at_m: Array, reach_m: Array) -> Flags:
        """Whether waves to points pass edges of two objects, (n, 2), one after the other."""
        from_m = _one_from_m(at_m[:, 0], at_m[:, 1], np.full(len(at_m), _APART_SINGLY))
        is_strange = self._group[items[:, 0]] != self._group[items[:, 1]]
        return np.asarray(is_strange & (from_m >= reach_m))


class _Group:
    """Pieces of outlines on the same lines of sight, by object."""

    def __init__(self, parts: dict[int, Pieces], wavelength_m: float) -> None:
        # Some something before them hides from all points.
        every = [part.take(np.flatnonzero(part.from_m[:, 0] > 0)) for part in parts.values()]
        self._edges = [int(part.edge.max(initial=-1)) + 1 for part in every]
        self._objects = list(parts)
        self._pieces, self._wavelength_m = Pieces.together(every), wavelength_m
        self._far, self._near, self._one_from_m = _behind_others(self._pieces)
        self._depths_m = np.unique(np.append(self._pieces.from_m, self._one_from_m))
        self._at: dict[int, dict[int, Outline]] = {}
        self._found: dict[bytes, dict[int, Outline]] = {}

    def up_to(self, reach_m: float) -> dict[int, Outline]:
        """By object, to points so far from the source."""
        number = int(np.searchsorted(self._depths_m, reach_m))
        if number not in self._at:
            room_m = _room_m(self._pieces.aside_m, self._pieces.from_m < reach_m)
            is_one = (room_m[self._near] > 0) & (self._one_from_m < reach_m)
            room_m[self._far[is_one]] = 0
            # Many depths change nothing.
            key = room_m.tobytes()
            if key not in self._found:
                self._found[key] = self._outlines(room_m)
            self._at[number] = self._found[key]
        return self._at[number]

    def _outlines(self, room_m: Array) -> dict[int, Outline]:
        runs, edge = _runs(self._pieces, room_m)
        runs = _joined(_past_corners(runs), self._wavelength_m)
        first = np.searchsorted(edge, np.cumsum(self._edges)[:-1])
        rows = np.split(np.arange(len(edge)), first)
        return {item: runs.take(some) for item, some in zip(self._objects, rows, strict=True)}


def _alone(prepared: PreparedScene, boxes: Array, source: Array) -> Indices:
    """Mirrors, by object, that stand alone as seen from a source, with the boxes of objects (n, 2,
    3) relative to it.
    """
    nearest_m = lengths(np.maximum(np.maximum(boxes[:, 0], -boxes[:, 1]), 0))
    farthest_m = lengths(np.abs(boxes).max(axis=1))
    size_m = boxes[:, 1] - boxes[:, 0]
    is_ground = farthest_m > _GROUND * nearest_m
    is_ground &= size_m[:, 2] < _LOW * size_m[:, :2].min(axis=1)
    of_source = {
        number
        for image in prepared.images
        for level in range(1, len(image.places))
        if np.array_equal(image.places[level], source)
        for number in image.patches[:level]
    }
    flats = prepared.flats.object
    mirrors = flats[flats < len(boxes)]
    return np.union1d(mirrors[is_ground[mirrors]], flats[sorted(of_source)])


def _close(boxes: Array, alone: Indices, wavelength_m: float) -> list[Indices]:
    """Of objects with boxes (n, 2, 3) relative to a source, which others may stand close before or
    behind them, but for those that stand alone.
    """
    farthest_m = np.abs(boxes).max(axis=(1, 2))[:, None, None]
    aside_m = WIDEST * np.sqrt(wavelength_m * farthest_m) * [[-1.0], [1.0]]
    deep = np.concatenate([boxes, (1 + _APART) * boxes], axis=1)
    deep = np.stack([deep.min(axis=1), deep.max(axis=1)], axis=1) + aside_m
    pairs = near_pairs(deep)[0]
    pairs = pairs[~np.isin(pairs, alone).any(axis=1)]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.lexsort(both.T[::-1])]
    return np.split(both[:, 1], np.searchsorted(both[:, 0], np.arange(1, len(boxes))))


def _first_met(
    prepared: PreparedScene, is_part: Flags, which: Indices, source: Array, towards: Array
) -> tuple[Array, Indices]:
    """How far from a source rays in directions (n, 3) first meet any of some objects, inf: never;
    and the number of that object, -1: none. Of each ray those ``which`` of the rows of ``is_part``,
    (k, n_objects), tells.
    """
    mi, count = prepared.context.mi, len(towards)
    direction = towards / lengths(towards)[:, None]
    objects = prepared.world.object_of_face.astype(np.int64)
    met, what, begin = np.full(count, np.inf), np.full(count, -1), np.zeros(count)
    rows = np.arange(count)
    while len(rows):
        at = source + begin[rows, None] * direction[rows]
        ray = mi.Ray3f(vector(mi, at, "Point3f"), vector(mi, direction[rows], "Vector3f"))
        hit = prepared.world.scene.ray_intersect_preliminary(ray)
        is_there, face, distance = host([hit.is_valid(), hit.prim_index, hit.t], len(rows))
        begin[rows] += np.where(is_there, distance, 0)
        number = objects[np.where(is_there, face, 0)]
        meets_part = is_there & is_part[which[rows], number]
        met[rows[meets_part]] = begin[rows[meets_part]]
        what[rows[meets_part]] = number[meets_part]
        begin[rows] += _ON * np.where(is_there, distance, 0) + _ON_M
        rows = rows[is_there & ~meets_part]
    return met, what


def _one_from_m(one_m: Array, other_m: Array, apart: Array) -> Array:
    """Distance of points from which on what stands at two distances from the source, one before the
    other, has one outline, by the gap over distance that sets both apart; inf: never.
    """
    near, far = np.minimum(one_m, other_m), np.maximum(one_m, other_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = far - near
        behind = gap / (apart - gap / near)
    return np.where(gap < apart * near, far + behind, np.inf)


def _room_m(aside_m: Array, is_met: Flags) -> Array:
    """How far aside of pieces of rims, (n,), the body does not go on: 0 within its outline."""
    steps = np.where(is_met.any(axis=1), is_met.argmax(axis=1), STEPS)
    bounds = np.hstack([np.zeros((len(aside_m), 1)), aside_m])
    bounds[steps == STEPS, -1] = np.inf
    room: Array = np.take_along_axis(bounds, steps[:, None], axis=1)[:, 0]
    return room


def _behind_others(some: Pieces) -> tuple[Indices, Indices, Array]:
    """Pieces on the line of sight to others that are nearer, or the same, (n,), and these; and from
    which distance of points on both are one.
    """
    sight, distance, lit = some.sight, some.distance_m, some.outline.lit
    side, beside = some.outline.ends[:, 1] - some.outline.ends[:, 0], some.aside_m[:, 0] / distance
    side -= np.sum(side * sight, axis=1)[:, None] * sight
    length = np.linalg.norm(side, axis=1) / distance  # as angles
    reach = float(np.max(length / 2 + beside, initial=0))
    around = cKDTree(sight).query(sight, range(1, _AROUND + 1), distance_upper_bound=reach)[1]
    first, rank = np.nonzero((around < len(sight)) & (around != np.arange(len(sight))[:, None]))
    pairs = np.stack([first, around[first, rank]], axis=1)
    one, other = np.sort(pairs, axis=1).T
    is_behind = _depth_m(some, one, sight[other]) > (1 + _SAME) * distance[other]
    # Of two at one place the first is the nearer one.
    near, far = np.where(is_behind, other, one), np.where(is_behind, one, other)
    apart = sight[far] - sight[near]
    along = np.abs(np.sum(apart * side[near], axis=1)) / np.linalg.norm(side[near], axis=1)
    across = np.abs(np.sum(apart * lit[near], axis=1))
    is_same = np.sum(lit[near] * lit[far], axis=1) > _ALIKE
    is_same &= (along < length[near] / 2) & (across < beside[near])
    near, far = near[is_same], far[is_same]
    touches = some.group[near] == some.group[far]
    apart = np.where(touches, _APART, _APART_SINGLY)
    return far, near, _one_from_m(distance[near], distance[far], apart)


def _depth_m(some: Pieces, which: Indices, sight: Array) -> Array:
    """How far from the source the lines of some pieces, (n,), are next to lines of sight (n, 3)."""
    side, middle = some.outline.ends[which, 1] - some.outline.ends[which, 0], some.middle[which]
    across = side - dots(side, sight)[:, None] * sight
    share = -dots(middle, across) / np.maximum(dots(across, across), 1e-300)
    return dots(middle + share[:, None] * side, sight)


def _runs(pieces: Pieces, room_m: Array) -> tuple[Outline, Indices]:
    """Pieces of one edge that follow each other as one, and the edge of each; those without room
    are left out. Ends within an edge are corners of their own.
    """
    rim, some = pieces.outline, np.flatnonzero(room_m > 0)
    edge, piece = pieces.edge[some], pieces.piece[some]
    follows = np.zeros(len(some), dtype=bool)
    follows[1:] = (edge[1:] == edge[:-1]) & (piece[1:] == piece[:-1] + 1)
    begin = np.flatnonzero(~follows)
    first, last = some[begin], some[np.append(begin[1:], len(some))[: len(begin)] - 1]
    ends = np.stack([rim.ends[first, 0], rim.ends[last, 1]], axis=1)
    is_cut = [pieces.piece[first] > 0, pieces.piece[last] + 1 < pieces.count[last]]
    number = int(rim.corner.max(initial=-1)) + 1 + np.arange(2 * len(first)).reshape(-1, 2)
    corner = np.where(np.stack(is_cut, axis=1), number, rim.corner[first])
    runs = Outline.of(ends, rim.edge[first], corner, rim.lit[first])
    room = np.minimum.reduceat(room_m[some], begin) if len(begin) else room_m[some]
    return replace(runs, room_m=room), pieces.edge[first]


def _joined(rim: Outline, wavelength_m: float) -> Outline:
    """With the light beside ends where two rims cross between both, past which waves pass."""
    _, number, count = np.unique(rim.corner, return_inverse=True, return_counts=True)
    loose = np.flatnonzero(count[number.ravel()] == 1)
    ends, aside, past = (x.reshape(-1, 3).copy() for x in (rim.ends, rim.aside, rim.past))
    reach = _MEET * piece_m(ends[loose], wavelength_m) / lengths(ends[loose])
    one, other = _crossing(rim, loose, reach)
    aside[one] = _between(aside[one], aside[other])
    past[one] = ends[other]
    return replace(rim, aside=aside.reshape(rim.aside.shape), past=past.reshape(rim.past.shape))


def _past_corners(rim: Outline) -> Outline:
    """With the light beside corners that touch one of another outline, in the light of both as two
    squares of a chessboard: each edge has it together with the other's that meets it there.
    """
    ends, lit, aside = rim.ends.reshape(-1, 3), rim.lit, rim.aside.reshape(-1, 3)
    one, other = _crossing(rim, np.arange(len(ends)), 3 * unsure_m(ends) / lengths(ends))
    is_light = dots(aside[one], aside[other]) < -_OPPOSITE
    one, other = one[is_light], other[is_light]
    turned = aside.copy()
    turned[one] = _between(lit[one // 2], lit[other // 2])
    return replace(rim, aside=turned.reshape(rim.aside.shape))


def _crossing(rim: Outline, some: Indices, reach: Array) -> tuple[Indices, Indices]:
    """Some ends of edges, 2 n and 2 n + 1 those of edge n, and of each the next of another one
    within an angle (n,) at which both edges lead into the other's light.
    """
    ends = rim.ends.reshape(-1, 3)[some]
    if not len(ends):
        return some, some
    sight = ends / lengths(ends)[:, None]
    number = min(len(ends), _MEETING)
    angle, place = cKDTree(sight).query(sight, np.arange(1, number + 1))
    along, lit = rim.lines.along, rim.lit
    inwards = np.stack([along, -along], axis=1).reshape(-1, 3)
    one, other = np.repeat(some, number), some[place].ravel()
    meets = (angle < reach[:, None]).ravel() & (dots(inwards[other], lit[one // 2]) > _ASKEW)
    meets &= dots(inwards[one], lit[other // 2]) > _ASKEW
    first = np.flatnonzero(meets)
    first = first[np.unique(one[first], return_index=True)[1]]
    return one[first], other[first]


def _between(one: Array, other: Array) -> Array:
    """Unit vectors between others, (n, 3)."""
    both = one + other
    between: Array = both / np.maximum(lengths(both), 1e-300)[:, None]
    return between
