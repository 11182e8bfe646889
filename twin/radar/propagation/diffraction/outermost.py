"""The outline of a body of several parts, seen from a point: the rims of its parts without what of
them lies within another part's outline.

Parts of a body overlap, and one folds in front of itself. A rim within the outline of the whole
diffracts nothing: beside it the body goes on, nearer or a little farther. Far behind the rim, or
behind the point that the wave goes to, it does not matter. Rays decide just beside the rim.
Of several rims one behind the other, as where the rim of a mesh turns back for a face, one counts.
Where one rim passes below another both end, and the light is between them.
"""

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.scene import SceneObject
from twin.transfer import host, vector

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_PIECE = 0.02  # of the root of wavelength and distance: pieces of rims that are hidden or not
_MOST_PIECES = 256, 2**15  # of an edge, and of a body
_BESIDE_M = 3e-4  # of a rim, where rays are sure; as much more for every 10 m
#: Gap between a rim and what goes on behind it, times the sum of the inverse distances from the
#: source to the one and from the other to the point: from there on waves pass between both.
_APART = 0.3
#: Of a way, and besides, by which rays go on behind a body that does not count.
_ON, _ON_M = 1e-5, 1e-4
#: How far aside rays look at most, of the same root, and at how many distances.
_WIDEST, _STEPS = 0.1, 4
_MEET = 3.0  # pieces: angle between two ends of rims where one passes below the other
_AROUND = 8  # pieces next to each, that may be on one line of sight with it
_ALIKE = 0.9  # cosine between directions across rims one behind the other


def wholes(
    prepared: PreparedScene, items: tuple[SceneObject, ...], body: NDArray[np.int32]
) -> Indices:
    """Number of what each object has one outline with: its body; of objects without one those that
    it touches, but for mirrors, which stand alone: a ground touches everything.
    """
    whole = len(items) + np.arange(len(items))
    whole[body >= 0] = body[body >= 0]
    loose = np.flatnonzero((body < 0) & ~np.isin(np.arange(len(items)), prepared.flats.object))
    if len(loose):
        whole[loose] = 2 * len(items) + bodies_of([items[i] for i in loose])
    return whole


class OuterRims:
    """Of the outlines of a body's parts, by object, what is on the outline of the whole, seen from
    a source relative to the anchor, by waves that go to points at a distance from it.
    """

    def __init__(self, prepared: PreparedScene, rims: dict[int, Outline], source: Array) -> None:
        self._parts, self._wavelength_m = rims, prepared.wavelength_m
        self._item = np.repeat(list(rims), [len(rim.ends) for rim in rims.values()])
        self._found: dict[int, dict[int, Outline]] = {}
        if not len(self._item):
            return
        self._rim = _together(list(rims.values()))
        self._pieces, *edges = _pieces(self._rim, prepared.wavelength_m)
        self._edge, self._piece, self._count = edges
        is_part = np.zeros(len(prepared.originals), dtype=bool)
        is_part[list(rims)] = True
        self._aside_m, self._from_m = _beside(prepared, is_part, self._pieces, source)
        self._depths_m = np.unique(self._from_m)

    def up_to(self, reach_m: float) -> dict[int, Outline]:
        """To points so far from the source: what the body has behind them hides no rim."""
        if not len(self._item):
            return self._parts
        number = int(np.searchsorted(self._depths_m, reach_m))
        if number not in self._found:
            self._found[number] = self._outermost(reach_m)
        return self._found[number]

    def _outermost(self, reach_m: float) -> dict[int, Outline]:
        room = _room_m(self._aside_m, self._from_m < reach_m)
        kept = room > 0
        rows = np.flatnonzero(kept)
        beside = _beside_m(self._pieces.ends.mean(axis=1))
        kept[rows[_is_behind_another(self._pieces.take(rows), beside[rows])]] = False
        room = np.where(kept, room, 0.0)
        runs, edge = _runs(self._rim, self._edge, self._piece, self._count, room)
        runs = _joined(runs, self._wavelength_m)
        return {part: runs.take(np.flatnonzero(self._item[edge] == part)) for part in self._parts}


