"""The kernel of the ray tracer: rays out, currents on every further facet they meet, echo back.

Everything is an array on the device, one element per ray; vectors are float64 but for what meets
triangles.
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr

from twin.radar.scattering.arrays import ComplexVector3, Index, Mask, Real, Vector3
from twin.radar.scattering.surface import TABLE_STEPS
from twin.radar.scattering.target import TargetScene

_PASSED, _STOPPED = 0.5, 0.9  # cycles of phase from tube to tube


def launch(mi: Any, setting: dict[str, Any], index: Index) -> tuple[Any, ...]:
    """Start of the rays of a grid by index: point, direction, path so far, weight, tube, field.

    Points are relative to the mesh's centre, paths to the distance of the target's origin.
    """
    u, q = setting["towards"], setting["inverse_distance"]
    spacing = setting["spacing"]
    row = index // setting["columns"]
    column = index - row * setting["columns"]
    a = (mi.Float64(column) + setting["left"]) * spacing
    b = (mi.Float64(row) + setting["bottom"]) * spacing
    x = setting["center"] + a * setting["first"] + b * setting["second"]
    ray = q * x - u
    stretch = dr.norm(ray)
    direction = ray / stretch
    path = (q * dr.squared_norm(x) - 2 * dr.dot(u, x)) / (1 + stretch)
    weight = spacing**2 * dr.dot(direction, setting["forward"]) / stretch**2
    x -= setting["center_of_mesh"]
    back = dr.minimum(stretch * setting["distance"], dr.dot(direction, x) + setting["radius"])
    tube = (setting["first"] * spacing / stretch, setting["second"] * spacing / stretch)
    field = turned(setting["sent"], u, direction)
    return x - direction * back, direction, path - back, weight, *tube, field


def turned(e: Vector3, u: Vector3, direction: Vector3) -> Vector3:
    """Polarisation ``e`` of the boresight -u, in another direction of the antenna's field."""
    return e - dr.dot(e, direction) / dr.maximum(1 - dr.dot(u, direction), 1e-9) * (direction - u)


@dr.syntax
def trace(
    mi: Any,
    engine: TargetScene,
    setting: dict[str, Any],
    coefficients: Real,
    max_bounces: Index,
    origin: Vector3,
    direction: Vector3,
    path: Real,
    weight: Real,
    tube_a: Vector3,
    tube_b: Vector3,
    sent: Vector3,
) -> tuple[Real, ...]:
    """Follow every ray. Six numbers for each: its echo after two and more reflections in V and H
    (Re, Im each); its weight where it hits, and where it is unfinished.

    ``listener`` is the direction of the receiver.
    """
    u, q, radius = setting["listener"], setting["inverse_distance"], setting["radius"]
    wavelength = setting["wavelength"]
    field = ComplexVector3(mi.Vector3d(sent), mi.Vector3d(0))
    vertical, horizontal = mi.Vector2d(0), mi.Vector2d(0)  # Re and Im
    lit, unfinished = mi.Float64(0), mi.Float64(0)
    bounce = mi.UInt32(0)
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))
    hit = engine.scene.ray_intersect_preliminary(ray, coherent=True)
    face, coarse, active = hit.prim_index, mi.Float64(hit.t), hit.is_valid()
    while active:
        normal, distance = plane(mi, engine, face, origin, direction, active)
        # On a facet seen edge on the plane says nothing about the distance.
        distance = dr.select(dr.abs(distance - coarse) < 1e-3 * radius, distance, coarse)
        origin = origin + distance * direction
        path += distance
        cosine = -dr.dot(normal, direction)

        surface = dr.gather(mi.UInt32, engine.surface_of_face, face, active)
        row = coefficients_at(mi, coefficients, surface, cosine, active)
        away = direction + 2 * cosine * normal
        reflected_field = reflected(field, direction, normal, row)

        # Back to the receiver: unit vector, distance over and minus that of the origin.
        place = origin + setting["center_of_mesh"]
        towards = u - q * place
        scale = dr.maximum(dr.norm(towards), 1e-12)
        back = towards / scale
        detour = (q * dr.squared_norm(place) - 2 * dr.dot(u, place)) / (1 + scale)
        offset = normal * (4e-6 * radius)
        reach = mi.Float(dr.minimum(scale * setting["distance"], 3 * radius))
        shadow = mi.Ray3f(mi.Point3f(origin + offset), mi.Vector3f(back), reach, 0.0, [])
        later = active & (bounce > 0)
        sees = later & ~engine.scene.ray_test(shadow, active=later)

        amplitude = weight * (1 + q * path) / scale / dr.maximum(cosine, 1e-9)
        step = (direction - back) * (1 + q * path)
        amplitude *= followed(tube_a, step, direction, normal, cosine, wavelength)
        amplitude *= followed(tube_b, step, direction, normal, cosine, wavelength)
        cycles = (path + detour) / wavelength
        turn_im, turn_re = dr.sincos(2 * dr.pi * (dr.round(cycles) - cycles))
        turn_re *= amplitude
        turn_im *= amplitude
        current = radiating(field, reflected_field, direction, away, normal, back)
        for e, echo in ((setting["vertical"], vertical), (setting["horizontal"], horizontal)):
            received = turned(e, u, -back)
            re, im = dr.dot(received, current.re), dr.dot(received, current.im)
            echo.x += dr.select(sees, re * turn_re - im * turn_im, 0)
            echo.y += dr.select(sees, re * turn_im + im * turn_re, 0)
        lit += dr.select(bounce == 0, weight, 0)

        field, direction = reflected_field, away
        tube_a -= 2 * dr.dot(normal, tube_a) * normal
        tube_b -= 2 * dr.dot(normal, tube_b) * normal
        bounce += 1
        active &= dr.squared_norm(field.re) + dr.squared_norm(field.im) > 1e-12
        following = mi.Ray3f(mi.Point3f(origin + offset), mi.Vector3f(direction))
        struck = engine.scene.ray_intersect_preliminary(following, active=active)
        face, coarse = struck.prim_index, mi.Float64(struck.t)
        active &= struck.is_valid()
        unfinished += dr.select(active & (bounce == max_bounces), weight, 0)
        active &= bounce < max_bounces
    return vertical.x, vertical.y, horizontal.x, horizontal.y, lit, unfinished


