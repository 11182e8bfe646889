"""Borders of mirrors as openings: where a large flat surface ends and nothing goes on beside it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.blocking import first_between
from twin.radar.propagation.diffraction.open_edges import open_edges
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image, mirrored
from twin.radar.propagation.scene.mesh_scene import Flat, Flats
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_IN_PLANE = 1e-6  # of the distance: by which corners of a flat patch are off its plane
RIGHT = 0.035  # cosine between planes that meet at a right angle
_BESIDE_M = 1e-3  # of an edge, where another surface goes on; and of a plane, what is in it
_ONE_PLANE = 1 - 1e-6  # cosine between planes that are one


def on_plane(flat: Flat, begin: Array, places: Array) -> Array:
    """Where ways from a place (3,) to others (n, 3) meet a plane, (n, 3)."""
    ways = places - begin
    share = (flat.point - begin) @ flat.normal / (ways @ flat.normal)
    return np.asarray(begin + share[:, None] * ways)


def border(
    prepared: PreparedScene, number: int, source: Array, behind: Sequence[int] = ()
) -> Outline:
    """Edges beyond which a patch doesn't go on, as seen from a source, with the patch as opening;
    where other patches show it that stand before it, the last one the nearest.
    """
    flat = prepared.flats[number]
    item = prepared.originals[flat.object]
    points, place = np.unique(item.vertices_m - prepared.anchor_m, axis=0, return_inverse=True)
    faces = place.reshape(-1)[item.geometry.faces]
    off = np.abs((points - flat.point) @ flat.normal)
    tolerance = _IN_PLANE * (1 + np.linalg.norm(points - flat.point, axis=1))
    faces = faces[(off <= tolerance)[faces].all(axis=1)]
    edges = open_edges(points, faces, flat.normal)
    ends, within = edges.ends, edges.within
    for mirror in behind:
        ends, within = (mirrored(places, prepared.flats[mirror]) for places in (ends, within))
    ends, within = ends - source, within - source
    lit = np.cross(ends[:, 0], ends[:, 1])
    lit *= np.sign(np.sum(lit * (within - ends[:, 0]), axis=1, keepdims=True))
    lit /= np.maximum(lengths(lit), 1e-300)[:, None]
    return Outline.of(ends, np.arange(len(ends)), edges.corner, lit)


def between_mirrors(prepared: PreparedScene, image: Image, leg: int, rim: Outline) -> Outline:
    """Edges of a rim seen from where a leg of an image's ways begins: those before the mirror that
    ends it and behind that at which it begins. None are in a mirror's plane: there its own border
    is, or it shows how the obstacle goes on.
    """
    source, flats = image.places[leg], prepared.flats
    middle = rim.ends.mean(axis=1) + source
    is_there = np.ones(len(middle), dtype=bool)
    for patch, side in ((leg - 1, -1), (leg, 1)):
        if 0 <= patch < len(image.patches):
            flat = flats[image.patches[patch]]
            towards = side * np.sign((source - flat.point) @ flat.normal)
            is_there &= towards * ((middle - flat.point) @ flat.normal) > _BESIDE_M
    return rim.take(np.flatnonzero(is_there))


def askew(flats: Flats, number: int) -> Indices:
    """Numbers of objects with mirrors that are neither in the plane of one nor at a right angle."""
    cosine = np.abs(flats.normal @ flats.normal[number])
    return np.unique(flats.object[(cosine > RIGHT) & (cosine < _ONE_PLANE)])


def is_past(prepared: PreparedScene, image: Image, places: Array) -> Flags:
    """Whether the ways from points (n, 3) to an image, which do not meet its only mirror, go past
    it where no other mirror goes on in its plane, (n,).
    """
    (number,) = image.patches
    flats, flat = prepared.flats, prepared.flats[number]
    above, below = ((x - flat.point) @ flat.normal for x in (places, image.place))
    past: Flags = above * below < 0
    is_on = np.abs(flats.normal @ flat.normal) >= _ONE_PLANE
    is_on &= np.abs((flats.point - flat.point) @ flat.normal) < _BESIDE_M
    is_on[number] = False
    if is_on.any() and past.any():
        feet, off = on_plane(flat, image.place, places[past]), _BESIDE_M * flat.normal
        met = first_between(prepared, feet + off, feet - off)
        past[past] = ~np.isin(met, flats.object[is_on])
    return past


def free_border(prepared: PreparedScene, image: Image, level: int) -> Outline:
    """The border of one of an image's mirrors, as the others show it, without edges beside which
    another goes on in its plane, or stands on it at a right angle: there the waves of both cancel.
    """
    flats, number, here = prepared.flats, image.patches[level], image.places[0]
    real = border(prepared, number, here)
    normal = flats.normal[number]
    along = real.ends[:, 1] - real.ends[:, 0]
    outward = np.cross(along, normal)
    outward *= (
        -np.sign(dots(outward, real.lit))[:, None] / np.maximum(lengths(along), 1e-300)[:, None]
    )
    beside = here + real.ends.mean(axis=1) + _BESIDE_M * outward
    is_free = np.ones(len(beside), dtype=bool)
    for other in range(len(flats)):
        cosine = abs(normal @ flats.normal[other])
        if other == number or RIGHT < cosine < _ONE_PLANE:
            continue
        height = (beside - flats.point[other]) @ flats.normal[other]
        up = 0.0 if cosine >= _ONE_PLANE else np.sign((here - flats[number].point) @ normal)
        for row in np.flatnonzero(is_free & (np.abs(height) < 2 * _BESIDE_M)):
            foot = beside[row] - height[row] * flats.normal[other] + up * _BESIDE_M * normal
            is_free[row] = not flats.covers(other, foot)
    shown = border(prepared, number, image.place, image.patches[level + 1 :])
    return shown.take(np.flatnonzero(is_free))
