"""Physical optics in the scene: rays out to the bodies, currents where they hit, echoes back.

As `twin.radar.scattering.rays` does for one mesh, here for all at their true places: a ray counts
for the body that it first hits, so nothing is counted twice, and what stands in between hides. Out
and back, directly or by an image, are legs (`twin.radar.propagation.legs`). Every ray is a
contribution of its own, with its own delay: right over the whole band.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.grids import Launch
from twin.radar.propagation.legs import Leg, Station, leg, offset
from twin.radar.propagation.walls import Passage, no_passage
from twin.radar.scattering.kernel import coefficients_at, followed, plane, radiating, reflected
from twin.transfer import aligned, rows

Array = NDArray[np.float64]

_RAYS_AT_ONCE = 2**18  # some 200 MB while they are under way
_MOST_TRIPS = 8  # within a wall
_FAINTEST = 3e-3  # of the first: 0.03 dB
_SURELY = 2e-4  # of the distance: float32's error where a facet is not seen edge on


@dataclass(frozen=True, eq=False)
class Rays:
    """Contributions of rays, each (n,), in order: amplitude without the antenna's gain, path length
    and its rate in m and m/s; departure and arrival (n, 3) as seen from the radar, in the
    world's axes; object that is hit last, and the images by which the wave goes out and back.
    """

    amplitude: NDArray[np.complex128]
    length_m: Array
    rate_m_per_s: Array
    departure: Array
    arrival: Array
    object: NDArray[np.uint32]
    source: NDArray[np.uint32]
    receiver: NDArray[np.uint32]

    def chosen(self, which: Any) -> "Rays":
        """Only some of them, by index or mask."""
        return Rays(*(getattr(self, f.name)[which] for f in fields(Rays)))

    @staticmethod
    def joined(parts: Sequence["Rays"]) -> "Rays":
        """One after the other."""
        return Rays(
            amplitude=np.concatenate([np.zeros(0, complex), *(p.amplitude for p in parts)]),
            length_m=np.concatenate([np.zeros(0), *(p.length_m for p in parts)]),
            rate_m_per_s=np.concatenate([np.zeros(0), *(p.rate_m_per_s for p in parts)]),
            departure=np.concatenate([np.zeros((0, 3)), *(p.departure for p in parts)]),
            arrival=np.concatenate([np.zeros((0, 3)), *(p.arrival for p in parts)]),
            **{
                name: np.concatenate(
                    [np.zeros(0, dtype=np.uint32), *(getattr(p, name) for p in parts)]
                )
                for name in ("object", "source", "receiver")
            },
        )


@dataclass(frozen=True, eq=False)
class Bodies:
    """Per object, on the device: its body (or -1 where it does not scatter), surface, velocity."""

    body: Any
    surface: Any
    velocity: Any


def bodies(mi: Any, body: NDArray[np.int32], surface: Any, velocity: Array) -> Bodies:
    """Put on the device."""
    return Bodies(
        mi.Int32(body), mi.UInt32(surface), mi.Float64(velocity.ravel() if velocity.size else [0])
    )


def shoot(
    at_station: Station, scatterers: Bodies, launched: Launch, wavelength_m: float, bounces: int
) -> Rays:
    """Every contribution of every grid.

    From image i to image j counts once with i before j; the way back is the same one reversed, and
    is added with departure and arrival exchanged.
    """
    found = []
    grid = np.repeat(np.arange(len(launched.rays), dtype=np.uint32), launched.rays)
    index = np.arange(len(grid)) - np.repeat(
        np.cumsum(launched.rays) - launched.rays, launched.rays
    )
    for first in range(0, len(grid), _RAYS_AT_ONCE):
        part = slice(first, first + _RAYS_AT_ONCE)
        found += _follow(
            at_station, scatterers, launched, grid[part], index[part], wavelength_m, bounces
        )
    return Rays.joined(found)


@dataclass(eq=False)
class _Front:
    """Rays between two bounces: where, whither, how far from the image, how wide, with what field.

    ``nudge`` takes float32 rays off the surface where they begin; ``rate`` is that of the way so
    far, without what the next direction adds.
    """

    origin: Any
    nudge: Any
    direction: Any
    path: Any
    weight: Any
    tube_a: Any
    tube_b: Any
    field: Any
    field_im: Any
    rate: Any
    departure: Any
    source: Any
    passage: Passage

    def everything(self) -> list[Any]:
        return [*self._own().values(), *vars(self.passage).values()]

    def chosen(self, kept: Any) -> "_Front":
        """Only some of the rays."""
        own = {name: _taken(value, kept) for name, value in self._own().items()}
        passage = {name: _taken(value, kept) for name, value in vars(self.passage).items()}
        return _Front(**own, passage=Passage(**passage))

    def _own(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "passage"}


def _follow(
    s: Station,
    scatterers: Bodies,
    launched: Launch,
    grid: NDArray[np.uint32],
    index: NDArray[np.int64],
    wavelength_m: float,
    bounces: int,
) -> list[Rays]:
    mi = s.mi
    wavelength = dr.opaque(mi.Float64, wavelength_m)
    row, at = mi.UInt32(aligned(grid)), mi.UInt32(aligned(index.astype(np.uint32)))
    front, body = _launched(s, launched, row, at)
    active = mi.Bool(True) & (front.weight > 0)
    found = []
    for bounce in range(bounces):
        ray = mi.Ray3f(mi.Point3f(front.origin + front.nudge), mi.Vector3f(front.direction))
        hit = s.world.scene.ray_intersect_preliminary(ray, active=active)
        active &= hit.is_valid()
        face, coarse = hit.prim_index, mi.Float64(hit.t)
        number = dr.gather(mi.UInt32, s.world.object_index, face, active)
        met = dr.gather(mi.Int32, scatterers.body, number, active)
        active &= (met == body) if bounce == 0 else (met >= 0)
        hit_place, normal, cosine = _measured(s, front, face, coarse, active)
        front.path += dr.norm(hit_place - front.origin)
        front.origin = hit_place
        if bounce == 0:
            out_leg = leg(
                s, front.source, hit_place, normal * offset(hit_place), active, traced=True
            )
            active &= out_leg.clear
            front.path = out_leg.length
            front.field, front.field_im = out_leg.field, out_leg.field_im
            front.rate, front.departure = out_leg.rate, out_leg.departure
            front.passage = out_leg.passage
        elif s.walls is not None:  # between bodies no wall lets through
            ray.maxt = hit.t
            active &= ~s.walls.mesh.scene.ray_test(ray, active=active)
        velocity = [
            dr.gather(mi.Float64, scatterers.velocity, 3 * number + i, active) for i in range(3)
        ]
        hits = _Hits(front, normal, cosine, number, mi.Vector3d(*velocity))
        surface = dr.gather(mi.UInt32, scatterers.surface, number, active)
        hits.reflect(s, surface, active)
        dr.eval(*front.everything(), *hits.everything(), active)
        kept = dr.compress(active)
        if dr.width(kept) == 0:
            break
        front, hits = hits.chosen(front, kept)
        for receiver in range(s.n_sources):
            found.append(_received(s, front, hits, receiver, wavelength, bounce))
        front = hits.onwards(front)
        active = mi.Bool(True) & (
            dr.squared_norm(front.field) + dr.squared_norm(front.field_im) > 1e-12
        )
        body = None
    return found


def _launched(s: Station, launched: Launch, row: Any, index: Any) -> tuple[_Front, Any]:
    mi = s.mi
    numbers = mi.Float64(launched.numbers.ravel())
    center, forward, first, second = (
        mi.Vector3d(*(dr.gather(mi.Float64, numbers, 16 * row + 3 * k + i) for i in range(3)))
        for k in range(4)
    )
    spacing, left, bottom, columns = (
        dr.gather(mi.Float64, numbers, 16 * row + 12 + i) for i in range(4)
    )
    # In floats: an integer division by the 0 of an idle lane would be a fault.
    count = mi.Float64(index)
    line = dr.floor((count + 0.5) / columns)
    column = count - line * columns
    source = dr.gather(mi.UInt32, mi.UInt32(launched.source), row)
    body = dr.gather(mi.Int32, mi.Int32(launched.body.astype(np.int32)), row)
    image = mi.Vector3d(*(dr.gather(mi.Float64, s.positions, 3 * source + i) for i in range(3)))
    x = center + (column + left) * spacing * first + (line + bottom) * spacing * second
    ray = x - image
    distance = dr.norm(ray)
    direction = ray / distance
    weight = dr.square(spacing / distance) * dr.dot(direction, forward)
    # From an image the ray begins where it leaves the last mirror.
    origin, nudge = image, dr.zeros(mi.Vector3d, dr.width(row))
    if s.order:
        order = dr.gather(mi.UInt32, s.orders, source)
        last = source * s.order + dr.maximum(order, 1) - 1
        point, normal = (
            mi.Vector3d(*(dr.gather(mi.Float64, s.levels, 12 * last + k + i) for i in range(3)))
            for k in (3, 6)
        )
        slope = dr.dot(normal, direction)
        t = dr.dot(normal, point - image) / dr.select(slope != 0, slope, 1.0)
        mirror = image + t * direction
        facing = normal * dr.select(slope < 0, -1.0, 1.0)
        origin = dr.select(order > 0, mirror, image)
        nudge = dr.select(order > 0, facing * offset(mirror), 0)
        weight = dr.select((order > 0) & (t <= 0), 0.0, weight)
    zero = dr.zeros(mi.Vector3d, dr.width(row))
    none = dr.zeros(mi.Float64, dr.width(row))
    front = _Front(
        origin=origin,
        nudge=nudge,
        direction=direction,
        path=dr.norm(origin - image),
        weight=weight,
        tube_a=first * (spacing / distance),
        tube_b=second * (spacing / distance),
        field=mi.Vector3d(zero),
        field_im=mi.Vector3d(zero),
        rate=none,
        departure=mi.Vector3d(zero),
        source=source,
        passage=no_passage(mi),
    )
    return front, body


def _measured(s: Station, front: _Front, face: Any, coarse: Any, active: Any) -> Any:
    """Where the ray meets the facet's plane, the normal against the ray, the cosine."""
    normal, distance = plane(s.mi, s.world, face, front.origin, front.direction, active)
    # On a facet seen edge on the plane says nothing about the distance.
    near = dr.abs(distance - coarse) < _SURELY * coarse + 2 * offset(front.origin)
    distance = dr.select(near, distance, coarse)
    cosine = -dr.dot(normal, front.direction)
    return front.origin + distance * front.direction, normal, cosine


