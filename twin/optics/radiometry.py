"""Closed forms of the optical chain: etendue, field, and the power a flat wall sends back."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin.files import InputError
from twin.system import System

Array = NDArray[np.float64]
Outline = Literal["square", "disc"]
FAR = 100.0  # radii of the pupil
_PARTS = 64  # of the field along each side, over which the filter's shift is averaged


def cell_centres(n: int) -> NDArray[np.float64]:
    """Middles of n cells side by side across a field from -1 to 1."""
    return (2 * np.arange(n) + 1) / n - 1


@dataclass(frozen=True)
class Collection:
    """Field, focal length, f-number and pupil of the detector's lens, which determine each other.

    ``tan_half_field`` is that of the square's half width or the disc's radius. ``pupil_area_m2``
    is the effective entrance pupil: on axis, a field of radiance L fills the detector with
    pi L A / (4 N^2 + 1), so etendue and thin-lens formula agree at every f-number.
    """

    outline: Outline
    tan_half_field: float
    focal_length_m: float
    pupil_diameter_m: float
    pupil_area_m2: float
    transmission: float

    @property
    def field_area(self) -> float:
        """Area of the field on the plane at distance 1."""
        return field_area(self.tan_half_field, self.outline)


def field_area(tan_half_field: float, outline: Outline) -> float:
    """Area of a square or disc on the plane at distance 1."""
    return (4 if outline == "square" else math.pi) * tan_half_field**2


def field_stop(system: System) -> tuple[float, Outline]:
    """Tangent of half the detector's field, and its outline."""
    tangent = math.tan(math.radians(system.optics.field_of_view_deg.value) / 2)
    return tangent, "square" if system.has_square_field else "disc"


def collection(system: System) -> Collection:
    """Lens, field stop and filter of a system, as one collector."""
    optics, focal_length = system.optics, system.focal_length_m
    tangent, outline = field_stop(system)
    n = optics.f_number.value
    return Collection(
        outline=outline,
        tan_half_field=tangent,
        focal_length_m=focal_length,
        pupil_diameter_m=focal_length / n,
        pupil_area_m2=math.pi * focal_length**2 / (4 * n**2 + 1),
        transmission=optics.transmission.value * system.filter.transmission.value,
    )


def mean_cos_power(power: float, tan_half_field: float, outline: Outline) -> float:
    """Mean of cos^power over a field, uniform on the plane at distance 1.

    Over a 20 deg square: 0.96999 for cos^3, 0.93191 for cos^7.
    """
    node, weight = np.polynomial.legendre.leggauss(64)
    t = tan_half_field
    if outline == "square":
        x2 = (t * node) ** 2
        cos2 = 1 / (1 + x2[:, None] + x2)
        return float(weight @ cos2 ** (power / 2) @ weight / 4)
    r2 = t**2 * (node + 1) / 2  # uniform in r^2
    return float(weight @ (1 + r2) ** (-power / 2) / 2)


def field_angles(half: float, power: int, seen: tuple[float, Outline]) -> tuple[Array, Array]:
    """Angles to the axis, degrees, over a square of half width ``half`` on the plane at distance 1,
    and cos^power there, 0 outside what is ``seen``: half width or radius, and outline.
    """
    radius = np.hypot(*np.meshgrid(*[cell_centres(_PARTS) * half] * 2))
    angles = np.arctan(radius)
    outside = (seen[1] == "disc") & (radius > seen[0])
    return np.degrees(angles), np.cos(angles) ** power * ~outside


def near_pupil_m(lens: Collection, distance_m: float) -> float:
    """Radius of the pupil where its area matters at this distance, else 0: as a point it takes
    (R / z)^2 too much, less than 1e-4 from 100 radii on.
    """
    radius = lens.pupil_diameter_m / 2
    return radius if distance_m < FAR * radius else 0.0


