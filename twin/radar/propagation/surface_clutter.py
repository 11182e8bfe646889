"""Clutter of rough surfaces: point scatterers fixed to the surface, wherever the radar moves.

Each represents an area A of its face with a cross-section gamma cos(theta) A (the constant-gamma
model: Long, Radar Reflectivity of Land and Sea, 3rd edition, section 2.5) and a random phase. Near
the radar all of them are computed. Farther off each is kept with a probability p and then
represents an area A / p; the random number that decides is its own, so a moving radar receives
echoes of the same points again.

Points ahead of the radar also have paths over its images; points behind it, which a mirror may
show, are left out. Where the forward and the return path differ, cos(theta) is the geometric mean
of both: an assumption.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any
from weakref import WeakKeyDictionary
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from twin.geometry import Geometry
from twin.radar.propagation.one_way.motion import RigidMotions
from twin.radar.propagation.one_way.path import LEVEL, TracingContext, offset_m
from twin.radar.propagation.one_way.points import PointPaths, between, paths_to_points
from twin.radar.rows import lengths
from twin.radar.synthesis import Contributions
from twin.scene import SceneObject

Array = NDArray[np.float64]

_MOST_POINTS = 2**20  # of all surfaces together, 70 MB
_PER_SCATTERER = 16.0  # points to choose from for each that is kept
#: Scatterers of each object at least, of which speckle is made on one far smaller than the ground.
_LEAST = 64
_AT_ONCE = 2**17  # points, 100 MB while they are under way
_BEYOND = 12.0  # offsets of rays: a ray through walls ends up to 8 of them before its end


@dataclass(frozen=True, eq=False)
class SurfaceClutter:
    """A rough surface: the object and its number, gamma, whether it is a closed wall that the radar
    sees through, the images from which paths to it are traced, and the motions of all objects.
    """

    item: SceneObject
    number: int
    gamma: float
    is_slab: bool
    sources: tuple[int, ...]
    motions: RigidMotions


@dataclass(frozen=True, eq=False)
class Field:
    """Points of one object, in its faces' own coordinates, so that they move with it.

    ``face`` (n,), barycentric ``weights`` (n, 3), ``phase`` (n,) in rad, ``chance`` (n,): random
    number in 0 to 1 that decides whether a point is kept; ``area_m2`` that each represents.
    """

    face: NDArray[np.int64]
    weights: Array
    phase: Array
    chance: Array
    area_m2: float


#: The last one made for each name and geometry, with what it was made for.
_fields: WeakKeyDictionary[Geometry, dict[int, tuple[int, int, Field]]] = WeakKeyDictionary()


def field_of(item: SceneObject, count: int, seed: int) -> Field:
    """The points of an object: the same for the same faces, count and seed."""
    name = crc32(item.name.encode())
    held = _fields.setdefault(item.geometry, {})
    if name in held and held[name][:2] == (seed, count):
        return held[name][2]
    held[name] = seed, count, sampled(item, count, seed)
    return held[name][2]


def sampled(item: SceneObject, count: int, seed: int) -> Field:
    """So many points on an object, and random numbers by its name and the seed."""
    rng = np.random.default_rng([seed, crc32(item.name.encode())])
    area = item.geometry.areas_m2
    # Stratified over the faces' areas: no face has more or less than its share.
    at = (np.arange(count) + rng.random(count)) / count
    face = np.minimum(np.searchsorted(np.cumsum(area) / area.sum(), at), len(area) - 1)
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return Field(
        face=face,
        weights=np.stack([1 - u - v, u, v], axis=1),
        phase=rng.uniform(0, 2 * np.pi, count),
        chance=rng.random(count),
        area_m2=float(area.sum()) / count,
    )


def clutter_echoes(
    context: TracingContext,
    anchor_m: Array,
    surfaces: list[SurfaceClutter],
    wanted: int,
    seed: int,
) -> Iterator[Contributions]:
    """Contributions of all rough surfaces ahead of the radar, without gains, part by part.

    Parameters
    ----------
    wanted
        Approximate number of scatterers that are kept, of all surfaces together; more where some of
        them would have fewer than 64.
    seed
        Of places and phases.
    """
    areas = [float(r.item.geometry.areas_m2.sum()) for r in surfaces]
    whole = sum(areas)
    place, boresight = (np.array(vector).ravel() for vector in (context.place, context.boresight))
    points = min(_MOST_POINTS, int(_PER_SCATTERER * wanted))
    for rough, area in zip(surfaces, areas, strict=True):
        if not rough.sources:
            continue
        count = max(int(points * area / whole), int(_PER_SCATTERER * _LEAST))
        field = field_of(rough.item, count, seed)
        seen = _ahead(rough.item, field, anchor_m, place, boresight)
        share = max(wanted * area / whole, _LEAST)
        sample = _kept(field, seen, share)
        for first in range(0, len(sample.index), _AT_ONCE):
            yield from _echoes(context, rough, sample.take(slice(first, first + _AT_ONCE)))


@dataclass(frozen=True, eq=False)
class _Points:
    """Points ahead of the radar: their number in the field, place and normal (n, 3), distance,
    phase, and the area that each stands for.
    """

    index: NDArray[np.intp]
    place: Array
    normal: Array
    distance: Array
    phase: Array
    area: Array

    def take(self, which: Any) -> "_Points":
        """Only some of them, by index or mask."""
        return _Points(*(getattr(self, f.name)[which] for f in fields(_Points)))


def _ahead(
    item: SceneObject, field: Field, anchor: Array, place: Array, boresight: Array
) -> _Points:
    corners = item.vertices_m - anchor
    a, b, c = (corners[item.geometry.faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    unit = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    w, face = field.weights, field.face
    at = w[:, :1] * a[face] + w[:, 1:2] * b[face] + w[:, 2:] * c[face]
    towards = at - place
    index = np.flatnonzero(towards @ boresight > 0)
    return _Points(
        index=index,
        place=at[index],
        normal=unit[face[index]],
        distance=lengths(towards[index]),
        phase=field.phase[index],
        area=np.full(len(index), field.area_m2),
    )


def _kept(field: Field, seen: _Points, share: float) -> _Points:
    """Points that are kept at their distance, each with the area of those that are not."""
    keep = np.minimum(_reach2(seen.distance, share) / seen.distance**2, 1.0)
    weighted = replace(seen, area=seen.area / keep)
    return weighted.take(np.flatnonzero(field.chance[seen.index] < keep))


def _echoes(context: TracingContext, rough: SurfaceClutter, points: _Points) -> list[Contributions]:
    """Echoes from image i to image j >= i, and the same paths reversed."""
    paths = [_paths(context, rough, points, source) for source in rough.sources]
    scale = float(context.wavelength[0]) / (4 * np.pi) ** 1.5
    velocity, acceleration = rough.motions.at(rough.number, points.place)
    contributions = []
    for i, (forward_path, falling) in enumerate(paths):
        for return_path, rising in paths[i:]:
            # Both paths on the same side of the surface; geometric mean of both cosines.
            at = np.flatnonzero(forward_path.clear & return_path.clear & (falling * rising > 0))
            if not len(at):
                continue
            sigma = rough.gamma * np.sqrt(falling[at] * rising[at]) * points.area[at]
            amplitude = scale * np.sqrt(sigma) * np.exp(1j * points.phase[at])
            one, other = forward_path.take(at), return_path.take(at)
            amplitude *= np.sum(one.field * other.field, axis=1)
            number, motion = np.full(len(at), rough.number), (velocity[at], acceleration[at])
            contributions += between(one, other, amplitude, motion, number).and_reversed()
    return contributions


def _paths(
    context: TracingContext, rough: SurfaceClutter, points: _Points, source: int
) -> tuple[PointPaths, Array]:
    """Paths to points from an image, and the cosines of incidence, negative from behind."""
    towards = np.array(context.positions).reshape(-1, 3)[source] - points.place
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    cosine = np.sum(towards * points.normal, axis=1)
    step = offset_m(points.place)
    if order := int(np.array(context.orders)[source]):
        mirror = np.array(context.levels).reshape(context.n_sources, context.order, LEVEL)[
            source, order - 1
        ]
        height = np.abs((points.place - mirror[3:6]) @ mirror[6:9])
        cosine[height < 2 * _BEYOND * step[:, 0]] = (
            0  # points of the mirror itself have no path over it
        )
    off = 2 * step * points.normal * np.sign(cosine)[:, None]
    # The path to the far face of a slab ends a little beyond it, so that it crosses the slab.
    at = points.place - (_BEYOND * step * towards if rough.is_slab else 0)
    return paths_to_points(context, source, at, off), cosine


def _reach2(distance: Array, share: float) -> float:
    """Square of the distance up to which all points are kept, if about ``share`` are kept in
    all.
    """
    if len(distance) <= share:
        return np.inf
    # Solves sum min(x / d^2, 1) = share for x: with d^2 sorted, the nearest points count 1 each.
    square = np.sort(distance**2)
    rest = np.cumsum((1 / square)[::-1])[::-1]
    full = np.arange(len(square))
    total = full + square * rest
    k = int(np.searchsorted(total, share))
    k = min(k, len(square) - 1)
    return float((share - k) / rest[k]) if share > k else float(square[k])


def coherent(sigma_h_m: float, cosine: Array, wavelength_m: float) -> Array:
    """Coherent reflection of a rough surface, over that of a smooth one: exp(-2 (k s cos theta)^2),
    s the rms height.


    Ament, Proc. IRE 41, 1953.
    """
    k = 2 * np.pi / wavelength_m
    left: Array = np.exp(-2 * (k * sigma_h_m * np.asarray(cosine)) ** 2)
    return left
