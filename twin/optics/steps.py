"""Steps of a light path: to the next surface, unscattered or scattered by the air on the way, and
from there to the light.
"""

from typing import Any, NamedTuple

import drjit as dr

from twin.engine import mitsuba
from twin.optics.paths import Connection, Light, albedo, clearance_m, connector, ray_from
from twin.optics.scattering import Medium, ScatteredPath


class Arrival(NamedTuple):
    """First surface that light along a ray reaches: the hit, the last ray, whether there is a
    surface, and the length of the whole path, m.
    """

    hit: Any
    ray: Any
    active: Any
    length: Any


class PathSteps:
    """Steps among the surfaces of a scene, through a medium, to a light.

    Not a dataclass: Dr.Jit would traverse its fields at every loop.
    """

    def __init__(self, scene: Any, light: Light, medium: Medium | None) -> None:
        self.scene, self.medium = scene, medium
        self.scatters = medium is not None and medium.scatters
        self.clearance = dr.opaque(mitsuba().Float, clearance_m(scene))
        self._connect = connector(light, self.clearance, medium)

    def meet(self, ray: Any, coherent: bool, active: Any = True) -> Any:
        """Intersection of a ray with the scene, at a point on the ray itself.

        Mitsuba interpolates the point between the triangle's corners. At grazing incidence on a
        large triangle that point is displaced by the corners' float32 step over the cosine, 8 mm at
        89.9 deg on 200 m. ``coherent``: neighbouring rays are similar, which makes tracing cheaper.
        """
        mi = mitsuba()
        hit = self.scene.ray_intersect(ray, mi.RayFlags.All, mi.Bool(coherent), active)
        hit.p = dr.select(hit.is_valid(), ray(hit.t), hit.p)
        return hit

    def next_surface_straight(self, ray: Any, active: Any, *, first: bool = True) -> Arrival:
        """The next surface along the ray, without scattering by the air."""
        hit = self.meet(ray, first, active)
        active = active & hit.is_valid()
        return Arrival(hit, ray, active, dr.select(active, hit.t, 0))

    def next_surface(self, ray: Any, rng: Any, active: Any, *, first: bool) -> Arrival:
        """The next surface, with random scattering by the air on the way."""
        if self.medium is None or not self.scatters:
            return self.next_surface_straight(ray, active, first=first)
        hit = self.meet(ray, first, active)
        return Arrival(*_random_walk(self, ray, hit, self.medium.free_path(rng), rng, active))

    def next_surface_scattered(self, ray: Any, rng: Any, active: Any) -> tuple[Arrival, Any]:
        """The same for light scattered at least once; and the share of light that is scattered."""
        assert self.medium is not None
        hit = self.meet(ray, True, active)
        straight = dr.select(hit.is_valid(), hit.t, dr.inf)
        t = self.medium.free_path_within(straight, rng)
        share = 1 - self.medium.unscattered(straight)
        return Arrival(*_random_walk(self, ray, hit, t, rng, active)), share

    def light_at(
        self, hit: Any, ray: Any, rng: Any, active: Any, *, coherent: bool
    ) -> tuple[Any, Connection]:
        """Light reflected back along the ray from direct illumination by the light, without
        absorption by the air over the distance; and the connection.
        """
        mi = mitsuba()
        link = self._connect(hit, rng)
        value, lit = self._reflected(hit, ray, link, active)
        lit &= ~self.scene.ray_test(link.shadow_ray, mi.Bool(coherent), lit)
        value = dr.select(lit, value, 0)
        if not self.scatters or not link.places:
            return value, link
        assert self.medium is not None
        path = ScatteredPath(self.medium, link.direction, link.length, rng, active)
        around = self._connect.scattered(link, path)
        more, lit = self._reflected(hit, ray, around, active)
        lit = path.is_clear(self.scene, ray_from(hit, path.first, self.clearance).o, lit)
        return _together(value, link, dr.select(lit, more, 0), around)

    def _reflected(self, hit: Any, ray: Any, link: Connection, active: Any) -> tuple[Any, Any]:
        """Light of a connection that is reflected back along the ray if nothing is in its way; and
        whether there is any.
        """
        cos_out = dr.dot(link.direction, hit.n)
        same_side = cos_out * dr.dot(ray.d, hit.n) < 0
        value = albedo(hit, active) * dr.abs(cos_out) * link.weight / dr.pi
        return value, active & same_side & (value > 0)

    def unabsorbed(self, length: Any) -> Any:
        """Transmission of a path of this length, of absorption alone."""
        return self.medium.unabsorbed(length) if self.medium else 1.0

    def unscattered(self, length: Any) -> Any:
        """Unscattered share over a path of this length; 1 where scattering is not traced."""
        return self.medium.unscattered(length) if self.medium and self.scatters else 1.0


def _together(
    value: Any, link: Connection, more: Any, around: Connection
) -> tuple[Any, Connection]:
    """Unscattered and scattered light of a connection: their sum, and the connection of both."""
    total = value + more
    share = value / dr.select(total > 0, total, 1)
    ((_, left, up),), ((_, to_left, to_up),) = link.places, around.places
    places = ((share, left, up), (1 - share, to_left, to_up))
    return total, link._replace(places=places, detour=(1 - share) * around.detour)


@dr.syntax
def _random_walk(
    steps: PathSteps, ray: Any, hit: Any, t: Any, rng: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """Scatter after ``t`` and again, until a surface is nearer than the next scattering."""
    mi, medium = mitsuba(), steps.medium
    assert medium is not None
    length, order = mi.Float(0), mi.UInt32(0)
    distance = dr.select(hit.is_valid(), hit.t, dr.inf)
    while active & (t < distance) & (order < medium.orders):
        ray = mi.Ray3f(ray(t), medium.turned(ray.d, rng))
        length += t
        order += 1
        hit = steps.meet(ray, False, active)
        distance = dr.select(hit.is_valid(), hit.t, dr.inf)
        t = medium.free_path(rng)
    active &= hit.is_valid() & (t >= distance)
    return hit, ray, active, length + dr.select(active, hit.t, 0)