def _together(rims: list[Outline]) -> Outline:
    """As one outline, with corners numbered anew."""
    first = np.cumsum([0, *(int(rim.corner.max(initial=-1)) + 1 for rim in rims)])
    rims = [replace(rim, corner=rim.corner + n) for rim, n in zip(rims, first, strict=False)]
    columns = ([getattr(rim, f.name) for rim in rims] for f in fields(Outline))
    return Outline(*(np.concatenate(column) for column in columns))


def _pieces(rim: Outline, wavelength_m: float) -> tuple[Outline, Indices, Indices, Indices]:
    """Short pieces of edges; of each the edge and its number there; and of edges how many."""
    side = rim.ends[:, 1] - rim.ends[:, 0]
    size = _piece_m(rim.ends.mean(axis=1), wavelength_m)
    parts = np.minimum(np.linalg.norm(side, axis=1) / size, _MOST_PIECES[0])
    parts *= min(_MOST_PIECES[1] / parts.sum(), 1)
    count = np.maximum(np.ceil(parts), 1).astype(np.int64)
    edge = np.repeat(np.arange(len(count)), count)
    piece = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    return _part(rim, edge, piece / count[edge], (piece + 1) / count[edge]), edge, piece, count


def _part(rim: Outline, edge: Indices, begin: Array, end: Array) -> Outline:
    """Of edges (n,) the part between two shares of their lengths."""
    some = rim.take(edge)
    first, side = some.ends[:, :1], some.ends[:, 1:] - some.ends[:, :1]
    return replace(some, ends=first + np.stack([begin, end], axis=1)[..., None] * side)


def _meets_m(prepared: PreparedScene, is_part: Flags, source: Array, towards: Array) -> Array:
    """How far from a source rays in directions (n, 3) first meet any part; inf: never."""
    mi, count = prepared.context.mi, len(towards)
    direction = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    objects = prepared.world.object_of_face.astype(np.int64)
    met, rows, begin = np.full(count, np.inf), np.arange(count), np.zeros(count)
    while len(rows):
        at = source + begin[rows, None] * direction[rows]
        ray = mi.Ray3f(vector(mi, at, "Point3f"), vector(mi, direction[rows], "Vector3f"))
        hit = prepared.world.scene.ray_intersect_preliminary(ray)
        is_there, face, distance = host([hit.is_valid(), hit.prim_index, hit.t], len(rows))
        begin[rows] += np.where(is_there, distance, 0)
        meets_part = is_there & is_part[objects[np.where(is_there, face, 0)]]
        met[rows[meets_part]] = begin[rows[meets_part]]
        begin[rows] += _ON * np.where(is_there, distance, 0) + _ON_M
        rows = rows[is_there & ~meets_part]
    return met


def _beside(
    prepared: PreparedScene, is_part: Flags, pieces: Outline, source: Array
) -> tuple[Array, Array]:
    """Distances aside of pieces of rims, and those of points from which on the body goes on there,
    (n, steps).
    """
    middle = pieces.ends.mean(axis=1)
    nearest = _beside_m(middle)
    widest = _WIDEST / _PIECE * _piece_m(middle, prepared.wavelength_m)
    share = np.arange(_STEPS) / (_STEPS - 1)
    off = nearest[:, None] * np.maximum(widest / nearest, 1)[:, None] ** share
    beside = middle[:, None] + off[..., None] * pieces.lit[:, None]
    met = _meets_m(prepared, is_part, source, beside.reshape(-1, 3)).reshape(off.shape)
    return off, _hidden_from_m(np.linalg.norm(middle, axis=1)[:, None], met)