@dataclass(eq=False)
class _Hits:
    """Rays where they hit: ``away`` they go on, with the reflected field ``out``."""

    front: _Front
    normal: Any
    cosine: Any
    number: Any
    velocity: Any
    away: Any = None
    out: Any = None
    out_im: Any = None

    def reflect(self, s: Station, surface: Any, active: Any) -> None:
        """Fill in direction and field after the bounce."""
        f = self.front
        row = coefficients_at(s.mi, s.table, surface, self.cosine, active)
        self.away = f.direction + 2 * self.cosine * self.normal
        self.out, self.out_im = reflected(f.field, f.field_im, f.direction, self.normal, row)

    def everything(self) -> list[Any]:
        names = ("normal", "cosine", "number", "velocity", "away", "out", "out_im")
        return [getattr(self, name) for name in names]

    def chosen(self, front: _Front, kept: Any) -> "tuple[_Front, _Hits]":
        """Only some of the rays."""
        front = front.chosen(kept)
        return front, _Hits(front, *(_taken(value, kept) for value in self.everything()))

    def onwards(self, front: _Front) -> _Front:
        """The rays after the bounce; their rate still lacks what the new direction adds."""
        across = 2 * self.normal
        return _Front(
            origin=front.origin,
            nudge=self.normal * offset(front.origin),
            direction=self.away,
            path=front.path,
            weight=front.weight,
            tube_a=front.tube_a - dr.dot(self.normal, front.tube_a) * across,
            tube_b=front.tube_b - dr.dot(self.normal, front.tube_b) * across,
            field=self.out,
            field_im=self.out_im,
            rate=front.rate + dr.dot(self.velocity, front.direction - self.away),
            departure=front.departure,
            source=front.source,
            passage=front.passage,
        )