def plane(
    mi: Any, engine: Any, face: Index, origin: Vector3, direction: Vector3, active: Mask
) -> tuple[Vector3, Real]:
    """Normal against the ray, and the float64 distance along it to the facet's plane."""
    x, y, z, a, b, c = (
        dr.gather(mi.Float64, engine.planes, 6 * face + i, active) for i in range(6)
    )
    normal = mi.Vector3d(a, b, c)
    along = dr.dot(normal, direction)
    distance = dr.dot(normal, mi.Vector3d(x, y, z) - origin) / along
    return normal * dr.select(along < 0, 1.0, -1.0), distance


def coefficients_at(
    mi: Any, coefficients: Real, surface: Index, cosine: Real, active: Mask, columns: int = 4
) -> list[Real]:
    """Re and Im of a surface's coefficients TE and TM, between two rows of the table."""
    at = dr.clip(cosine, 0, 1) * TABLE_STEPS
    below = dr.minimum(mi.UInt32(at), TABLE_STEPS - 1)
    share = at - mi.Float64(below)
    row = columns * (surface * (TABLE_STEPS + 1) + below)
    return [
        (1 - share) * dr.gather(mi.Float64, coefficients, row + i, active)
        + share * dr.gather(mi.Float64, coefficients, row + i + columns, active)
        for i in range(columns)
    ]


def reflected(
    field: ComplexVector3, direction: Vector3, normal: Vector3, coefficients: Sequence[Real]
) -> ComplexVector3:
    """Reflected field by the Re and Im of TE and TM.

    A conductor's mirror image times TM, and what TE differs from it across the plane of incidence.
    That difference vanishes at normal incidence, where "across" has no meaning.
    """
    te_re, te_im, tm_re, tm_im = coefficients
    across = dr.cross(direction, normal)
    across_norm = dr.maximum(dr.squared_norm(across), 1e-30)
    image, part = [], []
    for real in (field.re, field.im):
        image.append(2 * dr.dot(normal, real) * normal - real)
        part.append(across * (dr.dot(across, real) / across_norm))
    more_re, more_im = te_re + tm_re, te_im + tm_im
    return ComplexVector3(
        tm_re * image[0] - tm_im * image[1] + more_re * part[0] - more_im * part[1],
        tm_im * image[0] + tm_re * image[1] + more_im * part[0] + more_re * part[1],
    )


def radiating(
    field: ComplexVector3,
    reflected_field: ComplexVector3,
    direction: Vector3,
    away: Vector3,
    normal: Vector3,
    back: Vector3,
) -> ComplexVector3:
    """J + M x s, with the impedance of free space taken out."""

    def of(field: Vector3, reflected_field: Vector3) -> Vector3:
        magnetic = dr.cross(direction, field) + dr.cross(away, reflected_field)
        current = dr.cross(normal, magnetic)
        return current - dr.cross(dr.cross(normal, field + reflected_field), back)

    return ComplexVector3(of(field.re, reflected_field.re), of(field.im, reflected_field.im))


def followed(
    side: Vector3,
    step: Vector3,
    direction: Vector3,
    normal: Vector3,
    cosine: Real,
    wavelength: Real,
) -> Real:
    """1 while neighbouring tubes follow the phase on the facet, smoothly to 0 before they alias."""
    along = side + direction * (dr.dot(normal, side) / dr.maximum(cosine, 1e-9))
    cycles = dr.abs(dr.dot(step, along)) / wavelength
    late = (cycles - _PASSED) / (_STOPPED - _PASSED)
    fading = dr.square(dr.cos(0.5 * dr.pi * dr.maximum(late, 0)))
    return dr.select(late < 1, fading, 0)