def _hidden_from_m(rim_m: Array, met_m: Array) -> Array:
    """Distance of points from which on a rim counts as hidden by what goes on beside it, both at
    distances from the source: at once by what is nearer, never by what is far behind.
    """
    gap = np.maximum(met_m - rim_m, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        behind = gap / (_APART - gap / rim_m)
    return np.where(gap < _APART * rim_m, met_m + behind, np.inf)


def _room_m(aside_m: Array, is_met: Flags) -> Array:
    """How far aside of pieces of rims, (n,), the body does not go on: 0 within its outline."""
    steps = np.where(is_met.any(axis=1), is_met.argmax(axis=1), _STEPS)
    bounds = np.hstack([np.zeros((len(aside_m), 1)), aside_m])
    bounds[steps == _STEPS, -1] = np.inf
    room: Array = np.take_along_axis(bounds, steps[:, None], axis=1)[:, 0]
    return room


def _is_behind_another(pieces: Outline, beside_m: Array) -> Flags:
    """Which pieces are on the line of sight to another one that is nearer, or the same."""
    middle, side = pieces.ends.mean(axis=1), pieces.ends[:, 1] - pieces.ends[:, 0]
    distance = np.linalg.norm(middle, axis=1)
    sight, beside = middle / distance[:, None], beside_m / distance
    side -= np.sum(side * sight, axis=1)[:, None] * sight
    length = np.linalg.norm(side, axis=1) / distance  # as angles
    reach = float(np.max(length / 2 + beside, initial=0))
    around = cKDTree(sight).query(sight, range(1, _AROUND + 1), distance_upper_bound=reach)[1]
    first, rank = np.nonzero((around < len(sight)) & (around != np.arange(len(sight))[:, None]))
    pairs = np.stack([first, around[first, rank]], axis=1)
    # Of two at one place the first is the nearer one.
    order = np.lexsort((np.arange(len(distance)), distance)).argsort()
    near, far = np.where(order[pairs[:, :1]] < order[pairs[:, 1:]], pairs, pairs[:, ::-1]).T
    apart = sight[far] - sight[near]
    along = np.abs(np.sum(apart * side[near], axis=1)) / np.linalg.norm(side[near], axis=1)
    across = np.abs(np.sum(apart * pieces.lit[near], axis=1))
    is_same = np.sum(pieces.lit[near] * pieces.lit[far], axis=1) > _ALIKE
    is_same &= (along < length[near] / 2) & (across < beside[near])
    is_behind = np.zeros(len(middle), dtype=bool)
    is_behind[far[is_same]] = True
    return is_behind


def _runs(
    rim: Outline, edge: Indices, piece: Indices, count: Indices, room_m: Array
) -> tuple[Outline, Indices]:
    """Pieces of one edge that follow each other as one, and the edge of each; those without room
    are left out. Ends within an edge are corners of their own.
    """
    kept = room_m > 0
    follows = (piece > 0) & np.roll(kept, 1)
    first = np.flatnonzero(kept & ~follows)
    last = np.flatnonzero(kept & ~np.append(follows[1:] & kept[1:], False))
    edge = edge[first]
    runs = _part(rim, edge, piece[first] / count[edge], (piece[last] + 1) / count[edge])
    is_cut = np.stack([piece[first] > 0, piece[last] + 1 < count[edge]], axis=1)
    number = int(rim.corner.max()) + 1 + np.arange(2 * len(edge)).reshape(-1, 2)
    corner = np.where(is_cut, number, runs.corner)
    runs = Outline.of(runs.ends, runs.edge, corner, runs.lit)
    rows = np.flatnonzero(kept)
    room = np.minimum.reduceat(room_m[rows], np.searchsorted(rows, first)) if len(first) else first
    return replace(runs, room_m=room.astype(np.float64)), edge


def _joined(rim: Outline, wavelength_m: float) -> Outline:
    """With the light beside ends where two rims cross between both."""
    _, number, count = np.unique(rim.corner, return_inverse=True, return_counts=True)
    is_loose = count[number.reshape(rim.corner.shape)] == 1
    ends, aside = rim.ends[is_loose], rim.aside.copy()
    if len(ends) < 2:
        return rim
    length = np.linalg.norm(ends, axis=1)
    sight = ends / length[:, None]
    angle, other = (x[:, 1] for x in cKDTree(sight).query(sight, 2))
    is_met = angle < _MEET * _piece_m(ends, wavelength_m) / length
    lit = aside[is_loose]
    between = np.where(is_met[:, None], lit + lit[other], lit)
    aside[is_loose] = between / np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-300)
    return replace(rim, aside=aside)


def _piece_m(place: Array, wavelength_m: float) -> Array:
    size: Array = _PIECE * np.sqrt(wavelength_m * np.linalg.norm(place, axis=1))
    return size


def _beside_m(place: Array) -> Array:
    distance: Array = _BESIDE_M * (1 + 0.1 * np.linalg.norm(place, axis=1))
    return distance
