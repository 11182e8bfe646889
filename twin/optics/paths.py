"""Light paths at a surface: connection to a light, reflection; and the sampling of paths.

Surfaces are Lambertian and two-sided, with one reflectance at each point.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.errors import InputError
from twin.optics.devices import (
    Device,
    apply_blur,
    field_coordinates,
    is_in_field,
    per_distance2,
    point,
    pupil_point,
    relative_intensity,
    vectors,
)
from twin.optics.moving_scene import MovingScene
from twin.optics.scattering import Medium, ScatteredPath
from twin.transfer import vector

Array = NDArray[np.float64]

_OF_EXTENT = 2e-6  # of a scene's largest coordinate: height above a surface of rays that leave it

#: Rays of a render to a tolerance: some minute of one core.
RAYS = 10**8
#: Bounces at most of a path that ends by chance: one for so many rays of a render, and at least.
#: 1e-9 of 1000 paths are longer where 0.98 is reflected.
_RAYS_PER_BOUNCE, _BOUNCES = 50_000, 2000


@dataclass(frozen=True)
class TracingQuality:
    """Knobs of the path tracer, each with the error it bounds.

    samples
        Paths per cell, a square number, stratified: noise of a cell's direct light, which falls as
        samples^-0.75. `twin trade` compares it with the sensor's own noise.
    max_depth
        Bounces: 1 is direct light; each further one adds light of up to the reflectance's next
        power. Light of more bounces is lost.
    indirect_samples
        Paths per cell for the light of further bounces, a square number: its noise falls as
        samples^-0.5, but there is less of it. Default: a quarter of ``samples``.
    air_orders
        Largest order of scattering in the air on the way to a surface, and on the way back. Light
        of higher orders is lost. Of a wall's light, by a random walk: at an optical depth of 1 each
        way less than 0.1 % (asymmetry 0.85) and 0.6 % (0), with 4 orders 0.5 and 5 %; at 3 0.8 %
        (0.85), 16 % (0.5) and 43 % (0), which is a systematic error (`twin.optics.lost_orders`). 0:
        no scattering is traced, and forward scattered light stays in its cell, so that contrast is
        too high by the optical depth.
    rays
        Of a render to a tolerance, in place of the numbers of paths and bounces above: rays to
        surfaces at most, of all paths together. Light is then as exact as they make it.
    """

    samples: int = 64
    max_depth: int = 4
    indirect_samples: int | None = None
    air_orders: int = 12
    rays: int = RAYS

    def __post_init__(self) -> None:
        for name in ("samples", "indirect_samples"):
            value = getattr(self, name)
            if value is not None and (value < 1 or round(value**0.5) ** 2 != value):
                raise InputError(f"{name}: {value} is not a square number")
        if self.max_depth < 1:
            raise InputError(f"max_depth: {self.max_depth} is less than 1")
        if self.air_orders < 0:
            raise InputError(f"air_orders: {self.air_orders} is less than 0")

    @property
    def most_bounces(self) -> int:
        """Of a path that ends by chance."""
        return max(_BOUNCES, self.rays // _RAYS_PER_BOUNCE)

    @property
    def further_samples(self) -> int:
        """Paths per cell for indirect light."""
        if self.indirect_samples is not None:
            return self.indirect_samples
        return max(1, round(self.samples**0.5) // 2) ** 2


@dataclass(frozen=True, eq=False)
class SunLight:
    """Directional light; radiances are per unit irradiance on the plane normal to it.

    ``direction``: unit vector towards it, (3,); or of each instant of the rays, (n, 3).
    """

    direction: Array


@dataclass(frozen=True, eq=False)
class DeviceLight:
    """A device as light: of radiant intensity 1 (``emitter``), or a pupil of area 1 seen by
    reciprocity (``pupil``, which adds the cosine of its flat surface).
    """

    device: Device
    kind: Literal["emitter", "pupil"]


Light = SunLight | DeviceLight


#: Share of a connection's light (None: all), and the field coordinates from which it seems to come.
Place = tuple[Any, Any, Any]


class Connection(NamedTuple):
    """From a surface to a light: direction, shadow ray, irradiance per unit of the light on a
    surface facing it, and length. ``places``: parts by apparent origin; empty for the sun.
    ``detour``: mean length by which the light's way is longer.
    """

    direction: Any
    shadow_ray: Any
    weight: Any
    length: Any
    places: tuple[Place, ...]
    detour: Any = 0.0


class _SunConnector:
    def __init__(self, light: SunLight, clearance: Any) -> None:
        self.clearance = clearance
        self.turns = light.direction.ndim == 2
        if self.turns:
            self.directions = vector(mitsuba(), light.direction, "Vector3f")
        else:
            (self.direction,) = vectors(light.direction[None])

    def __call__(self, hit: Any, rng: Any) -> Connection:
        mi = mitsuba()
        direction = self.direction_at(hit) if self.turns else self.direction
        ray = ray_from(hit, direction, self.clearance)
        return Connection(direction, ray, mi.Float(1), mi.Float(0), ())

    def direction_at(self, hit: Any) -> Any:
        """Towards the sun, at the instant of each hit."""
        return dr.gather(mitsuba().Vector3f, self.directions, mitsuba().UInt32(hit.time))


class _DeviceConnector:
    def __init__(self, light: DeviceLight, medium: Medium | None, clearance: Any) -> None:
        self.device, self.medium, self.clearance = light.device, medium, clearance
        self.is_pupil = light.kind == "pupil"
        self.origin = point(light.device.origin_m)
        self.axes = vectors(light.device.axes)

    def __call__(self, hit: Any, rng: Any) -> Connection:
        origin, shift = self.origin, None
        if self.device.pupil_radius_m:
            shift, defocus = pupil_point(self.device, rng)
            origin = origin + shift.x * self.axes[1] + shift.y * self.axes[2]
        towards = origin - hit.p
        distance2 = dr.squared_norm(towards)
        direction = towards * dr.rsqrt(distance2)
        cos = dr.dot(-direction, self.axes[0])
        left, up = field_coordinates(self.device, -direction)
        if shift is not None:
            left, up = left + shift.x * defocus, up + shift.y * defocus
        weight = per_distance2(self.device, distance2) * relative_intensity(
            self.device, left, up, cos
        )
        if self.is_pupil:
            weight *= cos
        left, up = apply_blur(self.device, left, up, rng)
        distance, ray = dr.sqrt(distance2), ray_to(hit, origin, self.clearance)
        weight = dr.select((cos > 0) & is_in_field(self.device, left, up), weight, 0)
        if self.medium is not None and self.medium.scatters:
            weight *= self.medium.unscattered(distance)
        return Connection(direction, ray, weight, distance, ((None, left, up),))

    def scattered(self, link: Connection, path: ScatteredPath) -> Connection:
        """The same connection by a path that the air scatters, through the same point of the pupil
        and with the same blur.
        """
        device, ((_, seen_left, seen_up),) = self.device, link.places
        straight_left, straight_up = field_coordinates(device, -link.direction)
        left, up = field_coordinates(device, -path.last)
        cos = dr.dot(-path.last, self.axes[0])
        weight = path.weight * per_distance2(device, dr.square(link.length))
        weight *= relative_intensity(device, left, up, cos)
        if self.is_pupil:
            weight *= cos
        left, up = left + (seen_left - straight_left), up + (seen_up - straight_up)
        weight = dr.select((cos > 0) & is_in_field(device, left, up), weight, 0)
        return Connection(path.first, None, weight, link.length, ((None, left, up),), path.detour)


def connector(light: Light, clearance: Any, medium: Medium | None = None) -> Any:
    """Connection of a path's vertices to a light: ``connector(light)(hit, rng)`` is a `Connection`.

    The sun's light is that at the sensor, without the air between. A device's light is scattered on
    the way; absorption is applied by the caller, which knows the length of the whole path.
    """
    if isinstance(light, SunLight):
        return _SunConnector(light, clearance)
    return _DeviceConnector(light, medium, clearance)


def clearance_m(scene: Any) -> float:
    """Height above a surface at which rays leave it, so that they do not meet it again.

    Borders of shadows on surfaces askew are off by about as much. Hits are off their surface by up
    to 5e-7 of the scene's largest coordinate (1 of 6e6 rays on planes of 6 m to 2 km, at all
    angles), of which this is four times as much. Mitsuba's own height, 8.9e-5 (1 + |place|) m,
    holds where it is less.
    """
    if isinstance(scene, MovingScene):
        return _OF_EXTENT * scene.extent_m
    box = np.array([scene.bbox().min, scene.bbox().max], dtype=np.float64)
    return _OF_EXTENT * float(np.abs(box).max()) if np.isfinite(box).all() else math.inf


def ray_from(hit: Any, direction: Any, clearance: Any) -> Any:
    """The ray from a surface along a direction."""
    ray = hit.spawn_ray(direction)
    whole = dr.dot(ray.o - hit.p, hit.n)
    ray.o = hit.p + dr.copysign(dr.minimum(dr.abs(whole), clearance), whole) * hit.n
    return ray


def ray_to(hit: Any, place: Any, clearance: Any) -> Any:
    """The ray from a surface to a place."""
    ray = ray_from(hit, place - hit.p, clearance)
    towards = place - ray.o
    ray.maxt = dr.norm(towards)
    ray.d = towards / ray.maxt
    return ray


def bounce(hit: Any, ray: Any, rng: Any, clearance: Any) -> Any:
    """The reflected ray, drawn from the cosine lobe on the side of the incident ray."""
    mi = mitsuba()
    local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
    local.z = dr.copysign(local.z, -dr.dot(ray.d, hit.n))
    return ray_from(hit, hit.to_world(local), clearance)


def albedo(hit: Any, active: Any = True) -> Any:
    """Reflectance of the surface at a hit."""
    return hit.bsdf().eval_diffuse_reflectance(hit, active)[0]


def random_numbers(n: int, *seed: int, streams: Any = None) -> Any:
    """A generator of ``n`` independent streams, or of those given, (n,)."""
    mi = mitsuba()
    state = dr.opaque(mi.UInt64, int(np.random.SeedSequence(list(seed)).generate_state(1)[0]))
    if streams is not None:
        return mi.PCG32(initstate=state, initseq=streams)
    return mi.PCG32(size=n, initstate=state)