def _taken(value: Any, kept: Any) -> Any:
    return value if dr.width(value) == 1 else dr.gather(type(value), value, kept)


def _received(
    s: Station, front: _Front, hits: _Hits, receiver: int, wavelength: Any, bounce: int
) -> Rays:
    """What comes back to one image of the radar from where rays hit."""
    mi = s.mi
    end = dr.opaque(mi.UInt32, receiver)
    useful = front.source <= end
    home: Leg = leg(s, end, front.origin, hits.normal * offset(front.origin), useful)
    same = (front.source == end) if bounce == 0 else mi.Bool(False)
    seen = useful & (home.clear | same)
    step = (front.direction - home.back) * front.path
    kept = followed(front.tube_a, step, front.direction, hits.normal, hits.cosine, wavelength)
    kept *= followed(front.tube_b, step, front.direction, hits.normal, hits.cosine, wavelength)
    scale = front.weight * front.path / home.length / dr.maximum(hits.cosine, 1e-9) * kept
    way = (front.direction, hits.away, hits.normal, home.back)
    current = radiating(front.field, hits.out, *way)
    current_im = radiating(front.field_im, hits.out_im, *way)
    re = dr.dot(home.field, current) - dr.dot(home.field_im, current_im)
    im = dr.dot(home.field, current_im) + dr.dot(home.field_im, current)
    # a = -j / (8 pi) times the sum.
    scale /= 8 * dr.pi
    a_re, a_im = scale * im, -scale * re
    rate = front.rate + home.rate + dr.dot(hits.velocity, front.direction - home.back)
    length = front.path + home.length + front.passage.extra + home.passage.extra
    seen &= (a_re != 0) | (a_im != 0)
    dr.eval(a_re, a_im, length, rate, home.departure, seen, *vars(home.passage).values())
    chosen = dr.compress(seen)
    n = dr.width(chosen)
    if n == 0:
        return Rays.joined([])

    def host(value: Any) -> Any:
        taken = _taken(value, chosen)
        return np.array(taken) if dr.depth_v(taken) == 1 else rows(taken)

    one = _once(s, front, hits, home, host, (a_re, a_im, length, rate), receiver, n)
    if s.walls is not None:
        one = ringing(one, *_rings(front.passage, home.passage, host, n))
    return _and_reversed(one, receiver)


