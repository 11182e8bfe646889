"""The steps of a light path: on to the next surface, straight or scattered by the air on the way;
and from there to the light.
"""

from typing import Any, NamedTuple

import drjit as dr

from twin.engine import mitsuba
from twin.optics.paths import Connection, Light, albedo, connector
from twin.optics.scattering import Medium


class Arrival(NamedTuple):
    """Where light that started along a ray meets a surface: the hit, the last ray, whether there is
    one, and the length of the whole way, m.
    """

    hit: Any
    ray: Any
    active: Any
    length: Any


class PathSteps:
    """Steps among the surfaces of a scene, through a medium, to a light.

    No dataclass: Dr.Jit would take one apart at every loop.
    """

    def __init__(self, scene: Any, light: Light, medium: Medium | None) -> None:
        self.scene, self.medium = scene, medium
        self.scatters = medium is not None and medium.scatters
        self._connect = connector(light, medium)

    def meet(self, ray: Any, coherent: bool, active: Any = True) -> Any:
        """The surface that a ray meets, at a point of the ray itself.

        Mitsuba puts the point between the triangle's corners; at grazing incidence on a large
        triangle that is off sideways by the corners' float32 step over the cosine, 8 mm at 89.9 deg
        on 200 m. ``coherent`` says that neighbouring rays are alike: tracing them is cheaper.
        """
        mi = mitsuba()
        hit = self.scene.ray_intersect(ray, mi.RayFlags.All, mi.Bool(coherent), active)
        hit.p = dr.select(hit.is_valid(), ray(hit.t), hit.p)
        return hit

    def next_surface_straight(self, ray: Any, active: Any, *, first: bool = True) -> Arrival:
        """On along the ray, whatever the air."""
        hit = self.meet(ray, first, active)
        active = active & hit.is_valid()
        return Arrival(hit, ray, active, dr.select(active, hit.t, 0))

    def next_surface(self, ray: Any, rng: Any, active: Any, *, first: bool) -> Arrival:
        """On to the next surface; the air scatters the light as often as it happens to."""
        if self.medium is None or not self.scatters:
            return self.next_surface_straight(ray, active, first=first)
        hit = self.meet(ray, first, active)
        return Arrival(*_random_walk(self, ray, hit, self.medium.free_path(rng), rng, active))

    def next_surface_scattered(self, ray: Any, rng: Any, active: Any) -> tuple[Arrival, Any]:
        """The same for light that is scattered at all; and the share of light that is."""
        assert self.medium is not None
        hit = self.meet(ray, True, active)
        straight = dr.select(hit.is_valid(), hit.t, dr.inf)
        t = self.medium.free_path_within(straight, rng)
        share = 1 - self.medium.unscattered(straight)
        return Arrival(*_random_walk(self, ray, hit, t, rng, active)), share

    def light_at(
        self, hit: Any, ray: Any, rng: Any, active: Any, *, coherent: bool
    ) -> tuple[Any, Connection]:
        """What a surface has straight from the light and sends back along the ray, before anything
        that the air absorbs is taken off; and the connection.
        """
        mi = mitsuba()
        link = self._connect(hit, rng)
        cos_out = dr.dot(link.direction, hit.n)
        same_side = cos_out * dr.dot(ray.d, hit.n) < 0
        value = albedo(hit, active) * dr.abs(cos_out) * link.weight / dr.pi
        lit = active & same_side & (value > 0)
        lit &= ~self.scene.ray_test(link.shadow_ray, mi.Bool(coherent), lit)
        return dr.select(lit, value, 0), link

    def unabsorbed(self, length: Any) -> Any:
        """What absorption leaves of the light on a way of this length."""
        return self.medium.unabsorbed(length) if self.medium else 1.0

    def unscattered(self, length: Any) -> Any:
        """Share that is not scattered on a way of this length, where scatterings are followed."""
        return self.medium.unscattered(length) if self.medium and self.scatters else 1.0


@dr.syntax
def _random_walk(
    steps: PathSteps, ray: Any, hit: Any, t: Any, rng: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """Scatter after ``t``, and on until a surface is nearer than the next scattering."""
    mi, medium = mitsuba(), steps.medium
    assert medium is not None
    length, order = mi.Float(0), mi.UInt32(0)
    distance = dr.select(hit.is_valid(), hit.t, dr.inf)
    while active & (t < distance) & (order < medium.orders):
        cosine, angle = medium.cosine(rng), 2 * dr.pi * rng.next_float32()
        sine = dr.safe_sqrt(1 - cosine * cosine)
        sin_angle, cos_angle = dr.sincos(angle)
        local = mi.Vector3f(sine * cos_angle, sine * sin_angle, cosine)
        ray = mi.Ray3f(ray(t), mi.Frame3f(ray.d).to_world(local))
        length += t
        order += 1
        hit = steps.meet(ray, False, active)
        distance = dr.select(hit.is_valid(), hit.t, dr.inf)
        t = medium.free_path(rng)
    active &= hit.is_valid() & (t >= distance)
    return hit, ray, active, length + dr.select(active, hit.t, 0)
