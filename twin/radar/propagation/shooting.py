"""Physical optics in the scene: rays out to the bodies, currents where they hit, echoes back.

As `twin.radar.scattering.rays` does for one mesh, here for all at their true places: a ray counts
for the body that it first hits, so nothing is counted twice, and what stands in between hides. Out
and back, directly or by an image, are legs (`twin.radar.propagation.legs`). Every ray is a
contribution of its own, with its own delay: right over the whole band.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.grids import Launch
from twin.radar.propagation.legs import (
    LEVEL,
    Leg,
    Station,
    along,
    leg,
    lengthening,
    mirrored_axes,
    offset,
    turning,
)
from twin.radar.propagation.rays import Rays, Ring, and_reversed, ringing
from twin.radar.propagation.walls import Passage, no_passage
from twin.radar.scattering.kernel import coefficients_at, followed, plane, radiating, reflected
from twin.transfer import aligned, host

Array = NDArray[np.float64]

_RAYS_AT_ONCE = 2**18  # some 200 MB while they are under way
_SURELY = 2e-4  # of the distance: float32's error where a facet is not seen edge on


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

    ``nudge`` takes float32 rays off the surface where they begin; ``velocity`` is that of the image
    of the radar that they seem to come from, ``path`` away; ``axis_x`` to ``axis_z`` are the
    world's axes as bounces and mirrors show them.
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
    velocity: Any
    axis_x: Any
    axis_y: Any
    axis_z: Any
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
            front.velocity, front.departure = out_leg.velocity, out_leg.departure
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
            mi.Vector3d(*(dr.gather(mi.Float64, s.levels, LEVEL * last + k + i) for i in range(3)))
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
    axes = mirrored_axes(s, source)
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
        velocity=mi.Vector3d(zero),
        axis_x=axes[0],
        axis_y=axes[1],
        axis_z=axes[2],
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
        """The rays after the bounce."""
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
            velocity=front.velocity - dr.dot(self.normal, front.velocity - self.velocity) * across,
            axis_x=front.axis_x - dr.dot(self.normal, front.axis_x) * across,
            axis_y=front.axis_y - dr.dot(self.normal, front.axis_y) * across,
            axis_z=front.axis_z - dr.dot(self.normal, front.axis_z) * across,
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
    out = hits.velocity - front.velocity, front.direction, front.path
    back = hits.velocity - home.velocity, -home.back, home.length
    there, again = lengthening(*out), lengthening(*back)
    rate, acceleration = there[0] + again[0], there[1] + again[1]
    turns = [
        along(turning(*out), (front.axis_x, front.axis_y, front.axis_z)),
        along(turning(*back), mirrored_axes(s, end)),
    ]
    length = front.path + home.length + front.passage.extra + home.passage.extra
    seen &= (a_re != 0) | (a_im != 0)
    numbers = (a_re, a_im, length, rate, acceleration)
    dr.eval(*numbers, home.departure, *turns, seen, *vars(home.passage).values())
    chosen = dr.compress(seen)
    n = dr.width(chosen)
    if n == 0:
        return Rays.joined([])

    values = [*numbers, front.departure, home.departure, *turns, hits.number, front.source]
    for p in (front.passage, home.passage):
        values += [p.rho_re, p.rho_im, p.lag]
    on_host = host([_taken(value, chosen) for value in values], n)
    re, im, length, rate, acceleration, departure, arrival, *turns = on_host[:9]
    number, source, *rings = on_host[9:]
    one = Rays(
        amplitude=re + 1j * im,
        length_m=length,
        rate_m_per_s=rate,
        acceleration_m_per_s2=acceleration,
        departure=departure,
        arrival=arrival,
        object=number,
        source=source,
        receiver=np.full(n, receiver, dtype=np.uint32),
        departure_per_s=turns[0],
        arrival_per_s=turns[1],
    )
    if s.walls is not None:
        alike = (source == receiver) & (bounce == 0)
        one = ringing(one, Ring.of(*rings[:3]), Ring.of(*rings[3:]), alike)
    return and_reversed(one)
