"""Rough surfaces: scatterers that belong to the surface, whatever the radar does.

Each stands for an area A of its face and answers with gamma cos(theta) A (the constant-gamma model:
Long, Radar Reflectivity of Land and Sea, 3rd edition, section 2.5), at a random phase of its own.
They are many; near the radar all count, farther off each is kept by a number of its own with a
probability p, and stands for A / p: so a moving radar hears the same points again.
"""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.legs import OFF_SURFACE
from twin.radar.propagation.rays import Rays
from twin.radar.propagation.world import Mesher
from twin.scene import SceneObject

Array = NDArray[np.float64]

_MOST_POINTS = 2**20  # of all surfaces together, 70 MB
_PER_SCATTERER = 16.0  # points to choose from for each that is kept
_KEPT = 4
_known: "OrderedDict[tuple[int, int, int, int], Field]" = OrderedDict()


@dataclass(frozen=True, eq=False)
class Rough:
    """A rough surface: the object with its number in the world, and gamma."""

    item: SceneObject
    number: int
    gamma: float


@dataclass(frozen=True, eq=False)
class Field:
    """Points of one object, in its faces' own coordinates, so that they move with it.

    ``face`` (n,), ``weights`` (n, 3) of its corners, ``phase`` (n,) in rad, ``chance`` (n,) in 0 to
    1; ``area_m2`` that each stands for.
    """

    faces: NDArray[np.integer]
    face: NDArray[np.int64]
    weights: Array
    phase: Array
    chance: Array
    area_m2: float


def field_of(item: SceneObject, count: int, seed: int) -> Field:
    """The points of an object: the same for the same faces, count and seed."""
    key = (id(item.faces), count, seed, crc32(item.name.encode()))
    held = _known.get(key)
    if held is not None and held.faces is item.faces:
        _known.move_to_end(key)
        return held
    rng = np.random.default_rng([seed, key[3]])
    area = _areas(item)
    # Stratified over the faces' areas: no face has more or less than its share.
    at = (np.arange(count) + rng.random(count)) / count
    face = np.minimum(np.searchsorted(np.cumsum(area) / area.sum(), at), len(area) - 1)
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    found = Field(
        faces=item.faces,
        face=face,
        weights=np.stack([1 - u - v, u, v], axis=1),
        phase=rng.uniform(0, 2 * np.pi, count),
        chance=rng.random(count),
        area_m2=float(area.sum()) / count,
    )
    _known[key] = found
    if len(_known) > _KEPT:
        _known.popitem(last=False)
    return found


def _areas(item: SceneObject) -> Array:
    a, b, c = (item.vertices_m[item.faces[:, i]] for i in range(3))
    areas: Array = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


def rough_echoes(
    mi: Any,
    world: Mesher,
    surfaces: list[Rough],
    place: Array,
    boresight: Array,
    wavelength_m: float,
    wanted: int,
    seed: int,
) -> Rays:
    """Contributions of all rough surfaces, without gains.

    Parameters
    ----------
    place, boresight
        The radar, relative to the world's anchor; what lies behind it is silent.
    wanted
        Scatterers that are kept, about, all surfaces together.
    seed
        Of places and phases.
    """
    areas = [float(_areas(r.item).sum()) for r in surfaces]
    parts = []
    points = min(_MOST_POINTS, int(_PER_SCATTERER * wanted))
    for rough, area in zip(surfaces, areas, strict=True):
        count = max(int(points * area / sum(areas)), 1)
        field = field_of(rough.item, count, seed)
        here = _sampled(rough.item, field, world.anchor_m, place, boresight)
        share = max(wanted * area / sum(areas), 1.0)
        parts.append(_kept(mi, world, rough, field, here, place, wavelength_m, share))
    return Rays.joined(parts)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points ahead of the radar: which, where, how far, cosine of incidence, facing normal."""

    index: NDArray[np.intp]
    place: Array
    distance: Array
    direction: Array
    cosine: Array
    normal: Array


def _sampled(
    item: SceneObject, field: Field, anchor: Array, place: Array, boresight: Array
) -> _Seen:
    corners = item.vertices_m - anchor
    a, b, c = (corners[item.faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    unit = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    w, face = field.weights, field.face
    at = w[:, :1] * a[face] + w[:, 1:2] * b[face] + w[:, 2:] * c[face]
    way = at - place
    ahead = np.flatnonzero(way @ boresight > 0)
    at, way, normal = at[ahead], way[ahead], unit[face[ahead]]
    distance = np.linalg.norm(way, axis=1)
    direction = way / distance[:, None]
    slope = np.sum(direction * normal, axis=1)
    facing = normal * -np.sign(slope)[:, None]
    return _Seen(ahead, at, distance, direction, np.abs(slope), facing)


def _kept(
    mi: Any,
    world: Mesher,
    rough: Rough,
    field: Field,
    seen: _Seen,
    place: Array,
    wavelength_m: float,
    share: float,
) -> Rays:
    """Those that are kept at their distance and that nothing hides."""
    if not len(seen.index):
        return Rays.joined([])
    reach2 = _reach2(seen.distance, share)
    keep = np.minimum(reach2 / seen.distance**2, 1.0)
    chosen = np.flatnonzero(field.chance[seen.index] < keep)
    off = seen.normal[chosen] * OFF_SURFACE * 2
    at = seen.place[chosen]
    start = at + off * (np.linalg.norm(at, axis=1, keepdims=True) + 1e-3)
    way = (place - start).T.astype(np.float32)
    length = np.linalg.norm(way, axis=0)
    ray = mi.Ray3f(
        mi.Point3f(start.T.astype(np.float32)),
        mi.Vector3f(way / length),
        mi.Float(length * (1 - 1e-5)),
        0.0,
        [],
    )
    chosen = chosen[~np.array(world.scene.ray_test(ray))]
    distance, direction = seen.distance[chosen], seen.direction[chosen]
    sigma = rough.gamma * seen.cosine[chosen] * field.area_m2 / keep[chosen]
    amplitude = np.sqrt(sigma) * wavelength_m / ((4 * np.pi) ** 1.5 * distance**2)
    velocity = np.asarray(rough.item.velocity_m_per_s)
    n = len(chosen)
    zero = np.zeros(n, dtype=np.uint32)
    return Rays(
        amplitude=amplitude * np.exp(1j * field.phase[seen.index[chosen]]),
        length_m=2 * distance,
        rate_m_per_s=2 * direction @ velocity,
        departure=direction,
        arrival=direction,
        object=np.full(n, rough.number, dtype=np.uint32),
        source=zero,
        receiver=zero,
    )


def _reach2(distance: Array, share: float) -> float:
    """Square of the distance up to which all are kept, so that about ``share`` are in all."""
    if len(distance) <= share:
        return np.inf
    # sum min(x / d^2, 1) = share: with the d^2 in order, the first that fit count 1 each.
    square = np.sort(distance**2)
    rest = np.cumsum((1 / square)[::-1])[::-1]
    full = np.arange(len(square))
    total = full + square * rest
    k = int(np.searchsorted(total, share))
    k = min(k, len(square) - 1)
    return float((share - k) / rest[k]) if share > k else float(square[k])


def coherent(sigma_h_m: float, cosine: Array, wavelength_m: float) -> Array:
    """What roughness leaves of a mirror image's amplitude: exp(-2 (k sigma_h cos theta)^2).

    Ament, Proc. IRE 41, 1953.
    """
    k = 2 * np.pi / wavelength_m
    left: Array = np.exp(-2 * (k * sigma_h_m * np.asarray(cosine)) ** 2)
    return left