def _once(
    s: Station,
    front: _Front,
    hits: _Hits,
    home: Leg,
    host: Callable[[Any], Any],
    values: tuple[Any, ...],
    receiver: int,
    n: int,
) -> Rays:
    a_re, a_im, length, rate = values
    return Rays(
        amplitude=host(a_re) + 1j * host(a_im),
        length_m=host(length),
        rate_m_per_s=host(rate),
        departure=host(front.departure),
        arrival=host(home.departure),
        object=host(hits.number),
        source=host(front.source),
        receiver=np.full(n, receiver, dtype=np.uint32),
    )


def _rings(
    out: Passage, home: Passage, host: Callable[[Any], Any], n: int
) -> tuple[NDArray[np.complex128], Array, NDArray[np.int64]]:
    """Internal echo over the one before, its lag, and how many legs have one, (n,)."""
    parts = [(p.rho_re, p.rho_im, p.lag) for p in (out, home)]
    re, im, lag = (
        np.array([np.broadcast_to(host(part[i]), n) for part in parts]) for i in range(3)
    )
    legs = np.count_nonzero(lag > 0, axis=0)
    share = np.maximum(legs, 1)
    return (re + 1j * im).sum(axis=0) / share, lag.sum(axis=0) / share, legs


def ringing(rays: Rays, rho: NDArray[np.complex128], lag_m: Array, legs: NDArray[np.int64]) -> Rays:
    """Rays with the echoes that run to and fro within walls, each one a contribution of its own.

    Over ``legs`` legs that ring alike, p round trips in all come C(legs + p - 1, p) times.
    """
    found = [rays]
    strongest = float(np.abs(rho).max(initial=0.0))
    for trips in range(1, _MOST_TRIPS + 1):
        if (trips + 1) * strongest**trips < _FAINTEST:
            break
        chosen = np.flatnonzero(legs > 0)
        times = np.where(legs[chosen] == 2, trips + 1, 1)
        some = rays.chosen(chosen)
        found.append(
            replace(
                some,
                amplitude=some.amplitude * times * rho[chosen] ** trips,
                length_m=some.length_m + trips * lag_m[chosen],
            )
        )
    return Rays.joined(found)


def _and_reversed(one: Rays, receiver: int) -> Rays:
    """The same ways walked the other way round, too, unless they end where they began."""
    back = one.source != receiver
    if not back.any():
        return one
    some = one.chosen(back)
    reverse = replace(
        some,
        departure=some.arrival,
        arrival=some.departure,
        source=some.receiver,
        receiver=some.source,
    )
    return Rays.joined([one, reverse])
