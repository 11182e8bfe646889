"""Surfaces in one plane echo once.

Shadow rays start a millionth of the distance off a facet (`path.OFF_SURFACE`), beyond any other
that lies closer: both would echo, by 6 dB too much. So what lies that close behind another is
marked as covered. Of two in the very same plane the later one of the scene counts, as a label on a
box does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.geometry import Geometry
from twin.geometry.coplanar import Facets, Shared, shared_by_two, shared_within, stands_before
from twin.geometry.covered import covered
from twin.geometry.near_boxes import near_pairs
from twin.radar.propagation.one_way.path import OFF_SURFACE
from twin.scene import SceneObject
from twin.scene.boxes import boxes_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
#: Faces of a mesh, and the triangle of another, or of the same, that covers each.
Covers = list[tuple[Indices, Array]]

_MISSED = 2 * OFF_SURFACE  # of the distance from the anchor: rays may miss what lies closer
_within: WeakKeyDictionary[Geometry, tuple[float, tuple[Facets, Shared]]] = WeakKeyDictionary()
#: Objects that share no plane with another one, where both stand, to within a distance.
_apart: WeakKeyDictionary[SceneObject, WeakKeyDictionary[SceneObject, float]] = WeakKeyDictionary()
_NO_OBJECTS: WeakKeyDictionary[SceneObject, float] = WeakKeyDictionary()
_made: WeakKeyDictionary[Geometry, tuple[bytes, tuple[Geometry, Indices]]] = WeakKeyDictionary()


def echoing_once(
    items: Sequence[SceneObject], echoes: Sequence[bool], anchor_m: Array, place_m: Array
) -> tuple[list[SceneObject], list[str]]:
    """Objects of which those that echo have what others of them cover marked as covered, and what
    could not be marked. ``place_m`` is the radar's.
    """
    numbers = np.flatnonzero(echoes).tolist()
    some = [items[i] for i in numbers]
    if not some:
        return list(items), []
    boxes = boxes_of(some)
    reach = np.linalg.norm(np.maximum(boxes[:, 1] - anchor_m, anchor_m - boxes[:, 0]), axis=1)
    tolerance_m = tolerances_m(reach)
    covers = [
        own_covers(item.geometry, t, item.pose.inv().apply(place_m))
        for item, t in zip(some, tolerance_m.tolist(), strict=True)
    ]
    by = [{item.name} if own else set() for item, own in zip(some, covers, strict=True)]
    for i, j in near_pairs(boxes)[0].tolist():
        for behind, front, faces, seen_m in _between((i, j), some, boxes, tolerance_m, place_m):
            own = some[behind].pose.inv().apply(seen_m.reshape(-1, 3)).reshape(-1, 3, 3)
            covers[behind].append((faces, own))
            by[behind].add(some[front].name)
    found, remarks = list(items), []
    for number, item, parts, names in zip(numbers, some, covers, by, strict=True):
        if parts:
            try:
                found[number] = replace(item, geometry=divided_at(item.geometry, parts)[0])
            except InputError as error:
                remarks.append(
                    f"{item.name} shares planes with {', '.join(sorted(names))} ({error}): what "
                    "they share echoes twice, by up to 6 dB too much"
                )
    return found, remarks


def tolerances_m(reach_m: Array) -> Array:
    """Distance below which rays may miss another surface, so far from the anchor: a power of two,
    which stays as it is while things move.
    """
    steps: Array = 2.0 ** np.ceil(np.log2(_MISSED * (reach_m + 1e-3)))
    return steps


def own_covers(geometry: Geometry, tolerance_m: float, place_m: Array | None) -> Covers:
    """What of a mesh its own faces cover; ``place_m`` as of `stands_before`, in its frame."""
    held = _within.get(geometry)
    if held is None or held[0] != tolerance_m:
        held = _within[geometry] = tolerance_m, shared_within(geometry, tolerance_m)
    facets, shared = held[1]
    if not len(shared.one):
        return []
    before = stands_before(facets, facets, shared, place_m)
    behind = np.where(before, shared.other, shared.one)
    front = np.where(before, shared.one, shared.other)
    return [(facets.face[behind], facets.corners_m[front])]


def divided_at(geometry: Geometry, covers: Covers) -> tuple[Geometry, Indices]:
    """As `covered`; the same as before where that was asked for last."""
    face, corners_m = (np.concatenate(parts) for parts in zip(*covers, strict=True))
    key = face.tobytes() + np.round(corners_m / geometry.sphere[1], 9).tobytes()
    held = _made.get(geometry)
    if held is None or held[0] != key:
        held = _made[geometry] = key, covered(geometry, face, corners_m)
    return held[1]


def _between(
    pair: tuple[int, int],
    items: Sequence[SceneObject],
    boxes: Array,
    tolerance_m: Array,
    place_m: Array,
) -> Iterator[tuple[int, int, Indices, Array]]:
    """Of a pair of objects the one behind, the one in front, faces of the first, and triangles of
    the second that cover them, (n, 3, 3) in the world.
    """
    i, j = pair
    tolerance = float(max(tolerance_m[i], tolerance_m[j]))
    if _apart.get(items[i], _NO_OBJECTS).get(items[j]) == tolerance:
        return
    one, other = (_facing(items[a], boxes[b], tolerance_m[a]) for a, b in ((i, j), (j, i)))
    shared = shared_by_two(one, other, tolerance)
    if not len(shared.one):
        _apart.setdefault(items[i], WeakKeyDictionary())[items[j]] = tolerance
        return
    before = stands_before(one, other, shared, place_m)
    a, b = shared.one, shared.other
    if not before.all():
        yield i, j, one.face[a[~before]], other.corners_m[b[~before]]
    if before.any():
        yield j, i, other.face[b[before]], one.corners_m[a[before]]


def _facing(item: SceneObject, box: Array, tolerance_m: float) -> Facets:
    """Faces of an object that meet a box."""
    box = box + tolerance_m * np.array([[-1], [1]])
    facets = Facets.inside(item.geometry, item.vertices_m, box)
    return facets.known(item.geometry) if len(facets) else facets
