"""From where light starts to the next surface: straight on, or scattered by the air on its way."""

from typing import Any

import drjit as dr

from twin.engine import mitsuba
from twin.optics.scattering import Medium


def meet(scene: Any, ray: Any, coherent: bool, active: Any = True) -> Any:
    """The surface that a ray meets, at a point of the ray itself.

    Mitsuba puts the point between the triangle's corners; at grazing incidence on a large triangle
    that is off sideways by the corners' float32 step over the cosine, 8 mm at 89.9 deg on 200 m.
    """
    mi = mitsuba()
    hit = scene.ray_intersect(ray, mi.RayFlags.All, mi.Bool(coherent), active)
    hit.p = dr.select(hit.is_valid(), ray(hit.t), hit.p)
    return hit


def travel(
    scene: Any, ray: Any, medium: Medium | None, rng: Any, active: Any, *, first: bool
) -> tuple[Any, Any, Any, Any]:
    """Where light that starts along a ray meets a surface: the hit, the last ray, whether there is
    one, and the length of the whole way. The air scatters it as often as it happens to.
    """
    hit = meet(scene, ray, first, active)
    if medium is None or not medium.scatters:
        active = active & hit.is_valid()
        return hit, ray, active, dr.select(active, hit.t, 0)
    return _walk(mitsuba(), scene, ray, hit, medium.free_path(rng), medium, rng, active)


def scattered_once_or_more(
    scene: Any, ray: Any, medium: Medium, rng: Any, active: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """As `travel`, of the light that is scattered at all; and the share of light that is."""
    mi = mitsuba()
    hit = meet(scene, ray, True, active)
    straight = dr.select(hit.is_valid(), hit.t, dr.inf)
    t = medium.free_path_within(straight, rng)
    share = 1 - medium.unscattered(straight)
    return *_walk(mi, scene, ray, hit, t, medium, rng, active), share


@dr.syntax
def _walk(
    mi: Any, scene: Any, ray: Any, hit: Any, t: Any, medium: Any, rng: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """Scatter after ``t``, and on until a surface is nearer than the next scattering."""
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
        hit = meet(scene, ray, False, active)
        distance = dr.select(hit.is_valid(), hit.t, dr.inf)
        t = medium.free_path(rng)
    active &= hit.is_valid() & (t >= distance)
    return hit, ray, active, length + dr.select(active, hit.t, 0)