def lit_tan(system: System) -> float:
    """Tangent of half the emitter's square field; without a lens it lights all that is seen."""
    if not system.emitter.has_lens:
        return math.inf
    return math.tan(math.radians(system.emitter.field_of_view_deg.value) / 2)


def lit_share(system: System) -> float:
    """Of the detector's field, what the emitter lights, both on one axis."""
    half, lit = math.tan(math.radians(system.optics.field_of_view_deg.value) / 2), lit_tan(system)
    if lit >= half:
        return 1.0
    if system.has_square_field:
        return (lit / half) ** 2
    node, weight = np.polynomial.legendre.leggauss(64)
    return float(weight @ _within_disc(half, lit, lit * node)) * 2 * lit / (math.pi * half**2)


def _within_disc(radius: float, half: float, across: Array) -> Array:
    """Half the height of what a disc leaves of a square, at places across it (n, ...)."""
    return np.minimum(half, np.sqrt(np.maximum(radius**2 - across**2, 0)))


def wall_power_w(
    system: System, reflectance: float, distance_m: float, baseline_m: float = 0.0
) -> float:
    """Signal power on the detector from a wall that fills the field, all cells lit, in watts.

    I rho tau A / ((4 N^2 + 1) z^2) x <cos^7> for a square field at baseline 0: cos^3 from the
    emitter's irradiance on the wall, cos^4 from the flat pupil and the lens's image plane. With a
    horizontal baseline b, and where the emitter's field is narrower than the detector's, the common
    part of both remains, of two alike square fields 1 - b / (2 z tan), and the cosines belong to
    slightly different directions; the integral is over that part. Near the pupil, of radius R, the
    distance d to it counts as sqrt(d^2 + R^2) (`Device.disc_radius_m`).
    """
    lens = collection(system)
    if lens.outline != "square" and baseline_m:
        raise InputError("closed form with a baseline holds for square fields only")
    near = (near_pupil_m(lens, distance_m) / distance_m) ** 2
    field = lens.tan_half_field, lens.outline
    integral = _wall_integral(*field, lit_tan(system), baseline_m / distance_m, near)
    intensity = system.emitter.radiant_intensity_w_per_sr.value
    gain = intensity * reflectance / math.pi * lens.transmission * lens.pupil_area_m2
    return gain * integral / distance_m**2


def wall_share(system: System) -> float:
    """Light of a far wall, all cells lit, over that of the on-axis formula with all of the field
    lit: the lit share with the cosines of the field.
    """
    t, outline = field_stop(system)
    return _wall_integral(t, outline, lit_tan(system)) / field_area(t, outline)


def _wall_integral(
    t: float, outline: Outline, lit: float, shift: float = 0.0, near: float = 0.0
) -> float:
    """Integral of the cosines over what is seen and lit on the plane at distance 1.

    ``shift``: baseline over distance; ``near``: (R / z)^2 of the pupil, where it counts.
    """
    node, weight = np.polynomial.legendre.leggauss(64)
    if outline == "square" or lit < t:
        low, high = max(-lit, shift - t), min(lit, shift + t)
        if low >= high:
            return 0.0
        x = ((low + high) / 2 + (high - low) / 2 * node)[:, None]
        up = _within_disc(t, lit, x) if outline == "disc" else np.full_like(x, min(lit, t))
        y = up * node
        from_emitter = 1 + x**2 + y**2
        to_detector = 1 + (x - shift) ** 2 + y**2
        # emitter: cos^3 per tangent area; wall and pupil: cos^2; distance: cos^2
        kernel = up * from_emitter**-1.5 / to_detector**2
        if near:
            kernel /= 1 + near / to_detector
        return float(weight @ kernel @ weight) * (high - low) / 2
    if near:
        cos2 = 1 / (1 + t**2 * (node + 1) / 2)
        return float(weight @ (cos2**3.5 / (1 + near * cos2)) / 2) * field_area(t, outline)
    return mean_cos_power(7, t, "disc") * field_area(t, outline)
