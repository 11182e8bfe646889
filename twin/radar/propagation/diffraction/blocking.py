"""What stands in the way of a bent path: rays from each of its vertices to the next."""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image, mirrored
from twin.radar.propagation.scene.mesh_scene import Flat
from twin.transfer import aligned, host, vector

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_NEXT_TO = 1e-5  # of a segment, that rays leave out where it ends
#: Instead of the number of an object that blocks a path; and where the path goes past the border of
#: its mirror.
NOTHING, NO_WAY, PAST_MIRROR = -1, -2, -3


def folded(
    prepared: PreparedScene,
    image: Image,
    level: int,
    places: Array,
    stops: Array,
    at_mirror: bool = False,
) -> Array:
    """Vertices (m, n, 3) of paths from points to the radar: mirrors, edges (n, 2, 3), mirrors, the
    radar; NaN where a mirror is not between its neighbours. ``at_mirror``: the edges are those of
    the mirror before their leg, which reflects the paths there.
    """
    patches = [prepared.flats[number] for number in image.patches]
    aims = [stops[:, 1]]
    for flat in patches[level:]:
        aims.append(mirrored(aims[-1], flat))
    chain = [places]
    for flat, aim in zip(patches[level:][::-1], aims[:0:-1], strict=True):
        chain.append(_mirror(chain[-1], aim, flat))
    chain += [stops[:, 1], stops[:, 0]]
    return np.stack([*chain, *_home(prepared, image, level - at_mirror, stops[:, 0])])


def straight_home(prepared: PreparedScene, image: Image, places: Array) -> Array:
    """Vertices (m, n, 3) of paths from points past all mirrors to the radar, as of `folded`."""
    return np.stack([places, *_home(prepared, image, len(image.patches), places)])


def _home(prepared: PreparedScene, image: Image, level: int, begin: Array) -> list[Array]:
    """From points on a leg past the mirrors before it to the radar."""
    chain = [begin]
    for number, aim in zip(image.patches[:level][::-1], image.places[level:0:-1], strict=True):
        chain.append(_mirror(chain[-1], aim, prepared.flats[number]))
    return [*chain[1:], np.broadcast_to(image.places[0], begin.shape)]


def _mirror(begin: Array, aim: Array, flat: Flat) -> Array:
    """Where segments (n, 3) meet a plane, a little before it; NaN where they don't."""
    height, beyond = ((x - flat.point) @ flat.normal for x in (begin, aim))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = height / (height - beyond)
    share = np.where((share > 0) & (share < 1), share, np.nan)[:, None]
    place = begin + share * (aim - begin)
    reflection_point: Array = place + 2 * offset_m(place) * np.sign(height)[:, None] * flat.normal
    return reflection_point


def blocker(prepared: PreparedScene, chain: Array, off: Array) -> Indices:
    """Number of the object that stands first between two vertices that follow each other, (n,)."""
    is_way = np.isfinite(chain).all(axis=(0, 2))
    what, rows = np.where(is_way, NOTHING, NO_WAY), np.flatnonzero(is_way)
    begin, end = chain[:-1, rows], chain[1:, rows]
    begin[0] += off[rows]
    # All ways at once: few rays take the engine as long as many.
    met = first_between(prepared, begin.reshape(-1, 3), end.reshape(-1, 3))
    for of_way in met.reshape(begin.shape[:2])[::-1]:
        what[rows] = np.where(of_way == NOTHING, what[rows], of_way)
    return what


def first_between(prepared: PreparedScene, begin: Array, end: Array) -> Indices:
    """Number of the object that rays from points to others (n, 3) first meet, -1: none."""
    if not len(begin):
        return np.zeros(0, dtype=np.int64)  # the engine aborts the process on none
    mi = prepared.context.mi
    length = np.linalg.norm(end - begin, axis=1, keepdims=True)
    direction = (end - begin) / np.maximum(length, 1e-300)
    reach = (length[:, 0] * (1 - _NEXT_TO)).astype(np.float32)
    ray = mi.Ray3f(vector(mi, begin, "Point3f"), vector(mi, direction, "Vector3f"))
    ray = mi.Ray3f(ray.o, ray.d, mi.Float(aligned(reach)), 0.0, [])
    active = mi.Bool(aligned(reach > 0))
    hit = prepared.world.scene.ray_intersect_preliminary(ray, active=active)
    is_met, face = host([hit.is_valid(), hit.prim_index], len(begin))
    objects = prepared.world.object_of_face.astype(np.int64)
    return np.where(is_met, objects[np.where(is_met, face, 0)], NOTHING)


def distances_to(prepared: PreparedScene, begin: Array, direction: Array) -> Array:
    """From a place along unit vectors (n, 3) to what is first met, in m, (n,); inf: nothing."""
    if not len(direction):
        return np.zeros(0)
    mi = prepared.context.mi
    begin = np.broadcast_to(begin, direction.shape)
    ray = mi.Ray3f(vector(mi, begin, "Point3f"), vector(mi, direction, "Vector3f"))
    hit = prepared.world.scene.ray_intersect_preliminary(ray)
    is_met, distance_m = host([hit.is_valid(), hit.t], len(direction))
    return np.where(is_met, distance_m, np.inf)


def first_hit(prepared: PreparedScene, places: Array, off: Array, source: Array) -> Indices:
    """Number of the object that rays from points (n, 3) to a source first meet, (n,); -1: none."""
    return first_between(prepared, places + off, np.broadcast_to(source, places.shape))
