"""The outline of a body of several parts, seen from a point: the rims of its parts without what of
them lies within another part's outline.

Parts of a body overlap, and one folds in front of itself. A rim within the outline of the whole
diffracts nothing: beside it the body goes on, nearer or farther. Rays decide just beside the rim.
Of several rims one behind the other, as where the rim of a mesh turns back for a face, one counts.
Where one rim passes below another both end, and the light is between them.
"""

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.transfer import host, vector

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_PIECE = 0.02  # of the root of wavelength and distance: pieces of rims that are hidden or not
_MOST_PIECES = 256, 2**15  # of an edge, and of a body
_BESIDE_M = 3e-4  # of a rim, where rays are sure; as much more for every 10 m
#: Of a way, and besides, by which rays go on behind a body that does not count.
_ON, _ON_M = 1e-5, 1e-4
#: How far aside rays look at most, of the same root, and at how many distances.
_WIDEST, _STEPS = 0.1, 4
_MEET = 3.0  # pieces: angle between two ends of rims where one passes below the other
_AROUND = 8  # pieces next to each, that may be on one line of sight with it
_ALIKE = 0.9  # cosine between directions across rims one behind the other


def outermost(
    prepared: PreparedScene, rims: dict[int, Outline], source: Array
) -> dict[int, Outline]:
    """What of the outlines of a body's parts, by object, is on the outline of the whole, seen from
    a source relative to the anchor.
    """
    item = np.repeat(list(rims), [len(rim.ends) for rim in rims.values()])
    if not len(item):
        return rims
    rim = _together(list(rims.values()))
    pieces, edge, piece, count = _pieces(rim, prepared.wavelength_m)
    is_part = np.zeros(len(prepared.originals), dtype=bool)
    is_part[list(rims)] = True
    beside = _beside_m(pieces.ends.mean(axis=1))
    room = _room_m(prepared, is_part, pieces, source)
    kept = room > 0
    rows = np.flatnonzero(kept)
    kept[rows[_is_behind_another(pieces.take(rows), beside[rows])]] = False
    runs, edge = _runs(rim, edge, piece, count, np.where(kept, room, 0.0))
    runs = _joined(runs, prepared.wavelength_m)
    return {part: runs.take(np.flatnonzero(item[edge] == part)) for part in rims}


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


def _meets(prepared: PreparedScene, is_part: Flags, source: Array, towards: Array) -> Flags:
    """Whether rays from a source in directions (n, 3) meet any part, however far."""
    mi, count = prepared.context.mi, len(towards)
    direction = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    objects = prepared.world.object_of_face.astype(np.int64)
    is_met, rows, begin = np.zeros(count, dtype=bool), np.arange(count), np.zeros(count)
    while len(rows):
        at = source + begin[rows, None] * direction[rows]
        ray = mi.Ray3f(vector(mi, at, "Point3f"), vector(mi, direction[rows], "Vector3f"))
        hit = prepared.world.scene.ray_intersect_preliminary(ray)
        is_there, face, distance = host([hit.is_valid(), hit.prim_index, hit.t], len(rows))
        meets_part = is_there & is_part[objects[np.where(is_there, face, 0)]]
        is_met[rows[meets_part]] = True
        begin[rows] += np.where(is_there, distance, 0) * (1 + _ON) + _ON_M
        rows = rows[is_there & ~meets_part]
    return is_met


def _room_m(prepared: PreparedScene, is_part: Flags, pieces: Outline, source: Array) -> Array:
    """How far aside of pieces of rims, (n,), the body does not go on: 0 within its outline."""
    middle = pieces.ends.mean(axis=1)
    nearest = _beside_m(middle)
    widest = _WIDEST / _PIECE * _piece_m(middle, prepared.wavelength_m)
    room, rows = np.zeros(len(middle)), np.arange(len(middle))
    for step in range(_STEPS):
        off = nearest * np.maximum(widest / nearest, 1) ** (step / (_STEPS - 1))
        beside = middle[rows] + off[rows, None] * pieces.lit[rows]
        rows = rows[~_meets(prepared, is_part, source, beside)]
        room[rows] = off[rows]
    room[rows] = np.inf
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
